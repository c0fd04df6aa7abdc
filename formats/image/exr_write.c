/* exr_write.c - streaming EXR writer.
 *
 * OpenEXR compresses blocks of 16 lines, or tiles, independently. Blocks are packed here with
 * libdeflate, as OpenEXR 3.2 and later do. OpenEXR 3.1 uses zlib, which takes three times as long.
 *
 * OpenEXR's compression ZIP puts bytes of even offsets before those of odd offsets, and replaces
 * each byte by its difference from the one before. The result becomes a zlib stream (RFC 1950).
 * libdeflate makes the same bytes on every processor. */
#include "formats/image/image_writer.h"

#include <half.h>
#include <libdeflate.h>
#include <string.h>

#include "base/output.h"
#include "base/sort_array.h"
#include "formats/image/exr_internal.h"

/* ---- packing ---- */

/* Encodes one block at a time. */
struct encoder {
    struct libdeflate_compressor *compressor;
    uint64_t reserved_bytes;             /* of the compressor */
    uint8_t *chunk, *ordered, *deflated; /* a block each: its samples, ordered, and compressed */
    const uint8_t *packed;               /* what is written: one of these */
    size_t packed_bytes;
};

enum {
    LEVEL = 1, /* level 4 takes 1.5 to 2 times as long for 1 to 3 % of the size */
    COMPRESSOR_BYTES = 208 << 10, /* libdeflate 1.14 allocates 203 KB for one of this level */
    OFFSET = 128                  /* added to differences, so that small ones have similar values */
};

/* Separates even and odd bytes and takes differences. */
static void order(const uint8_t *chunk, size_t size, uint8_t *out)
{
    uint8_t *even = out, *odd = out + (size + 1) / 2;
    const size_t pairs = size / 2;
    for (size_t i = 0; i < pairs; ++i) {
        even[i] = chunk[2 * i];
        odd[i] = chunk[2 * i + 1];
    }
    if (size % 2 != 0)
        even[pairs] = chunk[size - 1];
    for (size_t i = size - 1; i > 0; --i)
        out[i] = (uint8_t)(out[i] - out[i - 1] + OFFSET);
}

/* Compresses the `size` bytes of encoder->chunk into encoder->deflated. Returns the bytes there, or
 * 0 if they would not be fewer than `size`. */
static size_t deflate_chunk(struct encoder *encoder, size_t size)
{
    if (size == 0)
        return 0;
    order(encoder->chunk, size, encoder->ordered);
    return libdeflate_zlib_compress(encoder->compressor, encoder->ordered, size, encoder->deflated,
                                    size - 1);
}

/* ---- the writer ---- */

enum { ZIP_ROWS = 16 /* of a block */ };

enum { COLORS = 4 };
/* In the order of samples. */
static const char *const color_names[COLORS] = {"R", "G", "B", "A"};
static const char *const grey_name = "Y";

struct channel {
    const char *name;
    uint32_t sample; /* of a texel */
};

struct exr_writer {
    struct fmt_image_writer base;
    struct fmt_exr_stream stream;
    exr_context_t file;
    struct channel *channels; /* in the order of the file, which OpenEXR sorts by name */
    uint32_t y;               /* of the first row in the whole image */
    bool as_half;
};

/* ---- callbacks of OpenEXR ---- */

static int64_t exr_out_write_bytes(exr_const_context_t file, void *user, const void *buffer,
                                   uint64_t size, uint64_t offset,
                                   exr_stream_error_func_ptr_t on_error)
{
    (void)file;
    (void)on_error;
    struct exr_writer *writer = user;
    int status = bsq_output_write_at(writer->base.output, buffer, size, offset);
    fmt_exr_set_status(&writer->stream, status);
    return status < 0 ? -1 : (int64_t)size;
}

/* Does nothing. OpenEXR calls it while it holds the file's lock, so that asking the file for its
 * user data would deadlock. fmt_exr_status() describes failures from their codes instead. */
static void leave_to_caller(exr_const_context_t file, exr_result_t result, const char *message)
{
    (void)file;
    (void)result;
    (void)message;
}

/* ---- header ---- */

static exr_result_t set_color_attributes(exr_context_t file, bool data)
{
    /* The EXR standard defines colorInteropID; OpenImageIO reads oiio:ColorSpace. */
    exr_result_t r =
        exr_attr_set_string(file, 0, "colorInteropID", data ? "data" : "lin_rec709_scene");
    if (r == EXR_ERR_SUCCESS)
        r = exr_attr_set_string(file, 0, "oiio:ColorSpace", data ? "Raw" : "Linear");
    if (r != EXR_ERR_SUCCESS || data)
        return r;
    static const exr_attr_chromaticities_t rec709 = {0.64f, 0.33f, 0.30f,   0.60f,
                                                     0.15f, 0.06f, 0.3127f, 0.3290f};
    return exr_attr_set_chromaticities(file, 0, "chromaticities", &rec709);
}

static exr_result_t set_attributes(exr_context_t file, const struct fmt_image_attribute *attributes,
                                   uint32_t count)
{
    exr_result_t r = EXR_ERR_SUCCESS;
    for (uint32_t a = 0; r == EXR_ERR_SUCCESS && a < count; ++a)
        r = exr_attr_set_string(file, 0, attributes[a].name, attributes[a].value);
    return r;
}

/* Writes the attributes that all files have. */
static exr_result_t set_windows(exr_context_t file, const struct fmt_image_options *options)
{
    const uint32_t width = options->full_width ? options->full_width : options->width;
    const uint32_t height = options->full_height ? options->full_height : options->height;
    exr_attr_box2i_t whole, own;
    exr_attr_v2f_t center;
    memset(&whole, 0, sizeof whole);
    memset(&own, 0, sizeof own);
    memset(&center, 0, sizeof center);
    whole.max.x = (int32_t)width - 1;
    whole.max.y = (int32_t)height - 1;
    own.min.x = (int32_t)options->x;
    own.min.y = (int32_t)options->y;
    own.max.x = (int32_t)(options->x + options->width) - 1;
    own.max.y = (int32_t)(options->y + options->height) - 1;
    return exr_initialize_required_attr(file, 0, &whole, &own, 1.0f, &center, 1.0f,
                                        EXR_LINEORDER_INCREASING_Y, EXR_COMPRESSION_ZIP);
}

static exr_result_t make_header(exr_context_t file, const struct channel *channels,
                                const struct fmt_image_options *options)
{
    int part;
    const uint32_t side = options->exr_tile_side;
    exr_result_t r =
        exr_add_part(file, NULL, side > 0 ? EXR_STORAGE_TILED : EXR_STORAGE_SCANLINE, &part);
    if (r == EXR_ERR_SUCCESS)
        r = set_windows(file, options);
    if (r == EXR_ERR_SUCCESS && side > 0)
        r = exr_set_tile_descriptor(file, 0, side, side, EXR_TILE_ONE_LEVEL, EXR_TILE_ROUND_DOWN);
    exr_pixel_type_t type = options->type == FMT_HALF ? EXR_PIXEL_HALF : EXR_PIXEL_FLOAT;
    for (uint32_t c = 0; r == EXR_ERR_SUCCESS && c < options->channel_count; ++c)
        r = exr_add_channel(file, 0, channels[c].name, type, EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1);
    if (r == EXR_ERR_SUCCESS)
        r = set_color_attributes(file, !options->color);
    if (r == EXR_ERR_SUCCESS)
        r = set_attributes(file, options->attributes, options->attribute_count);
    return r;
}

static int exr_out_describe_image(struct fmt_image_writer *base,
                                  const struct fmt_image_attribute *attributes, uint32_t count)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    return fmt_exr_status(&writer->stream, set_attributes(writer->file, attributes, count));
}

static int exr_out_start_image(struct fmt_image_writer *base)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    return fmt_exr_status(&writer->stream, exr_write_header(writer->file));
}

/* ---- blocks ---- */

static int exr_out_create_encoder(struct fmt_image_writer *base, void *memory)
{
    struct encoder *encoder = memory;
    struct bsq_ctx *ctx = base->ctx;
    const uint64_t texels =
        (uint64_t)base->block_rows * (base->exr_tile_side > 0 ? base->exr_tile_side : base->width);
    const uint64_t bytes =
        texels * base->channel_count * (((struct exr_writer *)base)->as_half ? 2 : sizeof(float));
    BSQ_PASS(bsq_alloc(ctx, "EXR block", bytes, 1, &encoder->chunk));
    BSQ_PASS(bsq_alloc(ctx, "EXR block", bytes, 1, &encoder->ordered));
    BSQ_PASS(bsq_alloc(ctx, "EXR block", bytes, 1, &encoder->deflated));
    BSQ_PASS(bsq_reserve(ctx, "EXR compression", COMPRESSOR_BYTES));
    encoder->reserved_bytes = COMPRESSOR_BYTES;
    encoder->compressor = libdeflate_alloc_compressor(LEVEL);
    if (!encoder->compressor)
        return bsq_fail(ctx, BSQ_ENOMEM, "the system has no memory left for EXR compression");
    return 0;
}

static void exr_out_free_encoder(struct fmt_image_writer *base, void *memory)
{
    struct encoder *encoder = memory;
    libdeflate_free_compressor(encoder->compressor);
    BSQ_FREE(base->ctx, encoder->chunk, encoder->ordered, encoder->deflated);
    bsq_release(base->ctx, encoder->reserved_bytes);
}

/* Stores each `stride`-th sample of a line. Returns the end of what it stored. */
static uint8_t *store_line(const float *samples, uint32_t width, size_t stride, bool as_half,
                           uint8_t *to)
{
    for (uint32_t x = 0; as_half && x < width; ++x, to += sizeof(imath_half_bits_t)) {
        const imath_half_bits_t bits = imath_float_to_half(samples[x * stride]);
        memcpy(to, &bits, sizeof bits);
    }
    for (uint32_t x = 0; !as_half && x < width; ++x, to += sizeof(float))
        memcpy(to, &samples[x * stride], sizeof(float));
    return to;
}

/* In a block, each line has its channels one after the other. Readers take a block of the size of
 * its samples as not compressed. */
static int exr_out_encode_block(struct fmt_image_writer *base, void *memory,
                                const struct fmt_image_block *block)
{
    const struct exr_writer *writer = (struct exr_writer *)base;
    struct encoder *encoder = memory;
    const uint32_t channels = base->channel_count, side = base->exr_tile_side;
    const uint32_t left = base->width - block->column * side;
    const uint32_t width = side > 0 && side < left ? side : left;
    uint8_t *to = encoder->chunk;
    for (uint32_t y = 0; y < block->rows; ++y)
        for (uint32_t c = 0; c < channels; ++c)
            to = store_line(block->samples + (size_t)y * base->width * channels +
                                writer->channels[c].sample,
                            width, channels, writer->as_half, to);
    const size_t size = (size_t)(to - encoder->chunk);
    const size_t deflated = deflate_chunk(encoder, size);
    encoder->packed = deflated > 0 ? encoder->deflated : encoder->chunk;
    encoder->packed_bytes = deflated > 0 ? deflated : size;
    return 0;
}

static int exr_out_emit_block(struct fmt_image_writer *base, void *memory,
                              const struct fmt_image_block *block)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    const struct encoder *encoder = memory;
    const uint32_t side = base->exr_tile_side;
    exr_result_t r =
        side > 0 ? exr_write_tile_chunk(writer->file, 0, (int)block->column,
                                        (int)(block->first_row / side), 0, 0, encoder->packed,
                                        encoder->packed_bytes)
                 : exr_write_scanline_chunk(writer->file, 0, (int)(writer->y + block->first_row),
                                            encoder->packed, encoder->packed_bytes);
    return fmt_exr_status(&writer->stream, r);
}

/* ---- from creating to ending ---- */

static int exr_out_compare_names(const void *a, const void *b)
{
    return strcmp(((const struct channel *)a)->name, ((const struct channel *)b)->name);
}

static int exr_out_name_channels(struct exr_writer *writer, const struct fmt_image_options *options)
{
    const uint32_t count = options->channel_count;
    const char *const *names = options->channels ? options->channels
                               : count == 1      ? &grey_name
                                                 : color_names;
    BSQ_PASS(BSQ_ALLOC(writer->base.ctx, "EXR channels", count, &writer->channels));
    for (uint32_t c = 0; c < count; ++c)
        writer->channels[c] = (struct channel){names[c], c};
    bsq_sort(writer->channels, count, sizeof *writer->channels, exr_out_compare_names);
    return 0;
}

static int exr_out_create_image(struct fmt_image_writer *base,
                                const struct fmt_image_options *options)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    /* OpenEXR holds the bytes of a line and the number of rows in int32_t. */
    if (options->height > INT32_MAX || (options->channel_count > COLORS && !options->channels) ||
        (uint64_t)options->width * options->channel_count > INT32_MAX / sizeof(float))
        return bsq_fail(base->ctx, BSQ_EUSAGE, "%s: %u x %u texels is too large for an EXR file",
                        base->path, options->width, options->height);
    writer->stream.ctx = base->ctx;
    writer->stream.path = base->path;
    writer->as_half = options->type == FMT_HALF;
    writer->y = options->y;
    BSQ_PASS(exr_out_name_channels(writer, options));
    base->block_rows = options->exr_tile_side > 0 ? options->exr_tile_side : ZIP_ROWS;
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = leave_to_caller;
    init.user_data = writer;
    init.write_fn = exr_out_write_bytes;
    exr_result_t r = exr_start_write(&writer->file, base->path, EXR_WRITE_FILE_DIRECTLY, &init);
    if (r == EXR_ERR_SUCCESS && options->channels)
        r = exr_set_longname_support(writer->file, 1);
    if (r == EXR_ERR_SUCCESS)
        r = make_header(writer->file, writer->channels, options);
    return fmt_exr_status(&writer->stream, r);
}

/* Closes the file, which writes its line table. Fails for an unfinished file; the failure that left
 * it unfinished is recorded already. */
static int exr_out_finish_image(struct fmt_image_writer *base)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    return fmt_exr_status(&writer->stream, exr_finish(&writer->file));
}

static void free_image(struct fmt_image_writer *base)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    if (writer->file)
        exr_finish(&writer->file);
    bsq_free(base->ctx, writer->channels);
}

const struct fmt_image_format fmt_exr_format = {
    .name = "OpenEXR",
    .suffix = ".exr",
    .sample_types = FMT_SAMPLE_BIT(FMT_HALF) | FMT_SAMPLE_BIT(FMT_FLOAT),
    .usual_type = FMT_HALF,
    .tiles = true,
    .writer_bytes = sizeof(struct exr_writer),
    .encoder_bytes = sizeof(struct encoder),
    .create = exr_out_create_image,
    .create_encoder = exr_out_create_encoder,
    .free_encoder = exr_out_free_encoder,
    .describe = exr_out_describe_image,
    .start = exr_out_start_image,
    .encode = exr_out_encode_block,
    .emit = exr_out_emit_block,
    .finish = exr_out_finish_image,
    .free = free_image,
};
