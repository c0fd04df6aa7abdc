/* test_nvdb_writer.c - regions in parts, wrong regions, too many regions, and outputs that cannot
 * be written. */
#include <sys/syscall.h>

#include "formats/grid/nvdb_writer_internal.h"
#include "tests/unit/test.h"
#include "tests/unit/formats/grid/nvdb_files.h"
#include "tests/grid_lookup.h"

/* ---- wrong use of the writer ---- */

static const uint16_t two_ids[2] = {7, 9};
static const uint64_t two_masks[2][8] = {{1, 0, 0, 0, 0, 0, 0, 0}, {0, 0, 0, 0, 2, 0, 0, 0}};
static const struct fmt_nvdb_record two_records[2] = {{1, 2, 3, 0}, {4, 5, 6, 0}};

static struct fmt_nvdb_region small_region(int32_t x, int32_t y, int32_t z)
{
    return (struct fmt_nvdb_region){.origin = {x, y, z},
                                    .leaf_count = 2,
                                    .leaf_ids = two_ids,
                                    .masks = two_masks,
                                    .record_count = 2,
                                    .records = two_records};
}

static struct fmt_nvdb_writer *new_writer(struct bsq_ctx *ctx)
{
    struct fmt_nvdb_info info = {.voxel_size = 1};
    struct fmt_nvdb_writer *writer;
    assert_ok(ctx, fmt_nvdb_create(ctx, nvdb_path, &info, &writer));
    return writer;
}

/* Appends `first`, which is valid, and `second`, which must be refused with the text `expected`. */
static void assert_refused(const struct fmt_nvdb_region *first,
                           const struct fmt_nvdb_region *second, const char *expected)
{
    unlink(nvdb_path);
    struct bsq_ctx *ctx = test_context(1, 0);
    struct fmt_nvdb_writer *writer = new_writer(ctx);
    if (first)
        assert_ok(ctx, fmt_nvdb_append(writer, first));
    assert_int_equal(fmt_nvdb_append(writer, second), BSQ_EBUG);
    assert_non_null(strstr(bsq_error(ctx), expected));
    struct fmt_nvdb_totals totals;
    assert_int_equal(grid_commit(writer, &totals), BSQ_EBUG);
    assert_int_equal(access(nvdb_path, F_OK), -1);
    test_context_end(ctx);
}

/* A region appended in one call and in two calls gives the same file. */
TEST(test_region_in_parts)
{
    uint64_t masks[3][8] = {{1, 0, 0, 0, 0, 0, 0, 5}, {0, 2}, {UINT64_MAX, 3}};
    uint16_t ids[3] = {7, 8, 4095};
    struct fmt_nvdb_record records[70], second = {5, 6, 0, 0};
    for (uint32_t i = 0; i < 70; i++)
        records[i] = (struct fmt_nvdb_record){i, 2 * i, 0, 0};
    records[3].plane |= FMT_NVDB_PLANE_SECOND;
    struct fmt_nvdb_region whole = {.origin = {128, 0, 0},
                                    .leaf_count = 3,
                                    .leaf_ids = ids,
                                    .masks = (const uint64_t(*)[8])masks,
                                    .record_count = 70,
                                    .second_count = 1,
                                    .records = records,
                                    .second = &second};
    struct fmt_nvdb_region first = whole, rest = whole, after = small_region(128, 0, 128);
    first.leaf_count = 1;
    first.record_count = 3;
    first.second_count = 0;
    rest.leaf_count = 2;
    rest.leaf_ids++;
    rest.masks++;
    rest.record_count -= 3;
    rest.records += 3;
    struct fmt_nvdb_totals totals;
    struct bsq_map map[2];
    struct bsq_ctx *ctx = test_context(1, 0);
    char copy[sizeof nvdb_path + 8];
    snprintf(copy, sizeof copy, "%s.whole", nvdb_path);
    for (int parts = 0; parts < 2; parts++) {
        struct fmt_nvdb_writer *writer = new_writer(ctx);
        assert_ok(ctx, fmt_nvdb_append(writer, parts ? &first : &whole));
        if (parts)
            assert_ok(ctx, fmt_nvdb_append(writer, &rest));
        assert_ok(ctx, fmt_nvdb_append(writer, &after));
        assert_ok(ctx, grid_commit(writer, &totals));
        assert_int_equal(totals.lowers, 2);
        assert_int_equal(totals.leaves, 3 + after.leaf_count);
        if (!parts)
            assert_int_equal(rename(nvdb_path, copy), 0);
    }
    assert_ok(ctx, bsq_map_open(ctx, copy, &map[0]));
    assert_ok(ctx, bsq_map_open(ctx, nvdb_path, &map[1]));
    assert_int_equal(map[0].size, map[1].size);
    assert_memory_equal(map[0].data, map[1].data, map[0].size);
    bsq_map_close(ctx, &map[0]);
    bsq_map_close(ctx, &map[1]);
    unlink(copy);
    unlink(nvdb_path);
    bsq_ctx_destroy(ctx);
    assert_refused(&rest, &first, "out of order");
}

TEST(test_order_of_regions)
{
    /* Regions ascend by x; negative root tiles come after positive ones. */
    static const int32_t ordered[][2][3] = {
        {{0, 0, 0}, {0, 0, 128}},       {{0, 0, 128}, {0, 128, 0}},
        {{0, 128, 0}, {128, 0, 0}},     {{3968, 0, 0}, {0, 0, 4096}},
        {{0, 0, 4096}, {0, 0, -128}},   {{0, 0, -128}, {-128, 0, 0}},
        {{-4096, 0, 0}, {-128, 0, 0}},  {{-8192, 0, 0}, {-4096, 0, 0}},
        {{128, 0, 0}, {4096, -128, 0}},
    };
    for (size_t i = 0; i < sizeof(ordered) / sizeof(*ordered); i++) {
        const int32_t *a = ordered[i][0], *b = ordered[i][1];
        struct fmt_nvdb_region left = small_region(a[0], a[1], a[2]);
        struct fmt_nvdb_region right = small_region(b[0], b[1], b[2]);
        assert_refused(&right, &left, "out of order");
        assert_refused(&left, &left, "out of order");
        struct bsq_ctx *ctx = test_context(1, 0);
        struct fmt_nvdb_writer *writer = new_writer(ctx);
        assert_ok(ctx, fmt_nvdb_append(writer, &left));
        assert_ok(ctx, fmt_nvdb_append(writer, &right));
        fmt_nvdb_discard(writer);
        bsq_ctx_destroy(ctx);
    }
}

TEST(test_wrong_regions)
{
    static const uint16_t descending[2] = {9, 7}, large[2] = {7, 4096};
    static const uint64_t empty[2][8] = {{1, 0, 0, 0, 0, 0, 0, 0}, {0}};
    static const struct fmt_nvdb_record flagged[2] = {{1, FMT_NVDB_PLANE_SECOND, 3, 0},
                                                      {4, 5, 6, 0}};
    struct fmt_nvdb_region region = small_region(0, 0, 64);
    assert_refused(NULL, &region, "multiple of 128");
    region = small_region(0, 0, 0);
    region.leaf_ids = descending;
    assert_refused(NULL, &region, "ascending");
    region.leaf_ids = large;
    assert_refused(NULL, &region, "ascending");
    region = small_region(0, 0, 0);
    region.masks = empty;
    assert_refused(NULL, &region, "without voxels");
    region = small_region(0, 0, 0);
    region.record_count = 1;
    assert_refused(NULL, &region, "records");
    region = small_region(0, 0, 0);
    region.records = flagged;
    assert_refused(NULL, &region, "second");
}

CONTEXT_TEST(test_nothing_to_write, 1, 0)
{
    unlink(nvdb_path);
    struct fmt_nvdb_writer *writer = new_writer(ctx);
    struct fmt_nvdb_region nothing = {.origin = {0, 0, 0}};
    assert_ok(ctx, fmt_nvdb_append(writer, &nothing));
    struct fmt_nvdb_totals totals;
    assert_int_equal(grid_commit(writer, &totals), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(ctx), "no voxels"));
    assert_int_equal(access(nvdb_path, F_OK), -1);
}

/* ---- temporary files that change ---- */

static int reads_until_damage = -1; /* negative: none */

/* Replaces the C library's function. Damages one byte of the chosen read. */
ssize_t pread(int fd, void *to, size_t size, off_t offset)
{
    ssize_t got = syscall(SYS_pread64, fd, to, size, offset);
    if (got > 0 && reads_until_damage-- == 0)
        ((uint8_t *)to)[got / 2] ^= 1;
    return got;
}

/* Whatever gets into a temporary file does not get into the grid unnoticed. */
TEST(test_damaged_temporary_files)
{
    struct fmt_nvdb_record flagged[2] = {{1, FMT_NVDB_PLANE_SECOND, 3, 0}, {4, 5, 6, 0}};
    struct fmt_nvdb_region region = small_region(0, 0, 0);
    region.records = region.second = flagged;
    region.second_count = 1;
    unlink(nvdb_path);
    int damaged = 0;
    for (int status = BSQ_EIO; status != 0; damaged++) {
        struct bsq_ctx *ctx = test_context(1, 0);
        struct fmt_nvdb_writer *writer = new_writer(ctx);
        struct fmt_nvdb_totals totals;
        assert_ok(ctx, fmt_nvdb_append(writer, &region));
        reads_until_damage = damaged;
        status = grid_commit(writer, &totals);
        assert_int_equal(status == 0, reads_until_damage >= 0);
        if (status != 0) {
            assert_int_equal(status, BSQ_EIO);
            assert_non_null(strstr(bsq_error(ctx), ": holds other bytes than were written"));
            assert_int_equal(access(nvdb_path, F_OK), -1);
        }
        reads_until_damage = -1;
        bsq_ctx_destroy(ctx);
    }
    assert_true(damaged > 7); /* uppers, lowers, leaves, two channels twice, second words */
    unlink(nvdb_path);
}

TEST(test_limits)
{
    static const struct fmt_nvdb_record flagged[2] = {{1, FMT_NVDB_PLANE_SECOND, 3, 0},
                                                      {4, 5, 6, 0}};
    for (int i = 0; i < 3; i++) {
        struct bsq_ctx *ctx = test_context(1, 0);
        struct fmt_nvdb_writer *writer = new_writer(ctx);
        struct fmt_nvdb_region region = small_region(0, 0, 0);
        region.records = region.second = flagged;
        region.second_count = 1;
        if (i == 0)
            writer->counts.leaves = UINT32_MAX - 1;
        else if (i == 1)
            writer->counts.lowers = UINT32_MAX;
        else
            writer->counts.seconds = UINT32_MAX;
        assert_int_equal(fmt_nvdb_append(writer, &region), BSQ_EUSAGE);
        assert_non_null(strstr(bsq_error(ctx), "4294967295"));
        fmt_nvdb_discard(writer);
        bsq_ctx_destroy(ctx);
    }
    struct bsq_ctx *ctx = test_context(1, 0);
    const struct fmt_nvdb_info no_size = {.voxel_size = 0};
    struct fmt_nvdb_writer *writer;
    assert_int_equal(fmt_nvdb_create(ctx, nvdb_path, &no_size, &writer), BSQ_EUSAGE);
    test_context_end(ctx);
}

RUN_TESTS(NULL, NULL)
