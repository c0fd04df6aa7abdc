/* grid_estimate.h - private: how large a grid will be, before hours go into one that nobody can
 * store. */
#ifndef VOX_VOXELIZE_GRID_ESTIMATE_H
#define VOX_VOXELIZE_GRID_ESTIMATE_H

#include "libvoxel/voxelize/plan/plan.h"

/* *voxels: about how many voxels the triangles touch. Right to some percent where triangles are
 * larger than voxels; surfaces that pass through the same voxels count more than once. Reads
 * chunks_max chunks at most, UINT64_MAX: all, on all threads that the budget has room for. Errors:
 * those of reading. */
int vox_estimate_voxels(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                        const struct vox_lattice *lattice, uint64_t chunks_max, double *voxels);

/* About how large the file of that many voxels will be. */
double vox_estimate_bytes(double voxels, bool has_color);

/* Refuses a grid that its disk has no room for (BSQ_EIO, with the bytes needed and free) or that
 * has more leaves than a file can number (BSQ_EUSAGE), and warns where it will be huge and far
 * finer than the triangles. A few chunks tell the size of an ordinary grid; all are read where
 * their bounds leave a billion voxels open. Less is asked for than is estimated: a grid that would
 * have had room must not be refused. */
int vox_estimate_check(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                       const struct vox_lattice *lattice, bool has_color, const char *grid_path);

#endif
