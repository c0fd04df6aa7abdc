/* png_write.c - streaming PNG writer (docs/decisions/0024-png-bands-in-parallel.md).
 *
 * libpng writes the header and the framing of chunks. Compression takes nearly all of the time, and
 * libpng does it on one thread. So png_encode.c filters and deflates bands of rows independently,
 * on all threads, and this file joins them to one stream. The stream is the same for any number of
 * threads. */
#include <png.h>
#include <string.h>

#include "base/output.h"
#include "base/parallel.h"
#include "formats/image/png_internal.h"

#define BAND_BYTES (UINT64_C(512) << 10) /* larger bands would hardly make files smaller */

static const uint8_t zlib_header[2] = {0x78, 0x5e}; /* deflate, 32 KiB window, level 5 */

struct slot {
    struct fmt_png_encoder encoder;
    struct fmt_png_band band;
};

struct png_writer {
    struct fmt_image_writer base;
    struct fmt_png_layout layout;
    png_structp png;
    png_infop info;
    uint32_t rows_written; /* rows given to encoders */
    float *above;          /* samples of the last row of the previous batch */
    uint32_t checksum;     /* Adler-32 of the filtered bytes written so far */
    struct slot *slots;
    unsigned slot_count;
};

/* ---- callbacks of libpng, which ends a failed call by longjmp ---- */

static void on_error(png_structp png, png_const_charp message)
{
    struct png_writer *writer = png_get_error_ptr(png);
    bsq_fail(writer->base.ctx, BSQ_EIO, "%s: %s", writer->base.path, message);
    png_longjmp(png, 1);
}

static void on_warning(png_structp png, png_const_charp message)
{
    struct png_writer *writer = png_get_error_ptr(png);
    bsq_warn(writer->base.ctx, "%s: %s", writer->base.path, message);
}

static void write_bytes(png_structp png, png_bytep data, png_size_t size)
{
    struct png_writer *writer = png_get_io_ptr(png);
    if (bsq_output_write(writer->base.output, data, size) < 0)
        png_error(png, "writing failed");
}

static void flush_bytes(png_structp png)
{
    (void)png;
}

static png_voidp allocate_bytes(png_structp png, png_alloc_size_t size)
{
    struct png_writer *writer = png_get_mem_ptr(png);
    void *memory;
    return bsq_alloc(writer->base.ctx, "PNG writer", size, 1, &memory) < 0 ? NULL : memory;
}

static void free_bytes(png_structp png, png_voidp memory)
{
    struct png_writer *writer = png_get_mem_ptr(png);
    bsq_free(writer->base.ctx, memory);
}

/* ---- chunks; nothing between setjmp and longjmp changes a local variable ---- */

static int write_chunk(struct png_writer *writer, const char *name, const uint8_t *data,
                       size_t size)
{
    if (setjmp(png_jmpbuf(writer->png)))
        return BSQ_EIO;
    png_write_chunk(writer->png, (png_const_bytep)name, data, size);
    return 0;
}

/* Adds a tEXt chunk to the header. */
static int add_text(struct png_writer *writer, const struct fmt_image_attribute *attribute)
{
    /* libpng does not change the texts. */
    png_text chunk = {.compression = PNG_TEXT_COMPRESSION_NONE,
                      .key = (png_charp)(uintptr_t)attribute->name,
                      .text = (png_charp)(uintptr_t)attribute->value,
                      .text_length = strlen(attribute->value)};
    if (setjmp(png_jmpbuf(writer->png)))
        return BSQ_ENOMEM; /* nothing else can fail */
    png_set_text(writer->png, writer->info, &chunk, 1);
    return 0;
}

static int write_header(struct png_writer *writer)
{
    const struct fmt_png_layout *layout = &writer->layout;
    int type = layout->channel_count == 1   ? PNG_COLOR_TYPE_GRAY
               : layout->channel_count == 3 ? PNG_COLOR_TYPE_RGB
                                            : PNG_COLOR_TYPE_RGB_ALPHA;
    png_structp png = writer->png;
    if (setjmp(png_jmpbuf(png)))
        return BSQ_EIO;
    png_set_user_limits(png, PNG_UINT_31_MAX, PNG_UINT_31_MAX); /* the default is a million */
    png_set_write_fn(png, writer, write_bytes, flush_bytes);
    png_set_IHDR(png, writer->info, layout->width, layout->height, (int)layout->bits, type,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    if (layout->srgb)
        png_set_sRGB_gAMA_and_cHRM(png, writer->info, PNG_sRGB_INTENT_PERCEPTUAL);
    else
        png_set_gAMA(png, writer->info, 1.0);
    png_write_info(png, writer->info);
    return 0;
}

/* ---- bands ---- */

struct batch {
    struct png_writer *writer;
    const float *samples;
    uint32_t rows, rows_taken;
};

static int take_band(void *arg, void *slot_memory, uint64_t sequence)
{
    (void)sequence;
    struct batch *batch = arg;
    struct slot *slot = slot_memory;
    struct png_writer *writer = batch->writer;
    uint32_t left = batch->rows - batch->rows_taken;
    if (left == 0)
        return 0;
    struct fmt_png_band *band = &slot->band;
    size_t row_samples = (size_t)writer->layout.width * writer->layout.channel_count;
    band->rows = left < writer->base.block_rows ? left : writer->base.block_rows;
    band->first_row = writer->rows_written;
    band->samples = batch->samples + batch->rows_taken * row_samples;
    band->above = batch->rows_taken > 0 ? band->samples - row_samples
                  : band->first_row > 0 ? writer->above
                                        : NULL;
    batch->rows_taken += band->rows;
    writer->rows_written += band->rows;
    return 1;
}

static int encode_band(void *arg, void *slot_memory, uint64_t sequence, unsigned worker)
{
    (void)sequence;
    (void)worker;
    const struct png_writer *writer = ((struct batch *)arg)->writer;
    struct slot *slot = slot_memory;
    return fmt_png_encode(writer->base.ctx, &slot->encoder, &writer->layout, &slot->band);
}

static int write_band(void *arg, void *slot_memory, uint64_t sequence)
{
    (void)sequence;
    struct png_writer *writer = ((struct batch *)arg)->writer;
    const struct fmt_png_encoder *encoder = &((const struct slot *)slot_memory)->encoder;
    writer->checksum = (uint32_t)adler32_combine(writer->checksum, encoder->checksum,
                                                 (z_off_t)encoder->filtered_bytes);
    return write_chunk(writer, "IDAT", encoder->packed, encoder->packed_bytes);
}

static int write_rows(struct fmt_image_writer *base, const float *samples, uint32_t rows)
{
    struct png_writer *writer = (struct png_writer *)base;
    struct batch batch = {.writer = writer, .samples = samples, .rows = rows};
    struct bsq_pipeline pipeline = {.produce = take_band,
                                    .work = encode_band,
                                    .emit = write_band,
                                    .arg = &batch,
                                    .slots = writer->slots,
                                    .slot_size = sizeof *writer->slots,
                                    .slot_count = writer->slot_count};
    int status = bsq_pipeline_run(base->ctx, &pipeline);
    size_t row_samples = (size_t)base->width * base->channel_count;
    memcpy(writer->above, samples + (rows - 1) * row_samples, row_samples * sizeof *samples);
    return status;
}

/* ---- from creating to ending ---- */

static int allocate_slots(struct png_writer *writer)
{
    const struct fmt_png_layout *layout = &writer->layout;
    uint64_t rows = BAND_BYTES / fmt_png_row_bytes(layout);
    uint32_t band_rows = rows == 0 ? 1 : rows < layout->height ? (uint32_t)rows : layout->height;
    uint32_t bands = (layout->height - 1) / band_rows + 1;
    unsigned slots = 2 * bsq_threads(writer->base.ctx);
    slots = slots < bands ? slots : bands;
    writer->base.block_rows = band_rows;
    int status = bsq_alloc(writer->base.ctx, "PNG row", layout->width,
                           layout->channel_count * sizeof(float), &writer->above);
    if (status == 0)
        status = bsq_calloc(writer->base.ctx, "PNG encoders", slots, sizeof *writer->slots,
                            &writer->slots);
    while (status == 0 && writer->slot_count < slots)
        status = fmt_png_encoder_create(writer->base.ctx, layout, band_rows,
                                        &writer->slots[writer->slot_count++].encoder);
    return status;
}

static int prepare(struct png_writer *writer)
{
    int status = allocate_slots(writer);
    if (status < 0)
        return status;
    writer->checksum = 1;
    writer->png = png_create_write_struct_2(PNG_LIBPNG_VER_STRING, writer, on_error, on_warning,
                                            writer, allocate_bytes, free_bytes);
    if (writer->png)
        writer->info = png_create_info_struct(writer->png);
    if (!writer->info)
        return bsq_fail(writer->base.ctx, BSQ_ENOMEM, "%s: no memory for the PNG writer",
                        writer->base.path);
    return 0;
}

static int describe_image(struct fmt_image_writer *base,
                          const struct fmt_image_attribute *attributes, uint32_t count)
{
    struct png_writer *writer = (struct png_writer *)base;
    int status = 0;
    for (uint32_t a = 0; status == 0 && a < count; ++a)
        status = add_text(writer, &attributes[a]);
    return status;
}

static int start_image(struct fmt_image_writer *base)
{
    struct png_writer *writer = (struct png_writer *)base;
    int status = write_header(writer);
    return status < 0 ? status : write_chunk(writer, "IDAT", zlib_header, sizeof zlib_header);
}

static int create_image(struct fmt_image_writer *base, const struct fmt_image_options *options)
{
    struct png_writer *writer = (struct png_writer *)base;
    if (options->width > PNG_UINT_31_MAX / 8 || options->height > PNG_UINT_31_MAX)
        return bsq_fail(base->ctx, BSQ_EUSAGE, "%s: %u x %u texels is too large for a PNG file",
                        base->path, options->width, options->height);
    if (options->channel_count != 1 && options->channel_count != 3 && options->channel_count != 4)
        return bsq_fail(base->ctx, BSQ_EUSAGE, "%s: PNG files cannot have %u channels", base->path,
                        options->channel_count);
    writer->layout = (struct fmt_png_layout){.width = options->width,
                                             .height = options->height,
                                             .channel_count = options->channel_count,
                                             .bits = options->type == FMT_UINT16 ? 16 : 8,
                                             .labels = options->labels,
                                             .srgb = options->color};
    return prepare(writer);
}

static int finish_image(struct fmt_image_writer *base)
{
    struct png_writer *writer = (struct png_writer *)base;
    uint32_t sum = writer->checksum;
    const uint8_t trailer[4] = {(uint8_t)(sum >> 24), (uint8_t)(sum >> 16), (uint8_t)(sum >> 8),
                                (uint8_t)sum};
    int status = write_chunk(writer, "IDAT", trailer, sizeof trailer);
    return status < 0 ? status : write_chunk(writer, "IEND", NULL, 0);
}

static void free_image(struct fmt_image_writer *base)
{
    struct png_writer *writer = (struct png_writer *)base;
    if (writer->png)
        png_destroy_write_struct(&writer->png, &writer->info);
    for (unsigned i = 0; i < writer->slot_count; ++i)
        fmt_png_encoder_free(base->ctx, &writer->slots[i].encoder);
    bsq_free(base->ctx, writer->slots);
    bsq_free(base->ctx, writer->above);
}

const struct fmt_image_format fmt_png_format = {
    .name = "PNG",
    .suffix = ".png",
    .sample_types = FMT_SAMPLE_BIT(FMT_UINT8) | FMT_SAMPLE_BIT(FMT_UINT16),
    .usual_type = FMT_UINT16,
    .writer_bytes = sizeof(struct png_writer),
    .create = create_image,
    .describe = describe_image,
    .start = start_image,
    .write_rows = write_rows,
    .finish = finish_image,
    .free = free_image,
};
