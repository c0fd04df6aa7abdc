/* Compares estimates of a grid's size with grids that are made. Tests warnings and refusals. */
#include "libvoxel/voxelize/voxelize_run.h"
#include "libvoxel/voxel.h"
#include "tests/unit/libvoxel/scan_fixture.h"
#include "base/file.h"
#include "tests/unit/test.h"

#include <sys/statvfs.h>

static uint64_t free_bytes;

/* Simulates a disk of any size; the linker finds this function before the system's. */
int statvfs(const char *path, struct statvfs *info)
{
    (void)path;
    *info = (struct statvfs){.f_frsize = 1, .f_bsize = 1, .f_bavail = free_bytes};
    return 0;
}

struct fixture {
    struct bsq_ctx *ctx;
    unsigned warnings;
    char warning[512];
};

static void keep_warning(void *user, const char *line)
{
    struct fixture *f = user;
    f->warnings++;
    snprintf(f->warning, sizeof f->warning, "%s", line);
}

static int set_up(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);
    struct bsq_ctx_options options = {
        .memory_bytes = 256 << 20, .threads = 2, .on_warning = keep_warning, .user = f};
    assert_non_null(f);
    assert_int_equal(bsq_ctx_create(&options, &f->ctx), 0);
    free_bytes = UINT64_C(1) << 60;
    *state = f;
    return 0;
}

static int tear_down(void **state)
{
    struct fixture *f = *state;
    test_context_end(f->ctx);
    unlink("scan.tris");
    unlink("scan.nvdb");
    free(f);
    return 0;
}
#define FIXTURE_TEST(name) STATE_TEST(name, struct fixture, set_up, tear_down)

static double estimate(const struct fixture *f, double voxel_size, uint64_t chunks_max)
{
    struct fmt_tris_file *file;
    struct vox_transform transform;
    double voxels;
    assert_int_equal(fmt_tris_open(f->ctx, "scan.tris", &file), 0);
    assert_int_equal(vox_transform_init(f->ctx, fmt_tris_get_header(file), "scan.tris", 0,
                                        voxel_size, &transform),
                     0);
    assert_int_equal(vox_estimate_voxels(f->ctx, file, &transform, chunks_max, &voxels), 0);
    fmt_tris_close(file);
    return voxels;
}

static int check(struct fixture *f, double voxel_size)
{
    struct fmt_tris_file *file;
    struct vox_transform transform;
    f->warnings = 0;
    bsq_clear_error(f->ctx);
    assert_int_equal(fmt_tris_open(f->ctx, "scan.tris", &file), 0);
    assert_int_equal(vox_transform_init(f->ctx, fmt_tris_get_header(file), "scan.tris", 0,
                                        voxel_size, &transform),
                     0);
    int status = vox_estimate_check(f->ctx, file, &transform, false, "scan.nvdb");
    fmt_tris_close(file);
    return status;
}

FIXTURE_TEST(test_estimates_are_those_of_grids)
{
    struct scan_mesh mesh = scan_sphere(10.0, 2.0);
    scan_sort(&mesh);
    scan_write(f->ctx, "scan.tris", &mesh, NULL, NULL, 0, mesh.triangle_count / 40);
    scan_mesh_free(&mesh);
    /* A ball's surface crosses 1.5 voxels per unit on average. */
    assert_true(fabs(estimate(f, 0.5, UINT64_MAX) / (1.5 * 4 * M_PI * 400) - 1) < 0.02);
    for (double size = 0.5; size > 0.03; size /= 2) {
        struct vox_voxelize_options options = {.size = sizeof(struct vox_voxelize_options),
                                               .tris_path = "scan.tris",
                                               .grid_path = "scan.nvdb",
                                               .voxel_size = size};
        struct vox_voxelize_report report = {.size = sizeof report};
        assert_int_equal(vox_voxelize(f->ctx, &options, &report), 0);
        double voxels = estimate(f, size, UINT64_MAX);
        assert_true(fabs(voxels / (double)report.voxels - 1) < 0.03);
        assert_true(fabs(estimate(f, size, 16) / voxels - 1) < 0.1);
        double bytes = vox_estimate_bytes(voxels, false) / (double)report.grid_bytes;
        assert_true(bytes < 1.2 &&
                    (bytes > 0.8 || size > 0.04)); /* a small file consists of nodes and headers */
    }
}

/* Writes a quad of 1 x 1 along an axis: one voxel per unit of area. */
static void write_quad(const struct fixture *f)
{
    static const float corners[4][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    static const uint32_t triangles[2][3] = {{0, 1, 2}, {0, 2, 3}};
    struct scan_mesh mesh = scan_mesh_new(4, 2);
    memcpy(mesh.positions, corners, sizeof corners);
    memcpy(mesh.triangles, triangles, sizeof triangles);
    scan_write(f->ctx, "scan.tris", &mesh, NULL, NULL, 0, 2);
    scan_mesh_free(&mesh);
}

FIXTURE_TEST(test_ordinary_grids_are_nothing_to_speak_of)
{
    write_quad(f);
    assert_int_equal(check(f, 1.0 / 4096), 0);
    assert_int_equal(f->warnings, 0);
}

FIXTURE_TEST(test_huge_grids_of_few_triangles_are_warned_of)
{
    write_quad(f);
    assert_int_equal(check(f, 1e-5), 0); /* 1e10 voxels of 11 bytes */
    assert_int_equal(f->warnings, 1);
    assert_non_null(strstr(
        f->warning, "scan.nvdb: the grid will have about 1e+10 voxels of 1e-05 and take 102 GiB"));
    assert_non_null(strstr(f->warning, "a scan of 2 triangles"));
}

/* Half of the estimate must be free, twice: the surface might overlap itself. */
FIXTURE_TEST(test_grids_larger_than_the_disk_are_refused)
{
    write_quad(f);
    free_bytes = UINT64_C(110100000000);
    assert_int_equal(check(f, 1e-5), 0);
    free_bytes = UINT64_C(109900000000);
    assert_int_equal(check(f, 1e-5), BSQ_EIO);
    assert_non_null(strstr(bsq_error(f->ctx), "109900000000 are free"));
    assert_int_equal(f->warnings, 1);
    free_bytes = 4096 * 4096 * 11 + 100;
    assert_int_equal(check(f, 1.0 / 4096), 0);
    free_bytes = 4096 * 4096 * 11 - 100;
    assert_int_equal(check(f, 1.0 / 4096), BSQ_EIO);
    assert_int_equal(f->warnings, 0);
}

/* If temporary files are on the output's disk, it must have space for both. */
FIXTURE_TEST(outputs_and_temporary_files_share_a_disk)
{
    struct bsq_ctx_options elsewhere = {.tmpdir = "/proc"};
    free_bytes = 100;
    assert_int_equal(bsq_require_space(f->ctx, "scan.nvdb", 60, 40), 0);
    assert_int_equal(bsq_require_space(f->ctx, "scan.nvdb", 60, 41), BSQ_EIO);
    bsq_ctx_destroy(f->ctx);
    assert_int_equal(bsq_ctx_create(&elsewhere, &f->ctx), 0);
    assert_int_equal(bsq_require_space(f->ctx, "scan.nvdb", 60, 41), 0);
    assert_int_equal(bsq_require_space(f->ctx, "scan.nvdb", 60, 101), BSQ_EIO);
    assert_non_null(strstr(bsq_error(f->ctx), "/proc: 101 bytes are needed for temporary files"));
}

RUN_TESTS(NULL, NULL)
