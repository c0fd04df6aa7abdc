/* nvdb_writer_internal.h - state of a grid writer: streams in temporary files, and the open nodes.
 */
#ifndef FMT_GRID_NVDB_WRITER_INTERNAL_H
#define FMT_GRID_NVDB_WRITER_INTERNAL_H

#include "formats/grid/nvdb_layout_internal.h"

#define NVDB_STREAM_BYTES (UINT64_C(256) << 10)

/* A part of a section that grows in a temporary file, through a buffer of NVDB_STREAM_BYTES. */
struct nvdb_stream {
    struct bsq_ctx *ctx;
    struct bsq_file file;
    uint64_t size; /* bytes written so far */
    uint8_t *buffer;
    uint64_t fill; /* bytes in the buffer */
    /* XXH3 states of the bytes that were written to the file, and of those read from it so far. */
    void *written, *read;
};

/* ---- nvdb_stream.c ---- */

/* Opens a stream in a temporary file. beside: path of the output. what: for messages. */
int fmt_nvdb_stream_open(struct bsq_ctx *ctx, const char *beside, const char *what,
                         struct nvdb_stream *stream);
/* Sets *out to space for `size` <= NVDB_STREAM_BYTES bytes. The caller adds what it writes there to
 * stream->fill. */
int fmt_nvdb_stream_reserve(struct nvdb_stream *stream, uint64_t size, void *out);
int fmt_nvdb_stream_put(struct nvdb_stream *stream, const void *bytes, uint64_t size);
/* Flushes and frees the buffer; nothing can be added any more. */
int fmt_nvdb_stream_end(struct nvdb_stream *stream);
/* Closes a stream and frees its memory; a zeroed stream is allowed. */
void fmt_nvdb_stream_close(struct nvdb_stream *stream);

/* ---- nvdb_writer.c ---- */

/* Stubs: an internal node without its table, which needs the totals. */
struct nvdb_lower_stub {
    int32_t bbox_min[3], bbox_max[3];
    uint64_t child_mask[64];
};
struct nvdb_upper_stub {
    int32_t bbox_min[3], bbox_max[3];
    uint64_t child_mask[512];
};

enum nvdb_writer_stream {
    STREAM_UPPERS, /* stubs */
    STREAM_LOWERS, /* stubs */
    STREAM_LEAVES,
    STREAM_NORMALS,
    STREAM_PLANES,
    STREAM_COLORS,
    STREAM_SECOND_NORMALS, /* this and the next two: of second records */
    STREAM_SECOND_PLANES,
    STREAM_SECOND_COLORS,
    STREAM_SECOND_WORDS,
    STREAM_IDS,
    STREAM_SECOND_IDS,      /* of second records */
    STREAM_CHANNELS,        /* the head of the section, and values */
    STREAM_SECOND_CHANNELS, /* of second records */
    STREAM_COUNT
};

struct fmt_nvdb_writer {
    struct bsq_ctx *ctx;
    struct bsq_output *output;
    char *path;
    struct fmt_nvdb_info info;
    struct nvdb_stream stream[STREAM_COUNT];
    int failed; /* status of the first failure; nothing can be committed after it */

    uint8_t *names; /* section NVDB_NAMES, counts.name_bytes; NULL: no ids */

    uint64_t *keys; /* of the root tiles so far */
    uint64_t keys_capacity;
    struct nvdb_upper_stub *upper; /* the open upper node, of the last key */
    uint32_t last_slot;            /* of the open lower node in the upper node */
    struct nvdb_lower_stub lower;  /* the open lower node; valid if counts.lowers > 0 */
    uint32_t last_leaf;            /* number of the last leaf in the lower node */

    struct nvdb_counts counts;
    int32_t bbox_min[3], bbox_max[3];
    uint32_t entry_bits, entry_rank; /* the open entry of section NVDB_SECONDS */
};

/* The streams of a section: its first part, and second records after it. Either may be NULL. */
struct nvdb_section_streams {
    struct nvdb_stream *first, *second;
};
struct nvdb_section_streams fmt_nvdb_streams_of(struct fmt_nvdb_writer *writer, int section);

/* Closes the open nodes, writes all buffers to the temporary files and frees the buffers. */
int fmt_nvdb_writer_finish(struct fmt_nvdb_writer *writer);

#endif
