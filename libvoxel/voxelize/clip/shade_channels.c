/* shade_channels.c - further channels of a scan, such as roughness, on the way to the grid. */
#include "base/channels.h"
#include "libvoxel/voxelize/clip/shade.h"

#include <string.h>

static const struct fmt_tris_source *source_of(const struct vox_shading *shading, uint32_t material,
                                               uint32_t channel)
{
    return &shading->header->materials[material].sources[shading->channels.list[channel].number];
}

/* Adds a channel. The list must have it once only; the scan must have it. */
static int add_channel(struct bsq_ctx *ctx, const struct fmt_tris_file *file, const char *list,
                       const char *name, struct vox_shading_channels *channels)
{
    int status = fmt_tris_require_channel(file, name);
    if (status < 0)
        return status;
    const uint32_t number = fmt_tris_find_channel(fmt_tris_get_header(file), name);
    for (uint32_t c = 0; c < channels->count; c++)
        if (channels->list[c].number == number)
            return bsq_fail(ctx, BSQ_EUSAGE, "\"%.60s\" names a channel twice", list);
    channels->list[channels->count++] =
        (struct vox_shading_channel){.number = number, .row = bsq_channel_find(name)};
    return 0;
}

static int find_channels(struct bsq_ctx *ctx, const struct fmt_tris_file *file, const char *list,
                         struct vox_shading_channels *channels)
{
    char *names;
    int status = bsq_alloc(ctx, "names of channels", strlen(list) + 1, 1, &names);
    if (status < 0)
        return status;
    memcpy(names, list, strlen(list) + 1);
    channels->words = bsq_channel_list_values(list, strlen(list)); /* at least one a channel */
    status = bsq_alloc(ctx, "channels", channels->words, sizeof *channels->list, &channels->list);
    char *rest = names;
    for (char *name = strsep(&rest, ","); name && status == 0; name = strsep(&rest, ","))
        status = add_channel(ctx, file, list, name, channels);
    bsq_free(ctx, names);
    return status;
}

/* Sets the values of materials, and which of them have textures. Returns whether any has one. */
static bool set_values(struct vox_shading *shading)
{
    struct vox_shading_channels *channels = &shading->channels;
    bool any = false;
    for (uint32_t m = 0; m < shading->header->material_count; m++) {
        double *to = channels->values + (uint64_t)m * channels->words;
        for (uint32_t c = 0; c < channels->count; c++) {
            const struct fmt_tris_source *source = source_of(shading, m, c);
            channels->textured[m] |= source->texture_path != NULL;
            for (uint32_t k = 0; k < channels->list[c].row->values; k++)
                *to++ = (double)source->value[k];
        }
        any |= channels->textured[m];
    }
    /* What triangles without a material have. */
    double *none = channels->values + (uint64_t)shading->header->material_count * channels->words;
    for (uint32_t c = 0; c < channels->count; c++)
        for (uint32_t k = 0; k < channels->list[c].row->values; k++)
            *none++ = (double)channels->list[c].row->usual;
    return any && (shading->header->attributes & FMT_TRIS_TEXCOORDS);
}

/* The texture of a material for a channel; those of the first channel come first. */
static void image_of(const void *arg, uint64_t index, struct fmt_texture_source *out)
{
    const struct vox_shading *shading = arg;
    const uint64_t materials = shading->header->material_count;
    const uint32_t channel = (uint32_t)(index / materials);
    const struct fmt_tris_source *source =
        source_of(shading, (uint32_t)(index % materials), channel);
    out->path = source->texture_path;
    out->data = !shading->channels.list[channel].row->color;
    out->alpha = bsq_channel_needs_alpha(source->component);
}

int vox_shading_use_channels(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                             const char *list, uint64_t texture_bytes, struct vox_shading *shading)
{
    struct vox_shading_channels *channels = &shading->channels;
    const uint64_t materials = shading->header->material_count;
    int status = find_channels(ctx, file, list, channels);
    if (status == 0)
        status = bsq_calloc(ctx, "channels", materials + 1,
                            channels->words * sizeof *channels->values, &channels->values);
    if (status == 0)
        status = bsq_calloc(ctx, "channels", materials + 1, sizeof *channels->textured,
                            &channels->textured);
    if (status == 0 && set_values(shading))
        status = fmt_textures_open_each(ctx, channels->count * materials, image_of, shading,
                                        texture_bytes, &channels->textures);
    return status;
}

bool vox_shading_channels_need_textures(const struct fmt_tris_header *header, const char *list)
{
    uint32_t first;
    for (uint32_t c = 0; list && c < header->channel_count; c++)
        if (bsq_channel_list_find(list, strlen(list), header->channels[c], &first))
            for (uint32_t m = 0; m < header->material_count; m++)
                if (header->materials[m].sources[c].texture_path)
                    return true;
    return false;
}

void vox_shading_channels_free(struct bsq_ctx *ctx, struct vox_shading_channels *channels)
{
    fmt_textures_close(channels->textures);
    bsq_free(ctx, channels->list);
    bsq_free(ctx, channels->values);
    bsq_free(ctx, channels->textured);
    *channels = (struct vox_shading_channels){0};
}

/* ---- triangles ---- */

bool vox_shade_has_textures(const struct vox_shading *shading, const struct vox_chunk *chunk,
                            uint32_t triangle)
{
    return shading->channels.textures &&
           shading->channels.textured[vox_shade_material(shading, chunk, triangle)];
}

const double *vox_shade_channels(const struct vox_shading *shading, const struct vox_chunk *chunk,
                                 uint32_t triangle)
{
    return shading->channels.values +
           (uint64_t)vox_shade_material(shading, chunk, triangle) * shading->channels.words;
}

int vox_shade_channel_textures(const struct vox_shading *shading, const struct vox_chunk *chunk,
                               uint32_t triangle, const double (*uv)[2], const double b[2],
                               const double uv_extent[2], double *out)
{
    const struct vox_shading_channels *channels = &shading->channels;
    const uint32_t material = vox_shade_material(shading, chunk, triangle);
    int status = 0;
    memcpy(out, vox_shade_channels(shading, chunk, triangle), channels->words * sizeof *out);
    for (uint32_t c = 0; c < channels->count && status == 0; c++) {
        const struct fmt_tris_source *source = source_of(shading, material, c);
        const struct bsq_channel *row = channels->list[c].row;
        float sample[3];
        if (source->texture_path) {
            const uint32_t image = c * shading->header->material_count + material;
            status = vox_sample_fragment(channels->textures, image, &source->uv, uv, b, uv_extent,
                                         sample);
            if (status == 0)
                bsq_channel_pick(row, source->component, source->value[0], sample);
            for (uint32_t k = 0; k < row->values && status == 0; k++)
                out[k] = (double)sample[k];
        }
        out += row->values;
    }
    return status;
}
