/* test_file_extent.c - extents of files that have names of their own. */
#include <sys/stat.h>

#include "formats/material/file_extent.h"
#include "tests/unit/test.h"

TEST(test_names)
{
    static const char *const others[] = {"",
                                         "a.png",
                                         "#bytes=1+2",
                                         "a#b",
                                         "a#bytes=",
                                         "a#bytes=1",
                                         "a#bytes=1+",
                                         "a#bytes=1+2 ",
                                         "a#bytes=1,2+3",
                                         "a#bytes=-1+2",
                                         "a#base64=1+2",
                                         "a#bytes=18446744073709551616+1",
                                         "a#bytes=1+9223372036854775807"};
    struct fmt_extent extent;
    assert_int_equal(fmt_extent_parse("x/a#1.glb#bytes=10+20", &extent), 9);
    assert_true(extent.offset == 10 && extent.size == 20 && extent.first == 0 && !extent.base64);
    assert_int_equal(fmt_extent_parse("a#base64=10,3+20", &extent), 1);
    assert_true(extent.offset == 10 && extent.size == 20 && extent.first == 3 && extent.base64);
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        assert_int_equal(fmt_extent_parse(others[i], &extent), 0);
}

/* Every range of base64 text of each length, against the bytes that it was made from. */
CONTEXT_TEST(test_base64, 0, 0)
{
    static const char *const texts[] = {"",         "/w==",     "/wE=",    "/wEC",
                                        "/wECAw==", "/wECAwQ=", "/wECAwQF"};
    static const unsigned char bytes[] = {255, 1, 2, 3, 4, 5};
    for (uint64_t size = 0; size <= 6; size++) {
        struct bsq_file file;
        assert_int_equal(bsq_file_temp(ctx, NULL, "base64", &file), 0);
        assert_int_equal(bsq_file_append(ctx, &file, "xx", 2), 0);
        assert_int_equal(bsq_file_append(ctx, &file, texts[size], strlen(texts[size])), 0);
        assert_int_equal(bsq_file_append(ctx, &file, "\"AAAA", 5), 0);
        for (uint64_t first = 0; first <= size; first++)
            for (uint64_t count = 0; first + count <= 7; count++) {
                const struct fmt_extent extent = {
                    .offset = 2, .first = first, .size = count, .base64 = true};
                unsigned char read[8] = {0};
                bsq_clear_error(ctx);
                const int status = fmt_extent_read(ctx, &file, &extent, read, count, 0);
                assert_int_equal(status, first + count <= size ? 0 : BSQ_EDATA);
                if (status == 0)
                    assert_memory_equal(read, bytes + first, count);
            }
        bsq_file_close(ctx, &file);
    }
}

/* Copies the extent of this name. */
static int copy_part(struct bsq_ctx *ctx, const char *name, struct bsq_file *copy)
{
    struct bsq_file file;
    struct fmt_extent extent;
    assert_int_equal(fmt_extent_open(ctx, name, &extent, &file), 0);
    const int status = fmt_extent_extract(ctx, &file, &extent, copy);
    bsq_file_close(ctx, &file);
    return status;
}

/* A copy of an extent; a file with the whole name is no extent. */
TEST(test_copies)
{
    char extent_path[] = "a#bytes=2+4";
    struct bsq_ctx *ctx;
    struct bsq_file copy;
    struct fmt_extent extent;
    char read[5] = "";
    test_text("a", "0123456789");
    ctx = test_context(0, 0);
    assert_int_equal(copy_part(ctx, extent_path, &copy), 0);
    assert_int_equal(copy.size, 4);
    assert_int_equal(bsq_file_read(ctx, &copy, read, 4, 0), 0);
    assert_string_equal(read, "2345");
    bsq_file_close(ctx, &copy);
    extent_path[strlen(extent_path) - 1] = '9'; /* beyond the file's end */
    assert_int_equal(copy_part(ctx, extent_path, &copy), BSQ_EDATA);
    test_text(extent_path, "");
    assert_int_equal(fmt_extent_parse(extent_path, &extent), 0);
    assert_int_equal(fmt_extent_open(ctx, extent_path, &extent, &copy), 0);
    assert_int_equal(copy.size, 0);
    assert_int_equal(extent.size, 0);
    bsq_file_close(ctx, &copy);
    bsq_ctx_destroy(ctx);
}

RUN_TESTS(NULL, NULL)
