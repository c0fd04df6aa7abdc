/* image_writer.c - the table of formats, and the parts of writing that they share: names, temporary
 * files, rows that wait until they fill a block, and the pipeline that encodes blocks.
 *
 * Each slot of the pipeline owns an encoder. The slots encode in parallel, and the pipeline writes
 * their bytes from top to bottom. So the file is the same for any number of threads. */
#include "formats/image/image_writer.h"

#include <stddef.h>
#include <string.h>

#include "base/parallel.h"
#include "base/text.h"

struct slot {
    struct fmt_image_block block;
    max_align_t encoder[]; /* of the format */
};

const struct fmt_image_format *const fmt_image_formats[] = {&fmt_exr_format, &fmt_png_format, NULL};

const struct fmt_image_format *fmt_image_format_of(const char *path)
{
    size_t length = strlen(path);
    for (int i = 0; fmt_image_formats[i]; ++i) {
        size_t suffix = strlen(fmt_image_formats[i]->suffix);
        if (length >= suffix &&
            strcasecmp(path + length - suffix, fmt_image_formats[i]->suffix) == 0)
            return fmt_image_formats[i];
    }
    return NULL;
}

int fmt_image_check_type(struct bsq_ctx *ctx, const struct fmt_image_format *format,
                         const char *path, enum fmt_sample_type type)
{
    static const char *const names[] = {"8-bit", "16-bit", "half-float", "float"};
    return format->sample_types & FMT_SAMPLE_BIT(type)
               ? 0
               : bsq_fail(ctx, BSQ_EUSAGE, "%s: %s files have no %s samples", path, format->name,
                          names[type]);
}

int fmt_image_check_tiles(struct bsq_ctx *ctx, const struct fmt_image_format *format,
                          const char *path, uint32_t exr_tile_side)
{
    if (exr_tile_side > 0 && !format->tiles)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: %s files have no tiles", path, format->name);
    return exr_tile_side <= FMT_MAX_TILE_SIDE
               ? 0
               : bsq_fail(ctx, BSQ_EUSAGE, "%s: tiles of %u x %u texels: at most %d", path,
                          exr_tile_side, exr_tile_side, FMT_MAX_TILE_SIDE);
}

/* ---- creating ---- */

/* Returns the number of columns of blocks. */
static uint32_t columns_of(const struct fmt_image_writer *writer)
{
    return writer->exr_tile_side > 0 ? (writer->width - 1) / writer->exr_tile_side + 1 : 1;
}

static struct slot *slot_at(const struct fmt_image_writer *writer, unsigned i)
{
    return (struct slot *)((char *)writer->slots + i * writer->slot_bytes);
}

static int create_encoders(struct fmt_image_writer *writer)
{
    const uint64_t blocks =
        ((uint64_t)(writer->height - 1) / writer->block_rows + 1) * columns_of(writer);
    const unsigned most = 2 * bsq_threads(writer->ctx);
    const unsigned count = most < blocks ? most : (unsigned)blocks;
    writer->slot_bytes =
        bsq_align_up(sizeof(struct slot) + writer->format->encoder_bytes, _Alignof(max_align_t));
    BSQ_PASS(bsq_calloc(writer->ctx, "image encoders", count, writer->slot_bytes, &writer->slots));
    while (writer->slot_count < count)
        BSQ_PASS(
            writer->format->create_encoder(writer, slot_at(writer, writer->slot_count++)->encoder));
    return 0;
}

static int image_start(struct fmt_image_writer *writer, const char *path,
                       const struct fmt_image_options *options)
{
    struct bsq_ctx *ctx = writer->ctx;
    BSQ_PASS(bsq_text_copy(ctx, path, &writer->path));
    BSQ_PASS(options->temporary ? bsq_output_open_temp(ctx, path, "an image", &writer->output)
                                : bsq_output_open(ctx, path, &writer->output));
    BSQ_PASS(writer->format->create(writer, options));
    BSQ_PASS(create_encoders(writer));
    return bsq_alloc(ctx, "image rows", (uint64_t)writer->block_rows * writer->width,
                     writer->channel_count * sizeof(float), &writer->pending);
}

int fmt_image_create(struct bsq_ctx *ctx, const struct fmt_image_format *format, const char *path,
                     const struct fmt_image_options *options, struct fmt_image_writer **out)
{
    *out = NULL;
    if (options->width == 0 || options->height == 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: an image of %u x %u texels", path, options->width,
                        options->height);
    BSQ_PASS(fmt_image_check_type(ctx, format, path, options->type));
    BSQ_PASS(fmt_image_check_tiles(ctx, format, path, options->exr_tile_side));
    void *memory;
    BSQ_PASS(bsq_calloc(ctx, "image writer", 1, format->writer_bytes, &memory));
    struct fmt_image_writer *writer = memory;
    writer->ctx = ctx;
    writer->format = format;
    writer->width = options->width;
    writer->height = options->height;
    writer->channel_count = options->channel_count;
    writer->exr_tile_side = options->exr_tile_side;
    const int status = image_start(writer, path, options);
    if (status < 0)
        fmt_image_discard(writer);
    else
        *out = writer;
    return status;
}

/* ---- blocks ---- */

static uint64_t image_row_samples(const struct fmt_image_writer *writer)
{
    return (uint64_t)writer->width * writer->channel_count;
}

struct batch {
    struct fmt_image_writer *writer;
    const float *samples;
    uint32_t rows, rows_taken, columns_taken;
};

static int take_block(void *arg, void *slot, uint64_t sequence)
{
    (void)sequence;
    struct batch *batch = arg;
    struct fmt_image_writer *writer = batch->writer;
    struct fmt_image_block *block = &((struct slot *)slot)->block;
    const uint32_t left = batch->rows - batch->rows_taken;
    const float *row = batch->samples + batch->rows_taken * image_row_samples(writer);
    if (left == 0)
        return 0;
    block->rows = left < writer->block_rows ? left : writer->block_rows;
    block->first_row = writer->rows_encoded;
    block->column = batch->columns_taken;
    block->samples = row + (size_t)block->column * writer->exr_tile_side * writer->channel_count;
    block->above = batch->rows_taken > 0  ? row - image_row_samples(writer)
                   : block->first_row > 0 ? writer->above
                                          : NULL;
    if (++batch->columns_taken < columns_of(writer))
        return 1;
    batch->columns_taken = 0;
    batch->rows_taken += block->rows;
    writer->rows_encoded += block->rows;
    return 1;
}

static int image_encode_block(void *arg, void *slot, uint64_t sequence, unsigned worker)
{
    (void)sequence;
    (void)worker;
    struct fmt_image_writer *writer = ((struct batch *)arg)->writer;
    return writer->format->encode(writer, ((struct slot *)slot)->encoder,
                                  &((struct slot *)slot)->block);
}

static int image_emit_block(void *arg, void *slot, uint64_t sequence)
{
    (void)sequence;
    struct fmt_image_writer *writer = ((struct batch *)arg)->writer;
    return writer->format->emit(writer, ((struct slot *)slot)->encoder,
                                &((struct slot *)slot)->block);
}

static int encode_rows(struct fmt_image_writer *writer, const float *samples, uint32_t rows)
{
    struct batch batch = {.writer = writer, .samples = samples, .rows = rows};
    const struct bsq_pipeline pipeline = {.produce = take_block,
                                          .work = image_encode_block,
                                          .emit = image_emit_block,
                                          .arg = &batch,
                                          .slots = writer->slots,
                                          .slot_size = writer->slot_bytes,
                                          .slot_count = writer->slot_count};
    const int status = bsq_pipeline_run(writer->ctx, &pipeline);
    if (writer->above)
        memcpy(writer->above, samples + (rows - 1) * image_row_samples(writer),
               image_row_samples(writer) * sizeof *samples);
    return status;
}

/* ---- rows ---- */

/* Adds rows to the pending block, and writes the block if it is full or the image's last. Returns
 * the number of rows taken, or a failure. */
static int64_t fill_block(struct fmt_image_writer *writer, const float *samples, uint32_t rows)
{
    uint32_t missing = writer->block_rows - writer->pending_rows;
    uint32_t taken = rows < missing ? rows : missing;
    memcpy(writer->pending + writer->pending_rows * image_row_samples(writer), samples,
           taken * image_row_samples(writer) * sizeof *samples);
    writer->pending_rows += taken;
    writer->rows_taken += taken;
    if (taken < missing && writer->rows_taken < writer->height)
        return taken;
    uint32_t block = writer->pending_rows;
    writer->pending_rows = 0;
    BSQ_PASS(encode_rows(writer, writer->pending, block));
    return taken;
}

int fmt_image_describe(struct fmt_image_writer *writer,
                       const struct fmt_image_attribute *attributes, uint32_t count)
{
    return writer->format->describe(writer, attributes, count);
}

/* Writes the header before the first row. */
static int ensure_started(struct fmt_image_writer *writer)
{
    int status = writer->started ? 0 : writer->format->start(writer);
    writer->started = writer->started || status == 0;
    return status;
}

int fmt_image_write_rows(struct fmt_image_writer *writer, const float *samples, uint32_t rows)
{
    uint32_t left = writer->height - writer->rows_taken;
    if (rows > left)
        return bsq_fail(writer->ctx, BSQ_EBUG, "%s: %u rows too many", writer->path, rows - left);
    int64_t taken = ensure_started(writer);
    if (taken == 0 && writer->pending_rows > 0)
        taken = fill_block(writer, samples, rows);
    if (taken < 0)
        return (int)taken;
    samples += (uint64_t)taken * image_row_samples(writer);
    rows -= (uint32_t)taken;
    uint32_t whole =
        writer->rows_taken + rows == writer->height ? rows : rows - rows % writer->block_rows;
    if (whole > 0) {
        writer->rows_taken += whole;
        BSQ_PASS(encode_rows(writer, samples, whole));
    }
    taken = rows > whole
                ? fill_block(writer, samples + whole * image_row_samples(writer), rows - whole)
                : 0;
    return taken < 0 ? (int)taken : 0;
}

/* ---- ending ---- */

static void free_encoders(struct fmt_image_writer *writer)
{
    for (unsigned i = 0; i < writer->slot_count; ++i)
        writer->format->free_encoder(writer, slot_at(writer, i)->encoder);
    writer->slot_count = 0;
    bsq_free(writer->ctx, writer->slots);
    writer->slots = NULL;
}

/* Frees all but the output. A job may have thousands of finished files. */
static void free_coding(struct fmt_image_writer *writer)
{
    if (writer->freed)
        return;
    writer->freed = true;
    free_encoders(writer);
    if (writer->format->free)
        writer->format->free(writer);
    BSQ_FREE(writer->ctx, writer->pending, writer->above);
}

int fmt_image_finish(struct fmt_image_writer *writer)
{
    if (writer->finished)
        return 0;
    if (writer->rows_taken != writer->height)
        return bsq_fail(writer->ctx, BSQ_EBUG, "%s: %u of %u rows were written", writer->path,
                        writer->rows_taken, writer->height);
    free_encoders(writer);
    BSQ_PASS(writer->format->finish(writer));
    BSQ_PASS(bsq_output_sync(writer->output));
    writer->finished = true;
    free_coding(writer);
    return 0;
}

static void free_writer(struct fmt_image_writer *writer)
{
    struct bsq_ctx *ctx = writer->ctx;
    BSQ_FREE(ctx, writer->path, writer);
}

int fmt_image_hand_over(struct fmt_image_writer *writer, struct bsq_output **out)
{
    int status = fmt_image_finish(writer);
    *out = NULL;
    if (status < 0) {
        fmt_image_discard(writer);
        return status;
    }
    *out = writer->output;
    free_writer(writer);
    return 0;
}

void fmt_image_discard(struct fmt_image_writer *writer)
{
    if (!writer)
        return;
    free_coding(writer);
    bsq_output_discard(writer->output);
    free_writer(writer);
}
