/* test_utf16.c - text in UTF-16 with a byte order mark is read as UTF-8. */
#include "formats/input/input.h"
#include "formats/mesh/mesh_reader.h"
#include "tests/unit/test.h"
#include "tests/unit/formats/input/packing.h"

static struct bsq_ctx *make_context(void)
{
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {.memory_bytes = 64 << 20, .threads = 2, .tmpdir = "."};
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    return ctx;
}

/* Writes units in either order; returns the bytes. */
static size_t put_units(const uint16_t *units, size_t count, bool big_endian, uint8_t *to)
{
    for (size_t i = 0; i < count; i++) {
        to[2 * i + big_endian] = (uint8_t)units[i];
        to[2 * i + !big_endian] = (uint8_t)(units[i] >> 8);
    }
    return 2 * count;
}

/* Writes ASCII text as a file in UTF-16 with its mark. */
static size_t put_ascii(const char *text, bool big_endian, uint8_t *to)
{
    const uint16_t mark = 0xfeff;
    size_t size = put_units(&mark, 1, big_endian, to);
    for (; *text; text++) {
        const uint16_t unit = (uint8_t)*text;
        size += put_units(&unit, 1, big_endian, to + size);
    }
    return size;
}

static void expect_text(const void *bytes, size_t size, const char *expected)
{
    struct bsq_ctx *ctx = make_context();
    const char *path = test_bytes("text", bytes, size);
    struct fmt_input *input;
    char *text, buffer[64] = "";
    uint64_t length, got;
    assert_int_equal(fmt_input_text(ctx, path, 3, &text, &length), 0);
    assert_int_equal(length, strlen(expected));
    assert_memory_equal(text, expected, length);
    assert_memory_equal(text + length, "\0\0\0", 3);
    bsq_free(ctx, text);
    assert_int_equal(fmt_input_create(ctx, path, NULL, false, &input), 0);
    assert_int_equal(fmt_input_open(input), 0);
    assert_int_equal(fmt_input_read_some(input, buffer, sizeof buffer - 1, 0, &got), 0);
    assert_string_equal(buffer, expected);
    assert_int_equal(fmt_input_close(input), 0);
    fmt_input_free(input);
    test_context_end(ctx);
}

/* Unicode Standard 15, table 3-6 and section 3.9: each length of UTF-8; halves of pairs alone. */
TEST(test_characters)
{
    static const struct {
        uint16_t units[8];
        size_t count;
        const char *utf8;
    } cases[] = {
        {{0xfeff}, 1, ""},
        {{0xfeff, 'v', 0x7f, 0x80, 0x7ff, 0x800, 0xffff},
         7,
         "v\x7f\xc2\x80\xdf\xbf\xe0\xa0\x80\xef\xbf\xbf"},
        {{0xfeff, '#', 0xd800, 0xdc00, 0xdbff, 0xdfff}, 6, "#\xf0\x90\x80\x80\xf4\x8f\xbf\xbf"},
        {{0xfeff, '#', 0xd83d, 'x'}, 4, "#\xef\xbf\xbdx"},
        {{0xfeff, '#', 0xde00, 'x'}, 4, "#\xef\xbf\xbdx"},
        {{0xfeff, '#', 0xd83d, 0xd83d, 0xde00}, 5, "#\xef\xbf\xbd\xf0\x9f\x98\x80"},
        {{0xfeff, '#', 0xd83d}, 3, "#\xef\xbf\xbd"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        for (int big = 0; big < 2; big++) {
            uint8_t bytes[16];
            const size_t size = put_units(cases[i].units, cases[i].count, big, bytes);
            expect_text(bytes, size, cases[i].utf8);
        }
}

/* Bytes that are no UTF-16 stay as they are. */
TEST(test_other_bytes)
{
    static const struct {
        const char *bytes;
        size_t size;
    } cases[] = {
        {"v 1", 3},          {"", 0}, {"\xff", 1}, {"\xfe\xfev\1", 4}, {"\xff\xfe\xff\xfe", 4},
        {"\xef\xbb\xbfv", 4}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char expected[8] = "";
        memcpy(expected, cases[i].bytes, cases[i].size);
        expect_text(cases[i].bytes, cases[i].size, expected);
    }
}

enum { PAIRS = 60000 };

/* Pairs at all places of the buffers: with `shift` characters of one unit before them. */
static void expect_pairs(unsigned shift, bool packed)
{
    static const uint16_t pair[2] = {0xd83d, 0xde00};
    static const char utf8[] = "\xf0\x9f\x98\x80";
    uint8_t *bytes = malloc(4 * PAIRS + 64);
    struct packed file = {0};
    struct bsq_ctx *ctx = make_context();
    char *text;
    uint64_t size;
    assert_non_null(bytes);
    size_t used = put_ascii("###" + (3 - shift), false, bytes);
    for (int i = 0; i < PAIRS; i++)
        used += put_units(pair, 2, false, bytes + used);
    (packed ? pack_gzip(&file, bytes, used, 1) : pack_bytes(&file, bytes, used));
    const char *path = test_bytes("pairs", file.data, file.size);
    assert_int_equal(fmt_input_text(ctx, path, 0, &text, &size), 0);
    assert_int_equal(size, shift + 4 * PAIRS);
    for (int i = 0; i < PAIRS; i++)
        assert_memory_equal(text + shift + 4 * i, utf8, 4);
    bsq_free(ctx, text);
    test_context_end(ctx);
    free(bytes);
    free(file.data);
}

TEST(test_pairs_across_buffers)
{
    expect_pairs(1, false);
    expect_pairs(2, false);
    expect_pairs(3, true);
}

/* A file that ends anywhere is read as far as it goes, or it is an error. */
TEST(test_every_truncated_length)
{
    uint8_t bytes[256];
    const size_t whole = put_ascii("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", true, bytes);
    int read = 0, cut = 0;
    for (size_t size = 0; size <= whole; size++) {
        struct bsq_ctx *ctx = make_context();
        const char *path = test_bytes("cut.obj", bytes, size);
        struct fmt_mesh mesh;
        const int status = fmt_mesh_load(ctx, path, false, &mesh);
        assert_true(status == 0 || status == BSQ_EDATA);
        if (size % 2 == 1 && size > 2) {
            assert_non_null(strstr(bsq_error(ctx), "ends in the middle of a character"));
            cut++;
        }
        if (status == 0) {
            assert_int_equal(mesh.triangle_count, 1);
            fmt_mesh_free(ctx, &mesh);
            read++;
        }
        test_context_end(ctx);
    }
    assert_int_equal(read, 2); /* without and with its last line end */
    assert_int_not_equal(cut, 0);
}

RUN_TESTS(NULL, NULL)
