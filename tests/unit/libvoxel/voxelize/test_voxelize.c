/* Voxelizes chunk files. Compares voxel counts with the exact sphere, and records with analytic
 * surfaces. */
#include "base/geometry/vec.h"
#include "tests/unit/sanitized.h"
#include "voxelize_fixture.h"
#include "tests/unit/test.h"
#include "tests/grid_lookup.h"

#define FIXTURE_TEST(name) STATE_TEST(name, struct vox_fixture, vox_set_up, vox_tear_down)

/* ---- the sphere ---- */

/* Returns the number of voxels of an n^3 grid that an exact sphere of radius n / 2 about its centre
 * touches: nearest corner <= R <= farthest corner. One octant is enough. */
static uint64_t exact_sphere_voxels(int64_t n)
{
    int64_t half = n / 2, square = half * half;
    uint64_t count = 0;
    for (int64_t x = 0; x < half; x++)
        for (int64_t y = 0; y < half; y++)
            for (int64_t z = 0; z < half; z++) {
                int64_t near = x * x + y * y + z * z;
                int64_t far = near + 2 * (x + y + z) + 3;
                count += near <= square && square <= far;
            }
    return 8 * count;
}

/* A polyhedron inside the sphere gives the same voxels if no voxel corner fits between the two.
 * Corners next to the sphere are at least 1 / (2 R) from it. Triangles with edges of up to 1.5
 * voxels dip 1.5^2 / (6 R) below it. */
FIXTURE_TEST(test_sphere_touches_the_voxels_of_the_exact_one)
{
    static const struct {
        uint32_t resolution;
        uint64_t voxels;
    } table[] = {{4, 56},      {8, 272},      {16, 1160},     {32, 4760},     {64, 19232},
                 {128, 77096}, {256, 308576}, {512, 1235144}, {1024, 4940816}};
    const size_t count = sizeof table / sizeof table[0] - (TEST_SANITIZED ? 3 : 0);
    for (size_t i = 0; i < count; i++) {
        assert_int_equal(exact_sphere_voxels(table[i].resolution), table[i].voxels);
        struct scan_mesh mesh = scan_sphere(table[i].resolution / 2.0, 1.5);
        scan_write(f->ctx, "scan.tris", &mesh, NULL, NULL, 0, 30000);
        struct vox_voxelize_report report = vox_make(f, table[i].resolution, 0.0);
        assert_int_equal(report.voxels, table[i].voxels);
        assert_int_equal(report.triangles, mesh.triangle_count);
        scan_mesh_free(&mesh);
        for (int a = 0; a < 3; a++) {
            assert_int_equal(report.index_min[a], 0);
            assert_int_equal(report.index_max[a], table[i].resolution - 1);
        }
    }
}

/* ---- borders ---- */

static void set_box(struct scan_mesh *mesh, uint32_t first_quad, double lo, double hi)
{
    double at[3] = {lo, lo, lo}, top[3] = {hi, hi, hi}, d = hi - lo;
    for (int a = 0; a < 3; a++) {
        double u[3] = {0, 0, 0}, v[3] = {0, 0, 0}, mu[3] = {0, 0, 0}, mv[3] = {0, 0, 0};
        u[(a + 1) % 3] = v[(a + 2) % 3] = d;
        mu[(a + 1) % 3] = mv[(a + 2) % 3] = -d;
        scan_set_quad(mesh, first_quad + 2 * (uint32_t)a, at, v, u);
        scan_set_quad(mesh, first_quad + 2 * (uint32_t)a + 1, top, mu, mv);
    }
}

FIXTURE_TEST(test_box_that_ends_on_the_bounds)
{
    struct scan_mesh mesh = scan_mesh_new(24, 12);
    set_box(&mesh, 0, -0.3, 0.7);
    vox_take_scan(f, &mesh);
    for (uint32_t n = 1; n <= 21; n += 4) {
        struct vox_voxelize_report report = vox_make(f, n, 0.0);
        uint64_t inner = n > 2 ? n - 2 : 0;
        assert_int_equal(report.voxels, (uint64_t)n * n * n - inner * inner * inner);
    }
}

/* With a given voxel size every border belongs to the voxel above it. */
FIXTURE_TEST(test_box_on_multiples_of_a_voxel_size)
{
    struct scan_mesh mesh = scan_mesh_new(24, 12);
    set_box(&mesh, 0, -2.0, 3.0);
    vox_take_scan(f, &mesh);
    struct vox_voxelize_report report = vox_make(f, 0, 0.5);
    /* Planes at -2 fill layer -4, planes at 3 layer 6: a shell of 11^3. */
    for (int a = 0; a < 3; a++) {
        assert_int_equal(report.index_min[a], -4);
        assert_int_equal(report.index_max[a], 6);
    }
    assert_int_equal(report.voxels, 11 * 11 * 11 - 9 * 9 * 9);
    struct fmt_nvdb_grid grid = vox_open(f);
    for (int a = 0; a < 3; a++)
        assert_true(grid.info.translation[a] == 0.25);
    fmt_nvdb_close(f->ctx, &grid);
}

/* ---- two sheets ---- */

/* The larger sheet is the first record in either order. A sheet below a hundredth is dropped. */
FIXTURE_TEST(test_second_sheet_is_the_smaller)
{
    struct scan_mesh mesh = scan_mesh_new(12, 6);
    scan_set_quad(&mesh, 0, (double[3]){0.1, 0.1, 0.7}, (double[3]){0.3, 0, 0},
                  (double[3]){0, 0.3, 0});
    scan_set_quad(&mesh, 1, (double[3]){0.1, 0.1, 0.4}, (double[3]){0, 0.8, 0},
                  (double[3]){0.8, 0, 0});
    scan_set_quad(&mesh, 2, (double[3]){1.1, 0.1, 0.4}, (double[3]){0.05, 0, 0},
                  (double[3]){0, 0.05, 0});
    vox_write_scan(f, &mesh);
    vox_make(f, 0, 1.0);
    struct fmt_nvdb_grid grid;
    const int32_t origin[3] = {0, 0, 0};
    assert_int_equal(fmt_nvdb_open(f->ctx, "scan.nvdb", &grid), 0);
    uint64_t index = grid_find(&grid, origin);
    assert_true(bsq_oct_unpack(grid_get(&grid, index).normal).z < -0.99999f);
    assert_int_not_equal(fmt_nvdb_second(&grid, index), 0);
    fmt_nvdb_close(f->ctx, &grid);

    scan_set_quad(&mesh, 0, (double[3]){0.1, 0.1, 0.7}, (double[3]){0.05, 0, 0},
                  (double[3]){0, 0.05, 0});
    vox_take_scan(f, &mesh);
    vox_make(f, 0, 1.0);
    assert_int_equal(fmt_nvdb_open(f->ctx, "scan.nvdb", &grid), 0);
    index = grid_find(&grid, origin);
    assert_true(bsq_oct_unpack(grid_get(&grid, index).normal).z < -0.99999f);
    assert_int_equal(fmt_nvdb_second(&grid, index), 0);
    fmt_nvdb_close(f->ctx, &grid);
}

/* ---- sums ---- */

FIXTURE_TEST(test_a_million_triangles_in_one_voxel)
{
    /* Large triangles face up; tiny ones of the same total area lean. All must count. */
    const uint32_t tiny = 1000000;
    struct scan_mesh mesh = scan_mesh_new(4 + 3, 2 + tiny);
    scan_set_quad(&mesh, 0, (double[3]){0, 0, 0.5}, (double[3]){0.9, 0, 0}, (double[3]){0, 0.9, 0});
    /* Area of each: 0.81 / 1e6; normal (1, 0, 1) / sqrt(2). */
    double side = sqrt(2.0 * 0.81e-6);
    scan_set_vertex(&mesh, 4, 0.5, 0.5, 0.5);
    scan_set_vertex(&mesh, 5, 0.5, 0.5 + side, 0.5);
    scan_set_vertex(&mesh, 6, 0.5 - side / sqrt(2.0), 0.5, 0.5 + side / sqrt(2.0));
    for (uint32_t i = 0; i < tiny; i++)
        scan_set_triangle(&mesh, 2 + i, 4, 5, 6);
    scan_write(f->ctx, "scan.tris", &mesh, NULL, NULL, 0, 65536);
    scan_mesh_free(&mesh);
    vox_make(f, 0, 1.0);
    struct fmt_nvdb_grid grid = vox_open(f);
    struct fmt_nvdb_record record = grid_get(&grid, grid_find(&grid, (int32_t[3]){0, 0, 0}));
    struct bsq_vec3 n = bsq_oct_unpack(record.normal);
    /* The mean of two unit vectors 45 degrees apart leans by 22.5. */
    assert_true(fabs(atan2((double)n.x, (double)n.z) - acos(-1.0) / 8.0) < 1e-3);
    assert_true(fabs(record_coverage(record) - cos(acos(-1.0) / 8.0)) < 1.0 / 255.0);
    fmt_nvdb_close(f->ctx, &grid);
}

/* ---- far and wide ---- */

/* Voxels at both ends of the index range, across many root tiles: the space between takes no
 * memory. */
FIXTURE_TEST(test_sparse_and_huge)
{
    struct scan_mesh mesh = scan_mesh_new(6, 2);
    const double far = 1073741000.0 / 1024.0;
    for (int s = 0; s < 2; s++) {
        double x = s ? far : -far;
        scan_set_vertex(&mesh, 3 * (uint32_t)s, x, x, x);
        scan_set_vertex(&mesh, 3 * (uint32_t)s + 1, x + 0.125, x, x);
        scan_set_vertex(&mesh, 3 * (uint32_t)s + 2, x, x + 0.125, x);
        scan_set_triangle(&mesh, (uint32_t)s, 3 * (uint32_t)s, 3 * (uint32_t)s + 1,
                          3 * (uint32_t)s + 2);
    }
    scan_write(f->ctx, "scan.tris", &mesh, NULL, NULL, 0, 1);
    vox_make(f, 0, 1.0 / 1024.0);
    struct fmt_nvdb_grid grid = vox_open(f);
    for (int s = 0; s < 2; s++) {
        int32_t at = (int32_t)floor((double)mesh.positions[3 * s][0] * 1024.0);
        assert_int_not_equal(grid_find(&grid, (int32_t[3]){at, at, at}), 0);
        assert_int_equal(grid_find(&grid, (int32_t[3]){at, at, at + 1}), 0);
    }
    scan_mesh_free(&mesh);
    fmt_nvdb_close(f->ctx, &grid);
}

/* ---- errors ---- */

FIXTURE_TEST(test_bad_sizes)
{
    struct scan_mesh mesh = scan_mesh_new(4, 2);
    scan_set_quad(&mesh, 0, (double[3]){0, 0, 0}, (double[3]){2, 0, 0}, (double[3]){0, 1, 0});
    vox_write_scan(f, &mesh);
    vox_expect_failure(f, 0, 0.0, BSQ_EUSAGE, "voxel size of 0");
    vox_expect_failure(f, 0, -1.0, BSQ_EUSAGE, "voxel size of -1");
    vox_expect_failure(f, 0, (double)NAN, BSQ_EUSAGE, "voxel size of");
    vox_expect_failure(f, 0, 1e-10, BSQ_EUSAGE, "from index 0 to 20000000000 along x");
    vox_expect_failure(f, 0, 1e-300, BSQ_EUSAGE, "from index 0 to 2e+300 along x");
    vox_expect_failure(f, 2000000000, 0.0, BSQ_EUSAGE, "2000000000");

    scan_set_quad(&mesh, 0, (double[3]){3, 4, 5}, (double[3]){0, 0, 0}, (double[3]){0, 0, 0});
    vox_take_scan(f, &mesh);
    vox_expect_failure(f, 100, 0.0, BSQ_EDATA, "(3, 4, 5)");
    assert_int_equal(vox_make(f, 0, 1.0).voxels, 1);
}

FIXTURE_TEST(test_missing_and_damaged_input)
{
    vox_expect_failure(f, 100, 0.0, BSQ_ENOINPUT, "scan.tris");
    struct scan_mesh mesh = scan_sphere(10.0, 0.5);
    vox_take_scan(f, &mesh);
    /* Damages a byte in the middle of a chunk. This is found when the chunk is loaded, after the
     * output was begun. */
    FILE *file = fopen("scan.tris", "r+b");
    assert_non_null(file);
    assert_int_equal(fseek(file, 5000, SEEK_SET), 0);
    int byte = fgetc(file);
    assert_int_equal(fseek(file, 5000, SEEK_SET), 0);
    fputc(byte ^ 1, file);
    fclose(file);
    vox_expect_failure(f, 100, 0.0, BSQ_EDATA, "scan.tris");
}

RUN_TESTS(NULL, NULL)
