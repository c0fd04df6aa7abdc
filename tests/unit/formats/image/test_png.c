/* test_png.c - reads PNG files with libpng; compares colours with the sRGB formula, and dithered
 * samples with the mean that they must keep. */
#include <png.h>

#include "tests/unit/image_file.h"
#include "tests/unit/test.h"

static const char path[] = "image.png";

static void write_image(struct bsq_ctx *ctx, const struct fmt_image_options *options,
                        const float *samples, uint32_t batch)
{
    struct fmt_image_writer *writer;
    assert_int_equal(fmt_image_create(ctx, &fmt_png_format, path, options, &writer), 0);
    for (uint32_t y = 0; y < options->height; y += batch) {
        uint32_t rows = options->height - y < batch ? options->height - y : batch;
        assert_int_equal(
            fmt_image_write_rows(
                writer, samples + (size_t)y * options->width * options->channel_count, rows),
            0);
    }
    assert_int_equal(test_commit_image(writer), 0);
}

struct image {
    png_structp png;
    png_infop info;
    png_bytepp rows;
};

static struct image read_image(void)
{
    struct image image;
    FILE *file = fopen(path, "rb");
    assert_non_null(file);
    image.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    image.info = png_create_info_struct(image.png);
    png_init_io(image.png, file);
    png_read_png(image.png, image.info, PNG_TRANSFORM_IDENTITY, NULL);
    image.rows = png_get_rows(image.png, image.info);
    fclose(file);
    return image;
}

static void free_image(struct image *image)
{
    png_destroy_read_struct(&image->png, &image->info, NULL);
}

static uint32_t sample16(const struct image *image, uint32_t y, uint32_t sample)
{
    return (uint32_t)image->rows[y][2 * sample] << 8 | image->rows[y][2 * sample + 1];
}

CONTEXT_TEST(test_16_bits_are_rounded, 3, 0)
{
    enum { WIDTH = 401, HEIGHT = 500 }; /* several bands */
    static const uint32_t channel_counts[] = {1, 3, 4};
    for (int c = 0; c < 3; ++c) {
        uint32_t channels = channel_counts[c];
        struct fmt_image_options options = {
            .width = WIDTH, .height = HEIGHT, .channel_count = channels, .type = FMT_UINT16};
        size_t count = (size_t)WIDTH * HEIGHT * channels;
        float *samples = malloc(count * sizeof *samples);
        for (size_t i = 0; i < count; ++i)
            samples[i] =
                (float)((double)(i * 7919 % 4001) / 3600.0 - 0.05); /* clamped at both ends */
        samples[0] = NAN;
        write_image(ctx, &options, samples, 9 + 100 * (uint32_t)c);
        struct image image = read_image();
        assert_int_equal(png_get_image_width(image.png, image.info), WIDTH);
        assert_int_equal(png_get_image_height(image.png, image.info), HEIGHT);
        assert_int_equal(png_get_channels(image.png, image.info), channels);
        assert_int_equal(png_get_bit_depth(image.png, image.info), 16);
        assert_false(png_get_valid(image.png, image.info,
                                   PNG_INFO_gAMA | PNG_INFO_cHRM | PNG_INFO_iCCP | PNG_INFO_sRGB));
        for (size_t i = 1; i < count; ++i) {
            double v = fmin(fmax((double)samples[i], 0.0), 1.0) * 65535.0;
            uint32_t row = (uint32_t)(i / (WIDTH * channels));
            double stored = sample16(&image, row, (uint32_t)(i % (WIDTH * channels)));
            assert_true(fabs(stored - v) <= 0.505);
        }
        assert_int_equal(sample16(&image, 0, 0), 0);
        free_image(&image);
        free(samples);
    }
}

CONTEXT_TEST(test_color_is_encoded_as_srgb_but_alpha_is_not, 1, 0)
{
    enum { WIDTH = 256 };
    struct fmt_image_options options = {
        .width = WIDTH, .height = 1, .channel_count = 4, .type = FMT_UINT16, .color = true};
    float samples[WIDTH * 4];
    for (int i = 0; i < WIDTH * 4; ++i)
        samples[i] = (float)(i / 4) / 255.0f;
    write_image(ctx, &options, samples, 1);
    struct image image = read_image();
    assert_true(png_get_valid(image.png, image.info, PNG_INFO_sRGB));
    for (uint32_t i = 0; i < WIDTH; ++i) {
        double v = i / 255.0;
        double s = v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1 / 2.4) - 0.055;
        for (uint32_t c = 0; c < 3; ++c)
            assert_true(fabs(sample16(&image, 0, 4 * i + c) - s * 65535) < 0.6);
        assert_int_equal(sample16(&image, 0, 4 * i + 3), i * 257);
    }
    free_image(&image);
}

/* Returns the mean of a channel over a block of the image. */
static double block_mean(const struct image *image, uint32_t x0, uint32_t y0, uint32_t size,
                         uint32_t channel)
{
    double sum = 0;
    for (uint32_t y = y0; y < y0 + size; ++y)
        for (uint32_t x = x0; x < x0 + size; ++x)
            sum += image->rows[y][3 * x + channel];
    return sum / size / size;
}

CONTEXT_TEST(test_dither_keeps_the_mean, 2, 0)
{
    enum { SIZE = 128, BLOCK = 16 };
    struct fmt_image_options options = {
        .width = SIZE, .height = SIZE, .channel_count = 3, .type = FMT_UINT8};
    float *samples = malloc(SIZE * SIZE * 3 * sizeof *samples);
    for (int level = 0; level <= 20; ++level) {
        double value = 100.0 + level / 20.0;
        for (size_t i = 0; i < SIZE * SIZE * 3; ++i)
            samples[i] = (float)(value / 255.0);
        write_image(ctx, &options, samples, 50);
        struct image image = read_image();
        for (uint32_t c = 0; c < 3; ++c) {
            assert_true(fabs(block_mean(&image, 0, 0, SIZE, c) - value) < 0.005);
            for (uint32_t y = 0; y < SIZE; y += BLOCK)
                for (uint32_t x = 0; x < SIZE; x += BLOCK)
                    assert_true(fabs(block_mean(&image, x, y, BLOCK, c) - value) < 0.05);
        }
        for (uint32_t y = 0; y < SIZE; ++y)
            for (uint32_t i = 0; i < 3 * SIZE; ++i)
                assert_true(fabs(image.rows[y][i] - value) < 1.0 + 1e-4);
        free_image(&image);
    }
    free(samples);
}

CONTEXT_TEST(test_black_and_white_do_not_dither, 2, 0)
{
    enum { SIZE = 64 };
    struct fmt_image_options options = {
        .width = SIZE, .height = SIZE, .channel_count = 1, .type = FMT_UINT8, .color = true};
    float *samples = malloc(SIZE * SIZE * sizeof *samples);
    for (uint32_t i = 0; i < SIZE * SIZE; ++i)
        samples[i] = i % SIZE < SIZE / 2 ? 0.0f : 1.0f;
    write_image(ctx, &options, samples, SIZE);
    struct image image = read_image();
    for (uint32_t y = 0; y < SIZE; ++y)
        for (uint32_t x = 0; x < SIZE; ++x)
            assert_int_equal(image.rows[y][x], x < SIZE / 2 ? 0 : 255);
    free_image(&image);
    free(samples);
}

CONTEXT_TEST(test_too_few_rows_make_no_file, 1, 0)
{
    const float samples[8] = {0};
    const struct fmt_image_options options = {
        .width = 8, .height = 4, .channel_count = 1, .type = FMT_UINT8};
    struct fmt_image_writer *writer;
    unlink(path);
    assert_int_equal(fmt_image_create(ctx, &fmt_png_format, path, &options, &writer), 0);
    assert_int_equal(fmt_image_write_rows(writer, samples, 1), 0);
    assert_int_equal(test_commit_image(writer), BSQ_EBUG);
    assert_int_equal(access(path, F_OK), -1);
}

RUN_TESTS(NULL, NULL)
