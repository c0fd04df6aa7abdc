/* smooth_normals.h - vertex normals for scans that have none. */
#ifndef VOX_VOXELIZE_CACHE_SMOOTH_NORMALS_H
#define VOX_VOXELIZE_CACHE_SMOOTH_NORMALS_H

#include "libvoxel/voxelize/cache/chunk_groups.h"

struct vox_smooth;

/* Room for up to `calls` >= 1 calls at a time, fewer where that is more than `bytes`, but one in
 * any case. The file must outlive *out. */
int vox_smooth_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file, unsigned calls,
                      uint64_t bytes, struct vox_smooth **out);
void vox_smooth_destroy(struct vox_smooth *smooth); /* NULL is allowed */

/* A decoded chunk, and the bounds of its groups. */
struct vox_loan {
    const struct fmt_tris_chunk *chunk; /* NULL: has to be read for the purpose */
    const struct vox_box *triangle_groups, *vertex_groups;
};

/* Where decoded chunks can be had. lend: sets *out; a negative status ends the work. take_back: of
 * a chunk that was lent. */
struct vox_smooth_lender {
    void *arg;
    int (*lend)(void *arg, uint32_t index, struct vox_loan *out);
    void (*take_back)(void *arg, uint32_t index);
};

/* Area-weighted smooth normals of a chunk's vertices as if the scan were whole: vertices at the
 * same position are one, whichever chunk they are in. `chunk` is number `index`, decoded; `normals`
 * has one entry a vertex: unit length, or zero at creases (see BSQ_CREASE_SHARE); and fourth
 * how far above the vertex, along its normal and in voxels, the surface lies that these normals,
 * interpolated, belong to; 0 at creases. The sums run in the order of triangles in the file, so the
 * result does not depend on who asks when. Thread-safe; a call waits while there is no room. */
int vox_smooth_normals(struct vox_smooth *smooth, const struct vox_smooth_lender *lender,
                       uint32_t index, const struct fmt_tris_chunk *chunk,
                       const struct vox_lattice *lattice, float (*normals)[4]);

#endif
