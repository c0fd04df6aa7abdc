/* picture.c - makes small pictures of maps, and finds the ranges of their values. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "formats/image/image_writer.h"
#include "libbake/page/items.h"

enum { LARGEST_SIDE = 1024 };

int bake_page_begin_picture(struct bsq_ctx *ctx, uint32_t width, uint32_t height,
                            struct bake_page_picture *out)
{
    const uint32_t side =
        bake_thumbnail_side(LARGEST_SIDE, bsq_memory_share(ctx, "pictures of a page", 16));
    for (int k = 0; k < 3; k++) {
        out->low[k] = INFINITY;
        out->high[k] = -INFINITY;
    }
    return bake_thumbnail_create(ctx, width, height, side, &out->texels);
}

int bake_page_take_rows(struct bsq_ctx *ctx, struct bake_page_picture *picture, uint32_t channels,
                        uint32_t first_row, uint32_t rows, const float *samples)
{
    const uint64_t texels = (uint64_t)rows * picture->texels.full_width;
    for (uint64_t i = 0; i < texels; i++)
        for (uint32_t k = 0; k < 3; k++) {
            const float value = samples[i * channels + (channels >= 3 ? k : 0)];
            if (isfinite(value)) {
                picture->low[k] = fminf(picture->low[k], value);
                picture->high[k] = fmaxf(picture->high[k], value);
            }
        }
    return bake_thumbnail_add(ctx, &picture->texels, channels, first_row, rows, samples);
}

/* Maps the range of each channel to 0 to 1, unless it lies in there. What is not finite is 0. */
static void normalise(struct bake_page_picture *picture)
{
    const uint64_t texels = (uint64_t)picture->texels.width * picture->texels.height;
    for (int k = 0; k < 3; k++) {
        float *low = &picture->low[k], *high = &picture->high[k];
        if (picture->color || (*low >= 0 && *high <= 1)) {
            *low = 0;
            *high = 1;
        }
        const float scale = *high > *low ? 1 / (*high - *low) : 0;
        for (uint64_t i = 0; i < texels; i++) {
            float *texel = &picture->texels.texels[i][k];
            *texel = isfinite(*texel) ? (*texel - *low) * scale : 0;
        }
    }
}

int bake_page_add_picture(struct bake_page *page, json_t *head, struct bake_page_picture *picture)
{
    const struct bake_thumbnail *texels = &picture->texels;
    const struct fmt_image_options options = {.width = texels->width,
                                              .height = texels->height,
                                              .channel_count = 3,
                                              .type = FMT_UINT8,
                                              .color = picture->color,
                                              .rounded = true,
                                              .temporary = true};
    struct fmt_image_writer *writer = NULL;
    struct bsq_output *output = NULL;
    int status;
    float *low = picture->low, *high = picture->high;
    for (int k = 0; k < 3; k++)
        if (!(low[k] <= high[k])) /* no value is finite */
            low[k] = high[k] = 0;
    json_object_set_new(
        head, "range",
        json_pack("[[f,f],[f,f],[f,f]]", low[0], high[0], low[1], high[1], low[2], high[2]));
    normalise(picture);
    BSQ_TRY(fmt_image_create(page->ctx, &fmt_png_format, page->path, &options, &writer));
    BSQ_TRY(fmt_image_write_rows(writer, texels->texels[0], texels->height));
    status = fmt_image_hand_over(writer, &output);
    writer = NULL;
    if (status == 0)
        status = bake_page_add(page, json_incref(head), output);
done:
    fmt_image_discard(writer);
    bsq_output_discard(output);
    json_decref(head);
    return status;
}

/* ---- rows of a bake ---- */

int bake_page_take(void *user, const struct bake_rows *rows)
{
    struct bake_page *page = user;
    struct bake_page_picture *picture = page->pictures;
    int status;
    while (picture && strcmp(picture->path, rows->path) != 0)
        picture = picture->next;
    if (!picture) {
        BSQ_TRY(bsq_calloc(page->ctx, "page", 1, sizeof *picture, &picture));
        picture->next = page->pictures;
        page->pictures = picture;
        picture->path = rows->path;
        picture->color = rows->light;
        BSQ_TRY(bake_page_begin_picture(page->ctx, rows->width, rows->height, picture));
    }
    BSQ_TRY(bake_page_take_rows(page->ctx, picture, rows->channels, rows->first, rows->count,
                                rows->samples));
    if (rows->first + rows->count < rows->height)
        return 0;
    char *path = bsq_escape(rows->path, true);
    json_t *head = json_pack("{s:s, s:s, s:s, s:i, s:i, s:i}", "kind", "map", "name", rows->map,
                             "path", path ? path : "", "width", (int)rows->width, "height",
                             (int)rows->height, "channels", (int)rows->channels);
    free(path);
    status = bake_page_add_picture(page, head, picture);
    bake_thumbnail_free(page->ctx, &picture->texels);
done:
    return status;
}
