/* png_write.c - streaming PNG writer (docs/decisions/0018-images-are-compressed-in-parallel.md).
 *
 * Compression takes nearly all of the time, and libpng does it on one thread. So bands of rows are
 * filtered and deflated independently, on all threads, and joined to one stream. The chunks around
 * it need no library.
 *
 * 8-bit samples are dithered with the additive recurrence of Roberts, "The Unreasonable
 * Effectiveness of Quasirandom Sequences", 2018: threshold = frac(x / g + y / g^2), where g is the
 * plastic number. In 32-bit fixed point it is exact on every machine and has no visible period. It
 * averages to one half over every neighbourhood, so gradients keep their mean and do not band.
 *
 * All rows have the filter of Paeth. To choose filters by row, as the PNG specification suggests in
 * section 12.8, makes maps hardly smaller. The first row of a band needs the bytes of the row
 * above. They are computed again from the samples of that row, so bands do not wait for each other.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#include "base/output.h"
#include "formats/image/image_writer.h"

#define BAND_BYTES (UINT64_C(512) << 10) /* larger bands would hardly make files smaller */

enum {
    DEFLATE_LEVEL = 5, /* 9 takes several times as long and saves a few per cent of the size */
    WINDOW_BITS = 15,
    MEMORY_LEVEL = 9,
    DEFLATE_BYTES = 1 << 19 /* memory of deflate with these settings, rounded up */
};

static const uint8_t zlib_header[2] = {0x78, 0x5e}; /* deflate, 32 KiB window, level 5 */

struct png_writer {
    struct fmt_image_writer base;
    uint32_t bits;          /* 8 or 16 */
    bool rounded;           /* do not dither */
    bool srgb;              /* samples are linear light: encode and tag them as sRGB */
    size_t row_bytes, step; /* bytes of a row and of a pixel */
    uint32_t checksum;      /* Adler-32 of the filtered bytes written so far */
};

/* Encodes one band of rows at a time. */
struct encoder {
    z_stream deflate;
    bool ready;        /* `deflate` is initialised */
    uint8_t *rows[2];  /* the current row as bytes, and the row above it */
    uint8_t *filtered; /* the band: for each row the filter's number and the filtered bytes */
    uint8_t *packed;   /* the band, deflated */
    uint64_t packed_capacity, packed_bytes;
    uint64_t filtered_bytes;
    uint32_t checksum; /* Adler-32 of the filtered bytes */
};

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

/* Values up to a 32nd of a level below the middle between two levels are rounded up. So a component
 * of a normal that is 0 but for rounding, or for the precision of a grid, is always 128, as
 * programs expect it of flat parts, and never 127. */
#define HALF_UP (0.5f + 0x1p-5f)

static void quantise_row(const struct png_writer *writer, const float *in, uint32_t y, uint8_t *out)
{
    uint32_t channels = writer->base.channel_count;
    uint32_t colors = channels == 4 ? 3 : channels; /* alpha is linear */
    float linear = 0.0f, encoded = 0.0f;            /* the last value; grey has three alike */
    for (uint32_t x = 0; x < writer->base.width; ++x) {
        for (uint32_t c = 0; c < channels; ++c) {
            float v = *in++;
            v = v > 0.0f ? (v < 1.0f ? v : 1.0f) : 0.0f; /* NaN becomes 0 */
            if (writer->srgb && c < colors) {
                if (v != linear)
                    encoded = srgb_from_linear(v);
                linear = v;
                v = encoded;
            }
            if (writer->bits == 8) {
                float threshold = writer->rounded ? HALF_UP : dither_threshold(x, y, c);
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

/* ---- the filter ---- */

static uint8_t paeth(int left, int above, int corner)
{
    int to_left = abs(above - corner), to_above = abs(left - corner);
    int to_corner = abs(left + above - 2 * corner);
    if (to_left <= to_above && to_left <= to_corner)
        return (uint8_t)left;
    return (uint8_t)(to_above <= to_corner ? above : corner);
}

/* Writes the filter's number, and the differences of a row's bytes from their predictions. step:
 * bytes of a pixel; what is left of the first pixel counts as 0. */
static void filter_row(const uint8_t *row, const uint8_t *above, size_t bytes, size_t step,
                       uint8_t *out)
{
    enum { PAETH = 4 };
    *out++ = PAETH;
    for (size_t i = 0; i < step; ++i)
        out[i] = (uint8_t)(row[i] - above[i]);
    for (size_t i = step; i < bytes; ++i)
        out[i] = (uint8_t)(row[i] - paeth(row[i - step], above[i], above[i - step]));
}

/* ---- bands ---- */

static int start_deflate(struct bsq_ctx *ctx, struct encoder *encoder)
{
    BSQ_PASS(bsq_reserve(ctx, "PNG compression", DEFLATE_BYTES));
    if (deflateInit2(&encoder->deflate, DEFLATE_LEVEL, Z_DEFLATED, -WINDOW_BITS, MEMORY_LEVEL,
                     Z_FILTERED) != Z_OK) {
        bsq_release(ctx, DEFLATE_BYTES);
        return bsq_fail(ctx, BSQ_ENOMEM, "the system has no memory left for PNG compression");
    }
    encoder->ready = true;
    return 0;
}

static int png_out_create_encoder(struct fmt_image_writer *base, void *memory)
{
    struct encoder *encoder = memory;
    struct bsq_ctx *ctx = base->ctx;
    const uint64_t row_bytes = ((struct png_writer *)base)->row_bytes;
    BSQ_PASS(start_deflate(ctx, encoder));
    /* Includes space for the flush that ends a band. */
    encoder->packed_capacity =
        deflateBound(&encoder->deflate, base->block_rows * (row_bytes + 1)) + 64;
    BSQ_PASS(bsq_alloc(ctx, "PNG band", 1, encoder->packed_capacity, &encoder->packed));
    BSQ_PASS(bsq_alloc(ctx, "PNG band", base->block_rows, row_bytes + 1, &encoder->filtered));
    for (int i = 0; i < 2; ++i)
        BSQ_PASS(bsq_alloc(ctx, "PNG row", 1, row_bytes, &encoder->rows[i]));
    return 0;
}

static void png_out_free_encoder(struct fmt_image_writer *base, void *memory)
{
    struct encoder *encoder = memory;
    struct bsq_ctx *ctx = base->ctx;
    if (encoder->ready) {
        deflateEnd(&encoder->deflate);
        bsq_release(ctx, DEFLATE_BYTES);
    }
    BSQ_FREE(ctx, encoder->packed, encoder->filtered, encoder->rows[0], encoder->rows[1]);
}

static int deflate_band(struct bsq_ctx *ctx, struct encoder *encoder, bool last)
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

/* Encodes a band as a part of a deflate stream. The parts of all bands in order make the stream,
 * which the band with the image's last row ends. */
static int encode_band(struct fmt_image_writer *base, void *memory,
                       const struct fmt_image_block *band)
{
    const struct png_writer *writer = (const struct png_writer *)base;
    struct encoder *encoder = memory;
    const size_t row_bytes = writer->row_bytes;
    const size_t row_samples = (size_t)base->width * base->channel_count;
    uint8_t *row = encoder->rows[0], *above = encoder->rows[1];
    if (band->above)
        quantise_row(writer, band->above, band->first_row - 1, above);
    else
        memset(above, 0, row_bytes);
    for (uint32_t r = 0; r < band->rows; ++r) {
        quantise_row(writer, band->samples + r * row_samples, band->first_row + r, row);
        filter_row(row, above, row_bytes, writer->step, encoder->filtered + r * (row_bytes + 1));
        above = row;
        row = encoder->rows[row == encoder->rows[0]];
    }
    encoder->filtered_bytes = band->rows * (row_bytes + 1);
    encoder->checksum =
        (uint32_t)adler32_z(1, encoder->filtered, (z_size_t)encoder->filtered_bytes);
    return deflate_band(base->ctx, encoder, band->first_row + band->rows == base->height);
}

/* ---- chunks ---- */

static void store_u32(uint8_t *to, uint32_t value)
{
    for (int i = 0; i < 4; ++i)
        to[i] = (uint8_t)(value >> (24 - 8 * i));
}

static int write_chunk(const struct png_writer *writer, const char *name, const uint8_t *data,
                       size_t size)
{
    struct bsq_output *output = writer->base.output;
    uint8_t head[8], end[4];
    store_u32(head, (uint32_t)size);
    memcpy(head + 4, name, 4);
    const uLong sum = crc32(0, head + 4, 4);
    store_u32(end, (uint32_t)(size > 0 ? crc32_z(sum, data, size) : sum));
    BSQ_PASS(bsq_output_write(output, head, sizeof head));
    BSQ_PASS(bsq_output_write(output, data, size));
    return bsq_output_write(output, end, sizeof end);
}

/* Writes what comes before the texts. Data has no colour space: programs that see one transform the
 * values. Colours have what the specification recommends beside sRGB (section 11.3.2.5). */
static int write_header(const struct png_writer *writer)
{
    static const uint8_t signature[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
    static const uint8_t perceptual[1] = {0};
    static const uint32_t chromaticities[8] = {31270, 32900, 64000, 33000,
                                               30000, 60000, 15000, 6000};
    static const uint8_t color_types[5] = {[1] = 0, [3] = 2, [4] = 6};
    uint8_t header[13] = {0}, gamma[4], white_and_primaries[32];
    store_u32(header, writer->base.width);
    store_u32(header + 4, writer->base.height);
    header[8] = (uint8_t)writer->bits;
    header[9] = color_types[writer->base.channel_count];
    BSQ_PASS(bsq_output_write(writer->base.output, signature, sizeof signature));
    BSQ_PASS(write_chunk(writer, "IHDR", header, sizeof header));
    if (!writer->srgb)
        return 0;
    store_u32(gamma, 45455);
    for (int i = 0; i < 8; ++i)
        store_u32(white_and_primaries + 4 * i, chromaticities[i]);
    BSQ_PASS(write_chunk(writer, "gAMA", gamma, sizeof gamma));
    BSQ_PASS(write_chunk(writer, "sRGB", perceptual, sizeof perceptual));
    return write_chunk(writer, "cHRM", white_and_primaries, sizeof white_and_primaries);
}

/* Writes a tEXt chunk: the name, a zero, and the value. */
static int png_out_write_text(const struct png_writer *writer,
                              const struct fmt_image_attribute *attribute)
{
    const size_t name = strlen(attribute->name) + 1, value = strlen(attribute->value);
    uint8_t *text = NULL;
    int status;
    BSQ_TRY(bsq_alloc(writer->base.ctx, "PNG text", name + value, 1, &text));
    memcpy(text, attribute->name, name);
    memcpy(text + name, attribute->value, value);
    status = write_chunk(writer, "tEXt", text, name + value);
done:
    bsq_free(writer->base.ctx, text);
    return status;
}

static int png_out_write_band(struct fmt_image_writer *base, void *memory,
                              const struct fmt_image_block *band)
{
    struct png_writer *writer = (struct png_writer *)base;
    const struct encoder *encoder = memory;
    (void)band;
    writer->checksum = (uint32_t)adler32_combine(writer->checksum, encoder->checksum,
                                                 (z_off_t)encoder->filtered_bytes);
    return write_chunk(writer, "IDAT", encoder->packed, encoder->packed_bytes);
}

/* ---- from creating to ending ---- */

static int png_out_describe_image(struct fmt_image_writer *base,
                                  const struct fmt_image_attribute *attributes, uint32_t count)
{
    for (uint32_t a = 0; a < count; ++a)
        BSQ_PASS(png_out_write_text((const struct png_writer *)base, &attributes[a]));
    return 0;
}

static int png_out_start_image(struct fmt_image_writer *base)
{
    return write_chunk((const struct png_writer *)base, "IDAT", zlib_header, sizeof zlib_header);
}

static int png_out_create_image(struct fmt_image_writer *base,
                                const struct fmt_image_options *options)
{
    struct png_writer *writer = (struct png_writer *)base;
    if (options->width > INT32_MAX / 8 || options->height > INT32_MAX)
        return bsq_fail(base->ctx, BSQ_EUSAGE, "%s: %u x %u texels is too large for a PNG file",
                        base->path, options->width, options->height);
    if (options->channel_count != 1 && options->channel_count != 3 && options->channel_count != 4)
        return bsq_fail(base->ctx, BSQ_EUSAGE, "%s: PNG files cannot have %u channels", base->path,
                        options->channel_count);
    writer->bits = options->type == FMT_UINT16 ? 16 : 8;
    writer->rounded = options->rounded;
    writer->srgb = options->color;
    writer->step = base->channel_count * (writer->bits / 8);
    writer->row_bytes = base->width * writer->step;
    writer->checksum = 1;
    const uint64_t rows = BAND_BYTES / writer->row_bytes;
    base->block_rows = rows == 0 ? 1 : rows < base->height ? (uint32_t)rows : base->height;
    BSQ_PASS(bsq_alloc(base->ctx, "PNG row", base->width, base->channel_count * sizeof(float),
                       &base->above));
    BSQ_PASS(write_header(writer));
    return png_out_describe_image(base, options->attributes, options->attribute_count);
}

static int png_out_finish_image(struct fmt_image_writer *base)
{
    struct png_writer *writer = (struct png_writer *)base;
    uint8_t trailer[4];
    store_u32(trailer, writer->checksum);
    BSQ_PASS(write_chunk(writer, "IDAT", trailer, sizeof trailer));
    return write_chunk(writer, "IEND", NULL, 0);
}

const struct fmt_image_format fmt_png_format = {
    .name = "PNG",
    .suffix = ".png",
    .sample_types = FMT_SAMPLE_BIT(FMT_UINT8) | FMT_SAMPLE_BIT(FMT_UINT16),
    .usual_type = FMT_UINT16,
    .writer_bytes = sizeof(struct png_writer),
    .encoder_bytes = sizeof(struct encoder),
    .create = png_out_create_image,
    .create_encoder = png_out_create_encoder,
    .free_encoder = png_out_free_encoder,
    .describe = png_out_describe_image,
    .start = png_out_start_image,
    .encode = encode_band,
    .emit = png_out_write_band,
    .finish = png_out_finish_image,
};
