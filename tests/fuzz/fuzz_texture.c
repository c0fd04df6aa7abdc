/* fuzz_texture.c - fuzz target for textures: PNG, JPEG and EXR files, which are decoded here. Most
 * mutated PNG files get correct checksums, so that mutations reach the chunks' content. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#include "formats/texture/texture.h"
#include "tests/fuzz/fuzz_file.h"

static const uint8_t png[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
static bool data_texels, alpha; /* how the image is opened; the input's size decides */

static int use(struct bsq_ctx *ctx, const char *const *paths, uint32_t count)
{
    const struct fmt_texture_source source = {
        .path = paths[0], .data = data_texels, .alpha = alpha};
    struct fmt_textures *textures;
    float color[3];
    (void)count;
    int status = fmt_textures_open(ctx, 1, fmt_texture_source_at, &source, 1, &textures);
    if (status)
        return status;
    for (int i = 0; !status && i < 18; i++) {
        const uint8_t wrap[2] = {(uint8_t)(i % 3), (uint8_t)(i / 3 % 3)};
        const float u = (float)i * 0.3f - 1, v = (float)i * 0.7f - 3, size = (float)(i % 5) * 0.1f;
        status = fmt_texture_sample(textures, 0, wrap, u, v, size, size, color);
        for (int k = 0; !status && k < 3; k++)
            require(isfinite(color[k]), "a colour is not finite");
    }
    if (!status)
        status = fmt_textures_tell_losses(textures);
    fmt_textures_close(textures);
    return status;
}

static bool begins(const uint8_t *data, size_t size, const uint8_t *magic, size_t length)
{
    return size >= length && memcmp(data, magic, length) == 0;
}

static uint32_t load_big(const uint8_t *from)
{
    return (uint32_t)from[0] << 24 | (uint32_t)from[1] << 16 | (uint32_t)from[2] << 8 | from[3];
}

/* Corrects the checksums of all chunks. */
static void mend(uint8_t *data, size_t size)
{
    for (size_t at = sizeof png; size >= at + 12 && load_big(data + at) <= size - at - 12;) {
        const uint32_t length = load_big(data + at);
        const uint32_t sum = (uint32_t)crc32(0, data + at + 4, length + 4);
        for (int i = 0; i < 4; i++)
            data[at + 8 + length + (size_t)i] = (uint8_t)(sum >> (24 - 8 * i));
        at += 12 + (size_t)length;
    }
}

size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned seed)
{
    size = LLVMFuzzerMutate(data, size, max_size);
    if (seed % 16 != 0 && begins(data, size, png, sizeof png))
        mend(data, size);
    return size;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const uint8_t jpeg[3] = {0xff, 0xd8, 0xff}, exr[4] = {0x76, 0x2f, 0x31, 0x01};
    if (!begins(data, size, png, sizeof png) && !begins(data, size, jpeg, sizeof jpeg) &&
        !begins(data, size, exr, sizeof exr))
        return -1; /* another program would decode it */
    data_texels = size & 1;
    alpha = size & 2;
    return fuzz_system_file(data, size, "fuzz.image", use);
}
