/* exr_write.c - streaming EXR writer.
 *
 * OpenEXR compresses blocks of 16 lines, or tiles, independently. Each slot of a pipeline owns an
 * encoder. The slots compress in parallel, and the pipeline writes their bytes from top to bottom.
 * So the file is the same for any number of threads. */
#include "formats/image/image_writer.h"

#include <string.h>

#include "base/output.h"
#include "base/parallel.h"
#include "formats/image/exr_internal.h"
#include "formats/image/exr_zip.h"

enum {
    ZIP_ROWS = 16,       /* of a block */
    ENCODER_BYTES = 4096 /* that OpenEXR allocates for an encoder beside the chunk's samples */
};

struct slot {
    exr_encode_pipeline_t encoder;
    bool ready;           /* the encoder was initialised */
    uint32_t column, row; /* of a tile in tiles, of a block of lines in lines */
    const float *samples;
    struct fmt_exr_zip zip;
    const void *packed; /* compressed block, in the memory of the encoder or of zip */
    uint64_t packed_bytes;
};

enum { MOST_CHANNELS = 4 };
static const char *const color_names[MOST_CHANNELS] = {"R", "G", "B", "A"};
static const char *const grey_name[] = {"Y"};

struct exr_writer {
    struct fmt_image_writer base;
    struct fmt_exr_stream stream;
    exr_context_t file;
    const char *const *channels;   /* names in the order of the samples */
    uint16_t order[MOST_CHANNELS]; /* sample number of each of the file's channels */
    uint32_t rows_written;         /* rows given to encoders */
    uint32_t tile_side;            /* 0: blocks of lines */
    struct slot *slots;
    unsigned slot_count;
    uint64_t reserved_bytes;
};

/* ---- callbacks of OpenEXR ---- */

static int64_t write_bytes(exr_const_context_t file, void *user, const void *buffer, uint64_t size,
                           uint64_t offset, exr_stream_error_func_ptr_t on_error)
{
    (void)file;
    (void)on_error;
    struct exr_writer *writer = user;
    int status = bsq_output_write_at(writer->base.output, buffer, size, offset);
    fmt_exr_set_status(&writer->stream, status);
    return status < 0 ? -1 : (int64_t)size;
}

/* Replaces the encoder's own compression. Readers take a block of the size of its samples as not
 * compressed. The pipeline writes the blocks in order, in place of the encoder's write step. */
static exr_result_t compress(exr_encode_pipeline_t *encoder)
{
    struct slot *slot = encoder->encoding_user_data;
    slot->packed_bytes =
        fmt_exr_zip_pack(&slot->zip, encoder->packed_buffer, encoder->packed_bytes);
    slot->packed = slot->zip.packed;
    if (slot->packed_bytes == 0) {
        slot->packed = encoder->packed_buffer;
        slot->packed_bytes = encoder->packed_bytes;
    }
    return EXR_ERR_SUCCESS;
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

static exr_result_t make_header(struct exr_writer *writer, const struct fmt_image_options *options)
{
    exr_context_t file = writer->file;
    int part;
    const uint32_t side = options->tile_side;
    exr_result_t r =
        exr_add_part(file, NULL, side > 0 ? EXR_STORAGE_TILED : EXR_STORAGE_SCANLINE, &part);
    if (r == EXR_ERR_SUCCESS)
        r = exr_initialize_required_attr_simple(file, 0, (int32_t)options->width,
                                                (int32_t)options->height, EXR_COMPRESSION_ZIP);
    if (r == EXR_ERR_SUCCESS && side > 0)
        r = exr_set_tile_descriptor(file, 0, side, side, EXR_TILE_ONE_LEVEL, EXR_TILE_ROUND_DOWN);
    exr_pixel_type_t type = options->type == FMT_HALF ? EXR_PIXEL_HALF : EXR_PIXEL_FLOAT;
    for (uint32_t c = 0; r == EXR_ERR_SUCCESS && c < options->channel_count; ++c)
        r = exr_add_channel(file, 0, writer->channels[c], type, EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1);
    if (r == EXR_ERR_SUCCESS)
        r = set_color_attributes(file, !options->color);
    if (r == EXR_ERR_SUCCESS)
        r = set_attributes(file, options->attributes, options->attribute_count);
    return r;
}

static int describe_image(struct fmt_image_writer *base,
                          const struct fmt_image_attribute *attributes, uint32_t count)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    return fmt_exr_status(&writer->stream, set_attributes(writer->file, attributes, count));
}

static int start_image(struct fmt_image_writer *base)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    return fmt_exr_status(&writer->stream, exr_write_header(writer->file));
}

/* Finds the sample of each of the file's channels, which OpenEXR sorts by name. */
static int map_channels(struct exr_writer *writer)
{
    const exr_attr_chlist_t *list;
    int status = fmt_exr_status(&writer->stream, exr_get_channels(writer->file, 0, &list));
    for (int i = 0; status == 0 && i < list->num_channels; ++i) {
        for (uint32_t c = 0; c < writer->base.channel_count; ++c)
            if (strcmp(list->entries[i].name.str, writer->channels[c]) == 0)
                writer->order[i] = (uint16_t)c;
    }
    return status;
}

/* ---- compression ---- */

struct batch {
    struct exr_writer *writer;
    const float *samples;
    uint32_t rows, rows_taken, columns_taken; /* columns: of tiles */
};

static int take_chunk(void *arg, void *slot_memory, uint64_t sequence)
{
    (void)sequence;
    struct batch *batch = arg;
    struct slot *slot = slot_memory;
    struct exr_writer *writer = batch->writer;
    const uint32_t side = writer->tile_side, width = writer->base.width;
    if (batch->rows_taken == batch->rows)
        return 0;
    slot->column = batch->columns_taken;
    slot->row = side > 0 ? writer->rows_written / side : writer->rows_written;
    slot->samples =
        batch->samples + ((size_t)batch->rows_taken * width + (size_t)slot->column * side) *
                             writer->base.channel_count;
    if (side > 0 && ++batch->columns_taken <= (width - 1) / side)
        return 1;
    uint32_t left = batch->rows - batch->rows_taken;
    uint32_t rows = left < writer->base.block_rows ? left : writer->base.block_rows;
    batch->columns_taken = 0;
    batch->rows_taken += rows;
    writer->rows_written += rows;
    return 1;
}

static exr_result_t prepare_encoder(struct exr_writer *writer, struct slot *slot)
{
    exr_encode_pipeline_t *encoder = &slot->encoder;
    exr_chunk_info_t chunk;
    exr_result_t r = writer->tile_side > 0
                         ? exr_write_tile_chunk_info(writer->file, 0, (int)slot->column,
                                                     (int)slot->row, 0, 0, &chunk)
                         : exr_write_scanline_chunk_info(writer->file, 0, (int)slot->row, &chunk);
    if (r != EXR_ERR_SUCCESS)
        return r;
    if (slot->ready)
        r = exr_encoding_update(writer->file, 0, &chunk, encoder);
    else
        r = exr_encoding_initialize(writer->file, 0, &chunk, encoder);
    for (int c = 0; r == EXR_ERR_SUCCESS && c < encoder->channel_count; ++c) {
        exr_coding_channel_info_t *channel = &encoder->channels[c];
        channel->user_bytes_per_element = sizeof(float);
        channel->user_data_type = EXR_PIXEL_FLOAT;
        channel->user_pixel_stride = (int32_t)(writer->base.channel_count * sizeof(float));
        channel->user_line_stride =
            (int32_t)(writer->base.width * writer->base.channel_count * sizeof(float));
        channel->encode_from_ptr = (const uint8_t *)(slot->samples + writer->order[c]);
    }
    if (r == EXR_ERR_SUCCESS && !slot->ready) {
        slot->ready = true;
        r = exr_encoding_choose_default_routines(writer->file, 0, encoder);
        encoder->encoding_user_data = slot;
        encoder->yield_until_ready_fn = NULL;
        encoder->compress_fn = compress;
        encoder->write_fn = NULL;
    }
    return r;
}

static int compress_chunk(void *arg, void *slot_memory, uint64_t sequence, unsigned worker)
{
    (void)sequence;
    (void)worker;
    struct exr_writer *writer = ((struct batch *)arg)->writer;
    struct slot *slot = slot_memory;
    exr_result_t r = prepare_encoder(writer, slot);
    if (r == EXR_ERR_SUCCESS)
        r = exr_encoding_run(writer->file, 0, &slot->encoder);
    return fmt_exr_status(&writer->stream, r);
}

static int write_chunk(void *arg, void *slot_memory, uint64_t sequence)
{
    (void)sequence;
    struct exr_writer *writer = ((struct batch *)arg)->writer;
    const struct slot *slot = slot_memory;
    exr_result_t r = writer->tile_side > 0
                         ? exr_write_tile_chunk(writer->file, 0, (int)slot->column, (int)slot->row,
                                                0, 0, slot->packed, slot->packed_bytes)
                         : exr_write_scanline_chunk(writer->file, 0, (int)slot->row, slot->packed,
                                                    slot->packed_bytes);
    return fmt_exr_status(&writer->stream, r);
}

static int write_rows(struct fmt_image_writer *base, const float *samples, uint32_t rows)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    struct batch batch = {.writer = writer, .samples = samples, .rows = rows};
    struct bsq_pipeline pipeline = {.produce = take_chunk,
                                    .work = compress_chunk,
                                    .emit = write_chunk,
                                    .arg = &batch,
                                    .slots = writer->slots,
                                    .slot_size = sizeof *writer->slots,
                                    .slot_count = writer->slot_count};
    return bsq_pipeline_run(base->ctx, &pipeline);
}

/* ---- from creating to ending ---- */

static int allocate(struct exr_writer *writer, enum fmt_sample_type type)
{
    struct bsq_ctx *ctx = writer->base.ctx;
    const uint32_t side = writer->tile_side;
    const uint32_t columns = side > 0 ? (writer->base.width - 1) / side + 1 : 1;
    writer->base.block_rows = side > 0 ? side : ZIP_ROWS;
    const uint64_t chunk_bytes = (uint64_t)writer->base.block_rows *
                                 (side > 0 ? side : writer->base.width) *
                                 writer->base.channel_count * (type == FMT_HALF ? 2 : 4);
    uint64_t chunks = (((uint64_t)writer->base.height - 1) / writer->base.block_rows + 1) * columns;
    writer->slot_count = 2 * bsq_threads(ctx);
    if (writer->slot_count > chunks)
        writer->slot_count = (unsigned)chunks;
    int status =
        bsq_calloc(ctx, "EXR encoders", writer->slot_count, sizeof *writer->slots, &writer->slots);
    if (status < 0)
        return status;
    for (unsigned i = 0; status == 0 && i < writer->slot_count; ++i)
        status = fmt_exr_zip_create(ctx, chunk_bytes, &writer->slots[i].zip);
    const uint64_t bytes = writer->slot_count * (chunk_bytes + ENCODER_BYTES);
    if (status == 0)
        status = bsq_reserve(ctx, "EXR encoders", bytes);
    if (status == 0)
        writer->reserved_bytes = bytes;
    return status;
}

static int create_image(struct fmt_image_writer *base, const struct fmt_image_options *options)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    /* OpenEXR holds the bytes of a line and the number of rows in int32_t. */
    if (options->height > INT32_MAX || options->channel_count > MOST_CHANNELS ||
        (uint64_t)options->width * options->channel_count > INT32_MAX / sizeof(float))
        return bsq_fail(base->ctx, BSQ_EUSAGE, "%s: %u x %u texels is too large for an EXR file",
                        base->path, options->width, options->height);
    writer->stream.ctx = base->ctx;
    writer->stream.path = base->path;
    writer->tile_side = options->tile_side;
    writer->channels = options->channel_count == 1 ? grey_name : color_names;
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = leave_to_caller;
    init.user_data = writer;
    init.write_fn = write_bytes;
    exr_result_t r = exr_start_write(&writer->file, base->path, EXR_WRITE_FILE_DIRECTLY, &init);
    if (r == EXR_ERR_SUCCESS)
        r = make_header(writer, options);
    int status = fmt_exr_status(&writer->stream, r);
    if (status == 0)
        status = allocate(writer, options->type);
    return status < 0 ? status : map_channels(writer);
}

/* Closes the file, which writes its line table. Returns an error for an unfinished file; the
 * failure that left it unfinished is recorded already. */
static exr_result_t close_file(struct exr_writer *writer)
{
    for (unsigned i = 0; writer->slots && i < writer->slot_count; ++i) {
        if (writer->slots[i].ready)
            exr_encoding_destroy(writer->file, &writer->slots[i].encoder);
        writer->slots[i].ready = false;
    }
    return writer->file ? exr_finish(&writer->file) : EXR_ERR_SUCCESS;
}

static int finish_image(struct fmt_image_writer *base)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    return fmt_exr_status(&writer->stream, close_file(writer));
}

static void free_image(struct fmt_image_writer *base)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    close_file(writer);
    for (unsigned i = 0; writer->slots && i < writer->slot_count; ++i)
        fmt_exr_zip_free(base->ctx, &writer->slots[i].zip);
    bsq_release(base->ctx, writer->reserved_bytes);
    bsq_free(base->ctx, writer->slots);
}

const struct fmt_image_format fmt_exr_format = {
    .name = "OpenEXR",
    .suffix = ".exr",
    .sample_types = FMT_SAMPLE_BIT(FMT_HALF) | FMT_SAMPLE_BIT(FMT_FLOAT),
    .usual_type = FMT_HALF,
    .tiles = true,
    .writer_bytes = sizeof(struct exr_writer),
    .create = create_image,
    .describe = describe_image,
    .start = start_image,
    .write_rows = write_rows,
    .finish = finish_image,
    .free = free_image,
};
