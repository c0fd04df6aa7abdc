/* exr_write.c - streaming EXR writer.
 *
 * OpenEXR compresses blocks of 16 lines, or tiles, independently. Blocks are packed here with
 * libdeflate, as OpenEXR 3.2 and later do. OpenEXR 3.1 uses zlib, which takes three times as long.
 *
 * OpenEXR's compression ZIP puts bytes of even offsets before those of odd offsets, and replaces
 * each byte by its difference from the one before. The result becomes a zlib stream (RFC 1950).
 * libdeflate makes the same bytes on every processor.
 *
 * Even offsets hold the low bytes of samples. In maps of 32-bit floats they are often noise, which
 * takes the longest to pack and does not get smaller. Then the stream begins with stored blocks
 * (RFC 1951, section 3.2.4) of that half, and compressed blocks of the other half follow. */
#include "formats/image/image_writer.h"

#include <libdeflate.h>
#include <string.h>

#include "base/output.h"
#include "formats/image/exr_internal.h"

/* ---- packing ---- */

/* Working memory for one chunk at a time. */
struct zip {
    struct libdeflate_compressor *compressor;
    uint8_t *ordered, *packed; /* a chunk each */
    uint64_t reserved_bytes;   /* of the compressor */
};

enum {
    LEVEL = 1, /* level 4 takes 1.5 to 2 times as long for 1 to 3 % of the size */
    COMPRESSOR_BYTES = 208 << 10, /* libdeflate 1.14 allocates 203 KB for one of this level */
    OFFSET = 128,                 /* added to differences, so that small ones have similar values */
    STORED_BYTES = 65535,         /* of the largest stored block */
    BLOCK_HEADER_BYTES = 5,       /* of a stored block */
    STREAM_BYTES = 2 + 4,         /* of a zlib stream: its header and its checksum */
    /* Halves that are tested for noise have at least this size. In shorter ones there are too few
     * samples for a histogram, and little time is lost. */
    TESTED_BYTES = 16384,
    COUNTED_STEP = 5, /* each fifth byte is counted; odd, to count all bytes of samples */
    TRIED_PART = 8    /* each eighth part is packed to find repetitions: two rows of 16 */
};

/* Deflate with a window of 32 KiB, packed fast; a multiple of 31. */
static const uint8_t zlib_header[2] = {0x78, 0x01};

/* Makes working memory for chunks of up to chunk_bytes. free_zip() frees it, also after a
 * failure. */
static int create_zip(struct bsq_ctx *ctx, uint64_t chunk_bytes, struct zip *zip)
{
    int status;
    BSQ_TRY(bsq_reserve(ctx, "EXR compression", COMPRESSOR_BYTES));
    zip->reserved_bytes = COMPRESSOR_BYTES;
    BSQ_TRY(bsq_alloc(ctx, "EXR compression", chunk_bytes, 1, &zip->ordered));
    BSQ_TRY(bsq_alloc(ctx, "EXR compression", chunk_bytes, 1, &zip->packed));
    zip->compressor = libdeflate_alloc_compressor(LEVEL);
    if (!zip->compressor)
        status = bsq_fail(ctx, BSQ_ENOMEM, "the system has no memory left for EXR compression");
done:
    return status;
}

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

/* Checks that compression would save less than about 1/16 of the bytes. The probability that two
 * bytes are equal bounds the gain of Huffman codes: the entropy is at least -log2 of it (Renyi
 * 1961). The limit 3/2 * 2^-8 stands for 7.4 of 8 bits. A trial finds repetitions. */
static bool is_noise(struct zip *zip, const uint8_t *bytes, size_t size)
{
    if (size < TESTED_BYTES)
        return false;
    uint64_t counts[256] = {0}, equal = 0;
    for (size_t i = 0; i < size; i += COUNTED_STEP)
        counts[bytes[i]]++;
    for (int i = 0; i < 256; i++)
        equal += counts[i] * counts[i];
    const uint64_t counted = (size + COUNTED_STEP - 1) / COUNTED_STEP;
    if (equal > counted * counted / 512 * 3)
        return false;
    const size_t tried = size / TRIED_PART;
    return libdeflate_deflate_compress(zip->compressor, bytes, tried, zip->packed,
                                       tried - tried / 16) == 0;
}

/* Writes stored blocks, none of which is the stream's last. Returns the end of what it wrote. */
static uint8_t *store(const uint8_t *bytes, size_t size, uint8_t *out)
{
    while (size > 0) {
        const size_t n = size < STORED_BYTES ? size : STORED_BYTES;
        const uint8_t header[BLOCK_HEADER_BYTES] = {0, (uint8_t)n, (uint8_t)(n >> 8), (uint8_t)~n,
                                                    (uint8_t)(~n >> 8)};
        memcpy(out, header, sizeof header);
        memcpy(out + sizeof header, bytes, n);
        out += sizeof header + n;
        bytes += n;
        size -= n;
    }
    return out;
}

/* Packs zip->ordered as pack() does; the first `stored` bytes become stored blocks. */
static size_t pack_after_stored(struct zip *zip, size_t stored, size_t size)
{
    const size_t blocks = (stored + STORED_BYTES - 1) / STORED_BYTES;
    const size_t fixed = stored + blocks * BLOCK_HEADER_BYTES + STREAM_BYTES;
    if (fixed >= size)
        return 0;
    memcpy(zip->packed, zlib_header, sizeof zlib_header);
    uint8_t *out = store(zip->ordered, stored, zip->packed + sizeof zlib_header);
    size_t packed = libdeflate_deflate_compress(zip->compressor, zip->ordered + stored,
                                                size - stored, out, size - 1 - fixed);
    if (packed == 0)
        return 0;
    const uint32_t sum = libdeflate_adler32(1, zip->ordered, size);
    const uint8_t checksum[4] = {(uint8_t)(sum >> 24), (uint8_t)(sum >> 16), (uint8_t)(sum >> 8),
                                 (uint8_t)sum};
    memcpy(out + packed, checksum, sizeof checksum);
    return fixed + packed;
}

/* Packs a chunk of `size` bytes into zip->packed, where it stays until the next call. Returns its
 * packed bytes, or 0 if they would not be fewer than `size`. */
static size_t pack(struct zip *zip, const uint8_t *chunk, size_t size)
{
    if (size == 0)
        return 0;
    order(chunk, size, zip->ordered);
    const size_t half = (size + 1) / 2;
    if (is_noise(zip, zip->ordered, half))
        return pack_after_stored(zip, half, size);
    return libdeflate_zlib_compress(zip->compressor, zip->ordered, size, zip->packed, size - 1);
}

static void free_zip(struct bsq_ctx *ctx, struct zip *zip)
{
    libdeflate_free_compressor(zip->compressor);
    bsq_free(ctx, zip->ordered);
    bsq_free(ctx, zip->packed);
    bsq_release(ctx, zip->reserved_bytes);
}

/* ---- the writer ---- */

enum {
    ZIP_ROWS = 16,       /* of a block */
    ENCODER_BYTES = 4096 /* that OpenEXR allocates for an encoder beside the chunk's samples */
};

struct encoder {
    exr_encode_pipeline_t pipeline;
    bool ready; /* the pipeline was initialised */
    struct zip zip;
    uint64_t reserved_bytes;
    const void *packed; /* compressed block, in the memory of the pipeline or of zip */
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
    uint64_t chunk_bytes;          /* of the samples of a block in the file */
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
static exr_result_t compress(exr_encode_pipeline_t *pipeline)
{
    struct encoder *encoder = pipeline->encoding_user_data;
    encoder->packed_bytes = pack(&encoder->zip, pipeline->packed_buffer, pipeline->packed_bytes);
    encoder->packed = encoder->zip.packed;
    if (encoder->packed_bytes == 0) {
        encoder->packed = pipeline->packed_buffer;
        encoder->packed_bytes = pipeline->packed_bytes;
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

static int create_encoder(struct fmt_image_writer *base, void *memory)
{
    struct encoder *encoder = memory;
    const uint64_t chunk_bytes = ((struct exr_writer *)base)->chunk_bytes;
    int status;
    BSQ_TRY(create_zip(base->ctx, chunk_bytes, &encoder->zip));
    BSQ_TRY(bsq_reserve(base->ctx, "EXR encoders", chunk_bytes + ENCODER_BYTES));
    encoder->reserved_bytes = chunk_bytes + ENCODER_BYTES;
done:
    return status;
}

static void free_encoder(struct fmt_image_writer *base, void *memory)
{
    struct encoder *encoder = memory;
    if (encoder->ready)
        exr_encoding_destroy(((struct exr_writer *)base)->file, &encoder->pipeline);
    free_zip(base->ctx, &encoder->zip);
    bsq_release(base->ctx, encoder->reserved_bytes);
}

/* Returns the number of a block among the rows of tiles, or that of its first line. */
static int row_of(const struct fmt_image_writer *base, const struct fmt_image_block *block)
{
    return (int)(base->tile_side > 0 ? block->first_row / base->tile_side : block->first_row);
}

static exr_result_t prepare(struct exr_writer *writer, struct encoder *encoder,
                            const struct fmt_image_block *block)
{
    exr_encode_pipeline_t *pipeline = &encoder->pipeline;
    const int row = row_of(&writer->base, block);
    exr_chunk_info_t chunk;
    exr_result_t r =
        writer->base.tile_side > 0
            ? exr_write_tile_chunk_info(writer->file, 0, (int)block->column, row, 0, 0, &chunk)
            : exr_write_scanline_chunk_info(writer->file, 0, row, &chunk);
    if (r != EXR_ERR_SUCCESS)
        return r;
    if (encoder->ready)
        r = exr_encoding_update(writer->file, 0, &chunk, pipeline);
    else
        r = exr_encoding_initialize(writer->file, 0, &chunk, pipeline);
    for (int c = 0; r == EXR_ERR_SUCCESS && c < pipeline->channel_count; ++c) {
        exr_coding_channel_info_t *channel = &pipeline->channels[c];
        channel->user_bytes_per_element = sizeof(float);
        channel->user_data_type = EXR_PIXEL_FLOAT;
        channel->user_pixel_stride = (int32_t)(writer->base.channel_count * sizeof(float));
        channel->user_line_stride =
            (int32_t)(writer->base.width * writer->base.channel_count * sizeof(float));
        channel->encode_from_ptr = (const uint8_t *)(block->samples + writer->order[c]);
    }
    if (r == EXR_ERR_SUCCESS && !encoder->ready) {
        encoder->ready = true;
        r = exr_encoding_choose_default_routines(writer->file, 0, pipeline);
        pipeline->encoding_user_data = encoder;
        pipeline->yield_until_ready_fn = NULL;
        pipeline->compress_fn = compress;
        pipeline->write_fn = NULL;
    }
    return r;
}

static int encode_block(struct fmt_image_writer *base, void *memory,
                        const struct fmt_image_block *block)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    struct encoder *encoder = memory;
    exr_result_t r = prepare(writer, encoder, block);
    if (r == EXR_ERR_SUCCESS)
        r = exr_encoding_run(writer->file, 0, &encoder->pipeline);
    return fmt_exr_status(&writer->stream, r);
}

static int emit_block(struct fmt_image_writer *base, void *memory,
                      const struct fmt_image_block *block)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    const struct encoder *encoder = memory;
    const int row = row_of(base, block);
    exr_result_t r = base->tile_side > 0
                         ? exr_write_tile_chunk(writer->file, 0, (int)block->column, row, 0, 0,
                                                encoder->packed, encoder->packed_bytes)
                         : exr_write_scanline_chunk(writer->file, 0, row, encoder->packed,
                                                    encoder->packed_bytes);
    return fmt_exr_status(&writer->stream, r);
}

/* ---- from creating to ending ---- */

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
    const uint32_t side = options->tile_side;
    base->block_rows = side > 0 ? side : ZIP_ROWS;
    writer->chunk_bytes = (uint64_t)base->block_rows * (side > 0 ? side : base->width) *
                          base->channel_count * (options->type == FMT_HALF ? 2 : 4);
    writer->channels = options->channel_count == 1 ? grey_name : color_names;
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = leave_to_caller;
    init.user_data = writer;
    init.write_fn = write_bytes;
    exr_result_t r = exr_start_write(&writer->file, base->path, EXR_WRITE_FILE_DIRECTLY, &init);
    if (r == EXR_ERR_SUCCESS)
        r = make_header(writer, options);
    int status = fmt_exr_status(&writer->stream, r);
    return status < 0 ? status : map_channels(writer);
}

/* Closes the file, which writes its line table. Fails for an unfinished file; the failure that left
 * it unfinished is recorded already. */
static int finish_image(struct fmt_image_writer *base)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    return fmt_exr_status(&writer->stream, exr_finish(&writer->file));
}

static void free_image(struct fmt_image_writer *base)
{
    struct exr_writer *writer = (struct exr_writer *)base;
    if (writer->file)
        exr_finish(&writer->file);
}

const struct fmt_image_format fmt_exr_format = {
    .name = "OpenEXR",
    .suffix = ".exr",
    .sample_types = FMT_SAMPLE_BIT(FMT_HALF) | FMT_SAMPLE_BIT(FMT_FLOAT),
    .usual_type = FMT_HALF,
    .tiles = true,
    .writer_bytes = sizeof(struct exr_writer),
    .encoder_bytes = sizeof(struct encoder),
    .create = create_image,
    .create_encoder = create_encoder,
    .free_encoder = free_encoder,
    .describe = describe_image,
    .start = start_image,
    .encode = encode_block,
    .emit = emit_block,
    .finish = finish_image,
    .free = free_image,
};
