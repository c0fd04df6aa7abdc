/* nvdb_writer_internal.h - state of a grid writer: streams in a temporary file, and the open nodes.
 */
#ifndef FMT_GRID_NVDB_WRITER_INTERNAL_H
#define FMT_GRID_NVDB_WRITER_INTERNAL_H

#include "base/spill.h"
#include "formats/grid/nvdb_layout_internal.h"

/* A part of a section that grows: a stream of the writer's spill. */
struct nvdb_stream {
    struct bsq_spill *spill; /* NULL: not in use */
    uint32_t number;
    void *written; /* XXH3 state of its bytes */
};

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
    struct bsq_spill spill;
    int failed; /* status of the first failure; nothing can be committed after it */

    uint8_t *names; /* section NVDB_NAMES, counts.name_bytes; NULL: no ids */

    uint64_t *keys; /* of the root tiles so far */
    uint64_t keys_capacity;
    struct nvdb_stub upper,
        lower;          /* the open nodes, if there are any; the upper one of the last key
                         */
    uint32_t last_cell; /* of the open lower node in the upper node */
    uint32_t last_leaf; /* number of the last leaf in the lower node */

    struct nvdb_counts counts;
    int32_t bbox_min[3], bbox_max[3];
    uint32_t entry_bits, entry_rank; /* the open entry of section NVDB_SECONDS */
};

/* Closes the open nodes, writes all streams to the temporary file and frees their memory. */
int fmt_nvdb_writer_finish(struct fmt_nvdb_writer *writer);

#endif
