/* shade_normal_map.c - the scan's normal map in tangent space, on the way to the grid. */
#include "base/channels.h"
#include "libvoxel/voxelize/clip/shade.h"

static const char map_name[] = BSQ_CHANNEL_NORMAL_MAP;

bool vox_shading_needs_normal_map(const struct fmt_tris_header *header, const char *path)
{
    return path || fmt_tris_find_channel(header, map_name) != UINT32_MAX;
}

/* Finds the image of each material, and of triangles without one. path: one for all, or NULL. */
static void find_sources(const struct fmt_tris_header *header, const char *path,
                         struct fmt_tris_source *out)
{
    const uint32_t channel = fmt_tris_find_channel(header, map_name);
    for (uint64_t m = 0; path && m <= header->material_count; m++)
        out[m].texture_path = (char *)(uintptr_t)path;
    for (uint32_t m = 0; !path && channel != UINT32_MAX && m < header->material_count; m++)
        out[m] = header->materials[m].sources[channel];
}

/* The image of a material. */
static void source_of(const void *sources, uint64_t material, struct fmt_texture_source *out)
{
    out->path = ((const struct fmt_tris_source *)sources)[material].texture_path;
    out->data = true;
}

int vox_shading_use_normal_map(struct bsq_ctx *ctx, const char *tris_path, const char *path,
                               uint64_t texture_bytes, struct vox_shading *shading)
{
    const struct fmt_tris_header *header = shading->header;
    struct vox_shading_normal_map *map = &shading->normal_map;
    const uint64_t count = header->material_count + UINT64_C(1);
    if (!vox_shading_needs_normal_map(header, path))
        return 0;
    if (path && !(header->attributes & FMT_TRIS_TEXCOORDS))
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s has no texture coordinates for the normal map %s: make it again, with "
                        "--scan-normal-map",
                        tris_path, path);
    int status = bsq_calloc(ctx, "normal map", count, sizeof *map->sources, &map->sources);
    if (status < 0)
        return status;
    find_sources(header, path, map->sources);
    return fmt_textures_open_each(ctx, count, source_of, map->sources, texture_bytes,
                                  &map->textures);
}

void vox_shading_normal_map_free(struct bsq_ctx *ctx, struct vox_shading_normal_map *map)
{
    fmt_textures_close(map->textures);
    bsq_free(ctx, map->sources);
    *map = (struct vox_shading_normal_map){0};
}

bool vox_shade_has_normal_map(const struct vox_shading *shading, const struct vox_chunk *chunk,
                              uint32_t triangle)
{
    return shading->normal_map.textures && chunk->source.texcoords &&
           shading->normal_map.sources[vox_shade_material(shading, chunk, triangle)].texture_path;
}

int vox_shade_normal_map(const struct vox_shading *shading, const struct vox_chunk *chunk,
                         uint32_t triangle, const double (*uv)[2], const double b[2],
                         const double uv_extent[2], float texel[3])
{
    const uint32_t image = vox_shade_material(shading, chunk, triangle);
    return vox_sample_fragment(shading->normal_map.textures, image,
                               &shading->normal_map.sources[image].uv, uv, b, uv_extent, texel);
}
