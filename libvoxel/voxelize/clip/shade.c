/* shade.c - the colours of a scan.
 *
 * What is linear over a triangle is interpolated at a fragment's centroid, which gives the
 * fragment's mean exactly (shade_lanes.h). A texture is averaged over the fragment's extent
 * instead. */
#include "libvoxel/voxelize/clip/shade.h"
#include "base/ids.h"
#include "base/srgb.h"

#include <math.h>
#include <string.h>

static bool has_materials(const struct fmt_tris_header *header)
{
    return (header->attributes & FMT_TRIS_MATERIALS) && header->material_count > 0;
}

bool vox_shading_has_color(const struct fmt_tris_header *header)
{
    return fmt_tris_has_color(header);
}

bool vox_shading_needs_textures(const struct fmt_tris_header *header)
{
    if (!(header->attributes & FMT_TRIS_TEXCOORDS) || !has_materials(header))
        return false;
    for (uint32_t i = 0; i < header->material_count; i++)
        if (header->materials[i].texture_path)
            return true;
    return false;
}

/* The colour texture of a material. */
static void source_of(const void *header, uint64_t material, struct fmt_texture_source *out)
{
    out->path = ((const struct fmt_tris_header *)header)->materials[material].texture_path;
}

int vox_shading_init(struct bsq_ctx *ctx, const struct fmt_tris_header *header,
                     uint64_t texture_bytes, struct vox_shading *out)
{
    memset(out, 0, sizeof *out);
    out->header = header;
    vox_color_tables_init(&out->tables);
    out->has_color = vox_shading_has_color(header);
    if (!has_materials(header))
        return 0;
    int status = bsq_alloc(ctx, "material colours", header->material_count, sizeof *out->diffuse,
                           &out->diffuse);
    if (status < 0)
        return status;
    for (uint32_t i = 0; i < header->material_count; i++)
        for (int k = 0; k < 3; k++)
            out->diffuse[i][k] = bsq_srgb_to_linear((double)header->materials[i].diffuse[k]);
    if (vox_shading_needs_textures(header))
        status = fmt_textures_open_each(ctx, header->material_count, source_of, header,
                                        texture_bytes, &out->textures);
    if (status < 0)
        vox_shading_free(ctx, out);
    return status;
}

int vox_shading_tell_losses(const struct vox_shading *shading)
{
    struct fmt_textures *const sets[3] = {shading->textures, shading->normal_map.textures,
                                          shading->channels.textures};
    return fmt_textures_tell_losses(sets, 3);
}

void vox_shading_free(struct bsq_ctx *ctx, struct vox_shading *shading)
{
    fmt_textures_close(shading->textures);
    shading->textures = NULL;
    bsq_free(ctx, shading->diffuse);
    shading->diffuse = NULL;
    bsq_free(ctx, shading->ids);
    shading->ids = NULL;
    vox_shading_channels_free(ctx, &shading->channels);
    vox_shading_normal_map_free(ctx, &shading->normal_map);
}

/* ---- triangles ---- */

/* Returns the material that may give a triangle its colour, or UINT32_MAX. */
static uint32_t material_of(const struct vox_shading *shading, const struct vox_chunk *chunk,
                            uint32_t triangle)
{
    bool known = chunk->source.materials && shading->diffuse;
    uint32_t material = known ? chunk->source.materials[triangle] : UINT32_MAX;
    bool colored = material != UINT32_MAX && !shading->header->materials[material].colorless;
    return colored ? material : UINT32_MAX;
}

uint32_t vox_shade_image(const struct vox_shading *shading, const struct vox_chunk *chunk,
                         uint32_t triangle)
{
    uint32_t material = shading->textures ? material_of(shading, chunk, triangle) : UINT32_MAX;
    if (material == UINT32_MAX || !shading->header->materials[material].texture_path)
        return UINT32_MAX;
    return material;
}

bool vox_shade_corners(const struct vox_shading *shading, const struct vox_chunk *chunk,
                       uint32_t triangle, double rgb[3][3])
{
    const uint32_t *v = chunk->source.triangles[triangle];
    uint32_t material = material_of(shading, chunk, triangle);
    if (!chunk->source.colors && material == UINT32_MAX) {
        memset(rgb, 0, sizeof(double[3][3]));
        return false;
    }
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            rgb[i][k] =
                chunk->source.colors
                    ? shading->tables.to_linear[chunk->source.colors[v[i]] >> (8 * k) & 0xff]
                    : shading->diffuse[material][k];
    return true;
}

/* ---- ids ---- */

int vox_shading_use_ids(struct bsq_ctx *ctx, struct vox_shading *shading)
{
    const struct fmt_tris_header *header = shading->header;
    const uint64_t count = header->material_count;
    int status = bsq_alloc(ctx, "ids", count + 1, sizeof *shading->ids, &shading->ids);
    for (uint64_t i = 0; i <= count && status == 0; i++) {
        const char *name = i < count ? header->materials[i].name : NULL;
        shading->ids[i] = bsq_name_id(name ? name : "");
    }
    return status;
}

uint32_t vox_shade_id(const struct vox_shading *shading, const struct vox_chunk *chunk,
                      uint32_t triangle, double area, const double moment[2])
{
    const struct fmt_tris_chunk *source = &chunk->source;
    const double weight[3] = {area - moment[0] - moment[1], moment[0], moment[1]};
    int nearest = 0;
    if (shading->header->ids != BSQ_IDS_COLOR)
        return shading->ids[vox_shade_material(shading, chunk, triangle)];
    for (int i = 1; i < 3; i++)
        nearest = weight[i] > weight[nearest] ? i : nearest;
    const uint32_t color =
        source->colors ? source->colors[source->triangles[triangle][nearest]] : 0;
    return color | 0xff000000u;
}

/* ---- fragments ---- */

int vox_sample_fragment(struct fmt_textures *textures, uint32_t image, const struct bsq_uv *moved,
                        const double (*uv)[2], const double b[2], const double uv_extent[2],
                        float out[3])
{
    float at[2], width[2];
    for (int k = 0; k < 2; k++) {
        at[k] = (float)(uv[0][k] + b[0] * (uv[1][k] - uv[0][k]) + b[1] * (uv[2][k] - uv[0][k]));
        at[k] = bsq_uv_apply(moved, k, at[k]);
        width[k] = bsq_uv_width(moved, k, (float)uv_extent[k]);
    }
    return fmt_texture_sample(textures, image, at[0], at[1], width[0], width[1], out);
}

int vox_shade_texture(const struct vox_shading *shading, uint32_t image, const double (*uv)[2],
                      const double b[2], const double uv_extent[2], double rgb[3])
{
    float color[3];
    int status = vox_sample_fragment(
        shading->textures, image, &shading->header->materials[image].uv, uv, b, uv_extent, color);
    for (int k = 0; k < 3 && status == 0; k++)
        rgb[k] = (double)color[k];
    return status;
}
