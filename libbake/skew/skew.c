/* skew.c - see skew.h. */
#include "libbake/skew/skew.h"

#include <math.h>
#include <stdlib.h>

#include "base/job_files.h"
#include "libbake/bake.h"
#include "libbake/kernel/bk_types.h"
#include "libbake/udim/udim.h"

enum { LEAST_CACHE = 12 << 20, MOST_CACHE = 256 << 20 };

/* Names the images of the tiles, which the caller frees. */
static int name_images(struct bsq_ctx *ctx, const char *path, const uint32_t *tiles, uint32_t count,
                       struct fmt_texture_source *sources)
{
    for (uint32_t i = 0; i < count; i++) {
        sources[i] =
            (struct fmt_texture_source){.path = bake_tile_path(path, tiles[i]), .data = true};
        BSQ_PASS(sources[i].path ? bsq_note_input(ctx, sources[i].path, "the skew map")
                                 : bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", path));
    }
    return 0;
}

int bake_skew_open(struct bsq_ctx *ctx, const char *path, const uint32_t *tiles, uint32_t count,
                   struct fmt_textures **out)
{
    struct fmt_texture_source *sources;
    uint64_t cache = bsq_memory_left(ctx) / 16;
    *out = NULL;
    BSQ_PASS(BSQ_CALLOC(ctx, "skew map", count, &sources));
    cache = cache < LEAST_CACHE ? LEAST_CACHE : cache > MOST_CACHE ? MOST_CACHE : cache;
    int status = name_images(ctx, path, tiles, count, sources);
    if (status == 0)
        status = fmt_textures_open(ctx, sources, count, cache, out);
    if (status == 0)
        status = fmt_textures_tell_losses(*out);
    for (uint32_t i = 0; i < count; i++)
        free((void *)(uintptr_t)sources[i].path);
    bsq_free(ctx, sources);
    return status;
}

int bake_skew_sample(const struct bake_skew_image *image, float u, float v, float du, float dv,
                     uint32_t *out)
{
    static const uint8_t wrap[2] = {FMT_WRAP_CLAMP, FMT_WRAP_CLAMP};
    float rgb[3];
    int status = fmt_texture_sample(image->textures, image->number, wrap, u, v, du, dv, rgb);
    const float value = rgb[0] > 0 ? fminf(rgb[0], 1.0F) : 0; /* not a number: 0 */
    *out = status == 0 ? (uint32_t)(value * (float)BK_SKEW_ONE + 0.5F) : 0;
    return status;
}
