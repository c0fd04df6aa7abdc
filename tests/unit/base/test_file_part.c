/* test_file_part.c - parts of files that have names of their own. */
#include <sys/stat.h>

#include "base/file_part.h"
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
    struct bsq_part part;
    assert_int_equal(bsq_part_parse("x/a#1.glb#bytes=10+20", &part), 9);
    assert_true(part.offset == 10 && part.size == 20 && part.first == 0 && !part.base64);
    assert_int_equal(bsq_part_parse("a#base64=10,3+20", &part), 1);
    assert_true(part.offset == 10 && part.size == 20 && part.first == 3 && part.base64);
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        assert_int_equal(bsq_part_parse(others[i], &part), 0);
}

/* Every range of base64 text of each length, against the bytes that it was made from. */
TEST(test_base64)
{
    static const char *const texts[] = {"",         "/w==",     "/wE=",    "/wEC",
                                        "/wECAw==", "/wECAwQ=", "/wECAwQF"};
    static const unsigned char bytes[] = {255, 1, 2, 3, 4, 5};
    struct bsq_ctx *ctx = test_context(0, 0);
    for (uint64_t size = 0; size <= 6; size++) {
        struct bsq_file file;
        assert_int_equal(bsq_file_temp(ctx, NULL, "base64", &file), 0);
        assert_int_equal(bsq_file_append(ctx, &file, "xx", 2), 0);
        assert_int_equal(bsq_file_append(ctx, &file, texts[size], strlen(texts[size])), 0);
        assert_int_equal(bsq_file_append(ctx, &file, "\"AAAA", 5), 0);
        for (uint64_t first = 0; first <= size; first++)
            for (uint64_t count = 0; first + count <= 7; count++) {
                const struct bsq_part part = {
                    .offset = 2, .first = first, .size = count, .base64 = true};
                unsigned char read[8] = {0};
                bsq_clear_error(ctx);
                const int status = bsq_part_read(ctx, &file, &part, read, count, 0);
                assert_int_equal(status, first + count <= size ? 0 : BSQ_EDATA);
                if (status == 0)
                    assert_memory_equal(read, bytes + first, count);
            }
        bsq_file_close(ctx, &file);
    }
    bsq_ctx_destroy(ctx);
}

/* Copies the part of this name. */
static int copy_part(struct bsq_ctx *ctx, const char *name, struct bsq_file *copy)
{
    struct bsq_file file;
    struct bsq_part part;
    assert_int_equal(bsq_part_open(ctx, name, &part, &file), 0);
    const int status = bsq_part_extract(ctx, &file, &part, copy);
    bsq_file_close(ctx, &file);
    return status;
}

/* A copy of a part; a file with the whole name is no part. */
TEST(test_copies)
{
    char part_path[] = "a#bytes=2+4";
    struct bsq_ctx *ctx;
    struct bsq_file copy;
    struct bsq_part part;
    char read[5] = "";
    test_text("a", "0123456789");
    ctx = test_context(0, 0);
    assert_int_equal(copy_part(ctx, part_path, &copy), 0);
    assert_int_equal(copy.size, 4);
    assert_int_equal(bsq_file_read(ctx, &copy, read, 4, 0), 0);
    assert_string_equal(read, "2345");
    bsq_file_close(ctx, &copy);
    part_path[strlen(part_path) - 1] = '9'; /* beyond the file's end */
    assert_int_equal(copy_part(ctx, part_path, &copy), BSQ_EDATA);
    test_text(part_path, "");
    assert_int_equal(bsq_part_parse(part_path, &part), 0);
    assert_int_equal(bsq_part_open(ctx, part_path, &part, &copy), 0);
    assert_int_equal(copy.size, 0);
    assert_int_equal(part.size, 0);
    bsq_file_close(ctx, &copy);
    bsq_ctx_destroy(ctx);
}

RUN_TESTS(NULL, NULL)
