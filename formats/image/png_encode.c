/* png_encode.c - turns samples into integers, filters rows and deflates bands of rows.
 *
 * 8-bit samples are dithered with the additive recurrence of Roberts, "The Unreasonable
 * Effectiveness of Quasirandom Sequences", 2018: threshold = frac(x / g + y / g^2), where g is the
 * plastic number. In 32-bit fixed point it is exact on every machine and has no visible period. It
 * averages to one half over every neighbourhood, so gradients keep their mean and do not band.
 *
 * Each row takes the filter whose bytes, read as signed numbers, have the smallest sum of absolute
 * values (PNG specification, section 12.8). The first row of a band needs the bytes of the row
 * above. They are computed again from the samples of that row, so bands do not wait for each other.
 */
#include "formats/image/png_internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    DEFLATE_LEVEL = 5, /* 9 takes several times as long and saves a few per cent of the size */
    WINDOW_BITS = 15,
    MEMORY_LEVEL = 9,
    DEFLATE_BYTES = 1 << 19 /* memory of deflate with these settings, rounded up */
};

enum { FILTER_NONE, FILTER_SUB, FILTER_UP, FILTER_AVERAGE, FILTER_PAETH, FILTERS };

/* ---- samples to bytes ---- */

/* Encodes linear light as sRGB (IEC 61966-2-1). */
static float srgb_from_linear(float v)
{
    return v <= 0.0031308f ? 12.92f * v : 1.055f * powf(v, 1.0f / 2.4f) - 0.055f;
}

/* Returns a threshold in [0, 1). Channels are a third apart, so that grey does not dither in step.
 */
static float dither_threshold(uint32_t x, uint32_t y, uint32_t channel)
{
    uint32_t turn = x * 3242174889u + y * 2447445414u + channel * 1431655765u;
    return (float)(turn >> 8) * 0x1p-24f;
}

static void quantise_row(const struct fmt_png_layout *layout, const float *in, uint32_t y,
                         uint8_t *out)
{
    uint32_t channels = layout->channel_count;
    uint32_t colors = channels == 4 ? 3 : channels; /* alpha is linear */
    float linear = 0.0f, encoded = 0.0f;            /* the last value; grey has three alike */
    for (uint32_t x = 0; x < layout->width; ++x) {
        for (uint32_t c = 0; c < channels; ++c) {
            float v = *in++;
            v = v > 0.0f ? (v < 1.0f ? v : 1.0f) : 0.0f; /* NaN becomes 0 */
            if (layout->srgb && c < colors) {
                if (v != linear)
                    encoded = srgb_from_linear(v);
                linear = v;
                v = encoded;
            }
            if (layout->bits == 8) {
                float threshold = layout->labels ? 0.5f : dither_threshold(x, y, c);
                uint32_t level = (uint32_t)(v * 255.0f + threshold);
                *out++ = (uint8_t)(level < 255 ? level : 255);
            } else {
                uint32_t level = (uint32_t)(v * 65535.0f + 0.5f);
                *out++ = (uint8_t)(level >> 8);
                *out++ = (uint8_t)level;
            }
        }
    }
}

/* ---- filters ---- */

static uint8_t paeth(int left, int above, int corner)
{
    int to_left = abs(above - corner), to_above = abs(left - corner);
    int to_corner = abs(left + above - 2 * corner);
    if (to_left <= to_above && to_left <= to_corner)
        return (uint8_t)left;
    return (uint8_t)(to_above <= to_corner ? above : corner);
}

/* Filters the bytes [begin, end) of a row. step: bytes of a pixel; begin must be at least `step`.
 */
static void filter_bytes(int filter, const uint8_t *row, const uint8_t *above, size_t begin,
                         size_t end, size_t step, uint8_t *out)
{
    switch (filter) {
    case FILTER_SUB:
        for (size_t i = begin; i < end; ++i)
            out[i] = (uint8_t)(row[i] - row[i - step]);
        break;
    case FILTER_UP:
        for (size_t i = begin; i < end; ++i)
            out[i] = (uint8_t)(row[i] - above[i]);
        break;
    case FILTER_AVERAGE:
        for (size_t i = begin; i < end; ++i)
            out[i] = (uint8_t)(row[i] - (row[i - step] + above[i]) / 2);
        break;
    case FILTER_PAETH:
        for (size_t i = begin; i < end; ++i)
            out[i] = (uint8_t)(row[i] - paeth(row[i - step], above[i], above[i - step]));
        break;
    default:
        memcpy(out + begin, row + begin, end - begin);
        break;
    }
}

/* Filters a row. In the first pixel, the bytes to the left count as 0. */
static void filter_row(int filter, const uint8_t *row, const uint8_t *above, size_t bytes,
                       size_t step, uint8_t *out)
{
    for (size_t i = 0; i < step; ++i) {
        int up = filter == FILTER_UP || filter == FILTER_PAETH ? above[i]
                 : filter == FILTER_AVERAGE                    ? above[i] / 2
                                                               : 0;
        out[i] = (uint8_t)(row[i] - up);
    }
    filter_bytes(filter, row, above, step, bytes, step, out);
}

/* Returns the sum of the absolute values of signed bytes. */
static uint64_t cost(const uint8_t *bytes, size_t count)
{
    uint64_t sum = 0;
    for (size_t i = 0; i < count; ++i)
        sum += (uint64_t)abs((int8_t)bytes[i]);
    return sum;
}

/* Writes the number of the best filter and the filtered row. above: NULL in the first row of the
 * image, which only tries filters that need no row above. */
static void write_row(struct fmt_png_encoder *encoder, const uint8_t *row, const uint8_t *above,
                      size_t bytes, size_t step, uint8_t *out)
{
    uint64_t least = UINT64_MAX;
    for (int filter = FILTER_NONE; filter < (above ? FILTERS : FILTER_UP); ++filter) {
        filter_row(filter, row, above, bytes, step, encoder->trial);
        uint64_t sum = cost(encoder->trial, bytes);
        if (sum < least) {
            least = sum;
            out[0] = (uint8_t)filter;
            memcpy(out + 1, encoder->trial, bytes);
        }
    }
}

/* ---- bands ---- */

uint64_t fmt_png_row_bytes(const struct fmt_png_layout *layout)
{
    return (uint64_t)layout->width * layout->channel_count * (layout->bits / 8);
}

static int start_deflate(struct bsq_ctx *ctx, struct fmt_png_encoder *encoder)
{
    int status = bsq_reserve(ctx, "PNG compression", DEFLATE_BYTES);
    if (status < 0)
        return status;
    if (deflateInit2(&encoder->deflate, DEFLATE_LEVEL, Z_DEFLATED, -WINDOW_BITS, MEMORY_LEVEL,
                     Z_FILTERED) != Z_OK) {
        bsq_release(ctx, DEFLATE_BYTES);
        return bsq_fail(ctx, BSQ_ENOMEM, "the system has no memory left for PNG compression");
    }
    encoder->ready = true;
    return 0;
}

int fmt_png_encoder_create(struct bsq_ctx *ctx, const struct fmt_png_layout *layout, uint32_t rows,
                           struct fmt_png_encoder *out)
{
    *out = (struct fmt_png_encoder){.ready = false};
    uint64_t row_bytes = fmt_png_row_bytes(layout);
    int status = start_deflate(ctx, out);
    if (status == 0) {
        /* Includes space for the flush that ends a band. */
        out->packed_capacity = deflateBound(&out->deflate, rows * (row_bytes + 1)) + 64;
        status = bsq_alloc(ctx, "PNG band", 1, out->packed_capacity, &out->packed);
    }
    if (status == 0)
        status = bsq_alloc(ctx, "PNG band", rows, row_bytes + 1, &out->filtered);
    if (status == 0)
        status = bsq_alloc(ctx, "PNG row", 1, row_bytes, &out->trial);
    for (int i = 0; status == 0 && i < 2; ++i)
        status = bsq_alloc(ctx, "PNG row", 1, row_bytes, &out->rows[i]);
    return status;
}

void fmt_png_encoder_free(struct bsq_ctx *ctx, struct fmt_png_encoder *encoder)
{
    if (encoder->ready) {
        deflateEnd(&encoder->deflate);
        bsq_release(ctx, DEFLATE_BYTES);
    }
    bsq_free(ctx, encoder->packed);
    bsq_free(ctx, encoder->filtered);
    bsq_free(ctx, encoder->trial);
    bsq_free(ctx, encoder->rows[0]);
    bsq_free(ctx, encoder->rows[1]);
}

static int deflate_band(struct bsq_ctx *ctx, struct fmt_png_encoder *encoder, bool last)
{
    z_stream *stream = &encoder->deflate;
    encoder->packed_bytes = 0;
    uint64_t taken = 0;
    deflateReset(stream);
    for (;;) {
        /* zlib counts in 32 bits. */
        uint64_t input = encoder->filtered_bytes - taken;
        uint64_t left = encoder->packed_capacity - encoder->packed_bytes;
        bool whole = input <= (1u << 30);
        uint32_t given = whole ? (uint32_t)input : 1u << 30;
        uint32_t space = left < (1u << 30) ? (uint32_t)left : 1u << 30;
        stream->next_in = encoder->filtered + taken;
        stream->avail_in = given;
        stream->next_out = encoder->packed + encoder->packed_bytes;
        stream->avail_out = space;
        int result = deflate(stream, !whole ? Z_NO_FLUSH : last ? Z_FINISH : Z_SYNC_FLUSH);
        taken += given - stream->avail_in;
        encoder->packed_bytes += space - stream->avail_out;
        if (whole && stream->avail_out > 0)
            return result == (last ? Z_STREAM_END : Z_OK)
                       ? 0
                       : bsq_fail(ctx, BSQ_EBUG, "deflate: unexpected result %d", result);
        if (encoder->packed_bytes == encoder->packed_capacity)
            return bsq_fail(ctx, BSQ_EBUG, "deflate: a band needs more than its bound");
    }
}

int fmt_png_encode(struct bsq_ctx *ctx, struct fmt_png_encoder *encoder,
                   const struct fmt_png_layout *layout, const struct fmt_png_band *band)
{
    size_t row_bytes = fmt_png_row_bytes(layout);
    size_t step = layout->channel_count * (layout->bits / 8);
    size_t row_samples = (size_t)layout->width * layout->channel_count;
    uint8_t *row = encoder->rows[0], *above = NULL;
    if (band->above) {
        above = encoder->rows[1];
        quantise_row(layout, band->above, band->first_row - 1, above);
    }
    for (uint32_t r = 0; r < band->rows; ++r) {
        quantise_row(layout, band->samples + r * row_samples, band->first_row + r, row);
        write_row(encoder, row, above, row_bytes, step, encoder->filtered + r * (row_bytes + 1));
        above = row;
        row = encoder->rows[row == encoder->rows[0]];
    }
    encoder->filtered_bytes = band->rows * (row_bytes + 1);
    encoder->checksum =
        (uint32_t)adler32_z(1, encoder->filtered, (z_size_t)encoder->filtered_bytes);
    return deflate_band(ctx, encoder, band->first_row + band->rows == layout->height);
}
