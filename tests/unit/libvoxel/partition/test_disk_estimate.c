/* Tests the check of disk space before sorting, with invented free space. */
#include "libvoxel/partition/partition.h"
#include "base/file.h"
#include "tests/unit/test.h"

#include <sys/statvfs.h>

#define MIB ((uint64_t)1 << 20)

static uint64_t free_bytes;

/* Replaces the C library's function. */
int statvfs(const char *path, struct statvfs *info)
{
    (void)path;
    *info = (struct statvfs){.f_frsize = 1, .f_bsize = 1, .f_bavail = free_bytes};
    return 0;
}

enum { COLORS = 1, NORMALS = 2, QUADS = 4, TILES = 8 };

/* Writes a wavy grid of n x n quads. With tiles, the faces of each row follow its vertices. */
static void write_scan(const char *path, unsigned n, unsigned flags)
{
    FILE *file = fopen(path, "wb");
    for (unsigned y = 0; y <= n; y++) {
        for (unsigned x = 0; x <= n; x++) {
            fprintf(file, "v %.5f %.5f %.5f", x * 0.01, y * 0.01, (x * 7 + y * 5) % 13 * 0.0002);
            fputs(flags & COLORS ? " 0.2 0.4 0.6\n" : "\n", file);
            if (flags & NORMALS)
                fputs("vn 0.1 0.2 0.97\n", file);
        }
        for (unsigned x = 1; flags & TILES && y > 0 && x <= n; x++)
            fprintf(file, "f %u %u %u %u\n", (y - 1) * (n + 1) + x, (y - 1) * (n + 1) + x + 1,
                    y * (n + 1) + x + 1, y * (n + 1) + x);
    }
    for (unsigned y = 0; !(flags & TILES) && y < n; y++)
        for (unsigned x = 1; x <= n; x++) {
            unsigned a = y * (n + 1) + x, b = a + 1, c = a + n + 1, d = c + 1;
            if (flags & NORMALS)
                fprintf(file, "f %u//%u %u//%u %u//%u\nf %u//%u %u//%u %u//%u\n", a, a, b, b, c, c,
                        b, b, d, d, c, c);
            else if (flags & QUADS)
                fprintf(file, "f %u %u %u %u\n", a, b, d, c);
            else
                fprintf(file, "f %u %u %u\nf %u %u %u\n", a, b, c, b, d, c);
        }
    assert_int_equal(fclose(file), 0);
}

struct fixture {
    struct bsq_ctx *ctx;
};

static int set_up(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);
    *state = f;
    return 0;
}

static int tear_down(void **state)
{
    struct fixture *f = *state;
    bsq_ctx_destroy(f->ctx);
    unlink("scan.obj");
    unlink("scan.tris");
    free(f);
    return 0;
}
#define FIXTURE_TEST(name) STATE_TEST(name, struct fixture, set_up, tear_down)

static int sort(struct fixture *f, const struct sort_limits *limits, struct vox_sort_report *report)
{
    const char *paths[1] = {"scan.obj"};
    struct vox_sort_options options = {.size = sizeof(struct vox_sort_options),
                                       .scan_paths = paths,
                                       .scan_count = 1,
                                       .tris_path = "scan.tris"};
    bsq_ctx_destroy(f->ctx);
    f->ctx = test_context(2, 128 * MIB);
    bsq_forget_files(f->ctx);
    return vox_sort_with_limits(f->ctx, &options, limits, report);
}

static struct fmt_mesh_estimate estimate(struct fixture *f)
{
    const char *paths[1] = {"scan.obj"};
    struct fmt_mesh_reader *reader;
    struct fmt_mesh_estimate result;
    bsq_ctx_destroy(f->ctx);
    f->ctx = test_context(0, 0);
    assert_int_equal(fmt_mesh_open(f->ctx, paths, 1, &reader), 0);
    assert_int_equal(fmt_mesh_estimate(reader, &result), 0);
    fmt_mesh_close(reader);
    return result;
}

FIXTURE_TEST(estimates_are_near_the_truth)
{
    static const unsigned kinds[] = {0, COLORS, NORMALS, QUADS, QUADS | COLORS, TILES};
    free_bytes = UINT64_MAX / 4;
    for (size_t k = 0; k < sizeof kinds / sizeof *kinds; k++)
        for (int spilled = 0; spilled < 2; spilled++) {
            const unsigned n = 300;
            struct vox_sort_report report = {.size = sizeof report};
            struct sort_limits limits;
            write_scan("scan.obj", n, kinds[k]);
            vox_sort_limits_for(128 * MIB, 2, &limits);
            if (spilled)
                limits.stream_bytes = limits.page_memory = limits.max_page_memory = 0;
            struct fmt_mesh_estimate scan = estimate(f);
            bsq_ctx_destroy(f->ctx);
            f->ctx = NULL;
            struct disk_space space = vox_disk_estimate(&scan, &limits, true);
            assert_int_equal(scan.faces_come_last, !(kinds[k] & TILES));
            assert_int_equal(scan.has_colors, !!(kinds[k] & COLORS));
            assert_int_equal(sort(f, &limits, &report), 0);
            assert_true(labs((long)scan.vertices - (long)report.vertices) <
                        (long)report.vertices / 10);
            assert_true(labs((long)(scan.corners - 2 * scan.faces) - (long)report.triangles) <
                        (long)report.triangles / 10);
            assert_true(space.output_bytes > report.tris_bytes / 10 * 8);
            assert_true(space.output_bytes < report.tris_bytes / 10 * 12);
            assert_true(space.temp_bytes >= report.temp_bytes / 2);
            assert_true(space.temp_bytes <= report.temp_bytes * 2);
            assert_int_equal(spilled, space.temp_bytes > 0);
        }
}

FIXTURE_TEST(a_full_disk_is_found_before_the_work)
{
    struct vox_sort_report report = {.size = sizeof report};
    struct sort_limits limits;
    char needed[60], available[60];
    vox_sort_limits_for(128 * MIB, 2, &limits);
    write_scan("scan.obj", 300, 0);
    struct fmt_mesh_estimate scan = estimate(f);
    uint64_t bytes = vox_disk_estimate(&scan, &limits, true).output_bytes;
    free_bytes = bytes - 1;
    assert_int_equal(sort(f, &limits, &report), BSQ_EIO);
    snprintf(needed, sizeof needed, ": %llu bytes are needed", (unsigned long long)bytes);
    snprintf(available, sizeof available, ", %llu are free", (unsigned long long)bytes - 1);
    assert_non_null(strstr(bsq_error(f->ctx), needed));
    assert_non_null(strstr(bsq_error(f->ctx), available));
    assert_int_equal(report.vertices, 0); /* the scan was not read */
    assert_int_equal(access("scan.tris", F_OK), -1);
    free_bytes = bytes;
    assert_int_equal(sort(f, &limits, &report), 0);
}

/* If temporary files are on the output's disk, it must have space for both. */
FIXTURE_TEST(outputs_and_temporary_files_share_a_disk)
{
    struct bsq_ctx_options elsewhere = {.tmpdir = "/proc"};
    free_bytes = 100;
    f->ctx = test_context(0, 0);
    assert_int_equal(bsq_require_space(f->ctx, "scan.tris", 60, 40), 0);
    assert_int_equal(bsq_require_space(f->ctx, "scan.tris", 60, 41), BSQ_EIO);
    bsq_ctx_destroy(f->ctx);
    assert_int_equal(bsq_ctx_create(&elsewhere, &f->ctx), 0);
    assert_int_equal(bsq_require_space(f->ctx, "scan.tris", 60, 41), 0);
    assert_int_equal(bsq_require_space(f->ctx, "scan.tris", 60, 101), BSQ_EIO);
    assert_non_null(strstr(bsq_error(f->ctx), "/proc: 101 bytes are needed for temporary files"));
}

RUN_TESTS(NULL, NULL)
