/* mesh_arrays.c - see mesh_arrays.h. */
#include "formats/mesh/mesh_arrays.h"

#include <string.h>

void fmt_arrays_clear(struct mesh_arrays *arrays)
{
    memset(arrays->count, 0, sizeof arrays->count);
    memset(arrays->has_corners, 0, sizeof arrays->has_corners);
    arrays->face_count = arrays->corner_count = arrays->change_count = 0;
    arrays->has_colors = false;
}

/* Ensures capacity for `count` elements of `size` bytes in the array at `array`. */
static int reserve(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size,
                   void *array, uint64_t *capacity)
{
    return count <= *capacity ? 0 : (bsq_grow)(ctx, what, count, size, array, capacity);
}

int fmt_arrays_reserve_positions(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count)
{
    return reserve(ctx, "vertices", count, sizeof *arrays->positions, &arrays->positions,
                   &arrays->position_capacity);
}

int fmt_arrays_reserve_colors(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count)
{
    return reserve(ctx, "colours", count, sizeof *arrays->colors, &arrays->colors,
                   &arrays->color_capacity);
}

int fmt_arrays_reserve_texcoords(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count)
{
    return reserve(ctx, "texture coordinates", count, sizeof *arrays->texcoords, &arrays->texcoords,
                   &arrays->texcoord_capacity);
}

int fmt_arrays_reserve_normals(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count)
{
    return reserve(ctx, "normals", count, sizeof *arrays->normals, &arrays->normals,
                   &arrays->normal_capacity);
}

int fmt_arrays_reserve_faces(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count)
{
    return reserve(ctx, "faces", count, sizeof *arrays->face_sizes, &arrays->face_sizes,
                   &arrays->size_capacity);
}

int fmt_arrays_reserve_tags(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count)
{
    return reserve(ctx, "faces", count, sizeof *arrays->face_tags, &arrays->face_tags,
                   &arrays->tag_capacity);
}

int fmt_arrays_reserve_changes(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count)
{
    return reserve(ctx, "materials of faces", count, sizeof *arrays->changes, &arrays->changes,
                   &arrays->change_capacity);
}

int fmt_arrays_reserve_corners(struct bsq_ctx *ctx, struct mesh_arrays *arrays,
                               enum fmt_mesh_kind kind, uint64_t count)
{
    return reserve(ctx, "face corners", count, sizeof *arrays->corners[kind],
                   &arrays->corners[kind], &arrays->corner_capacity[kind]);
}

void fmt_arrays_show(const struct mesh_arrays *arrays, struct fmt_mesh_block *block)
{
    const bool *has = arrays->has_corners;
    block->vertex_count = arrays->count[FMT_MESH_VERTEX];
    block->positions = (const double(*)[3])arrays->positions;
    block->colors = arrays->has_colors ? (const float(*)[3])arrays->colors : NULL;
    block->texcoord_count = arrays->count[FMT_MESH_TEXCOORD];
    block->texcoords = (const double(*)[2])arrays->texcoords;
    block->normal_count = arrays->count[FMT_MESH_NORMAL];
    block->normals = (const float(*)[3])arrays->normals;
    block->face_count = arrays->face_count;
    block->face_sizes = arrays->face_sizes;
    block->corner_count = arrays->corner_count;
    block->corner_vertices = arrays->corners[FMT_MESH_VERTEX];
    block->corner_texcoords = has[FMT_MESH_TEXCOORD] ? arrays->corners[FMT_MESH_TEXCOORD] : NULL;
    block->corner_normals = has[FMT_MESH_NORMAL] ? arrays->corners[FMT_MESH_NORMAL] : NULL;
    block->material_change_count = arrays->change_count;
    block->material_changes = arrays->changes;
}

void fmt_arrays_free(struct bsq_ctx *ctx, struct mesh_arrays *arrays)
{
    void *parts[] = {arrays->positions,  arrays->colors,     arrays->texcoords,  arrays->normals,
                     arrays->face_sizes, arrays->corners[0], arrays->corners[1], arrays->corners[2],
                     arrays->face_tags,  arrays->changes};
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++)
        bsq_free(ctx, parts[i]);
    memset(arrays, 0, sizeof *arrays);
}
