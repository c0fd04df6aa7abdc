/* chunk_groups.h - private to voxelizing: where runs of a chunk's triangles lie, and runs of its
 * vertices.
 *
 * Triangles follow each other in space, and vertices are numbered as triangles need them, so that
 * runs of both share small bounds. Who needs a part of a chunk passes over the others by these. */
#ifndef VOX_VOXELIZE_CACHE_CHUNK_GROUPS_H
#define VOX_VOXELIZE_CACHE_CHUNK_GROUPS_H

#include "base/simd/simd.h"
#include "libvoxel/voxelize/plan/plan.h"

enum { VOX_GROUP_TRIANGLES = 64, VOX_GROUP_VERTICES = 64 };

static inline uint32_t vox_group_count(uint32_t things, uint32_t group)
{
    return (things + group - 1) / group;
}

/* Where the group behind begins: that of so many things which begins at `begin`, of `things` in
 * all. */
static inline uint32_t vox_group_end(uint32_t begin, uint32_t things, uint32_t group)
{
    return things - begin < group ? things : begin + group;
}

/* Returns the voxel of a point, and an arbitrary fourth number. Points are never below the grid;
 * a point on its upper bounds is counted to the last voxel. */
LANES_INLINE four_ints vox_cell(struct row point, const int32_t last_cell[4])
{
    return four_min(row_floor(point), four_load(last_cell));
}

/* Voxels of the bounds of each group. last_cell: what lies above belongs to it too, on each axis;
 * and anything. */
void vox_triangle_groups(const struct fmt_tris_chunk *chunk, const double (*points)[4],
                         const int32_t last_cell[4], struct vox_box *groups);
void vox_vertex_groups(const struct fmt_tris_chunk *chunk, const double (*points)[4],
                       const int32_t last_cell[4], struct vox_box *groups);

#endif
