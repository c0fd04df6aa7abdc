/* test_path_map.c - rules that replace the beginnings of paths. */
#include "tests/unit/test.h"

#include "base/path_map.h"

static void expect(struct bsq_ctx *ctx, const char *name, const char *path)
{
    assert_string_equal(bsq_map_path(ctx, name), path);
}

CONTEXT_TEST(test_the_longest_source_is_replaced_once, 1, 0)
{
    expect(ctx, "/mnt/a", "/mnt/a");
    assert_int_equal(bsq_add_path_rule(ctx, BSQ_PATH_POSIX, "/mnt", "/data"), 0);
    assert_int_equal(bsq_add_path_rule(ctx, BSQ_PATH_POSIX, "/mnt/scans/", "/mnt/x/"), 0);
    assert_int_equal(bsq_add_path_rule(ctx, BSQ_PATH_POSIX, "/mnt/scans", "/second"), 0);
    expect(ctx, "/mnt", "/data");
    expect(ctx, "/mnt/a", "/data/a");
    expect(ctx, "/mnt/scans", "/mnt/x/");
    expect(ctx, "/mnt/scans//a/b", "/mnt/x/a/b");
    expect(ctx, "/mnt/scanset", "/data/scanset");
    expect(ctx, "/mntx/a", "/mntx/a");
    expect(ctx, "/MNT/a", "/MNT/a");
    expect(ctx, "mnt/a", "mnt/a");
    assert_int_equal(bsq_add_path_rule(ctx, BSQ_PATH_POSIX, "", "/data"), BSQ_EDATA);
    bsq_clear_error(ctx);
}

CONTEXT_TEST(test_formats, 1, 0)
{
    assert_int_equal(bsq_add_path_rule(ctx, BSQ_PATH_WINDOWS, "Z:\\Studio", "/studio"), 0);
    assert_int_equal(bsq_add_path_rule(ctx, BSQ_PATH_URI, "s3://bucket/a", "/s3"), 0);
    assert_int_equal(bsq_add_path_rule(ctx, BSQ_PATH_POSIX, "/", "/root"), 0);
    expect(ctx, "z:/studio\\Maps/Skin.PNG", "/studio/Maps/Skin.PNG");
    expect(ctx, "Z:\\Studios\\a", "Z:\\Studios\\a");
    expect(ctx, "s3://bucket/a/b\\c", "/s3/b\\c");
    expect(ctx, "/etc/a", "/root/etc/a");
    expect(ctx, "etc/a", "etc/a");
}

RUN_TESTS(NULL, NULL)
