/* exact_transfer.c - further channels of a scan: their textures, and their values at hits. Also the
 * scan's normal map, which is such a channel. */
#include "base/channels.h"
#include "libbake/exact/exact_scene.h"

#include <string.h>

/* Returns the number of sources that each transfer has. */
static uint64_t sources_each(const struct bake_exact *exact)
{
    return exact->header->material_count + UINT64_C(1);
}

/* Finds the sources of a channel: in the chunk file, or the image of the options. */
static int find_sources(struct bake_exact *exact, const struct bake_transfer *transfer,
                        struct fmt_tris_source *out)
{
    const struct fmt_tris_header *header = exact->header;
    if (transfer->texture_path && !(header->attributes & FMT_TRIS_TEXCOORDS))
        return bsq_fail(exact->ctx, BSQ_EDATA,
                        "%s has no texture coordinates for the map %s: make it with "
                        "bisque-voxelize --channels %s=%s",
                        exact->options.paths[0], transfer->name, transfer->name,
                        transfer->texture_path);
    for (uint64_t m = 0; transfer->texture_path && m < sources_each(exact); m++)
        out[m] = (struct fmt_tris_source){.texture_path = (char *)(uintptr_t)transfer->texture_path,
                                          .component = bsq_channel_find(transfer->name)->component};
    if (transfer->texture_path)
        return 0;
    int status = fmt_tris_require_channel(exact->file, transfer->name);
    const uint32_t channel = fmt_tris_find_channel(header, transfer->name);
    const float usual = bsq_channel_find(transfer->name)->usual;
    for (int k = 0; k < 3; k++)
        out[header->material_count].value[k] = usual;
    for (uint32_t m = 0; m < header->material_count && status == 0; m++)
        out[m] = header->materials[m].sources[channel];
    return status;
}

/* What image_of() tells the images of. */
struct image_list {
    const struct exact_transfers *transfers;
    uint64_t each; /* sources of a transfer map */
};

static void image_of(const void *arg, uint64_t index, struct fmt_texture_source *out)
{
    const struct image_list *list = arg;
    const struct fmt_tris_source *source = &list->transfers->sources[index];
    out->path = source->texture_path;
    out->alpha = bsq_channel_needs_alpha(source->component);
    out->data = !list->transfers->rows[index / list->each]->color;
}

static int use(struct bake_exact *exact, const struct bake_transfer *list, uint32_t count,
               struct exact_transfers *out)
{
    const uint64_t each = sources_each(exact);
    *out = (struct exact_transfers){.count = count, .list = list};
    int status =
        bsq_calloc(exact->ctx, "channels", count * each, sizeof *out->sources, &out->sources);
    if (status == 0)
        status = bsq_calloc(exact->ctx, "channels", count, sizeof(void *), &out->rows);
    for (uint32_t i = 0; i < count && status == 0; i++) {
        out->rows[i] = bsq_channel_find(list[i].name);
        status = find_sources(exact, &list[i], out->sources + i * each);
    }
    return status < 0 ? status
                      : fmt_textures_open_each(exact->ctx, count * each, image_of,
                                               &(struct image_list){out, each},
                                               exact_cache_bytes(exact), &out->textures);
}

int bake_exact_use_transfers(struct bake_exact *exact, const struct bake_transfer *transfers,
                             uint32_t count)
{
    return use(exact, transfers, count, &exact->transfers);
}

int bake_exact_use_normal_map(struct bake_exact *exact, const char *path)
{
    const struct fmt_tris_header *header = exact->header;
    if (!path && fmt_tris_find_channel(header, BSQ_CHANNEL_NORMAL_MAP) == UINT32_MAX)
        return 0;
    exact->normal_map_source =
        (struct bake_transfer){.name = BSQ_CHANNEL_NORMAL_MAP, .texture_path = path};
    return use(exact, &exact->normal_map_source, 1, &exact->normal_map);
}

static void free_transfers(struct bsq_ctx *ctx, struct exact_transfers *transfers)
{
    fmt_textures_close(transfers->textures);
    bsq_free(ctx, transfers->sources);
    bsq_free(ctx, transfers->rows);
    *transfers = (struct exact_transfers){0};
}

void bake_exact_transfers_free(struct bake_exact *exact)
{
    free_transfers(exact->ctx, &exact->transfers);
    free_transfers(exact->ctx, &exact->normal_map);
}

int bake_exact_tell_losses(struct bake_exact *exact)
{
    struct fmt_textures *const sets[3] = {exact->textures, exact->normal_map.textures,
                                          exact->transfers.textures};
    return fmt_textures_tell_losses(sets, 3);
}

int bake_exact_sample(struct fmt_textures *textures, uint32_t image,
                      const struct exact_texture_place *at, const struct bsq_uv *uv, float out[3])
{
    return fmt_texture_sample(textures, image, bsq_uv_apply(uv, 0, at->u),
                              bsq_uv_apply(uv, 1, at->v), bsq_uv_width(uv, 0, at->du),
                              bsq_uv_width(uv, 1, at->dv), out);
}

/* Returns the number of a material among the sources of a channel. */
static uint32_t source_number(const struct bake_exact *exact, uint32_t material)
{
    const uint32_t none = exact->header->material_count;
    return material < none ? material : none;
}

int bake_exact_sample_normal_map(const struct bake_exact *exact,
                                 const struct exact_texture_place *at, float out[3])
{
    const struct exact_transfers *map = &exact->normal_map;
    const uint32_t image = source_number(exact, at->material);
    memset(out, 0, 3 * sizeof *out);
    return map->sources[image].texture_path
               ? bake_exact_sample(map->textures, image, at, &map->sources[image].uv, out)
               : 0;
}

int bake_exact_shade_channels(const struct bake_exact *exact, const struct exact_texture_place *at,
                              float *out)
{
    const struct exact_transfers *transfers = &exact->transfers;
    const uint32_t material = source_number(exact, at->material);
    int status = 0;
    for (uint32_t i = 0; i < transfers->count && status == 0; i++, out += BK_TRANSFER_VALUES) {
        const uint32_t image = (uint32_t)(i * sources_each(exact)) + material;
        const struct fmt_tris_source *source = &transfers->sources[image];
        memcpy(out, source->value, sizeof source->value);
        if (!source->texture_path)
            continue;
        status = bake_exact_sample(transfers->textures, image, at, &source->uv, out);
        if (status == 0)
            bsq_channel_pick(transfers->rows[i], source->component, source->value[0], out);
    }
    return status;
}
