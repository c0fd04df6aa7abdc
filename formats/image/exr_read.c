/* exr_read.c - reads EXR files, whole or row by row.
 *
 * Sizes in the header are checked against the memory budget before anything of that size is
 * allocated. This includes OpenEXR's own memory, which follows from the chunk size. Chunks (blocks
 * of lines, or tiles) are decoded straight into interleaved samples: by all threads into the whole
 * image, or by one into the lines of a row of chunks. */
#include "formats/image/exr_read.h"

#include <half.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "base/file.h"
#include "base/parallel.h"
#include "base/text.h"
#include "formats/image/exr_internal.h"

enum { UNPACKING_BYTES = 64 << 10 }; /* zlib needs at least this memory to unpack */
enum { MOST_TILE_SIDE = 8192 };      /* of tiles that are read one by one */

/* A file that is read. */
struct fmt_exr_rows {
    struct fmt_exr_stream stream; /* first: OpenEXR's user data */
    const struct bsq_file *input;
    exr_context_t file;
    struct fmt_exr_image image; /* without samples */
    exr_attr_box2i_t window;
    bool tiled;
    uint32_t pixel_bytes; /* of all channels */
    uint32_t chunk_width, chunk_height, chunks_across, chunks_down;
    uint32_t *places, kept; /* of each channel in `samples`, UINT32_MAX: none; their number */
    float *samples;         /* of the image, or of one row of chunks */
    uint32_t across;        /* texels of a line of them */
    uint32_t first_row, first_column; /* of the chunks in them */
    exr_decode_pipeline_t *decoders;  /* one a worker; each has a context from its first chunk on */
    unsigned workers;
    uint64_t reserved_bytes;
    uint32_t next; /* row */
    uint32_t side; /* of tiles; 0: there are none, or they are no squares */
};

/* Where unpack_chunk() writes a chunk's samples. */
struct target {
    const struct fmt_exr_rows *reader;
    float *samples;
};

/* ---- errors ---- */

/* EXR_ERR_READ_IO is bad data: the file ends too early. Callbacks record failures of the disk. */
static int status_of(exr_result_t result)
{
    switch (result) {
    case EXR_ERR_SUCCESS:
        return BSQ_OK;
    case EXR_ERR_OUT_OF_MEMORY:
        return BSQ_ENOMEM;
    case EXR_ERR_WRITE_IO:
    case EXR_ERR_FILE_ACCESS:
        return BSQ_EIO;
    default:
        return BSQ_EDATA;
    }
}

int fmt_exr_status(const struct fmt_exr_stream *stream, exr_result_t result)
{
    if (result == EXR_ERR_SUCCESS)
        return BSQ_OK;
    int described = atomic_load(&stream->status);
    if (described < 0)
        return described;
    return bsq_fail(stream->ctx, status_of(result), "%s: %s", stream->path,
                    exr_get_default_error_message(result));
}

void fmt_exr_set_status(struct fmt_exr_stream *stream, int status)
{
    int none = 0;
    if (status < 0)
        atomic_compare_exchange_strong(&stream->status, &none, status);
}

/* ---- callbacks of OpenEXR ---- */

/* Records OpenEXR's message with the file's name, except for EXR_ERR_CORRUPT_CHUNK. */
static void exr_in_describe_failure(exr_const_context_t file, exr_result_t result,
                                    const char *message)
{
    void *user = NULL;
    if (result == EXR_ERR_CORRUPT_CHUNK) /* the caller may try again, and describes it */
        return;
    if (!file || exr_get_user_data(file, &user) != EXR_ERR_SUCCESS || !user)
        return;
    struct fmt_exr_stream *stream = user;
    fmt_exr_set_status(stream, status_of(result));
    bsq_fail(stream->ctx, status_of(result), "%s: %s", stream->path, message);
}

static int64_t exr_in_read_bytes(exr_const_context_t file, void *user, void *buffer, uint64_t size,
                                 uint64_t offset, exr_stream_error_func_ptr_t on_error)
{
    (void)file;
    (void)on_error;
    struct fmt_exr_rows *reader = user;
    uint64_t got;
    int status = bsq_file_read_some(reader->stream.ctx, reader->input, buffer, size, offset, &got);
    fmt_exr_set_status(&reader->stream, status);
    return status < 0 ? -1 : (int64_t)got;
}

static int64_t file_size(exr_const_context_t file, void *user)
{
    (void)file;
    return (int64_t)((struct fmt_exr_rows *)user)->input->size;
}

static int refuse(const struct fmt_exr_rows *reader, const char *why)
{
    return bsq_fail(reader->stream.ctx, BSQ_EDATA, "%s: %s", reader->stream.path, why);
}

/* ---- header ---- */

static int read_layout(struct fmt_exr_rows *reader)
{
    struct fmt_exr_image *image = &reader->image;
    exr_storage_t storage;
    exr_result_t r = exr_get_storage(reader->file, 0, &storage);
    if (r == EXR_ERR_SUCCESS)
        r = exr_get_data_window(reader->file, 0, &reader->window);
    if (r != EXR_ERR_SUCCESS)
        return fmt_exr_status(&reader->stream, r);
    if (storage != EXR_STORAGE_SCANLINE && storage != EXR_STORAGE_TILED)
        return refuse(reader, "deep EXR files are not supported");
    int64_t width = (int64_t)reader->window.max.x - reader->window.min.x + 1;
    int64_t height = (int64_t)reader->window.max.y - reader->window.min.y + 1;
    if (width < 1 || height < 1 || width > INT32_MAX || height > INT32_MAX)
        return refuse(reader, "the data window is empty or too large");
    image->x = reader->window.min.x;
    image->y = reader->window.min.y;
    image->width = (uint32_t)width;
    image->height = (uint32_t)height;
    reader->tiled = storage == EXR_STORAGE_TILED;
    int32_t chunk_width = (int32_t)width, chunk_height;
    r = reader->tiled ? exr_get_tile_sizes(reader->file, 0, 0, 0, &chunk_width, &chunk_height)
                      : exr_get_scanlines_per_chunk(reader->file, 0, &chunk_height);
    if (r != EXR_ERR_SUCCESS)
        return fmt_exr_status(&reader->stream, r);
    if (chunk_width < 1 || chunk_height < 1)
        return refuse(reader, "the tile size is not positive");
    reader->chunk_width = (uint32_t)chunk_width;
    reader->chunk_height = (uint32_t)chunk_height;
    reader->chunks_across = (image->width - 1) / reader->chunk_width + 1;
    reader->chunks_down = (image->height - 1) / reader->chunk_height + 1;
    /* OpenEXR allocates this table outside the memory budget. */
    if ((uint64_t)reader->chunks_across * reader->chunks_down > reader->input->size / 8)
        return refuse(reader, "truncated: the table of blocks is longer than the file");
    return 0;
}

static int exr_in_read_channels(struct fmt_exr_rows *reader)
{
    struct bsq_ctx *ctx = reader->stream.ctx;
    struct fmt_exr_image *image = &reader->image;
    const exr_attr_chlist_t *list;
    BSQ_PASS(fmt_exr_status(&reader->stream, exr_get_channels(reader->file, 0, &list)));
    if (list->num_channels < 1)
        return refuse(reader, "there are no channels");
    uint32_t count = (uint32_t)list->num_channels;
    if ((uint64_t)count * image->width > INT32_MAX / sizeof(float))
        return refuse(reader, "a row of the image is longer than 2 GiB");
    BSQ_PASS(BSQ_CALLOC(ctx, "EXR channel names", count, &image->channels));
    image->channel_count = count;
    for (uint32_t c = 0; c < count; ++c) {
        const exr_attr_chlist_entry_t *entry = &list->entries[c];
        if (entry->x_sampling != 1 || entry->y_sampling != 1)
            return refuse(reader, "subsampled channels are not supported");
        reader->pixel_bytes += entry->pixel_type == EXR_PIXEL_HALF ? 2 : 4;
        BSQ_PASS(bsq_text_copy(ctx, entry->name.str, &image->channels[c]));
    }
    return 0;
}

static int exr_in_read_attributes(struct fmt_exr_rows *reader)
{
    struct bsq_ctx *ctx = reader->stream.ctx;
    struct fmt_exr_image *image = &reader->image;
    int32_t count;
    BSQ_PASS(fmt_exr_status(&reader->stream, exr_get_attribute_count(reader->file, 0, &count)));
    if (count > 0)
        BSQ_PASS(BSQ_CALLOC(ctx, "EXR attributes", (uint32_t)count, &image->attributes));
    for (int32_t i = 0; i < count; ++i) {
        const exr_attribute_t *attribute;
        BSQ_PASS(fmt_exr_status(
            &reader->stream,
            exr_get_attribute_by_index(reader->file, 0, EXR_ATTR_LIST_FILE_ORDER, i, &attribute)));
        if (attribute->type != EXR_ATTR_STRING || !attribute->string->str)
            continue;
        struct fmt_exr_attribute *copy = &image->attributes[image->attribute_count++];
        BSQ_PASS(bsq_text_copy(ctx, attribute->name, &copy->name));
        BSQ_PASS(bsq_text_copy(ctx, attribute->string->str, &copy->value));
    }
    return 0;
}

/* ---- chunks ---- */

static exr_result_t chunk_info(const struct fmt_exr_rows *reader, uint32_t column, uint32_t row,
                               exr_chunk_info_t *info)
{
    if (reader->tiled)
        return exr_read_tile_chunk_info(reader->file, 0, (int)column, (int)row, 0, 0, info);
    int y = reader->window.min.y + (int)(row * reader->chunk_height);
    return exr_read_scanline_chunk_info(reader->file, 0, y, info);
}

/* Writes one channel of one line to the interleaved samples; `stride` counts floats. Samples in the
 * file are little-endian and not aligned. */
static void unpack_line(const exr_coding_channel_info_t *channel, const uint8_t *in, uint32_t width,
                        float *out, size_t stride)
{
    for (uint32_t x = 0; x < width; ++x) {
        if (channel->data_type == EXR_PIXEL_HALF) {
            uint32_t bits = (uint32_t)in[0] | (uint32_t)in[1] << 8;
            out[x * stride] = imath_half_to_float((imath_half_bits_t)bits);
            in += 2;
        } else {
            uint32_t bits = (uint32_t)in[0] | (uint32_t)in[1] << 8 | (uint32_t)in[2] << 16 |
                            (uint32_t)in[3] << 24;
            if (channel->data_type == EXR_PIXEL_FLOAT)
                memcpy(&out[x * stride], &bits, sizeof bits);
            else
                out[x * stride] = (float)bits;
            in += 4;
        }
    }
}

/* Replaces OpenEXR's own unpacking. For interleaved output of some four-channel files,
 * version 3.1.5 takes the channels in the wrong order. */
static exr_result_t unpack_chunk(exr_decode_pipeline_t *decoder)
{
    const struct target *target = decoder->decoding_user_data;
    const struct fmt_exr_rows *reader = target->reader;
    const size_t line = (size_t)reader->across * reader->kept;
    uint32_t width = (uint32_t)decoder->chunk.width, height = (uint32_t)decoder->chunk.height;
    const uint8_t *in = decoder->unpacked_buffer;
    if (!in)
        return EXR_ERR_CORRUPT_CHUNK;
    for (uint32_t y = 0; y < height; ++y)
        for (int c = 0; c < decoder->channel_count; ++c) {
            const exr_coding_channel_info_t *channel = &decoder->channels[c];
            if (reader->places[c] != UINT32_MAX)
                unpack_line(channel, in, width, target->samples + y * line + reader->places[c],
                            reader->kept);
            in += (size_t)width * (channel->data_type == EXR_PIXEL_HALF ? 2 : 4);
        }
    return EXR_ERR_SUCCESS;
}

/* Decodes a chunk. OpenEXR returns the same result for a damaged chunk and for memory that ran out.
 * So this tries to allocate before it blames the file. `probe` is volatile, or a compiler may
 * remove the attempt. */
static exr_result_t run_decoder(struct fmt_exr_rows *reader, exr_decode_pipeline_t *decoder)
{
    exr_result_t r = exr_decoding_run(reader->file, 0, decoder);
    if (r != EXR_ERR_CORRUPT_CHUNK)
        return r;
    void *volatile probe = malloc(UNPACKING_BYTES);
    free(probe);
    return probe ? exr_decoding_run(reader->file, 0, decoder) : EXR_ERR_OUT_OF_MEMORY;
}

static int decode_chunk(void *arg, uint64_t index, unsigned worker)
{
    struct fmt_exr_rows *reader = arg;
    const struct fmt_exr_image *image = &reader->image;
    exr_decode_pipeline_t *decoder = &reader->decoders[worker];
    uint32_t column = (uint32_t)(index % reader->chunks_across);
    uint32_t row = (uint32_t)(index / reader->chunks_across);
    uint32_t width = image->width - column * reader->chunk_width;
    uint32_t height = image->height - row * reader->chunk_height;
    if (width > reader->chunk_width)
        width = reader->chunk_width;
    if (height > reader->chunk_height)
        height = reader->chunk_height;
    size_t first = ((size_t)(row - reader->first_row) * reader->chunk_height * reader->across +
                    (size_t)(column - reader->first_column) * reader->chunk_width) *
                   reader->kept;
    struct target target = {reader, reader->samples + first};
    exr_chunk_info_t info;
    exr_result_t r = chunk_info(reader, column, row, &info);
    if (r != EXR_ERR_SUCCESS)
        return fmt_exr_status(&reader->stream, r);
    /* A chunk of another size would be decoded outside the image. */
    uint64_t expected = (uint64_t)width * height * reader->pixel_bytes;
    if (info.width != (int32_t)width || info.height != (int32_t)height ||
        info.unpacked_size != expected || info.packed_size > reader->input->size ||
        (info.compression == EXR_COMPRESSION_NONE && info.packed_size != expected))
        return refuse(reader, "a block has the wrong size");
    const bool fresh = !decoder->context;
    r = fresh ? exr_decoding_initialize(reader->file, 0, &info, decoder)
              : exr_decoding_update(reader->file, 0, &info, decoder);
    if (r == EXR_ERR_SUCCESS && fresh)
        r = exr_decoding_choose_default_routines(reader->file, 0, decoder);
    if (r == EXR_ERR_SUCCESS) {
        decoder->decoding_user_data = &target;
        decoder->unpack_and_convert_fn = unpack_chunk;
        r = run_decoder(reader, decoder);
    }
    return fmt_exr_status(&reader->stream, r);
}

/* ---- the file ---- */

/* Allocates a decoder for each worker, and room for samples. */
static int exr_in_allocate(struct fmt_exr_rows *reader, uint32_t across, uint32_t lines)
{
    struct bsq_ctx *ctx = reader->stream.ctx;
    const unsigned workers = reader->workers;
    uint64_t chunk_bytes;
    BSQ_PASS(fmt_exr_status(&reader->stream,
                            exr_get_chunk_unpacked_size(reader->file, 0, &chunk_bytes)));
    if (chunk_bytes > UINT64_MAX / 4 / workers)
        return refuse(reader, "a block is too large");
    /* OpenEXR allocates packed, unpacked and scratch bytes for each chunk. */
    uint64_t bytes = workers * (3 * chunk_bytes + chunk_bytes / 50 + 4096);
    BSQ_PASS(bsq_reserve(ctx, "EXR decoding", bytes));
    reader->reserved_bytes = bytes;
    BSQ_PASS(BSQ_CALLOC(ctx, "EXR decoders", workers, &reader->decoders));
    reader->across = across;
    return bsq_alloc(ctx, "EXR image", (uint64_t)across * lines, reader->kept * sizeof(float),
                     &reader->samples);
}

static int exr_in_read_header(struct fmt_exr_rows *reader, bool by_rows)
{
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = exr_in_describe_failure;
    init.user_data = reader;
    init.read_fn = exr_in_read_bytes;
    init.size_fn = file_size;
    init.flags = EXR_CONTEXT_FLAG_DISABLE_CHUNK_RECONSTRUCTION;
    exr_compression_t packing;
    BSQ_PASS(fmt_exr_check_header(reader->stream.ctx, reader->stream.path, reader->input));
    BSQ_PASS(
        fmt_exr_status(&reader->stream, exr_start_read(&reader->file, reader->stream.path, &init)));
    BSQ_PASS(fmt_exr_status(&reader->stream, exr_get_compression(reader->file, 0, &packing)));
    if (by_rows && (packing == EXR_COMPRESSION_DWAA || packing == EXR_COMPRESSION_DWAB))
        return BSQ_RETRY;
    BSQ_PASS(read_layout(reader));
    BSQ_PASS(exr_in_read_channels(reader));
    return BSQ_ALLOC(reader->stream.ctx, "EXR channels", reader->image.channel_count,
                     &reader->places);
}

static void close_reader(struct fmt_exr_rows *reader)
{
    struct bsq_ctx *ctx = reader->stream.ctx;
    for (unsigned w = 0; reader->decoders && w < reader->workers; ++w)
        if (reader->decoders[w].context)
            exr_decoding_destroy(reader->file, &reader->decoders[w]);
    if (reader->file)
        exr_finish(&reader->file);
    BSQ_FREE(ctx, reader->decoders, reader->places, reader->samples);
    bsq_release(ctx, reader->reserved_bytes);
    fmt_exr_image_free(ctx, &reader->image);
}

static int read_image(struct fmt_exr_rows *reader)
{
    struct fmt_exr_image *image = &reader->image;
    BSQ_PASS(exr_in_read_header(reader, false));
    BSQ_PASS(exr_in_read_attributes(reader));
    for (uint32_t c = 0; c < image->channel_count; ++c)
        reader->places[c] = c;
    reader->kept = image->channel_count;
    BSQ_PASS(exr_in_allocate(reader, image->width, image->height));
    return bsq_parallel_for(reader->stream.ctx,
                            (uint64_t)reader->chunks_across * reader->chunks_down, decode_chunk,
                            reader);
}

int fmt_exr_read(struct bsq_ctx *ctx, const char *path, struct fmt_exr_image *out)
{
    struct bsq_file input;
    struct fmt_exr_rows reader = {
        .stream = {.ctx = ctx, .path = path}, .input = &input, .workers = bsq_threads(ctx)};
    memset(out, 0, sizeof *out);
    BSQ_PASS(bsq_file_open(ctx, path, &input));
    const int status = read_image(&reader);
    if (status == 0) {
        *out = reader.image;
        out->samples = reader.samples;
        reader.image = (struct fmt_exr_image){0};
        reader.samples = NULL;
    }
    close_reader(&reader);
    bsq_file_close(ctx, &input);
    return status;
}

/* ---- rows ---- */

/* Returns the end of a channel's name, after the name of its layer. */
static const char *own_name(const char *name)
{
    const char *dot = strrchr(name, '.');
    return dot ? dot + 1 : name;
}

/* Returns the channel with one of two names in the layer of channel `of`, or UINT32_MAX. */
static uint32_t find_in_layer(const struct fmt_exr_image *image, uint32_t of, const char *name,
                              const char *long_name)
{
    const char *layer = image->channels[of];
    const size_t length = (size_t)(own_name(layer) - layer);
    for (uint32_t c = 0; c < image->channel_count; ++c) {
        const char *other = image->channels[c], *own = own_name(other);
        if ((size_t)(own - other) == length && memcmp(other, layer, length) == 0 &&
            (strcasecmp(own, name) == 0 || strcasecmp(own, long_name) == 0))
            return c;
    }
    return UINT32_MAX;
}

/* Returns the first channel of the first layer that has a name of red, or of all. */
static uint32_t find_layer(const struct fmt_exr_image *image)
{
    static const char *const names[] = {"R", "Red", "Y"};
    for (size_t i = 0; i < sizeof names / sizeof *names; ++i)
        if (fmt_exr_channel(image, names[i]) != UINT32_MAX)
            return fmt_exr_channel(image, names[i]);
    for (uint32_t c = 0; c < image->channel_count; ++c)
        if (find_in_layer(image, c, "R", "Red") != UINT32_MAX)
            return c;
    return 0;
}

/* Keeps red, green, blue, or the one channel of another layer, and the alpha after them. */
static void exr_in_choose_channels(struct fmt_exr_rows *reader)
{
    const struct fmt_exr_image *image = &reader->image;
    const uint32_t layer = find_layer(image);
    const uint32_t rgb[] = {find_in_layer(image, layer, "R", "Red"),
                            find_in_layer(image, layer, "G", "Green"),
                            find_in_layer(image, layer, "B", "Blue")};
    const uint32_t alpha = find_in_layer(image, layer, "A", "Alpha");
    const bool colors = rgb[0] != UINT32_MAX && rgb[1] != UINT32_MAX && rgb[2] != UINT32_MAX;
    for (uint32_t c = 0; c < image->channel_count; ++c)
        reader->places[c] = UINT32_MAX;
    for (uint32_t i = 0; colors && i < 3; ++i)
        reader->places[rgb[i]] = reader->kept++;
    if (!colors)
        reader->places[layer] = reader->kept++;
    if (alpha != UINT32_MAX && reader->places[alpha] == UINT32_MAX)
        reader->places[alpha] = reader->kept++;
}

/* Returns the lines of the largest row of chunks. */
static uint32_t row_height(const struct fmt_exr_rows *reader)
{
    const uint32_t height = reader->image.height;
    return reader->chunk_height < height ? reader->chunk_height : height;
}

/* Opens an image whose chunks one thread reads. Close *out also after a failure. */
static int open_rows(struct bsq_ctx *ctx, const char *path, const struct bsq_file *input,
                     bool colors, struct fmt_exr_rows **out)
{
    *out = NULL;
    BSQ_PASS(BSQ_CALLOC(ctx, "an EXR decoder", 1, out));
    **out =
        (struct fmt_exr_rows){.stream = {.ctx = ctx, .path = path}, .input = input, .workers = 1};
    return exr_in_read_header(*out, colors);
}

int fmt_exr_rows_open(struct bsq_ctx *ctx, const char *path, const struct bsq_file *input,
                      struct fmt_exr_size *size, struct fmt_exr_rows **out)
{
    BSQ_PASS(open_rows(ctx, path, input, true, out));
    struct fmt_exr_rows *rows = *out;
    exr_in_choose_channels(rows);
    BSQ_PASS(exr_in_allocate(rows, rows->image.width, row_height(rows)));
    *size = (struct fmt_exr_size){rows->image.width, rows->image.height, rows->kept};
    return 0;
}

int fmt_exr_rows_read(struct fmt_exr_rows *rows, float *out)
{
    const size_t line = (size_t)rows->image.width * rows->kept;
    const uint32_t row = rows->next / rows->chunk_height, y = rows->next % rows->chunk_height;
    rows->first_row = row;
    for (uint32_t column = 0; y == 0 && column < rows->chunks_across; ++column)
        BSQ_PASS(decode_chunk(rows, (uint64_t)row * rows->chunks_across + column, 0));
    memcpy(out, rows->samples + y * line, line * sizeof *out);
    rows->next++;
    return 0;
}

/* ---- tiles ---- */

/* Finds the place of each channel among those that the caller names. */
static int exr_in_name_channels(struct fmt_exr_rows *reader, const char *const *channels,
                                uint32_t count)
{
    const struct fmt_exr_image *image = &reader->image;
    if (image->channel_count != count)
        return refuse(reader, "it has other channels");
    for (uint32_t i = 0; i < count; ++i) {
        const uint32_t c = fmt_exr_channel(image, channels[i]);
        if (c == UINT32_MAX)
            return refuse(reader, "it has other channels");
        reader->places[c] = i;
    }
    reader->kept = count;
    return 0;
}

/* Finds the side of tiles: chunks of an image that is smaller than a tile are smaller, too. */
static int exr_in_find_side(struct fmt_exr_rows *rows)
{
    uint32_t width = 0, height = 0;
    exr_tile_level_mode_t levels;
    exr_tile_round_mode_t rounding;
    if (!rows->tiled)
        return 0;
    BSQ_PASS(fmt_exr_status(&rows->stream, exr_get_tile_descriptor(rows->file, 0, &width, &height,
                                                                   &levels, &rounding)));
    rows->side = width == height && width <= MOST_TILE_SIDE ? width : 0;
    return 0;
}

int fmt_exr_tiles_open(struct bsq_ctx *ctx, const char *path, const struct bsq_file *input,
                       const char *const *channels, uint32_t count, struct fmt_exr_rows **out)
{
    BSQ_PASS(open_rows(ctx, path, input, false, out));
    struct fmt_exr_rows *rows = *out;
    BSQ_PASS(exr_in_read_attributes(rows));
    BSQ_PASS(exr_in_name_channels(rows, channels, count));
    BSQ_PASS(exr_in_find_side(rows));
    const uint32_t across = rows->side > 0 ? rows->side : rows->chunk_width;
    return exr_in_allocate(rows, across, row_height(rows));
}

const struct fmt_exr_image *fmt_exr_rows_image(const struct fmt_exr_rows *rows)
{
    return &rows->image;
}

uint32_t fmt_exr_tile_side(const struct fmt_exr_rows *rows)
{
    return rows->side;
}

int fmt_exr_tile_read(struct fmt_exr_rows *rows, uint32_t column, uint32_t row,
                      const float **samples)
{
    rows->first_row = row;
    rows->first_column = column;
    *samples = rows->samples;
    return decode_chunk(rows, (uint64_t)row * rows->chunks_across + column, 0);
}

void fmt_exr_rows_close(struct fmt_exr_rows *rows)
{
    if (!rows)
        return;
    close_reader(rows);
    bsq_free(rows->stream.ctx, rows);
}

/* ---- the image ---- */

void fmt_exr_image_free(struct bsq_ctx *ctx, struct fmt_exr_image *image)
{
    for (uint32_t c = 0; image->channels && c < image->channel_count; ++c)
        bsq_free(ctx, image->channels[c]);
    bsq_free(ctx, image->channels);
    for (uint32_t a = 0; image->attributes && a < image->attribute_count; ++a) {
        BSQ_FREE(ctx, image->attributes[a].name, image->attributes[a].value);
    }
    BSQ_FREE(ctx, image->attributes, image->samples);
    memset(image, 0, sizeof *image);
}

uint32_t fmt_exr_channel(const struct fmt_exr_image *image, const char *name)
{
    for (uint32_t c = 0; c < image->channel_count; ++c)
        if (strcmp(image->channels[c], name) == 0)
            return c;
    return UINT32_MAX;
}

const char *fmt_exr_image_attribute(const struct fmt_exr_image *image, const char *name)
{
    for (uint32_t a = 0; a < image->attribute_count; ++a)
        if (strcmp(image->attributes[a].name, name) == 0)
            return image->attributes[a].value;
    return NULL;
}
