/* voxel_transform.h - where voxels lie in the world.
 *
 * Voxel (i, j, k) covers [lattice + i h, lattice + (i + 1) h) on each axis, half-open, in double.
 * So every point belongs to exactly one voxel, i = floor(((origin + p) - lattice) / h) as computed
 * in double, and a plane that lies on the border of two layers fills the upper one alone.
 *
 * With a resolution N the lattice starts at the scan's lower bounds and voxels are clamped to its
 * extent: what lies exactly on the upper bounds belongs to the last voxel. With a given voxel size
 * the lattice is aligned to multiples of it and nothing is clamped: a triangle on an uppermost
 * plane that is a multiple of the size belongs to the voxel above. */
#ifndef VOX_VOXELIZE_PLAN_VOXEL_TRANSFORM_H
#define VOX_VOXELIZE_PLAN_VOXEL_TRANSFORM_H

#include "formats/chunks/tris.h"

/* Voxels lo to hi, inclusive. */
struct vox_box {
    int32_t lo[3], hi[3];
};

/* Whether any voxel is in both. */
static inline bool vox_boxes_meet(const struct vox_box *a, const struct vox_box *b)
{
    bool apart = false;
    for (int k = 0; k < 3; k++)
        apart |= (a->lo[k] > b->hi[k]) | (a->hi[k] < b->lo[k]);
    return !apart;
}

struct vox_lattice {
    double origin[3];      /* world position of the file's float positions */
    double start[3];       /* world position of the lower corner of voxel (0, 0, 0) */
    double h;              /* edge of a voxel in world units */
    struct vox_box voxels; /* all that the scan may touch */
};

/* Lattice of a scan for a resolution (voxels along the longest side) or, where that is 0, a voxel
 * size. Errors: BSQ_EUSAGE with the values where the size is no positive number or an index would
 * leave +-2^30; BSQ_EDATA where the scan has no extent to divide, or one too small or large for
 * voxels whose size and its inverse are float32. */
int vox_lattice_init(struct bsq_ctx *ctx, const struct fmt_tris_header *header, const char *path,
                     uint32_t resolution, double voxel_size, struct vox_lattice *out);

/* Lattice coordinate of a file position on one axis; its floor, clamped to voxels, is the voxel. */
static inline double vox_lattice_coordinate(const struct vox_lattice *lattice, float p, int axis)
{
    return ((lattice->origin[axis] + (double)p) - lattice->start[axis]) / lattice->h;
}

/* Voxels that the positions between two corners may touch. */
struct vox_box vox_lattice_box(const struct vox_lattice *lattice, const float min[3],
                               const float max[3]);

#endif
