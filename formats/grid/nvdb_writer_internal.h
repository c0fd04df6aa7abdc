/* nvdb_writer_internal.h - state of a .nvdb writer: sections in temporary files, open nodes. */
#ifndef FMT_GRID_NVDB_WRITER_INTERNAL_H
#define FMT_GRID_NVDB_WRITER_INTERNAL_H

#include "formats/grid/nvdb_layout_internal.h"

/* A section that grows in a temporary file through one buffer. */
struct nvdb_stream {
    struct bsq_ctx *ctx;
    struct bsq_file file;
    uint8_t *buffer;
    uint64_t fill;
    void *hash; /* XXH3 state of all bytes so far; NULL where none is kept */
};

#define NVDB_STREAM_BYTES (UINT64_C(256) << 10)

/* beside: path of the output. what: for messages. */
int fmt_nvdb_stream_open(struct bsq_ctx *ctx, const char *beside, const char *what, bool hashed,
                         struct nvdb_stream *stream);
void fmt_nvdb_stream_close(struct nvdb_stream *stream); /* zeroed ones are allowed */
/* Makes room for up to `size` <= NVDB_STREAM_BYTES bytes at *out; the caller then adds to fill what
 * it has written there. */
int fmt_nvdb_stream_room(struct nvdb_stream *stream, uint64_t size, void *out);
int fmt_nvdb_stream_flush(struct nvdb_stream *stream);
/* Flushes, and gives the buffer back: nothing can be added any more. */
int fmt_nvdb_stream_end(struct nvdb_stream *stream);
/* Bytes written so far. */
uint64_t fmt_nvdb_stream_size(const struct nvdb_stream *stream);

/* What is kept of an internal node until the totals are known: its table follows from them. */
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
    STREAM_SECOND_NORMALS, /* in the order of the three above */
    STREAM_SECOND_PLANES,
    STREAM_SECOND_COLORS,
    STREAM_SECOND_WORDS,
    STREAM_COUNT
};

struct fmt_nvdb_writer {
    struct bsq_ctx *ctx;
    struct bsq_output *output;
    char *path;
    struct fmt_nvdb_info info;
    struct nvdb_stream stream[STREAM_COUNT];
    int failed; /* status of the first failure: nothing can be committed after it */

    uint64_t *keys; /* of the root tiles so far */
    uint64_t keys_capacity;
    struct nvdb_upper_stub *upper; /* the open one: the last of keys */
    uint32_t last_slot;            /* of the open region in it */
    struct nvdb_lower_stub lower;  /* the open region; there is one once counts.lowers > 0 */
    uint32_t last_leaf;            /* of the open region */

    struct nvdb_counts counts;
    int32_t bbox_min[3], bbox_max[3];
    uint32_t word_bits, word_rank; /* of the open word of NVDB_SECONDS */
};

/* Closes the open nodes, writes all buffers to the temporary files and frees them. */
int fmt_nvdb_writer_finish(struct fmt_nvdb_writer *writer);

#endif
