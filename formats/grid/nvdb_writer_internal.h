/* nvdb_writer_internal.h - state of a grid writer: streams in temporary files, and the open nodes.
 */
#ifndef FMT_GRID_NVDB_WRITER_INTERNAL_H
#define FMT_GRID_NVDB_WRITER_INTERNAL_H

#include "formats/grid/nvdb_layout_internal.h"

#define NVDB_STREAM_BYTES (UINT64_C(256) << 10)

/* A part of a section that grows in a temporary file, through a buffer of NVDB_STREAM_BYTES. */
struct nvdb_stream {
    struct bsq_ctx *ctx; /* NULL: not in use */
    struct bsq_file file;
    uint64_t size; /* bytes written so far */
    uint8_t *buffer;
    uint64_t fill; /* bytes in the buffer */
    /* XXH3 states of the bytes that were written to the file, and of those read from it so far. */
    void *written, *read;
};

/* Closes a stream and frees its memory. */
void fmt_nvdb_stream_close(struct nvdb_stream *stream);

/* A stub: an internal node without its table, which needs the totals. */
struct nvdb_stub {
    int32_t bbox_min[3], bbox_max[3];
    uint64_t child_mask[512]; /* of a lower node 64 */
};

/* Returns the bytes that a stub has in its stream. */
static inline uint64_t nvdb_stub_bytes(const struct nvdb_level *level)
{
    return offsetof(struct nvdb_stub, child_mask) + level->words * sizeof(uint64_t);
}

struct fmt_nvdb_writer {
    struct bsq_ctx *ctx;
    struct bsq_output *output;
    char *path;
    struct fmt_nvdb_info info;
    /* Of each section that grows with the grid: of upper and lower nodes the stubs; of values one a
     * record, those of first records, then those of second records. */
    struct nvdb_stream stream[NVDB_TRAILER][2];
    int failed; /* status of the first failure; nothing can be committed after it */

    uint8_t *names; /* section NVDB_NAMES, counts.name_bytes; NULL: no ids */

    uint64_t *keys; /* of the root tiles so far */
    uint64_t keys_capacity;
    struct nvdb_stub upper,
        lower;          /* the open nodes, if there are any; the upper one of the last key
                         */
    uint32_t last_slot; /* of the open lower node in the upper node */
    uint32_t last_leaf; /* number of the last leaf in the lower node */

    struct nvdb_counts counts;
    int32_t bbox_min[3], bbox_max[3];
    uint32_t entry_bits, entry_rank; /* the open entry of section NVDB_SECONDS */
};

/* Closes the open nodes, writes all buffers to the temporary files and frees the buffers. */
int fmt_nvdb_writer_finish(struct fmt_nvdb_writer *writer);

#endif
