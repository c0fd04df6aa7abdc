/* chunk_groups.c - the bounds of a chunk's groups, in voxels. */
#include "libvoxel/voxelize/cache/chunk_groups.h"

struct bounds {
    struct row least, most;
};

LANES_INLINE struct bounds begin_at(const double *point)
{
    return (struct bounds){row_load(point), row_load(point)};
}

LANES_INLINE void widen_by(struct bounds *bounds, const double *point)
{
    struct row p = row_load(point);
    bounds->least = row_min(p, bounds->least);
    bounds->most = row_max(p, bounds->most);
}

static struct vox_box box_of(const struct bounds *bounds, const int32_t last_cell[4])
{
    four_ints low = vox_cell(bounds->least, last_cell), high = vox_cell(bounds->most, last_cell);
    struct vox_box box;
    memcpy(box.lo, &low, sizeof box.lo);
    memcpy(box.hi, &high, sizeof box.hi);
    return box;
}

struct vox_box vox_triangle_box(const struct fmt_tris_chunk *chunk, const double (*points)[4],
                                const int32_t last_cell[4], uint32_t begin, uint32_t end)
{
    struct bounds bounds = begin_at(points[chunk->triangles[begin][0]]);
    for (uint32_t t = begin; t < end; t++)
        for (int corner = 0; corner < 3; corner++)
            widen_by(&bounds, points[chunk->triangles[t][corner]]);
    return box_of(&bounds, last_cell);
}

void vox_triangle_groups(const struct fmt_tris_chunk *chunk, const double (*points)[4],
                         const int32_t last_cell[4], struct vox_box *groups)
{
    for (uint32_t begin = 0; begin < chunk->triangle_count; begin += VOX_GROUP_TRIANGLES)
        *groups++ =
            vox_triangle_box(chunk, points, last_cell, begin,
                             vox_group_end(begin, chunk->triangle_count, VOX_GROUP_TRIANGLES));
}

void vox_vertex_groups(const struct fmt_tris_chunk *chunk, const double (*points)[4],
                       const int32_t last_cell[4], struct vox_box *groups)
{
    for (uint32_t begin = 0; begin < chunk->vertex_count; begin += VOX_GROUP_VERTICES) {
        uint32_t end = vox_group_end(begin, chunk->vertex_count, VOX_GROUP_VERTICES);
        struct bounds bounds = begin_at(points[begin]);
        for (uint32_t v = begin; v < end; v++)
            widen_by(&bounds, points[v]);
        *groups++ = box_of(&bounds, last_cell);
    }
}
