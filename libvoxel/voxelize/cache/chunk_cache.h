/* chunk_cache.h - a bounded cache of the scan's chunks, decoded and ready to voxelize.
 *
 * Takes a .tris file, the voxel transform and the chunk boxes. Gives chunks in index space, with
 * vertex normals. A chunk touches several regions, which are made at different times by different
 * workers. If memory allows, the cache reads it once for all of them. Thread-safe. */
#ifndef VOX_VOXELIZE_CACHE_CHUNK_CACHE_H
#define VOX_VOXELIZE_CACHE_CHUNK_CACHE_H

#include "base/geometry/vertex_normal.h"
#include "base/simd/simd.h"
#include "libvoxel/voxelize/plan/plan.h"

/* Triangles of a chunk follow each other in space, so groups of them have small bounds. Code that
 * needs only part of a chunk skips the other groups. */
enum { VOX_GROUP_TRIANGLES = 64 };

static inline uint32_t vox_group_count(uint32_t count, uint32_t group)
{
    return (count + group - 1) / group;
}

/* Returns the index of the first item of the next group, for a group that starts at `begin` out of
 * `count` items. */
static inline uint32_t vox_group_end(uint32_t begin, uint32_t count, uint32_t group)
{
    return count - begin < group ? count : begin + group;
}

struct vox_chunk {
    struct fmt_tris_chunk source;
    const double (*points)[4]; /* positions in index space; fourth, see vox_chunk_second() */
    int32_t last_cell[4]; /* inclusive upper bound; positions beyond it are clamped into the last
                             voxel. The fourth number is unused */
    /* Unit normals, or zero; fourth, the height in voxels of the surface with these normals above
     * the vertex. NULL: triangles have their own normals. */
    const float (*normals)[4];
    const struct fmt_tris_crease *creases; /* NULL: there are none */
    double h;                              /* edge of a voxel */
    bool wide;                             /* fragments must not be lifted far */
    bool coarse;        /* triangles are so large that their facets would show in the grid */
    double noise_share; /* facet-noise weight of records per square of an edge in voxels */
    const struct vox_box *groups; /* voxels of each triangle group */
    /* For each group: whether its normals are inconsistent with its triangles' planes. NULL: none
     * are. */
    const bool *inconsistent;
    uint32_t group_count;
};

/* Returns the voxel of a point, and an arbitrary fourth number. Points are never below the grid;
 * a point on its upper bounds is counted to the last voxel. */
LANES_INLINE four_ints vox_cell(struct row point, const int32_t last_cell[4])
{
    return four_min(row_floor(point), four_load(last_cell));
}

/* The fourth number of a point at a crease is the number of that, plus 1, times this. So it floors
 * to 0. */
#define VOX_CREASE_UNIT 0x1p-40

/* Sets the normal and the height of the second side of a crease; zeros if the vertex is none. */
static inline void vox_chunk_second(const struct vox_chunk *chunk, uint32_t vertex, float second[4])
{
    const double number = chunk->points[vertex][3] / VOX_CREASE_UNIT;
    const uint64_t packed =
        number > 0.0 ? chunk->creases[(uint32_t)number - 1].second : BSQ_VERTEX_NORMAL_NONE;
    bsq_vertex_normal_unpack(packed, second);
    second[3] = (float)((double)bsq_vertex_rise(packed) / chunk->h);
}

struct vox_chunks;

/* Returns the bytes of one slot. smooth: chunks get the normals that were made. */
uint64_t vox_chunks_slot_bytes(const struct fmt_tris_file *file, bool smooth);

/* Creates a cache of up to slot_count >= 1 chunks. `file` and `transform` must outlive it. boxes:
 * those of the schedule; they tell the first region that needs each chunk, and are not kept.
 * smooth: chunks without normals of the scan whose triangles are large for the grid get those that
 * were made, which the file must have. */
int vox_chunks_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                      const struct vox_transform *transform, const struct vox_chunk_box *boxes,
                      uint64_t box_count, bool smooth, uint32_t slot_count,
                      struct vox_chunks **out);
void vox_chunks_destroy(struct vox_chunks *chunks); /* NULL is allowed */

/* vox_chunks_expect() announces `uses` units of work that need `chunk`, and the region that needs
 * it next. vox_chunks_done() ends the need of one of these units. Both only guide what is kept. */
void vox_chunks_expect(struct vox_chunks *chunks, uint32_t chunk, uint32_t uses,
                       vox_region_key after);
void vox_chunks_done(struct vox_chunks *chunks, uint32_t chunk);

/* Loads or finds a chunk; *out is valid until it is released. A worker holds one chunk at a time.
 * Waits while other workers hold all slots. While another worker loads the chunk, this one loads
 * chunks that will be needed next, if there are spare slots. */
int vox_chunks_acquire(struct vox_chunks *chunks, uint32_t chunk, const struct vox_chunk **out);
void vox_chunks_release(struct vox_chunks *chunks, uint32_t chunk);

#endif
