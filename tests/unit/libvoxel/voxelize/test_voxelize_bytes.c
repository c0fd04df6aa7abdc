/* Tests that a grid has the same bytes for any budget, number of threads and division into
 * chunks. */
#include "voxelize_fixture.h"
#include "tests/unit/sanitized.h"
#include "tests/unit/test.h"

#define FIXTURE_TEST(name) STATE_TEST(name, struct vox_fixture, vox_set_up, vox_tear_down)

/* ---- same bytes ---- */

struct way {
    uint64_t mebibytes;
    unsigned threads;
};

/* Returns the report of the last way. */
static struct vox_voxelize_report check_ways(uint32_t resolution, const struct way *ways,
                                             size_t count)
{
    struct vox_voxelize_report report = {.size = sizeof report};
    for (size_t i = 0; i < count; i++) {
        struct bsq_ctx *ctx = test_context(ways[i].threads, ways[i].mebibytes << 20);
        struct vox_voxelize_options options = {
            .size = sizeof(struct vox_voxelize_options),
            .tris_path = "scan.tris",
            .grid_path = i == 0 ? "scan.nvdb" : "other.nvdb",
            .resolution = resolution,
        };
        int status = vox_voxelize(ctx, &options, &report);
        if (status != 0)
            print_message("%s\n", bsq_error(ctx));
        assert_int_equal(status, 0);
        assert_true(bsq_memory_high(ctx) <= ways[i].mebibytes << 20);
        test_context_end(ctx);
        if (i > 0)
            expect_same_bytes("scan.nvdb", "other.nvdb");
    }
    return report;
}

static void check_same_bytes(uint32_t resolution)
{
    static const struct way ways[] = {{1024, 1}, {1024, 2}, {1024, 7}, {32, 1}, {128, 3}};
    check_ways(resolution, ways, sizeof ways / sizeof ways[0]);
}

/* Triangles of all sizes fill most voxels, so that small budgets work in parts. */
FIXTURE_TEST(test_noise_gives_the_same_bytes)
{
    const uint32_t count = 40000;
    uint64_t seed = 8;
    print_message("seed %llu\n", (unsigned long long)seed);
    struct scan_mesh mesh = scan_mesh_new(3 * count, count);
    mesh.colors = calloc(3 * count, sizeof *mesh.colors);
    for (uint32_t t = 0; t < count; t++) {
        double at[3], size = pow(10.0, -3.0 * scan_random(&seed));
        for (int a = 0; a < 3; a++)
            at[a] = scan_random(&seed);
        for (uint32_t i = 3 * t; i < 3 * t + 3; i++) {
            for (int a = 0; a < 3; a++)
                mesh.positions[i][a] = (float)(at[a] + 0.3 * size * (scan_random(&seed) - 0.5));
            mesh.colors[i] = (uint32_t)(4294967296.0 * scan_random(&seed));
        }
        scan_set_triangle(&mesh, t, 3 * t, 3 * t + 1, 3 * t + 2);
    }
    vox_take_scan(f, &mesh);
    check_same_bytes(100);
}

/* Parallel sheets, one in every layer except that the last two share one: 2 million voxels in each
 * region, whose records alone exceed the budget. */
FIXTURE_TEST(test_solid_regions_in_little_memory)
{
    const uint32_t size = 144;
    struct scan_mesh mesh = scan_mesh_new(4 * size, 2 * size);
    for (uint32_t i = 0; i < size; i++)
        scan_set_quad(&mesh, i, (double[3]){0, 0, i + 0.5}, (double[3]){size, 0, 0},
                      (double[3]){0, size, 0});
    scan_write(f->ctx, "scan.tris", &mesh, NULL, NULL, 0, 64);
    scan_mesh_free(&mesh);
    static const struct way ways[] = {{256, 2}, {20, 4}, {12, 1}};
    struct vox_voxelize_report report = check_ways(size, ways, sizeof ways / sizeof ways[0]);
    assert_int_equal(report.voxels, (uint64_t)size * size * (size - 1));
    assert_int_equal(report.lowers, 8);
}

FIXTURE_TEST(test_sphere_gives_the_same_bytes)
{
    struct scan_mesh mesh = scan_sphere(100.0, 0.7);
    scan_sort(&mesh);
    vox_take_scan(f, &mesh);
    check_same_bytes(TEST_SANITIZED ? 200 : 300);
    check_same_bytes(40);
}

RUN_TESTS(NULL, NULL)
