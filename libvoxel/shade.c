/* shade.c - interpolates what is linear over a triangle at the centroid of a piece, which gives the
 * piece's mean exactly; a texture is averaged over the piece's extent instead. */
#include "libvoxel/shade.h"
#include "base/srgb.h"

#include <math.h>
#include <string.h>

static bool has_materials(const struct fmt_tris_header *header)
{
    return (header->attributes & FMT_TRIS_MATERIALS) && header->material_count > 0;
}

bool vox_shading_has_color(const struct fmt_tris_header *header)
{
    return has_materials(header) || (header->attributes & FMT_TRIS_COLORS);
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

static int open_textures(struct bsq_ctx *ctx, const struct fmt_tris_header *header,
                         uint64_t texture_bytes, struct fmt_textures **out)
{
    const char **paths;
    int status = bsq_calloc(ctx, "texture paths", header->material_count, sizeof *paths, &paths);
    if (status < 0)
        return status;
    for (uint32_t i = 0; i < header->material_count; i++)
        paths[i] = header->materials[i].texture_path;
    status = fmt_textures_open(ctx, paths, header->material_count, texture_bytes, out);
    bsq_free(ctx, paths);
    return status;
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
    if (vox_shading_needs_textures(header) &&
        (status = open_textures(ctx, header, texture_bytes, &out->textures)) < 0)
        vox_shading_free(ctx, out);
    return status;
}

void vox_shading_free(struct bsq_ctx *ctx, struct vox_shading *shading)
{
    if (shading->textures)
        fmt_textures_close(shading->textures);
    shading->textures = NULL;
    bsq_free(ctx, shading->diffuse);
    shading->diffuse = NULL;
}

/* ---- corners ---- */

static void texture_corners(const struct vox_chunk *chunk, const uint32_t v[3], uint32_t material,
                            struct vox_corners *out)
{
    out->color_source = VOX_COLOR_TEXTURE;
    out->image = material;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 2; k++)
            out->uv[i][k] = (double)chunk->source.texcoords[v[i]][k];
}

static void vertex_colors(const struct vox_shading *shading, const struct vox_chunk *chunk,
                          const uint32_t v[3], struct vox_corners *out)
{
    out->color_source = VOX_COLOR_VERTEX;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            out->rgb[i][k] =
                shading->tables.to_linear[chunk->source.colors[v[i]] >> (8 * k) & 0xff];
}

void vox_shade_corners(const struct vox_shading *shading, const struct vox_chunk *chunk,
                       uint32_t triangle, struct vox_corners *out)
{
    const uint32_t *v = chunk->source.triangles[triangle];
    out->has_normals = chunk->normals != NULL;
    out->curved = out->has_normals && chunk->coarse;
    if (out->has_normals)
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                out->normal[i][k] = (double)chunk->normals[v[i]][k];

    uint32_t material = chunk->source.materials && shading->diffuse
                            ? chunk->source.materials[triangle]
                            : UINT32_MAX;
    if (material != UINT32_MAX && shading->textures &&
        shading->header->materials[material].texture_path) {
        texture_corners(chunk, v, material, out);
    } else if (chunk->source.colors) {
        vertex_colors(shading, chunk, v, out);
    } else if (material != UINT32_MAX) {
        out->color_source = VOX_COLOR_DIFFUSE;
        memcpy(out->rgb[0], shading->diffuse[material], sizeof out->rgb[0]);
    } else {
        out->color_source = VOX_COLOR_NONE;
    }
}

/* ---- pieces ---- */

static inline double blend(double first, double second, double third, const double b[2])
{
    return first + b[0] * (second - first) + b[1] * (third - first);
}

void vox_shade_normal(const struct vox_corners *c, const double b[2], double normal[3])
{
    double n[3], square = 0.0;
    for (int k = 0; k < 3; k++) {
        n[k] = blend(c->normal[0][k], c->normal[1][k], c->normal[2][k], b);
        square += n[k] * n[k];
    }
    /* Normals that cancel say less than the triangle itself. */
    if (!(square > 1e-12)) {
        memcpy(normal, c->flat, sizeof c->flat);
        return;
    }
    double scale = 1.0 / sqrt(square);
    for (int k = 0; k < 3; k++)
        normal[k] = n[k] * scale;
}

static int shade_texture(const struct vox_shading *shading, const struct vox_corners *c,
                         const double b[2], const double uv_extent[2], double rgb[3])
{
    float color[3];
    double u = blend(c->uv[0][0], c->uv[1][0], c->uv[2][0], b);
    double v = blend(c->uv[0][1], c->uv[1][1], c->uv[2][1], b);
    int status = fmt_texture_sample(shading->textures, c->image, (float)u, (float)v,
                                    (float)uv_extent[0], (float)uv_extent[1], color);
    for (int k = 0; k < 3 && status == 0; k++)
        rgb[k] = (double)color[k];
    return status;
}

int vox_shade_color(const struct vox_shading *shading, const struct vox_corners *c,
                    const double b[2], const double uv_extent[2], double rgb[3])
{
    switch (c->color_source) {
    case VOX_COLOR_TEXTURE:
        return shade_texture(shading, c, b, uv_extent, rgb);
    case VOX_COLOR_VERTEX:
        for (int k = 0; k < 3; k++)
            rgb[k] = blend(c->rgb[0][k], c->rgb[1][k], c->rgb[2][k], b);
        return 0;
    default:
        memcpy(rgb, c->rgb[0], sizeof c->rgb[0]);
        return 0;
    }
}
