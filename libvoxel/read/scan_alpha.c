/* scan_alpha.c - the alpha channels of colour textures as opacity of materials. */
#include "base/loss.h"
#include "base/uv.h"
#include "formats/texture/texture.h"
#include "libvoxel/read/scan.h"

#include <string.h>

/* Memory for decoding an image, as a share of what is left. */
enum { DECODING_SHARE = 2 };

/* Returns the channel that the alpha of a colour texture gives, if the scan keeps it and no image
 * of the options gives it; else NULL. */
static const struct bsq_channel *wanted_channel(const struct scan *scan)
{
    for (uint32_t c = 0; c < scan->channel_count; c++) {
        const struct bsq_channel *channel = bsq_channel_find(scan->channels[c].name);
        if (channel->component == BSQ_CHANNEL_ALPHA && !scan->channels[c].texture_path)
            return channel;
    }
    return NULL;
}

/* Makes the alpha of a texture a channel of the material, unless that has another texture of it,
 * which is good. Sets *lost to the material if it also has a value, which is not multiplied. */
static int add_alpha(struct bsq_ctx *ctx, const struct scan_textures *textures,
                     const struct bsq_channel *channel, const char *path, const struct bsq_uv *uv,
                     struct fmt_material *material, const struct fmt_material **lost)
{
    struct fmt_material_channel *entry;
    const size_t size = strlen(path) + 1;
    int status = fmt_material_enter_channel(ctx, material, channel, &entry);
    if (status < 0 || (entry->texture_path && vox_textures_have(textures, entry->texture_path)))
        return status;
    bsq_free(ctx, entry->texture_path);
    bsq_free(ctx, entry->texture_place);
    entry->texture_place = NULL;
    status = bsq_alloc(ctx, "names", size, 1, &entry->texture_path);
    if (status < 0)
        return status;
    memcpy(entry->texture_path, path, size);
    if (entry->has_value && entry->value[0] != 1.0f && !material->cutout)
        *lost = material;
    entry->component = material->cutout ? BSQ_CHANNEL_CUTOUT : BSQ_CHANNEL_ALPHA;
    entry->uv = *uv;
    return 0;
}

/* Returns the texture whose alpha a material may have, or NULL. path: of all materials, or NULL. */
static const char *color_texture(const struct scan_textures *textures, const char *path,
                                 const struct fmt_material *material)
{
    if (path)
        return path;
    return material->texture_path && !material->opaque &&
                   vox_textures_have(textures, material->texture_path)
               ? material->texture_path
               : NULL;
}

/* The colour textures of materials. */
struct color_textures {
    const struct scan_textures *textures;
    const char *path;
    const struct fmt_materials *materials;
};

static void source_of(const void *arg, uint64_t material, struct fmt_texture_source *out)
{
    const struct color_textures *colors = arg;
    out->path = color_texture(colors->textures, colors->path, &colors->materials->list[material]);
}

int vox_scan_use_alpha(struct scan *scan, const struct scan_textures *textures, const char *path,
                       struct fmt_materials *materials)
{
    static const struct bsq_uv unmoved = {0};
    const struct bsq_channel *channel = wanted_channel(scan);
    const struct fmt_material *lost = NULL;
    struct fmt_textures *images;
    if (!channel || scan_count(scan, SCAN_TEXCOORDS) == 0)
        return 0;
    int status = fmt_textures_open_each(
        scan->ctx, materials->count, source_of, &(struct color_textures){textures, path, materials},
        bsq_memory_share(scan->ctx, "alpha of textures", DECODING_SHARE), &images);
    for (uint32_t i = 0; i < materials->count && status == 0 && images; i++) {
        struct fmt_material *material = &materials->list[i];
        const char *texture = color_texture(textures, path, material);
        if (texture && fmt_texture_has_alpha(images, i))
            status = add_alpha(scan->ctx, textures, channel, texture,
                               path ? &unmoved : &material->uv, material, &lost);
    }
    fmt_textures_close(images);
    if (status == 0 && lost)
        status = bsq_warn_loss(scan->ctx,
                               "material \"%s\": %s: its value is not used, but the alpha of its "
                               "texture",
                               lost->name, channel->name);
    return status;
}
