/* read_map.c - reads a map into floats: OpenEXR, PNG, or another format that textures may have.
 *
 * Integers become 0 to 1. Bisque and other programs store the attributes of PNG files as texts. */
#include <string.h>

#include "base/text.h"
#include "formats/texture/image_rows.h"
#include "libbake/compare/comparison.h"

/* Takes the texts before the texels of a PNG file. */
static int read_texts(struct bsq_ctx *ctx, const void *png, struct fmt_exr_image *out)
{
    const char *name, *value;
    uint64_t capacity = 0;
    int status = 0;
    for (uint32_t i = 0; fmt_png_text(png, i, &name, &value); i++) {
        BSQ_TRY(bsq_grow(ctx, "a map's attributes", i + UINT64_C(1), sizeof *out->attributes,
                         &out->attributes, &capacity));
        struct fmt_exr_attribute *attribute = &out->attributes[out->attribute_count++];
        *attribute = (struct fmt_exr_attribute){0};
        BSQ_TRY(bsq_text_copy(ctx, name, &attribute->name));
        BSQ_TRY(bsq_text_copy(ctx, value, &attribute->value));
    }
done:
    return status;
}

static void to_floats(const struct fmt_rows_info *info, const uint8_t *row, float *out)
{
    const size_t count = (size_t)info->width * info->channels;
    for (size_t i = 0; i < count; i++) {
        uint16_t wide;
        if (info->sample_bytes == 1) {
            out[i] = (float)row[i] / 255.0f;
        } else if (info->sample_bytes == 2) {
            memcpy(&wide, row + 2 * i, sizeof wide);
            out[i] = (float)wide / 65535.0f;
        } else {
            memcpy(&out[i], row + 4 * i, sizeof out[i]);
        }
    }
}

/* Names the channels: grey or RGB, perhaps with alpha. */
static int name_channels(struct bsq_ctx *ctx, const struct fmt_rows_info *info,
                         struct fmt_exr_image *out)
{
    static const char *const grey[] = {"Y", "A"}, *const rgb[] = {"R", "G", "B", "A"};
    const char *const *names = info->channels >= 3 ? rgb : grey;
    int status;
    BSQ_TRY(
        bsq_calloc(ctx, "a map's channels", info->channels, sizeof *out->channels, &out->channels));
    for (; out->channel_count < info->channels; out->channel_count++)
        BSQ_TRY(bsq_text_copy(ctx, names[out->channel_count], &out->channels[out->channel_count]));
done:
    return status;
}

static int read_rows(struct bsq_ctx *ctx, struct fmt_rows *rows, struct fmt_exr_image *out)
{
    const struct fmt_rows_info *info = &rows->info;
    const uint64_t samples = (uint64_t)info->width * info->channels;
    uint8_t *row = NULL;
    int status;
    if (info->channels > 4)
        return bsq_fail(ctx, BSQ_EDATA, "%s: %u channels; a map that is not OpenEXR has at most 4",
                        rows->input.path, info->channels);
    out->width = info->width;
    out->height = info->height;
    BSQ_TRY(name_channels(ctx, info, out));
    BSQ_TRY(bsq_alloc(ctx, "a map", samples * info->height, sizeof(float), &out->samples));
    BSQ_TRY(bsq_alloc(ctx, "a row of a map", samples, info->sample_bytes, &row));
    for (uint32_t y = 0; y < info->height; y++) {
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(rows->decoder->read(rows->state, row));
        to_floats(info, row, out->samples + y * samples);
    }
    if (rows->decoder == &fmt_png_rows)
        BSQ_TRY(read_texts(ctx, rows->state, out));
    status = bsq_file_check(ctx, &rows->input.file);
done:
    bsq_free(ctx, row);
    return status;
}

int bake_map_read(struct bsq_ctx *ctx, const char *path, struct fmt_exr_image *out,
                  struct bake_samples *samples)
{
    static const char exr[4] = {0x76, 0x2f, 0x31, 0x01};
    struct bsq_file file = BSQ_FILE_CLOSED;
    struct fmt_rows rows = {0};
    char head[sizeof exr] = {0};
    uint64_t got = 0;
    int status;
    BSQ_TRY(bsq_file_open(ctx, path, &file));
    BSQ_TRY(bsq_file_read_some(ctx, &file, head, sizeof head, 0, &got));
    *samples = (struct bake_samples){.gamma = 1};
    if (memcmp(head, exr, sizeof exr) == 0) {
        status = fmt_exr_read(ctx, path, out);
        goto done;
    }
    BSQ_TRY(fmt_rows_open(ctx, path, 1, &rows));
    samples->integers = rows.info.sample_bytes < 4;
    samples->gamma = samples->integers ? rows.info.gamma : 1;
    status = read_rows(ctx, &rows, out);
done:
    fmt_rows_close(&rows);
    bsq_file_close(ctx, &file);
    if (status < 0)
        fmt_exr_image_free(ctx, out);
    return status;
}
