/* one_ring.h - private to the cache: the one-rings of a chunk's vertices and their normals, for
 * each instruction set. */
#ifndef VOX_VOXELIZE_CACHE_ONE_RING_H
#define VOX_VOXELIZE_CACHE_ONE_RING_H

#include "base/smooth_normals.h"
#include "formats/chunks/tris.h"

/* Sums over the triangles around a vertex, in the form of base/smooth_normals.h. */
struct vox_one_ring {
    double normal[3], weight, moment[3], unused;
};

/* bsq_add_one_rings() of a chunk's triangles. */
typedef void vox_add_one_rings_fn(const struct fmt_tris_chunk *chunk, uint32_t begin, uint32_t end,
                                  const uint32_t *ring_of, enum bsq_scan_normals weights,
                                  struct vox_one_ring *rings);
BSQ_SIMD_DECLARE(vox_add_one_rings_fn, vox_add_one_rings);

/* Sets the normals of `count` vertices from their one-rings, see vox_smooth_normals(). h: edge of a
 * voxel. */
typedef void vox_finish_one_rings_fn(const struct vox_one_ring *rings, const uint32_t *ring_of,
                                     uint32_t count, double h, float (*normals)[4]);
BSQ_SIMD_DECLARE(vox_finish_one_rings_fn, vox_finish_one_rings);

#endif
