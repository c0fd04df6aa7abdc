/* test_jpeg.c - JPEG textures that are damaged are refused, although libjpeg would make up for what
 * is missing. */
#include <stdio.h>
#include <jpeglib.h>

#include "formats/texture/texture.h"
#include "tests/unit/test.h"

enum { SIDE = 600 };

/* A JPEG file in memory. */
struct jpeg {
    unsigned char *bytes;
    unsigned long size;
};

static struct jpeg make_jpeg(bool progressive, int restart_rows)
{
    struct jpeg out = {0};
    struct jpeg_compress_struct jpeg;
    struct jpeg_error_mgr errors;
    JSAMPLE row[3 * SIDE], *rows = row;
    uint32_t noise = 1;
    jpeg.err = jpeg_std_error(&errors);
    jpeg_create_compress(&jpeg);
    jpeg_mem_dest(&jpeg, &out.bytes, &out.size);
    jpeg.image_width = jpeg.image_height = SIDE;
    jpeg.input_components = 3;
    jpeg.in_color_space = JCS_RGB;
    jpeg_set_defaults(&jpeg);
    if (progressive)
        jpeg_simple_progression(&jpeg);
    jpeg.restart_in_rows = restart_rows;
    jpeg_start_compress(&jpeg, TRUE);
    for (int y = 0; y < SIDE; y++) {
        for (int i = 0; i < 3 * SIDE; i++)
            row[i] = (JSAMPLE)((noise = noise * 1664525 + 1013904223) >> 26);
        jpeg_write_scanlines(&jpeg, &rows, 1);
    }
    jpeg_finish_compress(&jpeg);
    jpeg_destroy_compress(&jpeg);
    assert_true(out.size > 40000);
    return out;
}

/* Opens bytes as a texture: it is fine if `reason` is NULL, else damaged for this reason. */
static void expect(const void *bytes, size_t size, const char *reason)
{
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {.threads = 2, .tmpdir = "."};
    struct fmt_textures *textures = NULL;
    const struct fmt_texture_source source = {.path = test_bytes("a.jpg", bytes, size)};
    char expected[300];
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    const int status =
        fmt_textures_open(ctx, 1, fmt_texture_source_at, &source, 12 << 20, &textures);
    assert_int_equal(status, reason ? BSQ_EDATA : 0);
    if (reason) {
        snprintf(expected, sizeof expected, "%s: damaged image: %s", source.path, reason);
        assert_string_equal(bsq_error(ctx), expected);
    }
    fmt_textures_close(textures);
    test_context_end(ctx);
}

TEST(test_a_file_that_is_cut_off)
{
    static const struct {
        bool progressive;
        int restart_rows;
        const char *reason;
    } cases[] = {
        {false, 0, "Corrupt JPEG data: premature end of data segment"},
        {false, 2, "Corrupt JPEG data: premature end of data segment"},
        {true, 0, "Premature end of JPEG file"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct jpeg jpeg = make_jpeg(cases[i].progressive, cases[i].restart_rows);
        expect(jpeg.bytes, jpeg.size, NULL);
        expect(jpeg.bytes, jpeg.size / 4, cases[i].reason);
        expect(jpeg.bytes, jpeg.size - 20, cases[i].reason);
        free(jpeg.bytes);
    }
}

TEST(test_zeros_in_the_middle)
{
    for (int progressive = 0; progressive < 2; progressive++) {
        struct jpeg jpeg = make_jpeg(progressive, 0);
        char message[256];
        memset(jpeg.bytes + jpeg.size / 2, 0, 200);
        struct bsq_ctx *ctx;
        struct bsq_ctx_options options = {.threads = 1, .tmpdir = "."};
        struct fmt_textures *textures;
        const struct fmt_texture_source source = {.path =
                                                      test_bytes("a.jpg", jpeg.bytes, jpeg.size)};
        assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
        assert_int_equal(
            fmt_textures_open(ctx, 1, fmt_texture_source_at, &source, 12 << 20, &textures),
            BSQ_EDATA);
        snprintf(message, sizeof message, "%s: damaged image: Corrupt JPEG data: ", source.path);
        assert_memory_equal(bsq_error(ctx), message, strlen(message));
        bsq_ctx_destroy(ctx);
        free(jpeg.bytes);
    }
}

/* All rows are there, so nothing is lost. */
TEST(test_a_careless_end)
{
    struct jpeg jpeg = make_jpeg(false, 0);
    unsigned char *copy = calloc(jpeg.size + 100, 1);
    assert_non_null(copy);
    expect(jpeg.bytes, jpeg.size - 2, NULL); /* no mark of the end */
    memcpy(copy, jpeg.bytes, jpeg.size);
    expect(copy, jpeg.size + 100, NULL); /* bytes after it */
    memset(copy + jpeg.size - 2, 0, 64); /* bytes before it */
    memcpy(copy + jpeg.size + 62, "\xff\xd9", 2);
    expect(copy, jpeg.size + 64, NULL);
    free(copy);
    free(jpeg.bytes);
}

/* The image is a part of another file, as in glTF. */
TEST(test_a_part_of_a_file)
{
    struct jpeg jpeg = make_jpeg(false, 0);
    unsigned char *file = malloc(jpeg.size + 1000);
    assert_non_null(file);
    memset(file, 'x', 1000);
    memcpy(file + 1000, jpeg.bytes, jpeg.size);
    const char *path = test_bytes("a.glb", file, jpeg.size + 1000);
    for (int whole = 0; whole < 2; whole++) {
        char part[200];
        struct bsq_ctx *ctx;
        struct bsq_ctx_options options = {.threads = 1, .tmpdir = "."};
        struct fmt_textures *textures = NULL;
        const struct fmt_texture_source source = {.path = part};
        snprintf(part, sizeof part, "%s#bytes=1000+%lu", path, whole ? jpeg.size : jpeg.size / 4);
        assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
        assert_int_equal(
            fmt_textures_open(ctx, 1, fmt_texture_source_at, &source, 12 << 20, &textures),
            whole ? 0 : BSQ_EDATA);
        fmt_textures_close(textures);
        bsq_ctx_destroy(ctx);
    }
    free(file);
    free(jpeg.bytes);
}

RUN_TESTS(NULL, NULL)
