/* grid_estimate.h - estimates how large a grid will be, so that one that does not fit on the disk
 * is refused at once. */
#ifndef VOX_VOXELIZE_GRID_ESTIMATE_H
#define VOX_VOXELIZE_GRID_ESTIMATE_H

#include "libvoxel/voxelize/plan/plan.h"

/* Estimates the number of voxels that the triangles touch, to some percent if triangles are larger
 * than voxels. Surfaces that pass through the same voxels count more than once. Reads up to
 * chunks_max chunks (UINT64_MAX: all) on as many threads as the budget allows. Errors: those of
 * reading. */
int vox_estimate_voxels(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                        const struct vox_transform *transform, uint64_t chunks_max, double *voxels);

/* Returns the estimated size in bytes of a file of that many voxels. */
double vox_estimate_bytes(double voxels, unsigned channels);

/* Refuses a grid that does not fit on its disk (BSQ_EIO, with the bytes needed and free) or has
 * more leaves than a file can number (BSQ_EUSAGE). Warns if the grid will be huge and far finer
 * than the triangles. Samples a few chunks; reads all if their bounds allow a billion voxels.
 * Requires less space than estimated, so that no grid is refused that would have fitted. */
int vox_estimate_check(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                       const struct vox_transform *transform, unsigned channels,
                       const char *grid_path);

#endif
