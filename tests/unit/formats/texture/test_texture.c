/* test_texture.c - compares texture lookups with averages computed by hand or by definition. */
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <png.h>
#include <sys/stat.h>
#include <sys/syscall.h>

#include <stdio.h>
#include <jpeglib.h>

#include "base/file.h"
#include "base/context.h"
#include "base/parallel.h"
#include "formats/texture/texture.h"
#include "tests/unit/test.h"

/* ---- a replacement of a function of the C library ---- */

static int reads_left = -1; /* reads until on_read() is called; below 0: never */
static ssize_t (*on_read)(void);

ssize_t pread64(int fd, void *to, size_t size, off_t offset)
{
    if (reads_left >= 0 && reads_left-- == 0) {
        const ssize_t result = on_read();
        if (result < 0)
            return result;
    }
    return syscall(SYS_pread64, fd, to, size, offset);
}

static ssize_t fail_read(void)
{
    errno = EIO;
    return -1;
}

/* A test image: `channels` bytes a texel, row 0 at the top. */
struct picture {
    int width, height, channels;
    uint8_t *texels;
};

static uint64_t random_state = 77;

static double random_unit(void)
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return (double)(random_state * UINT64_C(0x2545f4914f6cdd1d) >> 11) * 0x1p-53;
}

/* Makes a periodic image: for each channel a wave over the whole image, with noise. So wide
 * averages differ between positions, and neighbouring texels differ. */
static struct picture make_picture(int width, int height, int channels)
{
    const double turn = 6.283185307179586;
    struct picture p = {width, height, channels, malloc((size_t)width * (size_t)height * 4)};
    size_t i = 0;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++)
            for (int c = 0; c < channels; c++)
                p.texels[i++] = (uint8_t)(128 +
                                          70 * sin(turn * (x + 0.5) / width + c) *
                                              cos(turn * (y + 0.5) / height - c) +
                                          57 * (2 * random_unit() - 1));
    return p;
}

static const char *write_png(const char *name, const struct picture *p)
{
    const char *path = name;
    png_image image = {.version = PNG_IMAGE_VERSION,
                       .width = (png_uint_32)p->width,
                       .height = (png_uint_32)p->height,
                       .format = p->channels == 1   ? PNG_FORMAT_GRAY
                                 : p->channels == 3 ? PNG_FORMAT_RGB
                                                    : PNG_FORMAT_RGBA};
    assert_true(png_image_write_to_file(&image, path, 0, p->texels, 0, NULL));
    return path;
}

static const char *write_jpeg(const char *name, const struct picture *p, bool progressive)
{
    const char *path = name;
    struct jpeg_compress_struct jpeg;
    struct jpeg_error_mgr errors;
    FILE *file = fopen(path, "wb");
    jpeg.err = jpeg_std_error(&errors);
    jpeg_create_compress(&jpeg);
    jpeg_stdio_dest(&jpeg, file);
    jpeg.image_width = (JDIMENSION)p->width;
    jpeg.image_height = (JDIMENSION)p->height;
    jpeg.input_components = p->channels;
    jpeg.in_color_space = p->channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
    jpeg_set_defaults(&jpeg);
    if (progressive)
        jpeg_simple_progression(&jpeg);
    jpeg_start_compress(&jpeg, TRUE);
    for (int y = 0; y < p->height; y++) {
        JSAMPROW row = p->texels + (size_t)(y * p->width * p->channels);
        jpeg_write_scanlines(&jpeg, &row, 1);
    }
    jpeg_finish_compress(&jpeg);
    jpeg_destroy_compress(&jpeg);
    assert_int_equal(fclose(file), 0);
    return path;
}

/* Decodes sRGB by IEC 61966-2-1. */
static double linear(uint8_t value)
{
    double s = value / 255.0;
    return s <= 0.04045 ? s / 12.92 : pow((s + 0.055) / 1.055, 2.4);
}

static double texel(const struct picture *p, int64_t x, int64_t y, int channel)
{
    x = (x % p->width + p->width) % p->width;
    y = (y % p->height + p->height) % p->height;
    return linear(p->texels[(y * p->width + x) * p->channels + (p->channels < 3 ? 0 : channel)]);
}

/* Returns how much of a texel's cell lies in an interval. Cells begin at the image's edge, and its
 * last cell may be smaller. The image repeats. */
static double share(int64_t texel_index, int64_t size, int64_t cell, double start, double extent)
{
    int64_t inside = (texel_index % size + size) % size, first = texel_index - inside % cell;
    int64_t end = texel_index - inside + size;
    double last = (double)(first + cell < end ? first + cell : end);
    double common = fmin(last, start + extent) - fmax((double)first, start);
    return fmax(common, 0) / (last - (double)first);
}

/* Computes the average over a box by definition: each texel weighs as much as its cell shares with
 * the box. Cells of one texel give the exact average. Boxes have at least one texel. */
static void reference(const struct picture *p, double u, double v, double width, double height,
                      int64_t cell, double out[3])
{
    double x0 = u * p->width - width / 2, y0 = (1 - v) * p->height - height / 2;
    memset(out, 0, 3 * sizeof *out);
    for (int64_t y = (int64_t)floor(y0) - cell; (double)y < y0 + height + (double)cell; y++) {
        double high = share(y, p->height, cell, y0, height);
        for (int64_t x = (int64_t)floor(x0) - cell;
             high > 0 && (double)x < x0 + width + (double)cell; x++) {
            double area = high * share(x, p->width, cell, x0, width);
            for (int c = 0; c < 3 && area > 0; c++)
                out[c] += area * texel(p, x, y, c) / (width * height);
        }
    }
}

struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_textures *textures;
    uint8_t wrap[2];
};

static int open_textures(struct fixture *f, const char *const *paths, uint32_t count,
                         uint64_t cache)
{
    f->wrap[0] = f->wrap[1] = FMT_WRAP_REPEAT;
    struct bsq_ctx_options options = {.threads = 3, .memory_bytes = 256 << 20, .tmpdir = "."};
    struct fmt_texture_source *sources = calloc(count, sizeof *sources);
    assert_non_null(sources);
    for (uint32_t i = 0; i < count; i++)
        sources[i].path = paths[i];
    assert_int_equal(bsq_ctx_create(&options, &f->ctx), 0);
    int status =
        fmt_textures_open(f->ctx, count, fmt_texture_source_at, sources, cache, &f->textures);
    free(sources);
    return status;
}

static void open_one(struct fixture *f, const char *path)
{
    int status = open_textures(f, &path, 1, 32 << 20);
    if (status)
        print_message("%s\n", bsq_error(f->ctx));
    assert_int_equal(status, 0);
}

static void close_fixture(struct fixture *f)
{
    fmt_textures_close(f->textures);
    test_context_end(f->ctx);
}

static void assert_sample(struct fixture *f, double u, double v, double du, double dv, double r,
                          double g, double b, double tolerance)
{
    const double expected[3] = {r, g, b};
    float out[3];
    int status =
        fmt_texture_sample(f->textures, 0, f->wrap, (float)u, (float)v, (float)du, (float)dv, out);
    assert_int_equal(status, 0);
    for (int c = 0; c < 3; c++)
        if (!(fabs((double)out[c] - expected[c]) <= tolerance))
            fail_msg("(%g, %g) box %g x %g channel %d: %.9g, expected %.9g", u, v, du, dv, c,
                     (double)out[c], expected[c]);
}

TEST(test_orientation)
{
    /* Red at the top, green at the bottom; blue grows to the right. */
    static uint8_t texels[2][2][3] = {{{255, 0, 0}, {255, 0, 255}}, {{0, 255, 0}, {0, 255, 255}}};
    struct picture p = {2, 2, 3, &texels[0][0][0]};
    struct fixture f;
    open_one(&f, write_png("small.png", &p));
    assert_sample(&f, 0.25, 0.75, 0, 0, 1, 0, 0, 1e-6);
    assert_sample(&f, 0.75, 0.75, 0, 0, 1, 0, 1, 1e-6);
    assert_sample(&f, 0.25, 0.25, 0, 0, 0, 1, 0, 1e-6);
    /* Bilinear: a quarter of the way from one texel's centre to the next. */
    assert_sample(&f, 0.375, 0.25, 0, 0, 0, 1, 0.25, 1e-6);
    /* Wrapping: both columns meet at u = 0, both rows at v = 1; whole periods change nothing. */
    assert_sample(&f, 0, 0.75, 0, 0, 1, 0, 0.5, 1e-6);
    assert_sample(&f, 0.75, 1, 0, 0, 0.5, 0.5, 1, 1e-6);
    assert_sample(&f, 0.75, 0, 0, 0, 0.5, 0.5, 1, 1e-6);
    assert_sample(&f, -2.75, 5.75, 0, 0, 1, 0, 0, 1e-6);
    assert_sample(&f, 0.3, 0.9, 7, 9, 0.5, 0.5, 0.5, 1e-6);
    close_fixture(&f);
}

TEST(test_wrap_modes)
{
    /* Four columns of grey: 0, 85, 170, 255, as linear light by the formula of sRGB. */
    static uint8_t texels[4] = {0, 85, 170, 255};
    static const double light[4] = {0, 0.090841711, 0.401977780, 1};
    struct picture p = {4, 1, 1, texels};
    struct fixture f;
    open_one(&f, write_png("row.png", &p));
    for (int texel = -9; texel <= 9; texel++) {
        const double u = (texel + 0.5) / 4;
        const int period = ((texel % 8) + 8) % 8;
        const double expected[FMT_WRAPS] = {light[period % 4],
                                            light[texel < 0   ? 0
                                                  : texel > 3 ? 3
                                                              : texel],
                                            light[period < 4 ? period : 7 - period]};
        for (uint8_t mode = 0; mode < FMT_WRAPS; mode++) {
            const double e = expected[mode];
            f.wrap[0] = mode;
            assert_sample(&f, u, 0.5, 0, 0, e, e, e, 1e-6);
        }
    }
    /* At a border, half of a bilinear lookup is of the texel beyond it. */
    for (uint8_t mode = 0; mode < FMT_WRAPS; mode++) {
        const double e = mode == FMT_WRAP_REPEAT ? 0.5 : 1;
        f.wrap[0] = mode;
        assert_sample(&f, 1, 0.5, 0, 0, e, e, e, 1e-6);
    }
    close_fixture(&f);
}

TEST(test_checker_averages_in_linear_light)
{
    struct picture p = make_picture(256, 128, 1);
    for (int i = 0; i < 256 * 128; i++)
        p.texels[i] = (i + i / 256) % 2 ? 255 : 0;
    struct fixture f;
    open_one(&f, write_png("checker.png", &p));
    for (int size = 2; size <= 64; size *= 2)
        assert_sample(&f, 0.5, 0.5, size / 256.0, size / 128.0, 0.5, 0.5, 0.5, 1e-6);
    assert_sample(&f, 0.1, 0.2, 1, 1, 0.5, 0.5, 0.5, 1e-6);
    /* Half the light is about grey 188 in sRGB, whose exact light is 0.503. */
    memset(p.texels, 188, 256 * 128);
    close_fixture(&f);
    open_one(&f, write_png("grey.png", &p));
    assert_sample(&f, 0.3, 0.3, 0.1, 0.1, 0.502886, 0.502886, 0.502886, 1e-6);
    close_fixture(&f);
    free(p.texels);
}

static bool is_near(const float a[3], const double b[3], double tolerance)
{
    for (int c = 0; c < 3; c++)
        if (!(fabs((double)a[c] - b[c]) <= tolerance))
            return false;
    return true;
}

/* Samples random boxes. Boxes of 16 texels and more may be read from averages of square cells, of
 * which at least four lie along the box. A cell at the box's border then counts with its average,
 * by the share of its area. The averages are floats, made in at most 6 steps, and so are texels and
 * results: 8 roundings of at most 2^-25 each. */
static void compare_random_boxes(struct fixture *f, const struct picture *p, int count)
{
    const double tolerance = 8 * 0x1p-25;
    for (int i = 0; i < count; i++) {
        float u = (float)(3 * random_unit() - 1), v = (float)(3 * random_unit() - 1);
        double texels = exp2(8 * random_unit() - 1);
        float du = (float)(texels / p->width);
        float dv = (float)(texels * (0.5 + random_unit()) / p->height);
        double width = fmin(fmax((double)du * p->width, 1), p->width);
        double height = fmin(fmax((double)dv * p->height, 1), p->height);
        double expected[3], least = fmin(width, height);
        float out[3];
        assert_int_equal(fmt_texture_sample(f->textures, 0, f->wrap, u, v, du, dv, out), 0);
        reference(p, (double)u, (double)v, width, height, 1, expected);
        if (least >= 16 && !is_near(out, expected, tolerance))
            reference(p, (double)u, (double)v, width, height,
                      INT64_C(1) << (int)floor(log2(least / 4)), expected);
        if (!is_near(out, expected, tolerance))
            fail_msg("(%g, %g) box %g x %g: %.9g %.9g %.9g, expected %.9g %.9g %.9g", (double)u,
                     (double)v, width, height, (double)out[0], (double)out[1], (double)out[2],
                     expected[0], expected[1], expected[2]);
    }
}

TEST(test_random_boxes)
{
    static const int shapes[][3] = {{200, 100, 3}, {65, 131, 4}, {127, 1, 1}, {1, 77, 3}};
    random_state = test_seed() * 2 + 1; /* not 0 */
    for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++) {
        struct picture p = make_picture(shapes[i][0], shapes[i][1], shapes[i][2]);
        struct fixture f;
        open_one(&f, write_png("random.png", &p));
        compare_random_boxes(&f, &p, 400);
        close_fixture(&f);
        free(p.texels);
    }
}

/* Images larger than the cache are copied to a file; lookups must give the same. */
TEST(test_image_larger_than_cache)
{
    struct picture p = make_picture(3001, 2003, 3);
    struct fixture f;
    const char *path = write_png("large.png", &p);
    print_message("seed %" PRIu64 "\n", random_state);
    assert_int_equal(open_textures(&f, &path, 1, 12 << 20), 0);
    compare_random_boxes(&f, &p, 400);
    assert_true(bsq_memory_high(f.ctx) < 16 << 20);
    close_fixture(&f);
    free(p.texels);
}

/* A PFM file stores linear floats, lowest row first. */
TEST(test_float_image_is_linear)
{
    static const float rows[2][3] = {{0.25f, 4, -1}, {0.5f, 0, 0}};
    const char *path = "linear.pfm";
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    fprintf(file, "PF\n1 2\n-1.0\n");
    fwrite(rows, sizeof rows, 1, file);
    fclose(file);
    struct fixture f;
    open_one(&f, path);
    assert_sample(&f, 0.5, 0.25, 0, 0, 0.25, 4, -1, 1e-6);
    assert_sample(&f, 0.5, 0.75, 0, 0, 0.5, 0, 0, 1e-6);
    assert_sample(&f, 0.5, 0.5, 0, 0, 0.375, 2, -0.5, 1e-6);
    close_fixture(&f);
}

/* Two of 128 x 128 texels are not finite. They count as 0 in single texels and in all averages. */
TEST(test_texels_that_are_not_finite)
{
    enum { SIDE = 128 };
    const char *path = "broken.pfm";
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    fprintf(file, "PF\n%d %d\n-1.0\n", SIDE, SIDE);
    for (int i = 0; i < SIDE * SIDE; i++) {
        const float texel[3] = {i == 0 ? NAN : 1, i == 0 ? INFINITY : 2, i == 1 ? -INFINITY : 4};
        fwrite(texel, sizeof texel, 1, file);
    }
    fclose(file);
    struct fixture f;
    open_one(&f, path);
    const double texel = 1.0 / SIDE, all = SIDE * SIDE;
    assert_sample(&f, 0.5 * texel, 0.5 * texel, 0, 0, 0, 0, 4, 1e-6);
    assert_sample(&f, texel, 0.5 * texel, 0, 0, 0.5, 1, 2, 1e-6);
    assert_sample(&f, 0.5, 0.5, 1, 1, 1 - 1 / all, 2 - 2 / all, 4 - 4 / all, 1e-6);
    bsq_set_strict(f.ctx, true);
    assert_int_equal(fmt_textures_tell_losses(f.textures), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f.ctx), "broken.pfm: texels that are not finite: 2; they "));
    assert_int_equal(fmt_textures_tell_losses(f.textures), 0); /* told once */
    close_fixture(&f);
}

/* ---- files that are not what they should be ---- */

/* Opens one file and expects a failure, whose message has this text. */
static void expect_refusal(const char *path, int expected, const char *text)
{
    struct fixture f;
    int status = open_textures(&f, &path, 1, 12 << 20);
    if (status != expected || !strstr(bsq_error(f.ctx), text))
        fail_msg("%s: status %d, \"%s\"", path, status, bsq_error(f.ctx));
    assert_null(strchr(bsq_error(f.ctx), '\n'));
    close_fixture(&f);
}

/* OpenImageIO's plug-ins would open these, some of them as streams from a network. */
TEST(test_other_formats_are_refused)
{
    static const char *const texts[][2] = {
        {"list.png", "#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n"},
        {"concat.jpg", "ffconcat version 1.0\nfile 'http://127.0.0.1:9/a.png'\n"},
        {"description.sdp", "v=0\no=- 0 0 IN IP4 127.0.0.1\nm=video 9 RTP/AVP 96\n"},
        {"movie.avi", "RIFF    AVI LIST"},
        {"picture.gif", "GIF89a\1\1"},
        {"drawing.svg", "<svg xmlns=\"http://www.w3.org/2000/svg\"/>"},
        {"name.null", "null"},
        {"empty.png", ""},
    };
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++)
        expect_refusal(test_text(texts[i][0], texts[i][1]), BSQ_EDATA,
                       "not a readable image: it is no PNG, JPEG, TIFF");
    expect_refusal("http://127.0.0.1:9/a.png", BSQ_ENOINPUT, "No such file or directory");
}

/* OpenImageIO takes minutes for a header of very many attributes. */
TEST(test_excessive_exr_header)
{
    enum { ATTRIBUTES = 4097, EACH = 18 };
    static char bytes[8 + ATTRIBUTES * EACH] = "\x76\x2f\x31\x01\x02";
    for (unsigned i = 0; i < ATTRIBUTES; i++) {
        char *to = bytes + 8 + (size_t)i * EACH;
        snprintf(to, EACH, "a%04x", i);
        memcpy(to + 6, "int\0\4", 6);
    }
    expect_refusal(test_bytes("many.exr", bytes, sizeof bytes), BSQ_EDATA,
                   "the header has more than 4096 attributes");
}

/* Headers of images of 30000 x 30000 texels, which decoders would hold whole. */
TEST(test_whole_images_beyond_the_budget)
{
    static const char png[] =
        "\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x75\x30\0\0\x75\x30\x08\x02\0\0\x01\x9e\x42\x5f\x7b"
        "\0\0\0\x0aIDAT";
    static const char progressive[] =
        "\xff\xd8\xff\xc2\0\x11\x08\x75\x30\x75\x30\x03\x01\x22\0\x02\x11\x01\x03\x11\x01\xff\xda\0\x0c"
        "\x03\x01\0\x02\0\x03\0\0\0\0";
    static const char separate[] = /* a baseline file with a scan for each component */
        "\xff\xd8\xff\xc0\0\x11\x08\x75\x30\x75\x30\x03\x01\x22\0\x02\x11\x01\x03\x11\x01\xff\xda\0\x08"
        "\x01\x01\0\0\x3f\0";
    static const struct {
        const char *name, *bytes;
        size_t size;
    } cases[] = {
        {"i.png", png, sizeof png},
        {"p.jpg", progressive, sizeof progressive},
        {"s.jpg", separate, sizeof separate},
    };
    /* The list of textures has some bytes of the budget of 256 MiB. */
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        expect_refusal(test_bytes(cases[i].name, cases[i].bytes, cases[i].size), BSQ_ENOMEM,
                       "its 30000 x 30000 texels need 2575 MiB of memory, 255 MiB are left");
}

/* Writes rows of `bits` for each sample with libpng, which wants them in big-endian order. */
static const char *write_png_rows(const char *name, const struct picture *p, int bits,
                                  bool linear_light, int interlace)
{
    const char *path = name;
    FILE *file = fopen(path, "wb");
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    png_infop info = png_create_info_struct(png);
    png_init_io(png, file);
    png_set_IHDR(png, info, (png_uint_32)p->width, (png_uint_32)p->height, bits,
                 p->channels == 1   ? PNG_COLOR_TYPE_GRAY
                 : p->channels == 3 ? PNG_COLOR_TYPE_RGB
                                    : PNG_COLOR_TYPE_RGBA,
                 interlace, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    if (linear_light)
        png_set_gAMA(png, info, 1.0);
    png_write_info(png, info);
    for (int pass = png_set_interlace_handling(png); pass > 0; pass--)
        for (int y = 0; y < p->height; y++)
            png_write_row(png, p->texels + y * p->width * p->channels * bits / 8);
    png_write_end(png, info);
    png_destroy_write_struct(&png, &info);
    assert_int_equal(fclose(file), 0);
    return path;
}

TEST(test_interlaced)
{
    struct picture p = make_picture(61, 43, 3);
    struct fixture f;
    open_one(&f, write_png_rows("interlaced.png", &p, 8, false, PNG_INTERLACE_ADAM7));
    compare_random_boxes(&f, &p, 200);
    close_fixture(&f);
    free(p.texels);
}

TEST(test_sixteen_bits_of_linear_light)
{
    static uint8_t texels[] = {0x40, 0x00, 0xc0, 0x01}; /* 16384 and 49153 of 65535 */
    struct picture p = {2, 1, 1, texels};
    struct fixture f;
    open_one(&f, write_png_rows("linear.png", &p, 16, true, PNG_INTERLACE_NONE));
    assert_sample(&f, 0.25, 0.5, 0, 0, 16384 / 65535.0, 16384 / 65535.0, 16384 / 65535.0, 1e-6);
    assert_sample(&f, 0.75, 0.5, 0, 0, 49153 / 65535.0, 49153 / 65535.0, 49153 / 65535.0, 1e-6);
    close_fixture(&f);
}

/* Damaged headers, whose numbers are no size, are no question of memory. */
TEST(test_damaged_headers)
{
    static const char png[] =
        "\x89PNG\r\n\x1a\n\0\0\0\rIDAT\x75\x30\x75\x30\x75\x30\x75\x30\x08\x02\0\0\x01";
    static const char wide[] =
        "\x89PNG\r\n\x1a\n\0\0\0\rIHDR\xff\x30\x75\x30\0\0\x75\x30\x08\x02\0\0\x01";
    static const char jp2[] =
        "\0\0\0\x0cjP  \r\n\x87\n\0\0\0\0jp2c\x01\x01\x01\x01\x01\x01\x01\x01\x01"
        "\x01\x01\x01\x01\x01\x01\x01\0\0\0\0\0\0\0\0\x75\x30\0\0\x75\x30\0\0\0\0\0\0"
        "\0\0\0\x03";
    static const struct {
        const char *name, *bytes;
        size_t size;
    } cases[] = {
        {"d.png", png, sizeof png}, {"w.png", wide, sizeof wide}, {"d.jp2", jp2, sizeof jp2}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        expect_refusal(test_bytes(cases[i].name, cases[i].bytes, cases[i].size), BSQ_EDATA,
                       "not a readable image: ");
}

/* Bytes of a PNG file that are damaged, one at a time: libraries print nothing. */
TEST(test_damage_prints_nothing)
{
    struct picture p = make_picture(20, 30, 3);
    const char *path = write_png("damaged.png", &p), *log = "stderr";
    size_t size;
    uint8_t *bytes = test_read(path, &size);
    fflush(stderr);
    int before = dup(STDERR_FILENO), here = open(log, O_RDWR | O_CREAT | O_TRUNC, 0600);
    dup2(here, STDERR_FILENO);
    int refused = 0;
    for (size_t at = 8; at < size; at += 7) {
        bytes[at] ^= 0x5a;
        struct fixture f;
        path = test_bytes("damaged.png", bytes, at % 2 ? size : at);
        refused += open_textures(&f, &path, 1, 12 << 20) != 0;
        close_fixture(&f);
        bytes[at] ^= 0x5a;
    }
    fflush(stderr);
    dup2(before, STDERR_FILENO);
    assert_int_equal(lseek(here, 0, SEEK_END), 0);
    close(here);
    close(before);
    assert_true(refused > 20);
    free(bytes);
    free(p.texels);
}

/* ---- reads that fail, files that change ---- */

/* An image that does not fit in memory is read from a temporary file. A failed read is told to who
 * asked, and to nobody else. */
TEST(test_failed_lookup)
{
    struct picture p = make_picture(2000, 1000, 3);
    struct fixture f;
    const char *path = write_png("large.png", &p);
    float color[3];
    assert_int_equal(open_textures(&f, &path, 1, 1), 0);
    assert_true(bsq_temp_bytes(f.ctx) > 6000000);
    on_read = fail_read;
    reads_left = 0;
    assert_int_equal(fmt_texture_sample(f.textures, 0, f.wrap, 0.5f, 0.5f, 0, 0, color), BSQ_EIO);
    assert_non_null(strstr(bsq_error(f.ctx), "Input/output error"));
    bsq_clear_error(f.ctx);
    compare_random_boxes(&f, &p, 40);
    assert_true(bsq_memory_high(f.ctx) < 3 << 20);
    close_fixture(&f);
    free(p.texels);
}

/* Each read of each kind of file fails once. */
TEST(test_failed_reads)
{
    struct picture p = make_picture(60, 40, 3);
    const char *paths[] = {write_png("fails.png", &p), write_jpeg("fails.jpg", &p, false),
                           write_jpeg("progressive.jpg", &p, true)};
    on_read = fail_read;
    for (size_t i = 0; i < sizeof paths / sizeof *paths; i++)
        for (int read = 0, status = BSQ_EIO; status < 0; read++) {
            struct fixture f;
            reads_left = read;
            status = open_textures(&f, &paths[i], 1, 1);
            assert_true(read > 1 || status < 0);
            if (status < 0) {
                assert_int_equal(status, BSQ_EIO);
                assert_non_null(strstr(bsq_error(f.ctx), "Input/output error"));
            }
            close_fixture(&f);
        }
    reads_left = -1;
    free(p.texels);
}

static const char *changing_path;

static ssize_t append_byte(void)
{
    FILE *file = fopen(changing_path, "ab");
    putc(0, file);
    assert_int_equal(fclose(file), 0);
    return 0;
}

TEST(test_file_that_changes)
{
    struct picture p = make_picture(200, 200, 3);
    changing_path = write_png("changes.png", &p);
    on_read = append_byte;
    reads_left = 2;
    expect_refusal(changing_path, BSQ_EIO, "changes.png: was changed while it was read");
    assert_int_equal(reads_left, -1);
    free(p.texels);
}

/* Opens an image as a source of alpha. */
static void open_alpha(struct fixture *f, const char *path)
{
    const struct bsq_ctx_options options = {.threads = 2, .memory_bytes = 256 << 20, .tmpdir = "."};
    const struct fmt_texture_source source = {.path = path, .alpha = true};
    assert_int_equal(bsq_ctx_create(&options, &f->ctx), 0);
    assert_int_equal(
        fmt_textures_open(f->ctx, 1, fmt_texture_source_at, &source, 32 << 20, &f->textures), 0);
}

/* Alpha is data; an image without it gives its first channel. */
TEST(test_alpha)
{
    static uint8_t rgba[2][4] = {{255, 0, 0, 51}, {0, 255, 0, 204}}, rgb[2][3] = {{51}, {204}};
    static uint8_t grey[2] = {51, 204};
    const struct {
        const char *name;
        struct picture picture;
    } cases[] = {{"rgba.png", {2, 1, 4, &rgba[0][0]}},
                 {"rgb.png", {2, 1, 3, &rgb[0][0]}},
                 {"grey.png", {2, 1, 1, grey}}};
    for (int i = 0; i < 3; i++) {
        struct fixture f;
        open_alpha(&f, write_png(cases[i].name, &cases[i].picture));
        assert_int_equal(fmt_texture_has_alpha(f.textures, 0), i == 0);
        assert_sample(&f, 0.25, 0.5, 0, 0, 0.2, 0.2, 0.2, 1e-6);
        assert_sample(&f, 0.75, 0.5, 0, 0, 0.8, 0.8, 0.8, 1e-6);
        assert_sample(&f, 0.5, 0.5, 1, 1, 0.5, 0.5, 0.5, 1e-6);
        close_fixture(&f);
    }
    struct fixture f; /* colours are not multiplied by alpha */
    open_one(&f, "rgba.png");
    assert_true(fmt_texture_has_alpha(f.textures, 0));
    assert_sample(&f, 0.25, 0.5, 0, 0, 1, 0, 0, 1e-6);
    close_fixture(&f);
}

/* The same of an image that is decoded whole. */
TEST(test_alpha_of_an_interlaced_image)
{
    uint8_t texels[3 * 2 * 4];
    for (int i = 0; i < 3 * 2; i++)
        memcpy(texels + 4 * i, (const uint8_t[]){9, 99, 199, (uint8_t)(51 * (i % 3))}, 4);
    const struct picture p = {3, 2, 4, texels};
    struct fixture f;
    open_alpha(&f, write_png_rows("alpha_copy.png", &p, 8, false, PNG_INTERLACE_ADAM7));
    for (int x = 0; x < 3; x++)
        assert_sample(&f, (x + 0.5) / 3, 0.25, 0, 0, 0.2 * x, 0.2 * x, 0.2 * x, 1e-6);
    close_fixture(&f);
}

RUN_TESTS(NULL, NULL)
