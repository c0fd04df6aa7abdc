/* images.c - writes smaller copies of the images of an asset, as PNG or JPEG files, and looks up
 * points of an image. Part of the extension, see ffi_build.py. */
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jpeglib.h>

#include "base/srgb.h"
#include "formats/image/image_writer.h"
#include "formats/texture/image_rows.h"
#include "formats/texture/texture.h"

enum image_use { IMAGE_DATA, IMAGE_COLOR, IMAGE_NORMAL };

/* What becomes of an image. */
struct image_copy {
    const char *path, *output;
    enum image_use use; /* colours are averaged in linear light, normals as directions */
    uint32_t factor;    /* texels of a side that become one; it divides width and height */
    uint32_t channels;  /* of the copy, 1 or 3: the first ones of the image */
    int quality;        /* of a JPEG file, 1 to 100; 0: a PNG file */
};

struct jpeg_file {
    struct jpeg_compress_struct jpeg;
    struct jpeg_error_mgr errors;
    jmp_buf target;
    FILE *stream;
    bool created;
    char message[JMSG_LENGTH_MAX];
};

struct image_state {
    const struct image_copy *copy;
    struct bsq_ctx *ctx;
    struct fmt_rows rows;
    uint32_t width; /* of the copy */
    bool linear;   /* colours are averaged in linear light; copies of one size have their samples */
    float *values; /* of each sample that the image can have */
    void *row;
    float *sums;
    uint8_t *bytes; /* a row of a JPEG file */
    struct fmt_image_writer *png;
    struct jpeg_file jpeg;
};

/* ---- JPEG files; libjpeg leaves its functions by longjmp ---- */

static void leave_jpeg(j_common_ptr jpeg)
{
    struct jpeg_file *file = jpeg->client_data;
    file->errors.format_message(jpeg, file->message);
    longjmp(file->target, 1);
}

static int fail_jpeg(struct image_state *state)
{
    return bsq_fail(state->ctx, BSQ_EIO, "%s: %s", state->copy->output, state->jpeg.message);
}

static int start_jpeg(struct image_state *state, uint32_t height)
{
    struct jpeg_file *file = &state->jpeg;
    struct jpeg_compress_struct *jpeg = &file->jpeg;
    file->stream = fopen(state->copy->output, "wbe");
    if (!file->stream)
        return bsq_fail_errno(state->ctx, BSQ_ECANTCREAT, errno, "%s", state->copy->output);
    if (setjmp(file->target))
        return fail_jpeg(state);
    jpeg->err = jpeg_std_error(&file->errors);
    file->errors.error_exit = leave_jpeg;
    jpeg->client_data = file;
    file->created = true;
    jpeg_create_compress(jpeg);
    jpeg_stdio_dest(jpeg, file->stream);
    jpeg->image_width = state->width;
    jpeg->image_height = height;
    jpeg->input_components = (int)state->copy->channels;
    jpeg->in_color_space = state->copy->channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
    jpeg_set_defaults(jpeg);
    jpeg_set_quality(jpeg, state->copy->quality, TRUE);
    /* Colours as fine as brightness: 4:4:4. Otherwise those of charts reach over their borders. */
    jpeg->comp_info[0].h_samp_factor = jpeg->comp_info[0].v_samp_factor = 1;
    jpeg_start_compress(jpeg, TRUE);
    return 0;
}

static int write_jpeg_row(struct image_state *state)
{
    JSAMPROW row = state->bytes;
    if (setjmp(state->jpeg.target))
        return fail_jpeg(state);
    jpeg_write_scanlines(&state->jpeg.jpeg, &row, 1);
    return 0;
}

static int finish_jpeg(struct image_state *state)
{
    struct jpeg_file *file = &state->jpeg;
    if (setjmp(file->target))
        return fail_jpeg(state);
    jpeg_finish_compress(&file->jpeg);
    const int failed = fclose(file->stream);
    file->stream = NULL;
    return failed ? bsq_fail_errno(state->ctx, BSQ_EIO, errno, "%s", state->copy->output) : 0;
}

/* ---- rows ---- */

/* Adds a row of the image to the sums. */
static void add_image_row(struct image_state *state)
{
    const struct image_copy *copy = state->copy;
    const uint32_t step = state->rows.info.channels;
    const bool wide = state->rows.info.sample_bytes == 2;
    for (uint32_t x = 0; x < state->rows.info.width; x++)
        for (uint32_t c = 0; c < copy->channels; c++) {
            const uint64_t from = (uint64_t)x * step + (c < step ? c : step - 1);
            const unsigned sample =
                wide ? ((const uint16_t *)state->row)[from] : ((const uint8_t *)state->row)[from];
            state->sums[(uint64_t)(x / copy->factor) * copy->channels + c] += state->values[sample];
        }
}

/* Turns sums into samples from 0 to 1, colours in linear light. */
static void average_sums(struct image_state *state)
{
    const struct image_copy *copy = state->copy;
    const float count = (float)copy->factor * (float)copy->factor;
    for (uint64_t i = 0; i < (uint64_t)state->width * copy->channels; i++)
        state->sums[i] /= count;
    for (float *n = state->sums; copy->use == IMAGE_NORMAL && copy->factor > 1 &&
                                 n < state->sums + 3 * (uint64_t)state->width;
         n += 3) {
        float square = 0;
        for (int c = 0; c < 3; c++)
            square += (2 * n[c] - 1) * (2 * n[c] - 1);
        for (int c = 0; c < 3 && square > 0; c++)
            n[c] = (2 * n[c] - 1) / sqrtf(square) / 2 + 0.5f;
    }
}

/* Rounds samples to bytes; those between two levels alternate, so that means stay. */
static void round_row(struct image_state *state, uint32_t y)
{
    const uint32_t channels = state->copy->channels;
    for (uint32_t x = 0; x < state->width; x++)
        for (uint32_t c = 0; c < channels; c++) {
            const uint64_t i = (uint64_t)x * channels + c;
            const double value =
                state->linear ? bsq_linear_to_srgb((double)state->sums[i]) : (double)state->sums[i];
            state->bytes[i] =
                (uint8_t)(fmin(fmax(value, 0), 1) * 255 + ((x + y) & 1 ? 0.75 : 0.25));
        }
}

static int copy_rows(struct image_state *state)
{
    const struct image_copy *copy = state->copy;
    const uint64_t samples = (uint64_t)state->width * copy->channels;
    for (uint32_t y = 0; y < state->rows.info.height / copy->factor; y++) {
        memset(state->sums, 0, samples * sizeof *state->sums);
        for (uint32_t k = 0; k < copy->factor; k++) {
            BSQ_PASS(state->rows.decoder->read(state->rows.state, state->row));
            add_image_row(state);
        }
        average_sums(state);
        if (state->png) {
            BSQ_PASS(fmt_image_write_rows(state->png, state->sums, 1));
        } else {
            round_row(state, y);
            BSQ_PASS(write_jpeg_row(state));
        }
        BSQ_PASS(bsq_check(state->ctx));
    }
    return 0;
}

/* ---- the copy ---- */

static int start_image_copy(struct image_state *state)
{
    const struct image_copy *copy = state->copy;
    const struct fmt_rows_info *info = &state->rows.info;
    const uint32_t height = info->height / copy->factor;
    const uint32_t count = info->sample_bytes == 1 ? 256 : 65536;
    if (info->sample_bytes > 2 || info->width % copy->factor || info->height % copy->factor)
        return bsq_fail(state->ctx, BSQ_EDATA,
                        "%s: its size cannot be divided by %u, or its samples "
                        "are no integers",
                        copy->path, copy->factor);
    state->width = info->width / copy->factor;
    state->linear = copy->use == IMAGE_COLOR && copy->factor > 1;
    const uint64_t samples = (uint64_t)state->width * copy->channels;
    BSQ_PASS(BSQ_ALLOC(state->ctx, "an image", count, &state->values));
    BSQ_PASS(bsq_alloc(state->ctx, "an image", (uint64_t)info->width * info->channels,
                       info->sample_bytes, &state->row));
    BSQ_PASS(BSQ_ALLOC(state->ctx, "an image", samples, &state->sums));
    BSQ_PASS(BSQ_ALLOC(state->ctx, "an image", samples, &state->bytes));
    for (uint32_t i = 0; i < count; i++) {
        const double value = i / (count - 1.0);
        state->values[i] = (float)(state->linear ? bsq_srgb_to_linear(value) : value);
    }
    if (copy->quality > 0)
        return start_jpeg(state, height);
    const struct fmt_image_options options = {.width = state->width,
                                              .height = height,
                                              .channel_count = copy->channels,
                                              .type = FMT_UINT8,
                                              .color = state->linear};
    return fmt_image_create(state->ctx, &fmt_png_format, copy->output, &options, &state->png);
}

/* Copies an image. Errors: BSQ_EDATA, BSQ_EIO, BSQ_ECANTCREAT, BSQ_ENOMEM, BSQ_EINTR; a file that
 * is not complete may be left. */
static int images_copy(struct bsq_ctx *ctx, const struct image_copy *copy)
{
    struct image_state *state = NULL;
    struct bsq_output *output = NULL;
    int status;
    BSQ_TRY(BSQ_CALLOC(ctx, "an image", 1, &state));
    state->copy = copy;
    state->ctx = ctx;
    BSQ_TRY(fmt_rows_open(ctx, copy->path, 1, &state->rows));
    BSQ_TRY(start_image_copy(state));
    BSQ_TRY(copy_rows(state));
    if (!state->png) {
        status = finish_jpeg(state);
        goto done;
    }
    status = fmt_image_hand_over(state->png, &output);
    state->png = NULL;
    if (status == 0)
        status = bsq_output_commit(output);
done:
    if (state) {
        fmt_image_discard(state->png);
        if (state->jpeg.created)
            jpeg_destroy_compress(&state->jpeg.jpeg);
        if (state->jpeg.stream)
            fclose(state->jpeg.stream);
        fmt_rows_close(&state->rows);
        BSQ_FREE(ctx, state->values, state->row, state->sums, state->bytes, state);
    }
    return status;
}

/* ---- points of an image ---- */

/* Filters an image bilinearly at `count` points, from its lower left corner; beyond its border,
 * texels at the border count. cache_bytes, data, alpha, errors: as in formats/texture/texture.h. */
static int images_sample(struct bsq_ctx *ctx, const char *path, bool data, bool alpha,
                         uint64_t cache_bytes, uint64_t count, const float (*uv)[2],
                         float (*out)[3])
{
    static const uint8_t clamp[2] = {FMT_WRAP_CLAMP, FMT_WRAP_CLAMP};
    const struct fmt_texture_source source = {
        .path = path, .data = data, .srgb = !data, .alpha = alpha};
    struct fmt_textures *textures = NULL;
    int status = fmt_textures_open(ctx, 1, fmt_texture_source_at, &source, cache_bytes, &textures);
    for (uint64_t i = 0; status == 0 && i < count; i++)
        status = fmt_texture_sample(textures, 0, clamp, uv[i][0], uv[i][1], 0, 0, out[i]);
    fmt_textures_close(textures);
    return status;
}
