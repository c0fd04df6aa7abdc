/* mesh_stream.h - private to formats/mesh: reads files part by part, on all threads.
 *
 * A format cuts its files into parts, serially and in order, and parses each part alone. This file
 * does the rest: it opens the files, runs the pipeline, counts elements, and finds the part that
 * holds a face again. Everything that depends on earlier parts is done as parts pass in order. */
#ifndef FMT_MESH_STREAM_H
#define FMT_MESH_STREAM_H

#include "formats/mesh/mesh_arrays.h"
#include "formats/mesh/mesh_format.h"

/* Bytes of a file that one part has, as a rule. The part and what is parsed from it fit a core's
 * cache. Fuzz targets cut their small files too. */
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION
#define STREAM_PART_BYTES ((uint64_t)48)
#else
#define STREAM_PART_BYTES ((uint64_t)256 << 10)
#endif

struct stream_source {
    struct fmt_input *input; /* open from the first cut to the pass of the last part */
    const char *path;        /* of the input */
    bool open;
    /* Elements of the scan in earlier files, and in this file as far as it has passed. */
    uint64_t base[FMT_MESH_KIND_COUNT], count[FMT_MESH_KIND_COUNT];
};

/* What a cut says of a part: enough to parse it again. */
struct stream_part {
    uint32_t source;
    uint64_t offset, size; /* bytes of the file that hold its elements */
    uint64_t end;          /* all bytes before it belong to this part or to earlier ones */
    uint64_t first_line;   /* of text, from 1; 0: the format has no lines */
    uint64_t lines;        /* that the part has */
    bool failed;           /* it has an error: no part of this file follows */
    /* For the format: what the part holds, how many of it, and how many came before; how much of
     * it is still to come, and what the parser must know of the bytes before and tell the next. */
    uint32_t kind;
    uint64_t items, first_item, left;
    uint32_t carry, carry_out;
};

/* A part and what was parsed from it. The buffers are reused. */
struct stream_slot {
    struct stream_part part;
    uint8_t *bytes; /* of the part; the cut or the parse loads them */
    uint64_t capacity;
    bool loaded; /* `bytes` holds the part */
    struct mesh_arrays arrays;
    uint8_t *work; /* memory of the format */
    uint64_t work_capacity;
    int64_t balance;   /* a count of the format */
    float color_white; /* as in struct fmt_mesh_block */
    /* Faces with fewer than three corners, which were skipped. Normals, colours and lists of
     * texture coordinates that are no numbers, and so are missing. */
    uint64_t short_faces, bad_normals, bad_colors, bad_texcoords, clamped_colors;
    uint64_t missing_positions, missing_texcoords; /* as in struct fmt_mesh_block */
    /* Faces whose texture the file does not name, and the line or byte of the first. */
    uint64_t lost_textures, lost_texture_at;
    uint64_t last_face; /* parsing stops after this face of the part; UINT64_MAX: never */
    uint64_t at;        /* line or byte of the file where parsing stopped */
    char error[200];    /* what is wrong there; "": nothing */
    struct fmt_mesh_block view;
};

struct stream_place {
    struct stream_part part;
    uint64_t face_base;
};

struct stream_reader {
    struct fmt_mesh_reader base; /* must be first */
    const struct stream_format *stream;
    struct stream_source *sources;
    uint32_t source_count;
    struct stream_place *places; /* parts with faces, in order */
    uint64_t place_count, place_capacity;
};

/* What a format does. The reader is a structure that begins with a struct stream_reader. */
struct stream_format {
    const char *reader_name; /* for messages about memory: "PLY reader" */
    size_t reader_bytes;     /* size of the format's reader */
    /* Allocates what the reader has for each file. */
    int (*prepare)(struct stream_reader *reader);
    /* Reads the start of file number `source`. Called for each file, in order. */
    int (*begin)(struct stream_reader *reader, uint32_t source);
    /* Frees the reader, also after a failure of `prepare` or `begin`. */
    void (*end)(struct fmt_mesh_reader *reader);
    /* Open and close what belongs to file number `source` besides the file itself, before its first
     * cut and after its last part has passed. Both may be NULL. Closing what is not open does
     * nothing; after a failure of `open` it is called too. */
    int (*open)(struct stream_reader *reader, uint32_t source);
    int (*close)(struct stream_reader *reader, uint32_t source);
    /* Sets slot->part to the part after `before`, which is all zero but for `source` at the start
     * of a file. Returns 1, or 0 if the file has no more parts. May load slot->bytes; then it sets
     * slot->loaded. What is wrong with the file goes to slot->error, as in `parse`. */
    int (*cut)(struct stream_reader *reader, const struct stream_part *before,
               struct stream_slot *slot);
    /* Fills slot->arrays with indices that count from the start of the file. Thread-safe. What is
     * wrong with the file goes to slot->error, with slot->at: parts are parsed in any order, and
     * only the first error of the files is reported. */
    int (*parse)(struct stream_reader *reader, struct stream_slot *slot);
    /* Completes the arrays by what depends on earlier parts. Serial, in order. May be NULL. */
    int (*pass)(struct stream_reader *reader, struct stream_slot *slot,
                struct fmt_mesh_totals *totals);
};

/* Implements `open` of struct fmt_mesh_format: makes a reader of stream->reader_bytes, and reads
 * the start of each file. */
int fmt_stream_open(struct bsq_ctx *ctx, const struct stream_format *stream,
                    struct fmt_input *const *inputs, uint32_t input_count,
                    struct fmt_mesh_reader **out);
/* Frees the reader and what fmt_stream_open() gave it. */
void fmt_stream_free(struct stream_reader *reader);

/* Implements `read` of struct fmt_mesh_format. */
int fmt_stream_read(struct stream_reader *reader, const struct fmt_mesh_steps *steps, void *arg,
                    struct fmt_mesh_totals *totals);

/* Finds the part that holds face number `face` of the scan, and parses it up to this face.
 * out->line is set if the format has lines, else out->byte. */
int fmt_stream_locate_face(struct stream_reader *reader, uint64_t face, struct fmt_mesh_place *out);

/* Ensures capacity for `size` bytes of a part and STREAM_PADDING bytes after them. */
int fmt_stream_reserve(struct bsq_ctx *ctx, struct stream_slot *slot, uint64_t size);
#define STREAM_PADDING ((uint64_t)64)

/* Extends a part's loaded bytes from `have` on to `size` of them, from the part's offset; to fewer
 * at the end of the file. *loaded: their number. *at_end: the file ends with them, for certain. */
int fmt_stream_extend(struct stream_reader *reader, struct stream_slot *slot, uint64_t have,
                      uint64_t size, uint64_t *loaded, bool *at_end);

/* Loads the bytes of a part, unless they are loaded. */
int fmt_stream_load(struct stream_reader *reader, struct stream_slot *slot);

/* Describes what is wrong with a part, at a line or byte of its file; 0: the text says where.
 * Returns 0, so that a parse function can return it. Only the first description of a part is kept.
 */
int fmt_stream_fail(struct stream_slot *slot, uint64_t at, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

#endif
