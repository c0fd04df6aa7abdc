/* partition.h - the public header of this folder: a scan's triangles, partitioned into buckets by
 * place.
 *
 * Takes a mesh reader. Gives the scan's attribute streams (read/scan.h) and its triangles, coded in
 * buckets of a coarse Morton grid (tuple_runs.h). The reading is one pass if all vertices come
 * before all faces, which samples of the text can tell for most files; two passes work for any
 * file. Memory is bounded: attribute streams and buckets move to temporary files. */
#ifndef VOX_PARTITION_PARTITION_H
#define VOX_PARTITION_PARTITION_H

#include <stdatomic.h>

#include "libvoxel/partition/morton.h"
#include "libvoxel/partition/tuple_runs.h"

/* ---- vertices in use: a bit for each vertex that a face refers to ---- */

typedef atomic_uint_least64_t used_word;

static inline uint64_t used_words(uint64_t vertices)
{
    return vertices / 64 + 1;
}

/* Marks a vertex as used. May be called from any thread. */
static inline void used_mark(used_word *used, uint64_t vertex)
{
    used_word *word = &used[vertex / 64];
    uint64_t bit = (uint64_t)1 << vertex % 64;
    if (!(atomic_load_explicit(word, memory_order_relaxed) & bit))
        atomic_fetch_or_explicit(word, bit, memory_order_relaxed);
}

static inline bool used_is(const used_word *used, uint64_t vertex)
{
    return atomic_load_explicit(&used[vertex / 64], memory_order_relaxed) >> vertex % 64 & 1;
}

static inline uint64_t used_count(const used_word *used, uint64_t vertices)
{
    uint64_t count = 0;
    for (uint64_t i = 0; i < used_words(vertices); i++)
        count +=
            (uint64_t)__builtin_popcountll(atomic_load_explicit(&used[i], memory_order_relaxed));
    return count;
}

/* ---- the partition ---- */

struct partition {
    struct tuple_layout layout;
    struct morton_cube cube;
    uint32_t levels;          /* the first 3 * levels bits of a key name a bucket */
    struct bsq_spill buckets; /* of runs; items are triangles */
    uint64_t triangles;       /* in the buckets, including those without area */
    bool vertices_lack_order; /* neighbours in the file are not neighbours in space; only known if
                                 positions are in a file */
    used_word *used;          /* all clear: whoever reads the tuples marks them */
};

enum partition_passes {
    PARTITION_ONE_PASS, /* all elements come before all faces */
    PARTITION_TWO_PASSES
};

/* Reads the scan and partitions its faces. `out` is zero at first; free it with
 * vox_partition_free(), also after failure. The scan must be finished before the layout is known:
 * call vox_scan_finish(), vox_scan_find_materials() and vox_tuple_layout_for() next. Errors:
 * those of the reader; BSQ_RETRY if one pass is asked for and elements follow faces; BSQ_ENOMEM if
 * memory is too small for a scan of this size or its polygons. */
int vox_partition_read(struct scan *scan, struct fmt_mesh_reader *reader, const char *beside,
                       enum partition_passes passes, struct partition *out);
void vox_partition_free(const struct scan *scan, struct partition *partition);

/* Warns if faces use vertices without a colour in a file with other, coloured vertices, and colours
 * of materials are lost by that. Called after `used` has been marked. */
int vox_partition_warn_colorless(const struct scan *scan, const struct partition *partition);
/* Returns the number of vertices that no face refers to, after `used` has been marked. */
uint64_t vox_partition_unused(const struct scan *scan, const struct partition *partition);

/* ---- disk ---- */

struct disk_space {
    uint64_t output_bytes; /* of the chunk file */
    uint64_t temp_bytes;
};

/* Estimates what sorting a scan of this size needs on disk. The estimate is meant for faces that
 * refer to vertices in their order, or nearly so. Other scans need more, so no scan is refused that
 * has enough space. */
struct disk_space vox_disk_estimate(const struct fmt_mesh_estimate *scan,
                                    const struct sort_limits *limits, bool makes_normals);

#endif
