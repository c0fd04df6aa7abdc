/* estimate.h - private: how large a grid will be, before hours go into one that nobody can store. */
#ifndef VOX_ESTIMATE_H
#define VOX_ESTIMATE_H

#include "libvoxel/lattice.h"

/* *voxels: about how many voxels the triangles touch. Right to some percent where triangles are larger than voxels; surfaces that
 * pass through the same voxels count more than once. Reads all chunks, on all threads that the budget has room for. */
int estimate_voxels(struct bsq_ctx *ctx, const struct fmt_tris_file *file, const struct vox_lattice *lattice, double *voxels);

/* Warns where the grid will be huge and far finer than the triangles, and refuses one that has more leaves than a file can number
 * (BSQ_EUSAGE) or that its disk has no room for (BSQ_EIO). Chunks are read only where their bounds leave that open. */
int estimate_check(struct bsq_ctx *ctx, const struct fmt_tris_file *file, const struct vox_lattice *lattice, bool has_color,
                   const char *grid_path);

#endif
