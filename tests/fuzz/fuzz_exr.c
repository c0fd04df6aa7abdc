/* fuzz_exr.c - fuzz target for OpenEXR maps, as bisque-compare reads them, and for parts of bakes.
 */
#include "formats/image/exr_read.h"
#include "tests/fuzz/fuzz_file.h"

/* Reads all tiles, as merges of bakes do. */
static int read_tiles(struct bsq_ctx *ctx, const char *path, const struct fmt_exr_image *image)
{
    struct fmt_exr_rows *rows = NULL;
    struct bsq_file file;
    const float *texels;
    int status = bsq_file_open(ctx, path, &file);
    if (status == 0)
        status = fmt_exr_tiles_open(ctx, path, &file, (const char *const *)image->channels,
                                    image->channel_count, &rows);
    const uint32_t side = status == 0 ? fmt_exr_tile_side(rows) : 0;
    for (uint32_t y = 0; side > 0 && y < image->height && status == 0; y += side)
        for (uint32_t x = 0; x < image->width && status == 0; x += side)
            status = fmt_exr_tile_read(rows, x / side, y / side, &texels);
    fmt_exr_rows_close(rows);
    bsq_file_close(ctx, &file);
    return status;
}

static int use(struct bsq_ctx *ctx, const char *const *paths, uint32_t count)
{
    const char *path = paths[0];
    (void)count;
    struct fmt_exr_image image;
    int status = fmt_exr_read(ctx, path, &image);
    if (status)
        return status;
    require(image.width > 0 && image.height > 0 && image.channel_count > 0,
            "an image without size");
    status = read_tiles(ctx, path, &image);
    fmt_exr_image_free(ctx, &image);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_system_file(data, size, "fuzz.exr", use);
}
