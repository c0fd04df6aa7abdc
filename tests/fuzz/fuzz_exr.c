/* fuzz_exr.c - fuzz target for OpenEXR maps, as bisque-compare reads them. */
#include "formats/image/exr_read.h"
#include "tests/fuzz/fuzz_file.h"

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
    fmt_exr_image_free(ctx, &image);
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_system_file(data, size, "fuzz.exr", use);
}
