/* chunk_groups.h - bounds of consecutive triangles and vertices of a chunk.
 *
 * Triangles follow each other in space, and vertices are numbered in the order in which triangles
 * use them, so groups of either have small bounds. Code that needs only part of a chunk skips the
 * other groups. */
#ifndef VOX_VOXELIZE_CACHE_CHUNK_GROUPS_H
#define VOX_VOXELIZE_CACHE_CHUNK_GROUPS_H

#include "base/simd/simd.h"
#include "libvoxel/voxelize/plan/plan.h"

enum { VOX_GROUP_TRIANGLES = 64, VOX_GROUP_VERTICES = 64 };

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

/* A voxel transform as rows. Loops keep it in registers: compilers load the members of the
 * transform again for each point, as the points might overwrite them. */
struct vox_row_transform {
    struct row origin, start, size;
};

LANES_INLINE struct vox_row_transform vox_row_transform_of(const struct vox_transform *transform)
{
    const double *origin = transform->origin, *start = transform->start, h = transform->h;
    return (struct vox_row_transform){row_of(origin[0], origin[1], origin[2], 0.0),
                                      row_of(start[0], start[1], start[2], 0.0),
                                      row_of(h, h, h, h)};
}

/* Returns vox_transform_coordinate() of three axes, and 0. position: three numbers and 0. */
LANES_INLINE struct row vox_place(const struct vox_row_transform *transform, struct row position)
{
    const struct row moved = row_sum(transform->origin, position);
    return row_quotient(row_difference(moved, transform->start), transform->size);
}

/* Returns the voxel of a point, and an arbitrary fourth number. Points are never below the grid;
 * a point on its upper bounds is counted to the last voxel. */
LANES_INLINE four_ints vox_cell(struct row point, const int32_t last_cell[4])
{
    return four_min(row_floor(point), four_load(last_cell));
}

/* Bounds of positions. The fourth number is arbitrary: that of a position is the next number in
 * memory. */
struct vox_bounds {
    four_floats least, most;
};

LANES_INLINE void vox_widen_bounds(struct vox_bounds *bounds, const float *position)
{
    const four_floats p = four_floats_load(position);
    bounds->least = four_floats_min(p, bounds->least);
    bounds->most = four_floats_max(p, bounds->most);
}

/* Computes the voxels of each group's bounds. */
void vox_triangle_groups(const struct fmt_tris_chunk *chunk, const struct vox_transform *transform,
                         struct vox_box *groups);
void vox_vertex_groups(const struct fmt_tris_chunk *chunk, const struct vox_transform *transform,
                       struct vox_box *groups);

#endif
