/* chunk_groups.c - the bounds of a chunk's groups, in voxels.
 *
 * Index space keeps the order of positions on each axis, so bounds are found among positions and
 * then placed. */
#include "libvoxel/voxelize/cache/chunk_groups.h"

LANES_INLINE struct vox_bounds begin_at(const float *position)
{
    const four_floats p = four_floats_load(position);
    return (struct vox_bounds){p, p};
}

LANES_INLINE four_ints cell_of(const struct vox_row_transform *transform, four_floats position)
{
    float at[4];
    memcpy(at, &position, sizeof at);
    return row_floor(vox_place(transform, row_of_floats(at)));
}

static struct vox_box box_of(const struct vox_transform *transform, const struct vox_bounds *bounds)
{
    const int32_t *hi = transform->voxels.hi;
    const four_ints last = {hi[0], hi[1], hi[2], INT32_MAX};
    const struct vox_row_transform rows = vox_row_transform_of(transform);
    const four_ints low = four_min(cell_of(&rows, bounds->least), last),
                    high = four_min(cell_of(&rows, bounds->most), last);
    struct vox_box box;
    memcpy(box.lo, &low, sizeof box.lo);
    memcpy(box.hi, &high, sizeof box.hi);
    return box;
}

/* Returns the voxels of the bounds of triangles from `begin` to `end` > begin. */
static struct vox_box triangle_box(const struct fmt_tris_chunk *chunk,
                                   const struct vox_transform *transform, uint32_t begin,
                                   uint32_t end)
{
    struct vox_bounds bounds = begin_at(chunk->positions[chunk->triangles[begin][0]]);
    for (uint32_t t = begin; t < end; t++)
        for (int corner = 0; corner < 3; corner++)
            vox_widen_bounds(&bounds, chunk->positions[chunk->triangles[t][corner]]);
    return box_of(transform, &bounds);
}

void vox_triangle_groups(const struct fmt_tris_chunk *chunk, const struct vox_transform *transform,
                         struct vox_box *groups)
{
    for (uint32_t begin = 0; begin < chunk->triangle_count; begin += VOX_GROUP_TRIANGLES)
        *groups++ = triangle_box(chunk, transform, begin,
                                 vox_group_end(begin, chunk->triangle_count, VOX_GROUP_TRIANGLES));
}

void vox_vertex_groups(const struct fmt_tris_chunk *chunk, const struct vox_transform *transform,
                       struct vox_box *groups)
{
    for (uint32_t begin = 0; begin < chunk->vertex_count; begin += VOX_GROUP_VERTICES) {
        uint32_t end = vox_group_end(begin, chunk->vertex_count, VOX_GROUP_VERTICES);
        struct vox_bounds bounds = begin_at(chunk->positions[begin]);
        for (uint32_t v = begin; v < end; v++)
            vox_widen_bounds(&bounds, chunk->positions[v]);
        *groups++ = box_of(transform, &bounds);
    }
}
