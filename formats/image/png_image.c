/* png_image.c - maps and previews as PNG.
 *
 * libpng writes the header and the chunks' framing. Compression, which takes nearly all of the
 * time, is done here, as libpng does it on one thread: bands of rows are filtered and deflated
 * independently (png_encode.c) and their pieces joined to one stream, which is the same for any
 * number of threads. Rows that do not fill a band wait in `pending`. */
#include "formats/image/png_image.h"

#include <png.h>
#include <string.h>

#include "base/output.h"
#include "base/parallel.h"
#include "formats/image/png_internal.h"

#define BAND_BYTES (UINT64_C(512) << 10) /* bands this large lose next to nothing in size */

static const uint8_t zlib_header[2] = {0x78, 0x5e}; /* deflate, 32 KiB window, level 5 */

struct slot {
    struct fmt_png_encoder encoder;
    struct fmt_png_band band;
};

struct fmt_png_writer {
    struct bsq_ctx *ctx;
    struct fmt_png_options options;
    struct bsq_output *output;
    char *path;
    png_structp png;
    png_infop info;
    bool finished;
    uint32_t band_rows;
    uint32_t rows_written; /* handed to encoders */
    uint32_t pending_rows;
    float *pending;    /* band_rows rows */
    float *above;      /* the last row that was handed to encoders */
    uint32_t checksum; /* Adler-32 of what was written */
    struct slot *slots;
    unsigned slot_count;
};

/* ---- callbacks of libpng; failures leave it by longjmp ---- */

static void on_error(png_structp png, png_const_charp message)
{
    struct fmt_png_writer *writer = png_get_error_ptr(png);
    bsq_fail(writer->ctx, BSQ_EIO, "%s: %s", writer->path, message);
    png_longjmp(png, 1);
}

static void on_warning(png_structp png, png_const_charp message)
{
    struct fmt_png_writer *writer = png_get_error_ptr(png);
    bsq_warn(writer->ctx, "%s: %s", writer->path, message);
}

static void write_bytes(png_structp png, png_bytep data, png_size_t size)
{
    struct fmt_png_writer *writer = png_get_io_ptr(png);
    if (bsq_output_write(writer->output, data, size) < 0)
        png_error(png, "writing failed");
}

static void flush_bytes(png_structp png)
{
    (void)png;
}

static png_voidp allocate_bytes(png_structp png, png_alloc_size_t size)
{
    struct fmt_png_writer *writer = png_get_mem_ptr(png);
    void *memory;
    return bsq_alloc(writer->ctx, "PNG writer", size, 1, &memory) < 0 ? NULL : memory;
}

static void free_bytes(png_structp png, png_voidp memory)
{
    struct fmt_png_writer *writer = png_get_mem_ptr(png);
    bsq_free(writer->ctx, memory);
}

/* ---- chunks; nothing between setjmp and longjmp changes a local variable ---- */

static int write_chunk(struct fmt_png_writer *writer, const char *name, const uint8_t *data,
                       size_t size)
{
    if (setjmp(png_jmpbuf(writer->png)))
        return BSQ_EIO;
    png_write_chunk(writer->png, (png_const_bytep)name, data, size);
    return 0;
}

static int write_header(struct fmt_png_writer *writer)
{
    const struct fmt_png_options *options = &writer->options;
    int type = options->channel_count == 1   ? PNG_COLOR_TYPE_GRAY
               : options->channel_count == 3 ? PNG_COLOR_TYPE_RGB
                                             : PNG_COLOR_TYPE_RGB_ALPHA;
    png_structp png = writer->png;
    if (setjmp(png_jmpbuf(png)))
        return BSQ_EIO;
    png_set_user_limits(png, PNG_UINT_31_MAX, PNG_UINT_31_MAX); /* a million by default */
    png_set_write_fn(png, writer, write_bytes, flush_bytes);
    png_set_IHDR(png, writer->info, options->width, options->height, (int)options->bits, type,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    if (options->srgb)
        png_set_sRGB_gAMA_and_cHRM(png, writer->info, PNG_sRGB_INTENT_PERCEPTUAL);
    else
        png_set_gAMA(png, writer->info, 1.0);
    png_write_info(png, writer->info);
    return 0;
}

/* ---- bands ---- */

struct batch {
    struct fmt_png_writer *writer;
    const float *samples;
    uint32_t rows, rows_taken;
};

static int take_band(void *arg, void *slot_memory, uint64_t sequence)
{
    (void)sequence;
    struct batch *batch = arg;
    struct slot *slot = slot_memory;
    struct fmt_png_writer *writer = batch->writer;
    uint32_t left = batch->rows - batch->rows_taken;
    if (left == 0)
        return 0;
    struct fmt_png_band *band = &slot->band;
    size_t row_samples = (size_t)writer->options.width * writer->options.channel_count;
    band->rows = left < writer->band_rows ? left : writer->band_rows;
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
    const struct fmt_png_writer *writer = ((struct batch *)arg)->writer;
    struct slot *slot = slot_memory;
    return fmt_png_encode(writer->ctx, &slot->encoder, &writer->options, &slot->band);
}

static int write_band(void *arg, void *slot_memory, uint64_t sequence)
{
    (void)sequence;
    struct fmt_png_writer *writer = ((struct batch *)arg)->writer;
    const struct fmt_png_encoder *encoder = &((const struct slot *)slot_memory)->encoder;
    writer->checksum = (uint32_t)adler32_combine(writer->checksum, encoder->checksum,
                                                 (z_off_t)encoder->filtered_bytes);
    return write_chunk(writer, "IDAT", encoder->packed, encoder->packed_bytes);
}

/* rows is a multiple of band_rows, except at the bottom of the image. */
static int write_bands(struct fmt_png_writer *writer, const float *samples, uint32_t rows)
{
    struct batch batch = {.writer = writer, .samples = samples, .rows = rows};
    struct bsq_pipeline pipeline = {.produce = take_band,
                                    .work = encode_band,
                                    .emit = write_band,
                                    .arg = &batch,
                                    .slots = writer->slots,
                                    .slot_size = sizeof *writer->slots,
                                    .slot_count = writer->slot_count};
    int status = bsq_pipeline_run(writer->ctx, &pipeline);
    size_t row_samples = (size_t)writer->options.width * writer->options.channel_count;
    memcpy(writer->above, samples + (rows - 1) * row_samples, row_samples * sizeof *samples);
    return status;
}

/* ---- public ---- */

static int allocate_slots(struct fmt_png_writer *writer)
{
    const struct fmt_png_options *options = &writer->options;
    uint64_t rows = BAND_BYTES / fmt_png_row_bytes(options);
    writer->band_rows = rows == 0 ? 1 : rows < options->height ? (uint32_t)rows : options->height;
    uint32_t bands = (options->height - 1) / writer->band_rows + 1;
    unsigned slots = 2 * bsq_threads(writer->ctx);
    slots = slots < bands ? slots : bands;
    int status = bsq_alloc(writer->ctx, "PNG rows", (uint64_t)writer->band_rows * options->width,
                           options->channel_count * sizeof(float), &writer->pending);
    if (status == 0)
        status = bsq_alloc(writer->ctx, "PNG row", options->width,
                           options->channel_count * sizeof(float), &writer->above);
    if (status == 0)
        status =
            bsq_calloc(writer->ctx, "PNG encoders", slots, sizeof *writer->slots, &writer->slots);
    while (status == 0 && writer->slot_count < slots)
        status = fmt_png_encoder_create(writer->ctx, options, writer->band_rows,
                                        &writer->slots[writer->slot_count++].encoder);
    return status;
}

static int start(struct fmt_png_writer *writer)
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
        return bsq_fail(writer->ctx, BSQ_ENOMEM, "%s: no memory for the PNG writer", writer->path);
    status = write_header(writer);
    if (status < 0)
        return status;
    return write_chunk(writer, "IDAT", zlib_header, sizeof zlib_header);
}

static int check_options(struct bsq_ctx *ctx, const char *path,
                         const struct fmt_png_options *options)
{
    if (options->width == 0 || options->height == 0 || options->width > PNG_UINT_31_MAX / 8 ||
        options->height > PNG_UINT_31_MAX)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: %u x %u texels is no size for a PNG file", path,
                        options->width, options->height);
    if ((options->bits != 8 && options->bits != 16) ||
        (options->channel_count != 1 && options->channel_count != 3 && options->channel_count != 4))
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: PNG has no %u channels of %u bits", path,
                        options->channel_count, options->bits);
    return 0;
}

int fmt_png_create(struct bsq_ctx *ctx, const char *path, const struct fmt_png_options *options,
                   struct fmt_png_writer **out)
{
    *out = NULL;
    int status = check_options(ctx, path, options);
    if (status < 0)
        return status;
    struct fmt_png_writer *writer;
    status = bsq_calloc(ctx, "PNG writer", 1, sizeof *writer, &writer);
    if (status < 0)
        return status;
    writer->ctx = ctx;
    writer->options = *options;
    size_t path_bytes = strlen(path) + 1;
    status = bsq_alloc(ctx, "path", path_bytes, 1, &writer->path);
    if (status < 0)
        goto done;
    memcpy(writer->path, path, path_bytes);
    status = bsq_output_open(ctx, path, &writer->output);
    if (status < 0)
        goto done;
    status = start(writer);
done:
    if (status < 0)
        fmt_png_discard(writer);
    else
        *out = writer;
    return status;
}

/* Completes the pending band with as many of the rows as it takes. */
static int fill_pending(struct fmt_png_writer *writer, const float **samples, uint32_t *rows)
{
    size_t row_samples = (size_t)writer->options.width * writer->options.channel_count;
    uint32_t missing = writer->band_rows - writer->pending_rows;
    uint32_t take = *rows < missing ? *rows : missing;
    memcpy(writer->pending + writer->pending_rows * row_samples, *samples,
           take * row_samples * sizeof(float));
    writer->pending_rows += take;
    *samples += take * row_samples;
    *rows -= take;
    uint32_t reached = writer->rows_written + writer->pending_rows;
    if (writer->pending_rows < writer->band_rows && reached < writer->options.height)
        return 0;
    uint32_t count = writer->pending_rows;
    writer->pending_rows = 0;
    return write_bands(writer, writer->pending, count);
}

int fmt_png_write_rows(struct fmt_png_writer *writer, const float *samples, uint32_t rows)
{
    size_t row_samples = (size_t)writer->options.width * writer->options.channel_count;
    uint32_t left = writer->options.height - writer->rows_written - writer->pending_rows;
    if (rows > left)
        return bsq_fail(writer->ctx, BSQ_EBUG, "%s: %u rows too many", writer->path, rows - left);
    if (writer->pending_rows > 0) {
        int status = fill_pending(writer, &samples, &rows);
        if (status < 0)
            return status;
    }
    bool ends = writer->rows_written + writer->pending_rows + rows == writer->options.height;
    uint32_t whole = writer->pending_rows > 0 ? 0 : ends ? rows : rows - rows % writer->band_rows;
    if (whole > 0) {
        int status = write_bands(writer, samples, whole);
        if (status < 0)
            return status;
    }
    samples += whole * row_samples;
    rows -= whole;
    return rows > 0 ? fill_pending(writer, &samples, &rows) : 0;
}

static void free_writer(struct fmt_png_writer *writer)
{
    struct bsq_ctx *ctx = writer->ctx;
    if (writer->png)
        png_destroy_write_struct(&writer->png, &writer->info);
    for (unsigned i = 0; i < writer->slot_count; ++i)
        fmt_png_encoder_free(ctx, &writer->slots[i].encoder);
    bsq_free(ctx, writer->slots);
    bsq_free(ctx, writer->pending);
    bsq_free(ctx, writer->above);
    bsq_free(ctx, writer->path);
    bsq_free(ctx, writer);
}

int fmt_png_finish(struct fmt_png_writer *writer)
{
    if (writer->finished)
        return 0;
    if (writer->rows_written != writer->options.height)
        return bsq_fail(writer->ctx, BSQ_EBUG, "%s: %u of %u rows were written", writer->path,
                        writer->rows_written, writer->options.height);
    uint32_t sum = writer->checksum;
    const uint8_t trailer[4] = {(uint8_t)(sum >> 24), (uint8_t)(sum >> 16), (uint8_t)(sum >> 8),
                                (uint8_t)sum};
    int status = write_chunk(writer, "IDAT", trailer, sizeof trailer);
    if (status == 0)
        status = write_chunk(writer, "IEND", NULL, 0);
    if (status == 0)
        status = bsq_output_sync(writer->output);
    writer->finished = status == 0;
    return status;
}

int fmt_png_commit(struct fmt_png_writer *writer)
{
    int status = fmt_png_finish(writer);
    if (status < 0) {
        fmt_png_discard(writer);
        return status;
    }
    status = bsq_output_commit(writer->output);
    free_writer(writer);
    return status;
}

void fmt_png_discard(struct fmt_png_writer *writer)
{
    if (!writer)
        return;
    bsq_output_discard(writer->output);
    free_writer(writer);
}
