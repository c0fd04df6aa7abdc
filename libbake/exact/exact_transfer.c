/* exact_transfer.c - further channels of a scan: their textures, and their values at hits. */
#include "base/channels.h"
#include "libbake/exact/exact_scene.h"

static int open_textures(struct bake_exact *exact)
{
    struct exact_transfers *transfers = &exact->transfers;
    struct fmt_texture_source *sources;
    int status =
        bsq_calloc(exact->ctx, "texture paths", transfers->count, sizeof *sources, &sources);
    for (uint32_t i = 0; i < transfers->count && status == 0; i++)
        sources[i] = (struct fmt_texture_source){transfers->list[i].texture_path,
                                                 !bsq_channel_find(transfers->list[i].name)->color};
    if (status == 0)
        status = fmt_textures_open(exact->ctx, sources, transfers->count, exact_cache_bytes(exact),
                                   &transfers->textures);
    bsq_free(exact->ctx, sources);
    return status;
}

int bake_exact_use_transfers(struct bake_exact *exact, const struct bake_transfer *transfers,
                             uint32_t count)
{
    if (!(exact->header->attributes & FMT_TRIS_TEXCOORDS))
        return bsq_fail(exact->ctx, BSQ_EDATA,
                        "%s has no texture coordinates for the map %s: make it with "
                        "bisque-voxelize --texture FILE",
                        exact->options.paths[0], transfers[0].name);
    exact->transfers = (struct exact_transfers){.count = count, .list = transfers};
    return open_textures(exact);
}

void bake_exact_transfers_free(struct bake_exact *exact)
{
    if (exact->transfers.textures)
        fmt_textures_close(exact->transfers.textures);
    exact->transfers = (struct exact_transfers){0};
}

int bake_exact_shade_channels(const struct bake_exact *exact, const struct exact_texture_place *at,
                              float *out)
{
    const struct exact_transfers *transfers = &exact->transfers;
    int status = 0;
    for (uint32_t i = 0; i < transfers->count && status == 0; i++)
        status = fmt_texture_sample(transfers->textures, i, at->u, at->v, at->du, at->dv,
                                    out + (size_t)BK_TRANSFER_VALUES * i);
    return status;
}
