/* Tests how normals, colours, materials and textures of a scan reach the records of its grid. */
#include "base/geometry/vec.h"
#include "tests/unit/image_file.h"
#include "voxelize_fixture.h"
#include "tests/unit/test.h"
#include "tests/grid_lookup.h"

#define FIXTURE_TEST(name) STATE_TEST(name, struct vox_fixture, vox_set_up, vox_tear_down)

/* ---- attributes ---- */

FIXTURE_TEST(test_vertex_normals_are_interpolated)
{
    struct scan_mesh mesh = scan_mesh_new(4, 2);
    scan_set_quad(&mesh, 0, (double[3]){0, 0, 0.5}, (double[3]){10, 0, 0}, (double[3]){0, 10, 0});
    mesh.normals = calloc(4, sizeof *mesh.normals);
    for (int i = 0; i < 4; i++) /* they lean along x: -0.5 at x = 0, 0.5 at x = 10 */
        mesh.normals[i] =
            bsq_oct_pack(bsq_unit3(bsq_v3(i == 1 || i == 2 ? 0.5f : -0.5f, 0.0f, 1.0f)));
    vox_take_scan(f, &mesh);
    vox_make(f, 0, 1.0);
    struct fmt_nvdb_grid grid = vox_open(f);
    for (int32_t x = 0; x < 10; x++) {
        uint64_t index = grid_find(&grid, (int32_t[3]){x, 4, 0});
        struct bsq_vec3 n = bsq_oct_unpack(grid_get(&grid, index).normal);
        /* Both ends have the same length, so the slope x / z is linear. */
        assert_true(fabsf(n.x / n.z - ((float)x + 0.5f - 5.0f) / 10.0f) < 1e-3f);
    }
    fmt_nvdb_close(f->ctx, &grid);
}

/* Returns the facet-noise weight of the record in the middle of a plane of squares, each of two
 * triangles. side: of a square, in voxels. */
static uint32_t noise_of_squares(struct vox_fixture *f, double side, bool with_normals)
{
    enum { COUNT = 40 };
    struct scan_mesh mesh = scan_mesh_new(4 * COUNT * COUNT, 2 * COUNT * COUNT);
    for (uint32_t q = 0; q < COUNT * COUNT; q++)
        scan_set_quad(&mesh, q, (double[3]){side * (q % COUNT), side * (q / COUNT), 0.5},
                      (double[3]){side, 0, 0}, (double[3]){0, side, 0});
    if (with_normals)
        mesh.normals = calloc(mesh.vertex_count, sizeof *mesh.normals);
    for (uint32_t v = 0; with_normals && v < mesh.vertex_count; v++)
        mesh.normals[v] = bsq_oct_pack(bsq_v3(0.0f, 0.0f, 1.0f));
    vox_take_scan(f, &mesh);
    vox_make(f, 0, 1.0);
    struct fmt_nvdb_grid grid = vox_open(f);
    int32_t middle = (int32_t)(COUNT / 2 * side);
    uint64_t index = grid_find(&grid, (int32_t[3]){middle, middle, 0});
    assert_true(index > 0);
    uint32_t plane = grid_get(&grid, index).plane;
    fmt_nvdb_close(f->ctx, &grid);
    return plane >> FMT_NVDB_FACET_NOISE_SHIFT;
}

/* The squares of a triangle's edges are s^2, s^2 and 2 s^2. Their mean times 2.7 is the facet-noise
 * weight up to edges of 0.7 voxels, times 0.4 above; at most 1, which is 7 in the file. With the
 * scan's own normals the weight is 0. */
FIXTURE_TEST(test_facet_noise_weight_follows_the_triangles)
{
    static const struct {
        double side, share;
    } cases[] = {{0.125, 2.7}, {0.25, 2.7}, {0.5, 2.7}, {1.0, 0.4}, {1.25, 0.4}, {2.0, 0.4}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        double noise = cases[i].share * 4.0 / 3.0 * cases[i].side * cases[i].side;
        assert_int_equal(noise_of_squares(f, cases[i].side, false), lrint(7.0 * fmin(noise, 1.0)));
        assert_int_equal(noise_of_squares(f, cases[i].side, true), 0);
    }
}

static double to_linear(double srgb)
{
    return srgb <= 0.04045 ? srgb / 12.92 : pow((srgb + 0.055) / 1.055, 2.4);
}

static double to_srgb(double linear)
{
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1.0 / 2.4) - 0.055;
}

FIXTURE_TEST(test_vertex_colors_are_mixed_in_linear_light)
{
    struct scan_mesh mesh = scan_mesh_new(4, 2);
    scan_set_quad(&mesh, 0, (double[3]){0, 0, 0.5}, (double[3]){10, 0, 0}, (double[3]){0, 10, 0});
    mesh.colors = calloc(4, sizeof *mesh.colors);
    for (int i = 0; i < 4; i++)
        mesh.colors[i] = i == 1 || i == 2 ? 0xff3050ffu : 0xff305000u;
    vox_take_scan(f, &mesh);
    struct vox_voxelize_report report = vox_make(f, 0, 1.0);
    assert_true(report.has_color);
    struct fmt_nvdb_grid grid = vox_open(f);
    for (int32_t x = 0; x < 10; x++)
        for (int32_t y = 0; y < 10; y++) {
            uint64_t index = grid_find(&grid, (int32_t[3]){x, y, 0});
            uint32_t color = grid_get(&grid, index).color;
            /* Red rises linearly in light along x. A voxel on the diagonal has two fragments. */
            double expected = 255.0 * to_srgb((x + 0.5) / 10.0);
            assert_true(fabs((double)(color & 0xff) - expected) <= 0.51);
            assert_int_equal(color >> 8, 0xff3050);
        }
    fmt_nvdb_close(f->ctx, &grid);
}

FIXTURE_TEST(test_materials_color_what_has_no_other)
{
    struct scan_mesh mesh = scan_mesh_new(8, 4);
    struct fmt_tris_material materials[2] = {{.diffuse = {0.0f, 0.5f, 1.0f}},
                                             {.diffuse = {1.0f, 0.5f, 0.2f}}};
    /* Two halves of voxel (0, 0, 0) have two materials, another voxel has none. */
    scan_set_quad(&mesh, 0, (double[3]){0, 0, 0.5}, (double[3]){0.5, 0, 0}, (double[3]){0, 0.9, 0});
    scan_set_quad(&mesh, 1, (double[3]){2.1, 0, 0.5}, (double[3]){0.5, 0, 0},
                  (double[3]){0, 0.9, 0});
    mesh.materials = calloc(4, sizeof *mesh.materials);
    mesh.materials[1] = 1;
    mesh.materials[2] = mesh.materials[3] = UINT32_MAX;
    scan_write(f->ctx, "scan.tris", &mesh, NULL, materials, 2, 4000);
    scan_mesh_free(&mesh);
    assert_true(vox_make(f, 0, 1.0).has_color);
    struct fmt_nvdb_grid grid = vox_open(f);
    uint32_t mixed = grid_get(&grid, grid_find(&grid, (int32_t[3]){0, 0, 0})).color;
    for (int k = 0; k < 3; k++) {
        double linear = 0.5 * (to_linear((double)materials[0].diffuse[k]) +
                               to_linear((double)materials[1].diffuse[k]));
        assert_true(fabs((double)(mixed >> (8 * k) & 0xff) - 255.0 * to_srgb(linear)) <= 0.51);
    }
    assert_int_equal(mixed >> 24, 255);
    assert_int_equal(grid_get(&grid, grid_find(&grid, (int32_t[3]){2, 0, 0})).color, 0);
    fmt_nvdb_close(f->ctx, &grid);
}

RUN_TESTS(NULL, NULL)
