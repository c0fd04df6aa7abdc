/* test_exr.c - compares EXR files with those of OpenEXR's C++ library (through ImfCRgbaFile.h), and
 * tests exact rounding to half and damaged files. */
#include <ImfCRgbaFile.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <zlib.h>

#include "base/job_files.h"
#include "formats/image/exr_read.h"
#include "tests/unit/image_file.h"
#include "tests/unit/test.h"

static const char path[] = "image.exr";

static uint32_t next_random(uint32_t *state)
{
    *state = *state * 1664525u + 1013904223u;
    return *state >> 8;
}

static float *random_samples(size_t count, uint32_t seed)
{
    float *samples = malloc(count * sizeof *samples);
    for (size_t i = 0; i < count; ++i)
        samples[i] =
            ldexpf((float)next_random(&seed) - 0x1p23f, (int)(next_random(&seed) % 30) - 45);
    return samples;
}

/* Rounds to the nearest half, ties to even, by definition: 11 significant bits, exponents from -24.
 */
static float round_to_half(float v)
{
    int exponent;
    frexpf(v, &exponent);
    int unit = exponent - 11 < -24 ? -24 : exponent - 11;
    return ldexpf(nearbyintf(ldexpf(v, -unit)), unit);
}

static const char *const rgb[3] = {"R", "G", "B"};
static const struct fmt_image_attribute attributes[] = {{"bisque:map", "normal"},
                                                        {"bisque:front", "0.125"}};
static const struct fmt_image_attribute decoding = {"bisque:range", "3.5"};

static void write_image(struct bsq_ctx *ctx, uint32_t width, uint32_t height,
                        enum fmt_sample_type type, const float *samples, uint32_t batch,
                        uint32_t exr_tile_side)
{
    struct fmt_image_options options = {.width = width,
                                        .height = height,
                                        .channel_count = 3,
                                        .type = type,
                                        .exr_tile_side = exr_tile_side,
                                        .attributes = attributes,
                                        .attribute_count = 2};
    struct fmt_image_writer *writer;
    assert_int_equal(fmt_image_create(ctx, &fmt_exr_format, path, &options, &writer), 0);
    assert_int_equal(fmt_image_describe(writer, &decoding, 1), 0);
    for (uint32_t y = 0; y < height; y += batch) {
        uint32_t rows = height - y < batch ? height - y : batch;
        assert_int_equal(fmt_image_write_rows(writer, samples + (size_t)y * width * 3, rows), 0);
    }
    assert_int_equal(test_commit_image(writer), 0);
}

/* ---- blocks that hardly compress ---- */

enum { NOISE_WIDTH = 24, NOISE_ROWS = 16, NOISE_SAMPLES = NOISE_WIDTH * NOISE_ROWS };

/* Returns the size of samples after OpenEXR's ZIP compression: bytes are reordered and replaced by
 * differences before zlib compresses them. */
static size_t zip_size(const float *samples)
{
    enum { BYTES = NOISE_SAMPLES * sizeof(float) };
    const uint8_t *bytes = (const uint8_t *)samples;
    uint8_t apart[BYTES], packed[2 * BYTES];
    uLongf size = sizeof packed;
    for (size_t i = 0; i < BYTES; ++i)
        apart[(i & 1 ? BYTES / 2 : 0) + i / 2] = bytes[i];
    for (size_t i = BYTES; --i > 0;)
        apart[i] = (uint8_t)(apart[i] - apart[i - 1] + 128);
    assert_int_equal(compress2(packed, &size, apart, BYTES, 4), Z_OK);
    return size;
}

/* A compressed block of the size of its samples looks like one that is not compressed. */
CONTEXT_TEST(test_blocks_that_zip_to_their_own_size_are_kept, 1, 0)
{
    float samples[NOISE_SAMPLES];
    uint64_t random = 1;
    size_t size = 0;
    for (int trial = 0; trial < 100000 && size != sizeof samples; ++trial) {
        for (uint32_t i = 0; i < NOISE_SAMPLES; ++i) {
            /* A few equal samples gain about as much as the header of the stream takes. */
            const uint32_t noise = (uint32_t)test_random(&random) & 0xbfffffffu;
            const uint32_t bits = i < (uint32_t)trial % 32 ? 0x3f800000u : noise;
            memcpy(&samples[i], &bits, sizeof bits);
        }
        size = zip_size(samples);
    }
    assert_int_equal(size, sizeof samples);
    const struct fmt_image_options options = {
        .width = NOISE_WIDTH, .height = NOISE_ROWS, .channel_count = 1, .type = FMT_FLOAT};
    struct fmt_image_writer *writer;
    struct fmt_exr_image image;
    assert_int_equal(fmt_image_create(ctx, &fmt_exr_format, path, &options, &writer), 0);
    assert_int_equal(fmt_image_write_rows(writer, samples, NOISE_ROWS), 0);
    assert_int_equal(test_commit_image(writer), 0);
    assert_int_equal(fmt_exr_read(ctx, path, &image), 0);
    assert_memory_equal(image.samples, samples, sizeof samples);
    fmt_exr_image_free(ctx, &image);
}

/* Blocks that do not get smaller are not packed. */
CONTEXT_TEST(test_noise_reads_back, 2, 0)
{
    enum { WIDTH = 1000, HEIGHT = 40, COUNT = WIDTH * HEIGHT };
    const struct fmt_image_options options = {
        .width = WIDTH, .height = HEIGHT, .channel_count = 1, .type = FMT_FLOAT};
    static float samples[COUNT];
    struct fmt_image_writer *writer;
    struct fmt_exr_image image;
    uint64_t random = 17;
    size_t size;
    for (size_t i = 0; i < COUNT; i++) {
        const uint32_t bits = (uint32_t)test_random(&random) & 0xbfffffffu;
        memcpy(&samples[i], &bits, sizeof bits);
    }
    assert_int_equal(fmt_image_create(ctx, &fmt_exr_format, path, &options, &writer), 0);
    assert_int_equal(fmt_image_write_rows(writer, samples, HEIGHT), 0);
    assert_int_equal(test_commit_image(writer), 0);
    free(test_read(path, &size));
    assert_in_range(size, COUNT * sizeof *samples, COUNT * sizeof *samples + 1000);
    assert_int_equal(fmt_exr_read(ctx, path, &image), 0);
    assert_memory_equal(image.samples, samples, COUNT * sizeof *samples);
    fmt_exr_image_free(ctx, &image);
}

/* ---- sizes ---- */

static const uint32_t sizes[][4] = {
    /* width, height, rows at a time, side of the tiles */
    {1, 1, 1, 0},     {37, 53, 7, 0},    {130, 33, 33, 0}, {16, 16, 16, 0},
    {5, 100, 17, 0},  {300, 64, 40, 0},  {1, 1, 1, 8},     {37, 53, 7, 8},
    {16, 16, 16, 16}, {130, 33, 33, 64}, {5, 100, 17, 33}, {300, 64, 40, 17}};

CONTEXT_TEST(test_round_trip_is_exact, 4, 0)
{
    for (size_t s = 0; s < sizeof sizes / sizeof *sizes; ++s)
        for (int type = FMT_HALF; type <= FMT_FLOAT; ++type) {
            uint32_t width = sizes[s][0], height = sizes[s][1];
            size_t count = (size_t)width * height * 3;
            float *samples = random_samples(count, 7 + (uint32_t)s);
            write_image(ctx, width, height, (enum fmt_sample_type)type, samples, sizes[s][2],
                        sizes[s][3]);
            struct fmt_exr_image image;
            assert_int_equal(fmt_exr_read(ctx, path, &image), 0);
            assert_int_equal(image.width, width);
            assert_int_equal(image.height, height);
            assert_int_equal(image.channel_count, 3);
            assert_int_equal(fmt_exr_channel(&image, "A"), UINT32_MAX);
            assert_string_equal(fmt_exr_image_attribute(&image, "bisque:front"), "0.125");
            assert_string_equal(fmt_exr_image_attribute(&image, "bisque:range"), "3.5");
            assert_null(fmt_exr_image_attribute(&image, "bisque:back"));
            for (size_t i = 0; i < count; ++i) {
                float expected = type == FMT_HALF ? round_to_half(samples[i]) : samples[i];
                uint32_t channel = fmt_exr_channel(&image, rgb[i % 3]);
                assert_true(image.samples[i / 3 * 3 + channel] == expected);
            }
            fmt_exr_image_free(ctx, &image);
            free(samples);
        }
}

enum { SMALL_WIDTH = 45, SMALL_HEIGHT = 39 };

static void compare_pixels(const ImfRgba *pixels, const float *samples)
{
    for (size_t i = 0; i < SMALL_WIDTH * SMALL_HEIGHT; ++i) {
        assert_true(ImfHalfToFloat(pixels[i].r) == round_to_half(samples[3 * i]));
        assert_true(ImfHalfToFloat(pixels[i].g) == round_to_half(samples[3 * i + 1]));
        assert_true(ImfHalfToFloat(pixels[i].b) == round_to_half(samples[3 * i + 2]));
    }
}

CONTEXT_TEST(test_other_reader_agrees, 3, 0)
{
    float *samples = random_samples((size_t)SMALL_WIDTH * SMALL_HEIGHT * 3, 99);
    write_image(ctx, SMALL_WIDTH, SMALL_HEIGHT, FMT_HALF, samples, 11, 0);
    ImfInputFile *input = ImfOpenInputFile(path);
    assert_non_null(input);
    const ImfHeader *header = ImfInputHeader(input);
    assert_int_equal(ImfHeaderCompression(header), IMF_ZIP_COMPRESSION);
    assert_int_equal(ImfHeaderLineOrder(header), IMF_INCREASING_Y);
    const char *text;
    assert_true(ImfHeaderStringAttribute(header, "bisque:front", &text));
    assert_string_equal(text, "0.125");
    assert_true(ImfHeaderStringAttribute(header, "oiio:ColorSpace", &text));
    assert_string_equal(text, "Raw");
    ImfRgba *pixels = calloc(SMALL_WIDTH * SMALL_HEIGHT, sizeof *pixels);
    assert_true(ImfInputSetFrameBuffer(input, pixels, 1, SMALL_WIDTH));
    assert_true(ImfInputReadPixels(input, 0, SMALL_HEIGHT - 1));
    compare_pixels(pixels, samples);
    ImfCloseInputFile(input);
    free(pixels);
    free(samples);
}

CONTEXT_TEST(test_other_reader_agrees_on_tiles, 3, 0)
{
    float *samples = random_samples((size_t)SMALL_WIDTH * SMALL_HEIGHT * 3, 98);
    write_image(ctx, SMALL_WIDTH, SMALL_HEIGHT, FMT_HALF, samples, 11, 16);
    ImfTiledInputFile *input = ImfOpenTiledInputFile(path);
    assert_non_null(input);
    assert_int_equal(ImfTiledInputTileXSize(input), 16);
    assert_int_equal(ImfTiledInputTileYSize(input), 16);
    assert_int_equal(ImfTiledInputLevelMode(input), IMF_ONE_LEVEL);
    ImfRgba *pixels = calloc(SMALL_WIDTH * SMALL_HEIGHT, sizeof *pixels);
    assert_true(ImfTiledInputSetFrameBuffer(input, pixels, 1, SMALL_WIDTH));
    assert_true(ImfTiledInputReadTiles(input, 0, 2, 0, 2, 0, 0));
    compare_pixels(pixels, samples);
    ImfCloseTiledInputFile(input);
    free(pixels);
    free(samples);
}

static void write_tiled(int width, int height, int compression, const ImfRgba *pixels)
{
    ImfHeader *header = ImfNewHeader();
    ImfHeaderSetDataWindow(header, -3, 5, width - 4, height + 4);
    ImfHeaderSetDisplayWindow(header, -3, 5, width - 4, height + 4);
    ImfHeaderSetCompression(header, compression);
    ImfTiledOutputFile *output = ImfOpenTiledOutputFile(path, header, IMF_WRITE_RGBA, 32, 24,
                                                        IMF_MIPMAP_LEVELS, IMF_ROUND_DOWN);
    assert_non_null(output);
    assert_true(ImfTiledOutputSetFrameBuffer(output, pixels + 3 - 5 * width, 1, (size_t)width));
    for (int y = 0; y * 24 < height; ++y)
        for (int x = 0; x * 32 < width; ++x)
            assert_true(ImfTiledOutputWriteTile(output, x, y, 0, 0));
    ImfCloseTiledOutputFile(output);
    ImfDeleteHeader(header);
}

CONTEXT_TEST(test_reads_tiles_of_other_writers, 2, 0)
{
    enum { WIDTH = 77, HEIGHT = 50 };
    static const int compressions[] = {IMF_NO_COMPRESSION, IMF_RLE_COMPRESSION,
                                       IMF_ZIPS_COMPRESSION, IMF_ZIP_COMPRESSION,
                                       IMF_PIZ_COMPRESSION};
    ImfRgba *pixels = calloc(WIDTH * HEIGHT, sizeof *pixels);
    for (size_t i = 0; i < WIDTH * HEIGHT; ++i) {
        ImfFloatToHalf((float)(i % WIDTH), &pixels[i].r);
        ImfFloatToHalf((float)(i / WIDTH), &pixels[i].g);
        ImfFloatToHalf((float)(i % 7), &pixels[i].b);
        ImfFloatToHalf(0.5f, &pixels[i].a);
    }
    for (size_t c = 0; c < sizeof compressions / sizeof *compressions; ++c) {
        write_tiled(WIDTH, HEIGHT, compressions[c], pixels);
        bsq_forget_files(ctx);
        struct fmt_exr_image image;
        assert_int_equal(fmt_exr_read(ctx, path, &image), 0);
        assert_int_equal(image.width, WIDTH);
        assert_int_equal(image.height, HEIGHT);
        assert_int_equal(image.channel_count, 4);
        assert_string_equal(image.channels[0], "A");
        for (size_t i = 0; i < WIDTH * HEIGHT; ++i) {
            assert_true(image.samples[4 * i] == 0.5f);
            assert_true(image.samples[4 * i + 3] == (float)(i % WIDTH));
            assert_true(image.samples[4 * i + 2] == (float)(i / WIDTH));
            assert_true(image.samples[4 * i + 1] == (float)(i % 7));
        }
        fmt_exr_image_free(ctx, &image);
    }
    free(pixels);
}

static void expect_damage(struct bsq_ctx *ctx, const char *what, size_t where)
{
    struct fmt_exr_image image;
    int status = fmt_exr_read(ctx, path, &image);
    if (status >= 0 || !strstr(bsq_error(ctx), path)) {
        print_message("%s %zu: status %d, \"%s\"\n", what, where, status, bsq_error(ctx));
        fail();
    }
    assert_null(image.samples);
    bsq_clear_error(ctx);
}

CONTEXT_TEST(test_truncated_files_are_refused, 1, 0)
{
    float *samples = random_samples(20 * 40 * 3, 3);
    write_image(ctx, 20, 40, FMT_HALF, samples, 40, 0);
    size_t size;
    free(test_read(path, &size));
    for (size_t length = size; length-- > 0;) {
        assert_int_equal(truncate(path, (off_t)length), 0);
        expect_damage(ctx, "length", length);
    }
    free(samples);
}

/* Any result is allowed, but nothing may leak or be accessed out of bounds, which sanitizers
 * detect. */
CONTEXT_TEST(test_flipped_bytes_do_no_harm, 1, UINT64_C(256) << 20)
{
    uint32_t seed = (uint32_t)getpid();
    print_message("seed %u\n", seed);
    float *samples = random_samples(20 * 40 * 3, 3);
    write_image(ctx, 20, 40, FMT_FLOAT, samples, 40, 0);
    size_t size;
    uint8_t *bytes = test_read(path, &size);
    for (int round = 0; round < 1000; ++round) {
        /* Most rounds hit the header, where the sizes are. */
        size_t range = round % 4 ? 600 : size;
        size_t at = next_random(&seed) % range;
        uint8_t old = bytes[at];
        bytes[at] = (uint8_t)next_random(&seed);
        test_bytes(path, bytes, size);
        bytes[at] = old;
        struct fmt_exr_image image;
        if (fmt_exr_read(ctx, path, &image) == 0)
            fmt_exr_image_free(ctx, &image);
        assert_int_equal(bsq_memory_used(ctx), 0);
        bsq_clear_error(ctx);
    }
    free(bytes);
    free(samples);
}

/* Writes a small image, whose header then claims another size. */
static void write_other_window(struct bsq_ctx *ctx, const int32_t box[4])
{
    float *samples = random_samples(64 * 64 * 3, 3);
    write_image(ctx, 64, 64, FMT_HALF, samples, 64, 0);
    size_t size;
    uint8_t *bytes = test_read(path, &size);
    /* The attribute is "dataWindow\0box2i\0", a length, and four int32. */
    static const char name[] = "dataWindow\0box2i";
    uint8_t *window = memmem(bytes, size, name, sizeof name);
    assert_non_null(window);
    memcpy(window + sizeof name + 4, box, 4 * sizeof *box);
    test_bytes(path, bytes, size);
    free(bytes);
    free(samples);
}

CONTEXT_TEST(test_sizes_are_held_against_the_budget, 1, UINT64_C(8) << 20)
{
    write_other_window(ctx, (const int32_t[4]){0, 0, 63 + (1 << 22), 63});
    struct fmt_exr_image image;
    assert_int_equal(fmt_exr_read(ctx, path, &image), BSQ_ENOMEM);
    assert_non_null(strstr(bsq_error(ctx), "budget"));
    assert_null(image.samples);
    assert_true(bsq_memory_high(ctx) <= bsq_memory_limit(ctx));
}

/* Without the check, OpenEXR allocates a table of 256 MiB for a file of 10 KB. */
CONTEXT_TEST(test_a_table_of_blocks_is_held_against_the_file, 1, UINT64_C(1) << 40)
{
    /* One texel wide, 2^29 lines high, 16 lines a block. */
    write_other_window(ctx, (const int32_t[4]){0, 0, 0, (1 << 29) - 1});
    struct fmt_exr_image image;
    assert_int_equal(fmt_exr_read(ctx, path, &image), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(ctx), "table of blocks"));
    assert_true(bsq_memory_high(ctx) < 1 << 20);
}

/* Writes the header of a file of 1 x 1 texels with very much in it. */
static void write_excess(unsigned channels, unsigned integers, unsigned bytes)
{
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    const uint32_t magic[2] = {20000630, 2};
    const uint32_t channel[4] = {1, 0, 1, 1}, list = 25 * channels + 1, one = 4;
    fwrite(magic, 4, 2, file);
    for (unsigned i = 0; i < integers; i++) {
        fprintf(file, "a%07x%cint%c", i, 0, 0);
        fwrite(&one, 4, 1, file);
        fwrite(&i, 4, 1, file);
    }
    fprintf(file, "big%cstring%c", 0, 0);
    fwrite(&bytes, 4, 1, file);
    for (unsigned i = 0; i < bytes; i++)
        fputc('x', file);
    fprintf(file, "channels%cchlist%c", 0, 0);
    fwrite(&list, 4, 1, file);
    for (unsigned i = 0; i < channels; i++) {
        fprintf(file, "c%07x%c", i, 0);
        fwrite(channel, 4, 4, file);
    }
    fputc(0, file);
    fputc(0, file);
    assert_int_equal(fclose(file), 0);
}

/* OpenEXR takes minutes to sort very many channels, and memory that nobody counted. */
CONTEXT_TEST(test_excessive_headers, 1, UINT64_C(8) << 20)
{
    static const struct {
        unsigned channels, integers, bytes;
        const char *message;
    } cases[] = {{16385, 0, 0, "the header has more than 16384 channels"},
                 {3, 5000, 0, "the header has more than 4096 attributes"},
                 {3, 0, 1 << 20, "the header has more than 1 MiB"},
                 {16384, 4000, 1000, NULL}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct fmt_exr_image image;
        write_excess(cases[i].channels, cases[i].integers, cases[i].bytes);
        int status = fmt_exr_read(ctx, path, &image);
        if (cases[i].message) {
            assert_int_equal(status, BSQ_EDATA);
            assert_non_null(strstr(bsq_error(ctx), cases[i].message));
        } else { /* its header passes, the budget is too small for its image */
            assert_int_equal(status, BSQ_ENOMEM);
        }
        bsq_clear_error(ctx);
        bsq_forget_files(ctx);
    }
}

/* ---- a part of an image, with named channels ---- */

enum { PART_WIDTH = 23, PART_HEIGHT = 21, PART_CHANNELS = 5, PART_SIDE = 16 };
static const char *const names[PART_CHANNELS] = {"share", "normal.x", "normal.y", "z", "a.0"};

static void write_part(struct bsq_ctx *ctx, uint32_t height, const float *samples)
{
    const struct fmt_image_options options = {.width = PART_WIDTH,
                                              .height = height,
                                              .channel_count = PART_CHANNELS,
                                              .channels = names,
                                              .x = 32,
                                              .y = 16,
                                              .full_width = 100,
                                              .full_height = 60,
                                              .type = FMT_FLOAT,
                                              .exr_tile_side = PART_SIDE};
    struct fmt_image_writer *writer;
    assert_int_equal(fmt_image_create(ctx, &fmt_exr_format, path, &options, &writer), 0);
    assert_int_equal(fmt_image_write_rows(writer, samples, height), 0);
    assert_int_equal(test_commit_image(writer), 0);
}

/* Compares a tile with the samples that were written. */
static void expect_tile(struct fmt_exr_rows *rows, uint32_t column, uint32_t row, uint32_t height,
                        const float *samples)
{
    const float *texels;
    assert_int_equal(fmt_exr_tile_read(rows, column, row, &texels), 0);
    for (uint32_t y = 0; y < PART_SIDE && row * PART_SIDE + y < height; y++)
        for (uint32_t x = 0; x < PART_SIDE && column * PART_SIDE + x < PART_WIDTH; x++)
            assert_memory_equal(
                texels + ((size_t)y * PART_SIDE + x) * PART_CHANNELS,
                samples + ((size_t)(row * PART_SIDE + y) * PART_WIDTH + column * PART_SIDE + x) *
                              PART_CHANNELS,
                PART_CHANNELS * sizeof *texels);
}

/* Tiles have the samples in the order of the names, also if the image is smaller than a tile. The
 * whole file has them by name. */
CONTEXT_TEST(test_named_channels_of_a_part, 2, 0)
{
    float *samples = random_samples(PART_WIDTH * PART_HEIGHT * PART_CHANNELS, 7);
    for (uint32_t height = 5; height <= PART_HEIGHT; height += PART_HEIGHT - 5) {
        struct fmt_exr_image image;
        struct fmt_exr_rows *rows;
        struct bsq_file file;
        write_part(ctx, height, samples);
        assert_int_equal(fmt_exr_read(ctx, path, &image), 0);
        assert_int_equal(image.x, 32);
        assert_int_equal(image.y, 16);
        assert_int_equal(image.width, PART_WIDTH);
        assert_int_equal(image.height, height);
        for (uint32_t c = 0; c < PART_CHANNELS; c++) {
            const uint32_t at = fmt_exr_channel(&image, names[c]);
            assert_true(at < PART_CHANNELS);
            for (size_t i = 0; i < (size_t)PART_WIDTH * height; i++)
                assert_true(image.samples[i * PART_CHANNELS + at] ==
                            samples[i * PART_CHANNELS + c]);
        }
        fmt_exr_image_free(ctx, &image);
        assert_int_equal(bsq_file_open_as(ctx, path, BSQ_OPEN_OTHER, &file), 0);
        assert_int_equal(fmt_exr_tiles_open(ctx, path, &file, names, PART_CHANNELS, &rows), 0);
        assert_int_equal(fmt_exr_tile_side(rows), PART_SIDE);
        assert_int_equal(fmt_exr_rows_image(rows)->y, 16);
        for (uint32_t i = 0; i < 2 * ((height - 1) / PART_SIDE + 1); i++)
            expect_tile(rows, i % 2, i / 2, height, samples);
        fmt_exr_rows_close(rows);
        assert_int_equal(fmt_exr_tiles_open(ctx, path, &file, rgb, 3, &rows), BSQ_EDATA);
        fmt_exr_rows_close(rows);
        bsq_file_close(ctx, &file);
    }
    free(samples);
}

RUN_TESTS(NULL, NULL)
