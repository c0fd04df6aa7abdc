/* map_image.c - the image that is baked, in memory or in a temporary file, and statistics of it.
 *
 * The file holds texels in row order. A patch is written as short runs, which the page cache
 * gathers; a band is read at once. Texels that were never written are holes of the file and read as
 * zeros. */
#include "libbake/maps/maps.h"

#include <math.h>
#include <string.h>

#include "base/file.h"
#include "base/parallel.h"

/* Chooses between memory and a file, and allocates or creates it. */
static int map_image_allocate(struct bake_image *image, const struct bake_image_options *options)
{
    struct bsq_ctx *ctx = image->ctx;
    uint64_t texels = (uint64_t)options->width * options->height, bytes;
    if (__builtin_mul_overflow(texels, image->texel_bytes, &bytes) || bytes > INT64_MAX)
        return bsq_fail(ctx, BSQ_EUSAGE, "a map of %u x %u texels is too large", options->width,
                        options->height);
    if (bytes <= options->memory_bytes)
        return bsq_calloc(ctx, "map", texels, image->texel_bytes, &image->samples);
    BSQ_PASS(bsq_require_disk(ctx, options->beside, bytes));
    return bsq_file_temp(ctx, options->beside, "map", &image->file);
}

int bake_image_create(struct bsq_ctx *ctx, const struct bake_image_options *options,
                      struct bake_image **out)
{
    *out = NULL;
    struct bake_image *image;
    BSQ_PASS(BSQ_CALLOC(ctx, "map", 1, &image));
    image->ctx = ctx;
    image->width = options->width;
    image->height = options->height;
    image->channels = options->channels;
    image->blocks = options->blocks;
    image->texel_bytes = options->channels * sizeof(float);
    image->file = (struct bsq_file)BSQ_FILE_CLOSED;
    int status = map_image_allocate(image, options);
    if (status < 0)
        bake_image_free(image);
    else
        *out = image;
    return status;
}

void bake_image_free(struct bake_image *image)
{
    if (!image)
        return;
    bsq_file_close(image->ctx, &image->file);
    BSQ_FREE(image->ctx, image->samples, image);
}

uint32_t bake_image_channels_for(uint32_t maps)
{
    uint32_t channels = 1;
    for (unsigned i = 0; i < BK_MAP_COUNT; ++i)
        if (maps & 1u << i)
            channels += bake_map_values(i);
    return channels + BK_TRANSFER_VALUES * bk_transfers(maps);
}

int bake_image_write(struct bake_image *image, uint32_t x, uint32_t y, uint32_t width,
                     uint32_t height, const float *samples)
{
    size_t run_bytes = width * image->texel_bytes;
    for (uint32_t row = 0; row < height; ++row) {
        uint64_t texel = (uint64_t)(y + row) * image->width + x;
        const float *run = samples + (size_t)row * width * image->channels;
        if (image->samples) {
            memcpy(image->samples + texel * image->channels, run, run_bytes);
        } else {
            BSQ_PASS(bsq_file_write(image->ctx, &image->file, run, run_bytes,
                                    texel * image->texel_bytes));
        }
    }
    return 0;
}

int bake_image_write_patch(struct bake_image *image, const struct bk_patch *patch,
                           const float *samples)
{
    uint32_t x = patch->x, y = patch->y;
    if (image->blocks)
        bake_blocks_to_image(image->blocks, &x, &y);
    return bake_image_write(image, x, y, patch->width, patch->height, samples);
}

int bake_image_rows(const struct bake_image *image, uint32_t y, uint32_t count, float *buffer,
                    const float **rows)
{
    uint64_t texel = (uint64_t)y * image->width;
    if (image->samples) {
        *rows = image->samples + texel * image->channels;
        return 0;
    }
    uint64_t size = (uint64_t)count * image->width * image->texel_bytes, got;
    BSQ_PASS(bsq_file_read_some(image->ctx, &image->file, buffer, size, texel * image->texel_bytes,
                                &got));
    memset((char *)buffer + got, 0, size - got); /* the file ends after the last texel written */
    *rows = buffer;
    return 0;
}

int bake_image_bands(struct bsq_ctx *ctx, struct bake_image *image, uint32_t band_rows, bool change,
                     bake_band_fn *fn, void *arg)
{
    const uint64_t row_bytes = image->width * image->texel_bytes;
    const uint64_t most = bsq_memory_left(ctx) / 4 / row_bytes;
    const uint32_t step = most < 1 ? 1 : most < band_rows ? (uint32_t)most : band_rows;
    const float *texels;
    float *buffer = NULL;
    int status = 0;
    if (!image->samples)
        BSQ_TRY(bsq_alloc(ctx, "rows of a map", step, row_bytes, &buffer));
    for (uint32_t y = 0; y < image->height; y += step) {
        const uint32_t rows = image->height - y < step ? image->height - y : step;
        BSQ_TRY(bake_image_rows(image, y, rows, buffer, &texels));
        BSQ_TRY(fn(arg, y, rows, (float *)(uintptr_t)texels));
        if (buffer && change)
            BSQ_TRY(bsq_file_write(ctx, &image->file, buffer, rows * row_bytes, y * row_bytes));
    }
done:
    bsq_free(ctx, buffer);
    return status;
}
