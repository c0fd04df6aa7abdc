/* mesh_format.h - private to formats/mesh: what a mesh format implements, and the registry.
 *
 * A format is one source file that defines a `struct fmt_mesh_format`, and one row below. All files
 * of a scan are read as one stream (mesh_stream.c), whatever their formats. A format cuts a file
 * into blocks, serially and in order, and parses each block alone, on any thread. The stream does
 * the rest: it opens the files, runs the pipeline, counts elements, moves meshes, and finds the
 * block that holds a face again. What depends on earlier blocks is done when the blocks pass in
 * order.
 *
 * A block becomes one batch. Blocks are the same for each reading, any budget and any number of
 * threads. They take up to about 4 MiB. */
#ifndef FMT_MESH_FORMAT_H
#define FMT_MESH_FORMAT_H

#include "base/text.h"
#include "formats/input/input.h"
#include "formats/mesh/mesh_reader.h"

/* Bytes of a file that one block has, as a rule. The block and what is parsed from it fit a core's
 * cache. Fuzz targets cut their small files too. */
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION
#define STREAM_BLOCK_BYTES ((uint64_t)48)
#else
#define STREAM_BLOCK_BYTES ((uint64_t)256 << 10)
#endif

/* Something that a file has and that is not read as it is, such as positions that are not finite.
 * Each format has a list of them; the first ones are common to all. */
struct stream_oddity {
    uint64_t count, at; /* at: line or byte of the first; 0: unknown */
};
enum {
    STREAM_NO_POSITION, /* positions that are not finite: all numbers become NaN */
    STREAM_NO_TEXCOORD, /* texture coordinates likewise */
    STREAM_NO_NORMAL,   /* normals likewise; they become 0 */
    STREAM_NO_COLOR,    /* colours of vertices likewise; they become -1 */
    STREAM_FORMAT_ODDITIES,
    STREAM_ODDITY_COUNT = STREAM_FORMAT_ODDITIES + 4
};

/* Growing arrays for the elements and faces of one block; reused, so only the first blocks
 * allocate. Fields are those of struct fmt_mesh_batch. */
struct mesh_arrays {
    double (*positions)[3];
    float (*colors)[3];
    double (*texcoords)[2];
    float (*normals)[3];
    uint32_t *late_colors;
    uint32_t *face_sizes;
    uint64_t *corners[FMT_MESH_KIND_COUNT];
    uint32_t *face_tags; /* what decides the material of each face; the format says what it is */
    struct fmt_mesh_material_change *changes;

    uint64_t count[FMT_MESH_KIND_COUNT];
    uint64_t late_color_count, face_count, corner_count, change_count;
    bool has_colors;
    bool has_corners[FMT_MESH_KIND_COUNT];
    uint64_t vertex_bound; /* above all vertex indices; UINT64_MAX, unless the parser counts it */

    uint64_t position_capacity, color_capacity, texcoord_capacity, normal_capacity;
    uint64_t late_color_capacity, size_capacity, corner_capacity[FMT_MESH_KIND_COUNT];
    uint64_t tag_capacity, change_capacity;
};

/* Ensures capacity for `count` elements of one of these arrays. Errors: BSQ_ENOMEM. */
#define FMT_RESERVE(ctx, count, array, capacity)                                                   \
    ((count) <= (capacity) ? 0 : BSQ_GROW(ctx, "batches of a mesh", count, &(array), &(capacity)))

/* One file of the scan. */
struct stream_source {
    struct bsq_ctx *ctx;
    struct fmt_mesh_reader *reader;
    const struct fmt_mesh_format *format;
    uint32_t number;
    struct fmt_input *input; /* owned; open from the first cut to the pass of the last block */
    const char *path;        /* of the input */
    bool open;
    bool held;  /* the input stays open from the start of the reader to the first cut */
    void *data; /* what the format keeps of the file: format->data_bytes, zero at first */
    struct bsq_placement placement;
    bool moves; /* the placement changes something */
    /* Elements of the scan in earlier files, and in this file as far as it has passed. */
    uint64_t base[FMT_MESH_KIND_COUNT], count[FMT_MESH_KIND_COUNT];
    uint64_t late_color_count, face_base;
    uint64_t lines; /* that have passed, for formats whose cut does not know `first_line` */
    /* Numbers over the scan of the file's materials or, if the reader numbers objects, of its
     * objects. So many as `begin` says are assigned when the first block of the file passes. */
    uint32_t *numbers;
    uint64_t number_count, number_capacity, material_count, object_count;
};

/* What a cut says of a block: enough to parse it again. */
struct stream_block {
    uint32_t source;
    uint64_t offset, size; /* bytes of the file that hold its elements */
    uint64_t end;          /* all bytes before it belong to this block or to earlier ones */
    uint64_t first_line;   /* of text, from 1; 0: the format has no lines */
    uint64_t lines;        /* that the block has */
    bool failed;           /* it has an error: no block of this file follows */
    /* For the format: what the block holds, how many of it, and how many came before; how much of
     * it is still to come, and what the parser must know of the bytes before and tell the next. */
    uint32_t kind;
    uint64_t items, first_item, left;
    uint32_t carry, carry_out;
};

/* A statement of a text that names a material, an object or a file of materials. */
struct stream_statement {
    int kind;
    uint64_t face; /* number of faces of the block before it */
    uint64_t line; /* of the block, from 0 */
    uint64_t offset, size;
};

/* A block and what was parsed from it. The buffers are reused. */
struct stream_slot {
    struct bsq_ctx *ctx;
    struct stream_source *source;
    struct stream_block block;
    uint8_t *bytes; /* of the block; the cut or the parse loads them */
    uint64_t capacity;
    bool loaded; /* `bytes` holds the block */
    struct mesh_arrays arrays;
    uint8_t *work; /* memory of the format */
    uint64_t work_capacity;
    struct stream_statement *statements;
    uint64_t statement_count, statement_capacity;
    bool finite;                /* the parser saw that all numbers of the file are finite */
    unsigned local;             /* a bit for each kind whose indices count from the first element
                                   of the block, and not of the file */
    int64_t balance;            /* a count of the format */
    float color_white;          /* as in struct fmt_mesh_batch */
    bool fine_colors;           /* likewise; a format sets it where that may be */
    uint32_t material_at_start; /* likewise; set by `pass` */
    uint64_t short_faces;       /* faces with fewer than three corners, which were skipped */
    struct stream_oddity odd[STREAM_ODDITY_COUNT];
    uint64_t last_face; /* parsing stops after this face of the block; UINT64_MAX: never */
    uint64_t at;        /* line or byte of the file where parsing stopped */
    char error[200];    /* what is wrong there; "": nothing */
    struct fmt_mesh_batch view;
};

/* Where a face is, for messages. */
struct fmt_mesh_location {
    const char *path;    /* owned by the reader */
    uint64_t line;       /* from 1; 0: the format has none */
    uint64_t byte;       /* of the file, from 0; 0: unknown, then messages count faces */
    uint64_t first_face; /* then: the face of the scan that is the first of the file */
    bool from_zero;      /* the file counts elements from 0, and not from 1 */
    /* By kind: elements of the scan in files before the face's file, and in the face's file. */
    uint64_t base[FMT_MESH_KIND_COUNT], count[FMT_MESH_KIND_COUNT];
};

/* What a format does. Functions return 0 or a status, and are not NULL, unless their comment
 * says so. */
struct fmt_mesh_format {
    const char *name;   /* for messages: "OBJ" */
    const char *suffix; /* of file names, with its point, in any case: ".obj". Blanks separate
                           several. */
    bool from_one;      /* files count elements from 1, and not from 0 */
    size_t data_bytes;  /* of source->data; 0: NULL */
    /* What to say of its oddities: "positions are not finite". NULL: nothing. */
    const char *oddities[STREAM_ODDITY_COUNT];
    /* Returns true if the first bytes of a file show this format beyond doubt. `head` is the first
     * FMT_MESH_HEAD_BYTES, or the whole file if it is shorter; no zero follows it. May be NULL. */
    bool (*recognise)(const char *head, size_t size);
    /* Returns true if they may be of this format. Asked if no format recognises them, the suffix
     * tells nothing, and they are of no other known kind. May be NULL. */
    bool (*resembles)(const char *head, size_t size);
    /* Reads the start of a file. Called for each file, in order. The input is not open; it may be
     * packed, or a pipe, so its size is known only if fmt_input_size() knows it. May be NULL. */
    int (*begin)(struct stream_source *source);
    /* Frees what source->data refers to, also after a failure of `begin`. May be NULL. */
    void (*end)(struct stream_source *source);
    /* Open and close what belongs to a file besides the file itself, before its first cut and after
     * its last block has passed. Both may be NULL. Closing what is not open does nothing; after a
     * failure of `enter` it is called too. */
    int (*enter)(struct stream_source *source);
    int (*leave)(struct stream_source *source);
    /* Sets slot->block to the block after `before`, which is all zero but for `source` at the start
     * of a file. Returns 1, or 0 if the file has no more blocks. May load slot->bytes; then it sets
     * slot->loaded. What is wrong with the file goes to slot->error, as in `parse`. */
    int (*cut)(const struct stream_block *before, struct stream_slot *slot);
    /* Fills slot->arrays with indices that count from the start of the file, or as slot->local
     * says, and materials that are numbers of `pass`. Numbers need not be finite: the stream counts
     * the others as oddities. May make slot->block more exact. Thread-safe.
     * What is wrong with the file goes to slot->error, with slot->at: blocks are parsed in any
     * order, and only the first error of the files is reported. No two arrays overlap: callers
     * change them. */
    int (*parse)(struct stream_slot *slot);
    /* Completes the arrays by what depends on earlier blocks. Serial, in order. Called also if
     * slot->error is set, which is reported then. Changes of materials have numbers over the scan
     * after it. May be NULL. */
    int (*pass)(struct stream_slot *slot);
    /* Called for each file, in order, after all have been read. Warns of what was not read if the
     * reader's read_before is not set. May be NULL. */
    int (*finish)(struct stream_source *source);
    /* Sets what a file has, and clears faces_come_last if elements follow faces. */
    int (*look)(struct stream_source *source, struct fmt_mesh_hints *out);
    /* Append what is known of a file's materials to the list: in the order in which the file counts
     * them, and as fmt_mesh_preview_materials() does. NULL: the format has no materials. */
    int (*read_materials)(struct stream_source *source, struct fmt_materials *out);
    int (*preview_materials)(struct stream_source *source, struct fmt_materials *out);
    /* Returns the name of an object of the file, and in *material the number of its
     * material in the file, or a number that no material has. NULL: the format has no objects. */
    const char *(*find_object)(const struct stream_source *source, uint64_t number,
                               uint32_t *material);
};

/* What there is to say of all files: see stream_oddity. */
struct stream_note {
    const char *text;
    uint32_t source; /* that has the first */
    bool bytes;      /* odd.at is a byte, and no line */
    struct stream_oddity odd;
};

/* Materials that lack a colour, counted over the files; see obj_material.c. */
struct stream_colorless {
    uint64_t count;
    uint32_t source;  /* that has the first */
    const char *name; /* of the first; owned by the source */
};

/* A block with faces. */
struct stream_face_block {
    struct stream_block block;
    uint64_t face_base;
};

struct fmt_mesh_reader {
    struct bsq_ctx *ctx;
    bool objects;     /* set by fmt_mesh_use_objects() */
    bool read_before; /* the files were read to their end: what there is to warn of is known */
    bool uses_colors; /* the caller previewed materials */
    bool has_colors;  /* of vertices, in any block that has passed */
    bool gltf_colors; /* a glTF file has colours of vertices */
    bool painted, unpainted;        /* files have late colours for each vertex; have not */
    struct fmt_mesh_totals *totals; /* of the reading that goes on */
    struct stream_source *sources;
    uint32_t source_count;
    uint64_t material_count; /* numbers that were assigned */
    struct bsq_tally names;  /* the memory of names that formats keep */
    struct stream_face_block *face_blocks;
    uint64_t face_block_count, face_block_capacity;
    struct stream_note *notes;
    uint64_t note_count, note_capacity;
    bool warns_of_materials; /* set by a preview, cleared by the first warning */
    /* Counted while materials are read: of files that name no library, of files whose libraries
     * lack them, and faces without a material beside others with colours. */
    struct stream_colorless bare, lost, plain;
};

/* ---- mesh_stream.c ---- */

/* Finds a face that has been read: parses the block that holds face number `face` of the scan up to
 * this face. */
int fmt_stream_locate_face(struct fmt_mesh_reader *reader, uint64_t face,
                           struct fmt_mesh_location *out);
/* Parses a block up to its face number `face`, at which *slot stays. Free it with
 * fmt_stream_free_slot(), also after a failure. */
int fmt_stream_parse_again(struct stream_source *source, const struct stream_block *block,
                           uint64_t face, struct stream_slot *slot);
void fmt_stream_free_slot(struct stream_slot *slot);

/* Ensures capacity for `size` bytes of a block and STREAM_PADDING bytes after them. */
int fmt_stream_reserve(struct stream_slot *slot, uint64_t size);
#define STREAM_PADDING ((uint64_t)64)
/* Extends a block's loaded bytes from `have` on to `size` of them, from the block's offset; to
 * fewer at the end of the file. *loaded: their number. *at_end: the file ends with them, for
 * certain. */
int fmt_stream_extend(struct stream_slot *slot, uint64_t have, uint64_t size, uint64_t *loaded,
                      bool *at_end);
/* Cuts and loads the next block of a text, of about `usual` bytes: from block.offset and
 * block.first_line, which pass what is blank. find: returns the bytes of whole elements at the
 * start of `have` loaded bytes, 0 if none is whole; sets block.lines to the line ends in these
 * bytes or, if there are none, in all. Returns 1, or 0 at the end of the file. */
int fmt_stream_cut_text(struct stream_slot *slot, uint64_t usual,
                        uint64_t (*find)(struct stream_slot *slot, uint64_t have, bool at_end));
/* Loads the bytes of a block, unless they are loaded. */
int fmt_stream_load(struct stream_slot *slot);

/* Describes what is wrong with a block, at a line or byte of its file; 0: the text says where.
 * Returns 0, so that a parse function can return it. Only the first description of a block is kept.
 */
int fmt_stream_fail(struct stream_slot *slot, uint64_t at, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Assigns the next number over the scan to a further material of a file. */
int fmt_stream_add_material(struct stream_source *source, uint32_t *number);

/* Turns the materials of a block, which count over its file, into numbers over the scan. */
void fmt_stream_number_materials(struct stream_slot *slot);

/* A kind of data that is not read. */
struct stream_unread {
    uint64_t count;
    bool loss; /* the scan is poorer by it */
    const char *what;
};
/* Warns of each kind that a file has: "scan.gltf: 2 meshes ...". Warns only once, when the files
 * are read for the first time. */
int fmt_stream_warn_unread(const struct stream_source *source, const struct stream_unread *kinds,
                           size_t count);

/* ---- obj_material.c ---- */

/* Warns of materials without a colour, after those of all files were read. */
int fmt_obj_finish_materials(struct fmt_mesh_reader *reader);

/* The registry. The first row also reads files that no row recognises. */
#define FMT_MESH_FORMATS(ROW)                                                                      \
    ROW(fmt_obj_format)                                                                            \
    ROW(fmt_ply_format) ROW(fmt_stl_format) ROW(fmt_gltf_format)

#define FMT_MESH_DECLARE(format) extern const struct fmt_mesh_format format;
FMT_MESH_FORMATS(FMT_MESH_DECLARE)
#undef FMT_MESH_DECLARE

#endif
