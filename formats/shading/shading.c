/* shading.c - the sources of a scan's attributes, and their values.
 *
 * All textures are one set, in which image a * (materials + 1) + m is that of attribute a and
 * material m. */
#include "base/srgb.h"
#include "formats/shading/shading.h"

#include <string.h>
#include <unistd.h>

#include "formats/material/channels.h"
#include "formats/material/file_extent.h"
#include "base/sort_array.h"
#include "formats/material/tile_files.h"
#include "formats/texture/texture.h"

/* Returns the number of sources that an attribute has. */
static uint64_t source_count(const struct fmt_shading *shading)
{
    return shading->header->material_count + UINT64_C(1);
}

/* Makes attribute `number` used, with sources of zeros. */
static int shading_add(struct fmt_shading *shading, uint32_t number, const struct fmt_channel *row,
                       struct fmt_tris_source **sources)
{
    struct bsq_ctx *ctx = shading->ctx;
    const uint32_t count = number < FMT_SHADING_CHANNELS ? FMT_SHADING_CHANNELS : number + 1;
    BSQ_PASS(
        BSQ_GROW(ctx, "attributes", count, &shading->attributes, &shading->attribute_capacity));
    for (; shading->attribute_count < count; shading->attribute_count++)
        shading->attributes[shading->attribute_count] = (struct fmt_attribute){0};
    BSQ_PASS(BSQ_CALLOC(ctx, "attributes", source_count(shading), sources));
    shading->attributes[number] = (struct fmt_attribute){.row = row, .sources = *sources};
    return 0;
}

int fmt_shading_add_color(struct fmt_shading *shading)
{
    static const struct fmt_channel row = {.name = "color", .values = 3, .color = true};
    const struct fmt_tris_header *header = shading->header;
    struct fmt_tris_source *sources;
    if (!fmt_tris_has_color(header))
        return 0;
    BSQ_PASS(shading_add(shading, FMT_SHADING_COLOR, &row, &sources));
    BSQ_PASS(
        BSQ_CALLOC(shading->ctx, "material colours", source_count(shading), &shading->diffuse));
    for (uint32_t m = 0; m < header->material_count; m++) {
        const struct fmt_tris_material *material = &header->materials[m];
        for (int k = 0; k < 3; k++)
            shading->diffuse[m][k] = bsq_srgb_to_linear((double)material->diffuse[k]);
        if ((header->attributes & FMT_TRIS_TEXCOORDS) && !material->colorless)
            sources[m] = (struct fmt_tris_source){
                .texture_path = material->texture_path, .value = {1, 1, 1}, .uv = material->uv};
    }
    return 0;
}

/* Adds an attribute that an image gives, for all triangles, or else a channel of the chunk file. */
static int shading_add_channel(struct fmt_shading *shading, uint32_t number, const char *name,
                               const char *path)
{
    const struct fmt_tris_header *header = shading->header;
    const struct fmt_channel *row = fmt_channel_find(name);
    const uint32_t channel = fmt_tris_find_channel(header, name), none = header->material_count;
    struct fmt_tris_source *sources;
    BSQ_PASS(shading_add(shading, number, row, &sources));
    for (uint64_t m = 0; path && m <= none; m++)
        sources[m] = (struct fmt_tris_source){.texture_path = (char *)(uintptr_t)path,
                                              .value = {1, 1, 1},
                                              .component = row->component};
    for (uint32_t m = 0; !path && m < none; m++)
        sources[m] = header->materials[m].sources[channel];
    for (int k = 0; !path && k < 3; k++)
        sources[none].value[k] = row->usual;
    return 0;
}

int fmt_shading_add_normal_map(struct fmt_shading *shading, const char *path)
{
    static const char name[] = FMT_CHANNEL_NORMAL_MAP;
    if (!path && fmt_tris_find_channel(shading->header, name) == UINT32_MAX)
        return 0;
    if (path && !(shading->header->attributes & FMT_TRIS_TEXCOORDS))
        return bsq_fail(shading->ctx, BSQ_EDATA,
                        "%s has no texture coordinates for the normal map %s: make it again, with "
                        "--scan-normal-map",
                        shading->path, path);
    return shading_add_channel(shading, FMT_SHADING_NORMAL_MAP, name, path);
}

int fmt_shading_add_channel(struct fmt_shading *shading, const char *name, const char *path)
{
    const uint32_t count = shading->attribute_count;
    if (path && !(shading->header->attributes & FMT_TRIS_TEXCOORDS))
        return bsq_fail(shading->ctx, BSQ_EDATA,
                        "%s has no texture coordinates for the map %s: make it with "
                        "bisque-voxelize --channels %s=%s",
                        shading->path, name, name, path);
    if (!path && fmt_tris_find_channel(shading->header, name) == UINT32_MAX)
        return bsq_fail(shading->ctx, BSQ_EDATA,
                        "%s has no channel %s: make it with bisque-voxelize --channels %s",
                        shading->path, name, name);
    return shading_add_channel(shading, count > 0 ? count : FMT_SHADING_CHANNELS, name, path);
}

/* Returns the name that tells apart triangles of a material, or those without one. */
static const char *shading_name_of(const struct fmt_tris_header *header, uint64_t material)
{
    const bool named = material < header->material_count && header->materials[material].name;
    return named ? header->materials[material].name : "";
}

int fmt_shading_add_ids(struct fmt_shading *shading)
{
    const uint64_t count = source_count(shading);
    BSQ_PASS(BSQ_ALLOC(shading->ctx, "ids", count, &shading->ids));
    for (uint64_t m = 0; m < count; m++)
        shading->ids[m] = fmt_name_id(shading_name_of(shading->header, m));
    return 0;
}

static int by_bytes(const void *a, const void *b)
{
    return strcmp(*(const char *const *)a, *(const char *const *)b);
}

int fmt_shading_id_names(struct bsq_ctx *ctx, const struct fmt_tris_header *header,
                         const char ***names, uint64_t *count)
{
    const uint64_t all = header->material_count + UINT64_C(1);
    *count = 0;
    BSQ_PASS(BSQ_ALLOC(ctx, "names of ids", all, names));
    for (uint64_t m = 0; m < all; m++)
        (*names)[m] = shading_name_of(header, m);
    bsq_sort(*names, all, sizeof **names, by_bytes);
    for (uint64_t m = 0; m < all; m++)
        if (*count == 0 || strcmp((*names)[*count - 1], (*names)[m]) != 0)
            (*names)[(*count)++] = (*names)[m];
    return bsq_check(ctx);
}

/* ---- textures ---- */

/* Sets what fmt_textures_open() needs of an image. */
static void image_of(const void *arg, uint64_t image, struct fmt_texture_source *out)
{
    const struct fmt_shading *shading = arg;
    const struct fmt_attribute *attribute = &shading->attributes[image / source_count(shading)];
    if (!attribute->sources)
        return;
    const struct fmt_tris_source *source = &attribute->sources[image % source_count(shading)];
    out->path = source->texture_path;
    out->data = !attribute->row->color;
    out->srgb = source->uv.srgb;
    out->alpha = fmt_channel_needs_alpha(source->component);
}

bool fmt_shading_needs_textures(const struct fmt_shading *shading)
{
    for (uint32_t a = 0; a < shading->attribute_count; a++)
        for (uint64_t m = 0; shading->attributes[a].sources && m < source_count(shading); m++)
            if (shading->attributes[a].sources[m].texture_path)
                return true;
    return false;
}

/* Returns whether the chunk file names a texture, and not an option. */
static bool is_own(const struct fmt_tris_header *header, const char *path)
{
    bool own = false;
    for (uint32_t m = 0; m < header->material_count; m++) {
        const struct fmt_tris_material *material = &header->materials[m];
        own |= path == material->texture_path;
        for (uint32_t c = 0; material->sources && c < header->channel_count; c++)
            own |= path == material->sources[c].texture_path;
    }
    return own;
}

/* Refuses a scan whose textures are not where they were when it was sorted. */
static int shading_find_textures(const struct fmt_shading *shading)
{
    for (uint64_t i = 0; i < shading->attribute_count * source_count(shading); i++) {
        struct fmt_texture_source source = {0};
        struct fmt_extent extent;
        image_of(shading, i, &source);
        if (!source.path || fmt_extent_parse(source.path, &extent) > 0 ||
            fmt_has_tiles(source.path) || access(source.path, F_OK) == 0 ||
            !is_own(shading->header, source.path))
            continue;
        return bsq_fail(shading->ctx, BSQ_ENOINPUT,
                        "%s: its texture %s is missing: put it there, or sort the scan with "
                        "--embed-textures",
                        shading->path, source.path);
    }
    return 0;
}

int fmt_shading_open_textures(struct fmt_shading *shading, uint64_t cache_bytes)
{
    BSQ_PASS(shading_find_textures(shading));
    return fmt_textures_open(shading->ctx, shading->attribute_count * source_count(shading),
                             image_of, shading, cache_bytes, &shading->textures);
}

int fmt_shading_tell_losses(const struct fmt_shading *shading)
{
    return fmt_textures_tell_losses(shading->textures);
}

void fmt_shading_close(struct fmt_shading *shading)
{
    fmt_textures_close(shading->textures);
    for (uint32_t a = 0; a < shading->attribute_count; a++)
        bsq_free(shading->ctx, shading->attributes[a].sources);
    if (shading->ctx) {
        BSQ_FREE(shading->ctx, shading->attributes, shading->diffuse, shading->ids);
    }
    *shading = (struct fmt_shading){0};
}

/* ---- triangles ---- */

uint32_t fmt_shade_id(const struct fmt_shading *shading, const struct fmt_tris_chunk *chunk,
                      uint32_t triangle, const double weights[3])
{
    int nearest = 0;
    if (shading->header->ids != FMT_IDS_COLOR)
        return shading->ids[fmt_shading_material(shading, chunk, triangle)];
    for (int i = 1; i < 3; i++)
        nearest = weights[i] > weights[nearest] ? i : nearest;
    return chunk->colors ? chunk->colors[chunk->triangles[triangle][nearest]] : 0;
}

/* For a channel with one value, copies one component of a texture's sample to all three entries.
 * Samples of alpha have it three times already. value: of the channel, for FMT_CHANNEL_CUTOUT. */
static void pick(const struct fmt_channel *channel, uint32_t component, float value,
                 float sample[3])
{
    float picked = sample[component < FMT_CHANNEL_ALPHA ? component : 0];
    if (component == FMT_CHANNEL_CUTOUT)
        picked = picked >= value ? 1.0f : 0.0f;
    if (channel->values == 1)
        sample[0] = sample[1] = sample[2] = picked;
}

/* Applies the factor of a texture to its sample: neutral + factor * (sample - neutral). The third
 * value of a normal map stays as it is. */
static void scale(const struct fmt_channel *channel, const float factor[3], float sample[3])
{
    const bool normals = strcmp(channel->name, FMT_CHANNEL_NORMAL_MAP) == 0;
    for (int k = 0; k < (normals ? 2 : 3); k++)
        if (factor[k] != 1.0f)
            sample[k] = channel->neutral + factor[k] * (sample[k] - channel->neutral);
}

int fmt_shade_attribute(const struct fmt_shading *shading, uint32_t attribute,
                        const struct fmt_shading_footprint *footprint, float out[3])
{
    const struct fmt_attribute *of = &shading->attributes[attribute];
    const struct fmt_tris_source *source = &of->sources[footprint->material];
    const uint64_t image = attribute * source_count(shading) + footprint->material;
    float at[2], width[2];
    if (!shading->textures || !source->texture_path) {
        memcpy(out, source->value, sizeof source->value);
        return 0;
    }
    for (int k = 0; k < 2; k++) {
        at[k] = fmt_uv_apply(&source->uv, k, footprint->at[k]);
        width[k] = fmt_uv_width(&source->uv, k, footprint->width[k]);
    }
    BSQ_PASS(fmt_texture_sample(shading->textures, (uint32_t)image, source->uv.wrap, at[0], at[1],
                                width[0], width[1], out));
    pick(of->row, source->component, source->value[0], out);
    if (source->component != FMT_CHANNEL_CUTOUT)
        scale(of->row, source->value, out);
    return 0;
}
