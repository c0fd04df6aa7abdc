/* chunk_cache.h - a bounded cache of the scan's chunks, decoded and ready to voxelize.
 *
 * A chunk touches a few regions, which come up at different times and on different workers. The
 * cache reads it once for all of them where memory allows. Thread-safe. */
#ifndef VOX_VOXELIZE_CACHE_CHUNK_CACHE_H
#define VOX_VOXELIZE_CACHE_CHUNK_CACHE_H

#include "libvoxel/voxelize/cache/chunk_groups.h"
#include "libvoxel/voxelize/plan/plan.h"
#include "libvoxel/voxelize/cache/smooth_normals.h"

struct vox_chunk {
    struct fmt_tris_chunk source;
    const double (*points)[4]; /* positions in lattice coordinates, 0 */
    int32_t last_cell[4];      /* what lies above belongs to it too, on each axis; and anything */
    /* Unit, or zero, and how far above the vertex the surface of these normals is, in voxels; NULL:
     * those of the triangles. */
    const float (*normals)[4];
    bool wide;          /* pieces are not to be lifted far */
    bool coarse;        /* triangles are large enough for their facets to show in the grid */
    double grain_share; /* grain of records per square of an edge in voxels */
    const struct vox_box *groups; /* of the triangles */
    /* Whether the normals of such a group do not go with its triangles' planes; NULL: nowhere. */
    const bool *stray;
    uint32_t group_count;
};

struct vox_chunks;

/* Bytes that one cached chunk takes, with room for normals if the file has them or `smooth`. */
uint64_t vox_chunks_slot_bytes(const struct fmt_tris_file *file, bool smooth);

/* A cache of up to slot_count >= 1 chunks. `file`, `lattice` and `smooth` must outlive it. parts:
 * the schedule's, by which the first region that needs a chunk is known; they are not kept. smooth
 * makes the normals of chunks that have none and whose triangles are not small for the grid; NULL:
 * they stay without. */
int vox_chunks_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                      const struct vox_lattice *lattice, const struct vox_part *parts,
                      uint64_t part_count, struct vox_smooth *smooth, uint32_t slot_count,
                      struct vox_chunks **out);
void vox_chunks_destroy(struct vox_chunks *chunks); /* NULL is allowed */

/* Says that `uses` units of work which touch `chunk` are under way, and which region is the next
 * that will; and that one of those units has no more need of it. They only guide what is kept. */
void vox_chunks_expect(struct vox_chunks *chunks, uint32_t chunk, uint32_t uses,
                       struct vox_region_key after);
void vox_chunks_done(struct vox_chunks *chunks, uint32_t chunk);

/* Loads or finds a chunk; *out is valid until it is released. A worker holds one at a time. Waits
 * while other workers hold all slots. While another worker loads the chunk, this one loads others
 * that will be needed, where there are slots to spare. */
int vox_chunks_acquire(struct vox_chunks *chunks, uint32_t chunk, const struct vox_chunk **out);
void vox_chunks_release(struct vox_chunks *chunks, uint32_t chunk);

#endif
