/* scan_alpha.c - the alpha channels of colour textures as opacity of materials. */
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

static int find_alpha(struct bsq_ctx *ctx, const char *path, bool *out)
{
    const struct fmt_texture_source source = {.path = path};
    struct fmt_textures *textures;
    int status =
        fmt_textures_open(ctx, &source, 1, bsq_memory_left(ctx) / DECODING_SHARE, &textures);
    *out = status == 0 && fmt_texture_has_alpha(textures, 0);
    fmt_textures_close(textures);
    return status;
}

/* Makes the alpha of a texture a channel of the material, unless that has another texture of it. */
static int add_alpha(struct bsq_ctx *ctx, const struct bsq_channel *channel, const char *path,
                     const struct bsq_uv *uv, struct fmt_material *material)
{
    struct fmt_material_channel *entry;
    const size_t size = strlen(path) + 1;
    int status = fmt_material_enter_channel(ctx, material, channel, &entry);
    if (status < 0 || entry->texture_path)
        return status;
    status = bsq_alloc(ctx, "names", size, 1, &entry->texture_path);
    if (status < 0)
        return status;
    memcpy(entry->texture_path, path, size);
    entry->component = BSQ_CHANNEL_ALPHA;
    entry->uv = *uv;
    return 0;
}

int vox_scan_use_alpha(struct scan *scan, const struct scan_textures *textures,
                       struct fmt_materials *materials)
{
    const struct bsq_channel *channel = wanted_channel(scan);
    const char *path = NULL; /* of the texture that was looked at last */
    bool alpha = false;
    int status = 0;
    if (!channel || scan_count(scan, SCAN_TEXCOORDS) == 0)
        return 0;
    for (uint32_t i = 0; i < materials->count && status == 0; i++) {
        struct fmt_material *material = &materials->list[i];
        if (!material->texture_path || material->opaque ||
            !vox_textures_have(textures, material->texture_path))
            continue;
        if (!path || strcmp(path, material->texture_path) != 0)
            status = find_alpha(scan->ctx, material->texture_path, &alpha);
        path = material->texture_path;
        if (status == 0 && alpha)
            status = add_alpha(scan->ctx, channel, path, &material->uv, material);
    }
    return status;
}

int vox_scan_use_alpha_of(struct scan *scan, const char *path, struct fmt_materials *materials,
                          struct fmt_materials *none)
{
    static const struct bsq_uv unmoved = {0};
    const struct bsq_channel *channel = wanted_channel(scan);
    struct fmt_materials *const lists[] = {materials, none};
    bool alpha = false;
    int status = channel ? find_alpha(scan->ctx, path, &alpha) : 0;
    for (int list = 0; list < 2 && alpha; list++)
        for (uint32_t i = 0; i < lists[list]->count && status == 0; i++)
            status = add_alpha(scan->ctx, channel, path, &unmoved, &lists[list]->list[i]);
    return status;
}
