/* From a chunk file to a grid file: counts against the exact sphere, records against analytic
 * surfaces, bytes against other budgets and numbers of threads. */
#include "libvoxel/voxel.h"
#include "base/octahedral.h"
#include "formats/nvdb.h"
#include "formats/png_image.h"
#include "scan_fixture.h"
#include "tests/unit/sanitized.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>

struct fixture {
    char directory[64], tris[96], grid[96], other[96], image[96];
    struct bsq_ctx *ctx;
};

static struct bsq_ctx *make_context(uint64_t mebibytes, unsigned threads)
{
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {.memory_bytes = mebibytes << 20, .threads = threads};
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    return ctx;
}

static int set_up(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);
    assert_non_null(f);
    strcpy(f->directory, "/tmp/test_voxelize_XXXXXX");
    assert_non_null(mkdtemp(f->directory));
    snprintf(f->tris, sizeof f->tris, "%s/scan.tris", f->directory);
    snprintf(f->grid, sizeof f->grid, "%s/scan.nvdb", f->directory);
    snprintf(f->other, sizeof f->other, "%s/other.nvdb", f->directory);
    snprintf(f->image, sizeof f->image, "%s/texture.png", f->directory);
    f->ctx = make_context(512, 2);
    *state = f;
    return 0;
}

static int tear_down(void **state)
{
    struct fixture *f = *state;
    bsq_ctx_destroy(f->ctx);
    unlink(f->tris);
    unlink(f->grid);
    unlink(f->other);
    unlink(f->image);
    assert_int_equal(rmdir(f->directory), 0); /* nothing else was left behind */
    free(f);
    return 0;
}

static struct vox_voxelize_report voxelize(const struct fixture *f, uint32_t resolution,
                                           double voxel_size)
{
    struct vox_voxelize_options options = {
        .tris_path = f->tris,
        .grid_path = f->grid,
        .resolution = resolution,
        .voxel_size = voxel_size,
    };
    struct vox_voxelize_report report;
    int status = vox_voxelize(f->ctx, &options, &report);
    if (status != 0)
        print_message("%s\n", bsq_error(f->ctx));
    assert_int_equal(status, 0);
    return report;
}

static void expect_failure(struct fixture *f, uint32_t resolution, double voxel_size, int status,
                           const char *text)
{
    struct vox_voxelize_options options = {
        .tris_path = f->tris,
        .grid_path = f->grid,
        .resolution = resolution,
        .voxel_size = voxel_size,
    };
    struct vox_voxelize_report report;
    assert_int_equal(vox_voxelize(f->ctx, &options, &report), status);
    if (!strstr(bsq_error(f->ctx), text))
        print_message("%s\n", bsq_error(f->ctx));
    assert_non_null(strstr(bsq_error(f->ctx), text));
    assert_int_equal(access(f->grid, F_OK), -1);
    bsq_clear_error(f->ctx);
}

static void write_scan(const struct fixture *f, const struct scan_mesh *mesh)
{
    scan_write(f->ctx, f->tris, mesh, NULL, NULL, 0, 4000);
}

static void set_vertex(struct scan_mesh *mesh, uint32_t v, double x, double y, double z)
{
    mesh->positions[v][0] = (float)x;
    mesh->positions[v][1] = (float)y;
    mesh->positions[v][2] = (float)z;
}

static void set_triangle(struct scan_mesh *mesh, uint32_t t, uint32_t a, uint32_t b, uint32_t c)
{
    mesh->triangles[t][0] = a;
    mesh->triangles[t][1] = b;
    mesh->triangles[t][2] = c;
}

/* A parallelogram from `at` along u and v, facing along u x v, as vertices 4 q to 4 q + 3. */
static void set_quad(struct scan_mesh *mesh, uint32_t q, const double at[3], const double u[3],
                     const double v[3])
{
    for (uint32_t i = 0; i < 4; i++) {
        double p[3];
        for (int a = 0; a < 3; a++)
            p[a] = at[a] + (i == 1 || i == 2 ? u[a] : 0.0) + (i >= 2 ? v[a] : 0.0);
        set_vertex(mesh, 4 * q + i, p[0], p[1], p[2]);
    }
    set_triangle(mesh, 2 * q, 4 * q, 4 * q + 1, 4 * q + 2);
    set_triangle(mesh, 2 * q + 1, 4 * q, 4 * q + 2, 4 * q + 3);
}

static double plane_offset(struct fmt_nvdb_record record)
{
    return (double)(int16_t)(record.plane & 0xffff) / 32767.0;
}

static double coverage(struct fmt_nvdb_record record)
{
    return (double)(record.plane >> 16 & 0xff) / 255.0;
}

/* ---- the sphere ---- */

/* Voxels of an n^3 grid that an exact sphere of radius n / 2 about its centre touches: nearest
 * corner
 * <= R <= farthest corner. One octant is enough. */
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
 * Corners next to the sphere are at least 1 / (2 R) from it; triangles with sides of up to 1.5
 * voxels dip 1.5^2 / (6 R) below it. */
static void test_sphere_touches_the_voxels_of_the_exact_one(void **state)
{
    struct fixture *f = *state;
    static const struct {
        uint32_t resolution;
        uint64_t voxels;
    } table[] = {{4, 56},      {8, 272},      {16, 1160},     {32, 4760},     {64, 19232},
                 {128, 77096}, {256, 308576}, {512, 1235144}, {1024, 4940816}};
    const size_t count = sizeof table / sizeof table[0] - (TEST_SANITIZED ? 3 : 0);
    for (size_t i = 0; i < count; i++) {
        assert_int_equal(exact_sphere_voxels(table[i].resolution), table[i].voxels);
        struct scan_mesh mesh = scan_sphere(table[i].resolution / 2.0, 1.5);
        scan_write(f->ctx, f->tris, &mesh, NULL, NULL, 0, 30000);
        struct vox_voxelize_report report = voxelize(f, table[i].resolution, 0.0);
        assert_int_equal(report.voxels, table[i].voxels);
        assert_int_equal(report.triangles, mesh.triangle_count);
        scan_mesh_free(&mesh);
        for (int a = 0; a < 3; a++) {
            assert_int_equal(report.index_min[a], 0);
            assert_int_equal(report.index_max[a], table[i].resolution - 1);
        }
    }
}

/* Normals and planes of a finely tessellated sphere against the sphere's. */
static void test_sphere_records(void **state)
{
    struct fixture *f = *state;
    const double radius = 40.0;
    struct scan_mesh mesh = scan_sphere(radius, 0.4);
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    struct vox_voxelize_report report = voxelize(f, 80, 0.0);
    assert_int_equal(report.second_records, 0);
    assert_false(report.has_color);

    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    uint64_t found = 0;
    for (int32_t x = 0; x < 80; x++)
        for (int32_t y = 0; y < 80; y++)
            for (int32_t z = 0; z < 80; z++) {
                uint64_t index = fmt_nvdb_find(&grid, (int32_t[3]){x, y, z});
                if (index == 0)
                    continue;
                found++;
                struct fmt_nvdb_record record = fmt_nvdb_get(&grid, index);
                double p[3] = {x + 0.5 - radius, y + 0.5 - radius, z + 0.5 - radius};
                double r = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
                struct bsq_vec3 n = bsq_oct_unpack(record.normal);
                double cosine = ((double)n.x * p[0] + (double)n.y * p[1] + (double)n.z * p[2]) / r;
                /* The piece may lie at the voxel's far end: 0.87 voxels of 40. */
                assert_true(cosine > cos(0.87 / 39.0 + 0.01));
                assert_true(fabs(plane_offset(record) - (radius - r)) < 0.02);
                assert_true(coverage(record) > 0.99);
                assert_int_equal(record.color, 0);
            }
    assert_int_equal(found, report.voxels);
    assert_true(fabs(grid.info.translation[0] - (-radius + 0.5)) < 1e-12);
    assert_true(fabs(grid.info.voxel_size - 1.0) < 1e-12);
    fmt_nvdb_close(f->ctx, &grid);
}

/* ---- borders ---- */

static void set_box(struct scan_mesh *mesh, uint32_t first_quad, double lo, double hi)
{
    double at[3] = {lo, lo, lo}, top[3] = {hi, hi, hi}, d = hi - lo;
    for (int a = 0; a < 3; a++) {
        double u[3] = {0, 0, 0}, v[3] = {0, 0, 0}, mu[3] = {0, 0, 0}, mv[3] = {0, 0, 0};
        u[(a + 1) % 3] = v[(a + 2) % 3] = d;
        mu[(a + 1) % 3] = mv[(a + 2) % 3] = -d;
        set_quad(mesh, first_quad + 2 * (uint32_t)a, at, v, u);
        set_quad(mesh, first_quad + 2 * (uint32_t)a + 1, top, mu, mv);
    }
}

static void test_box_that_ends_on_the_bounds(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(24, 12);
    set_box(&mesh, 0, -0.3, 0.7);
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    for (uint32_t n = 1; n <= 21; n += 4) {
        struct vox_voxelize_report report = voxelize(f, n, 0.0);
        uint64_t inner = n > 2 ? n - 2 : 0;
        assert_int_equal(report.voxels, (uint64_t)n * n * n - inner * inner * inner);
    }
}

/* With a given voxel size every border belongs to the voxel above it. */
static void test_box_on_the_lattice_of_a_voxel_size(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(24, 12);
    set_box(&mesh, 0, -2.0, 3.0);
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    struct vox_voxelize_report report = voxelize(f, 0, 0.5);
    /* Planes at -2 fill layer -4, planes at 3 layer 6: a shell of 11^3. */
    for (int a = 0; a < 3; a++) {
        assert_int_equal(report.index_min[a], -4);
        assert_int_equal(report.index_max[a], 6);
    }
    assert_int_equal(report.voxels, 11 * 11 * 11 - 9 * 9 * 9);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    for (int a = 0; a < 3; a++)
        assert_true(grid.info.translation[a] == 0.25);
    fmt_nvdb_close(f->ctx, &grid);
}

static void test_flat_scan(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(4, 2);
    set_quad(&mesh, 0, (double[3]){5, 5, 5}, (double[3]){8, 0, 0}, (double[3]){0, 4, 0});
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    struct vox_voxelize_report report = voxelize(f, 16, 0.0);
    assert_int_equal(report.voxels, 16 * 8);
    assert_int_equal(report.index_max[2], 0);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    struct fmt_nvdb_record record =
        fmt_nvdb_get(&grid, fmt_nvdb_find(&grid, (int32_t[3]){3, 3, 0}));
    struct bsq_vec3 n = bsq_oct_unpack(record.normal);
    assert_true(n.z > 0.99999f);
    /* The plane lies on the voxel's lower face. */
    assert_true(fabs(plane_offset(record) + 0.5) < 1e-4);
    assert_true(coverage(record) == 1.0);
    fmt_nvdb_close(f->ctx, &grid);
}

/* ---- two sheets ---- */

static void test_plate_thinner_than_a_voxel(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(8, 4);
    /* Upper side at z = 0.7, lower side at z = 0.4 and smaller, so that some voxels have only one.
     */
    set_quad(&mesh, 0, (double[3]){0, 0, 0.7}, (double[3]){8, 0, 0}, (double[3]){0, 8, 0});
    set_quad(&mesh, 1, (double[3]){0, 0, 0.4}, (double[3]){0, 8, 0}, (double[3]){4, 0, 0});
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    struct vox_voxelize_report report = voxelize(f, 0, 1.0);
    /* Where a side ends on a border it touches the voxels beyond. These have records of no area:
     * where both sides end, at y = 8, the two are equal. */
    assert_int_equal(report.voxels, 9 * 9);
    assert_int_equal(report.second_records, 4 * 8 + 5);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    uint64_t two = fmt_nvdb_find(&grid, (int32_t[3]){2, 5, 0});
    uint64_t one = fmt_nvdb_find(&grid, (int32_t[3]){6, 5, 0});
    assert_int_equal(fmt_nvdb_second(&grid, one), 0);
    uint64_t second = fmt_nvdb_second(&grid, two);
    assert_int_not_equal(second, 0);
    struct fmt_nvdb_record up = fmt_nvdb_get(&grid, two), down = fmt_nvdb_get(&grid, second);
    /* Equal areas: the sheet that came first is the first record. */
    assert_true(bsq_oct_unpack(up.normal).z > 0.99999f);
    assert_true(bsq_oct_unpack(down.normal).z < -0.99999f);
    assert_true(fabs(plane_offset(up) - 0.2) < 1e-4);
    assert_true(fabs(plane_offset(down) - 0.1) < 1e-4);
    fmt_nvdb_close(f->ctx, &grid);
}

/* The larger sheet is the first record whatever comes first, and one below a hundredth is dropped.
 */
static void test_second_sheet_is_the_smaller(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(12, 6);
    set_quad(&mesh, 0, (double[3]){0.1, 0.1, 0.7}, (double[3]){0.3, 0, 0}, (double[3]){0, 0.3, 0});
    set_quad(&mesh, 1, (double[3]){0.1, 0.1, 0.4}, (double[3]){0, 0.8, 0}, (double[3]){0.8, 0, 0});
    set_quad(&mesh, 2, (double[3]){1.1, 0.1, 0.4}, (double[3]){0.05, 0, 0},
             (double[3]){0, 0.05, 0});
    write_scan(f, &mesh);
    voxelize(f, 0, 1.0);
    struct fmt_nvdb_grid grid;
    const int32_t origin[3] = {0, 0, 0};
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    uint64_t index = fmt_nvdb_find(&grid, origin);
    assert_true(bsq_oct_unpack(fmt_nvdb_get(&grid, index).normal).z < -0.99999f);
    assert_int_not_equal(fmt_nvdb_second(&grid, index), 0);
    fmt_nvdb_close(f->ctx, &grid);

    set_quad(&mesh, 0, (double[3]){0.1, 0.1, 0.7}, (double[3]){0.05, 0, 0},
             (double[3]){0, 0.05, 0});
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    voxelize(f, 0, 1.0);
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    index = fmt_nvdb_find(&grid, origin);
    assert_true(bsq_oct_unpack(fmt_nvdb_get(&grid, index).normal).z < -0.99999f);
    assert_int_equal(fmt_nvdb_second(&grid, index), 0);
    fmt_nvdb_close(f->ctx, &grid);
}

/* ---- attributes ---- */

static void test_vertex_normals_are_interpolated(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(4, 2);
    set_quad(&mesh, 0, (double[3]){0, 0, 0.5}, (double[3]){10, 0, 0}, (double[3]){0, 10, 0});
    mesh.normals = calloc(4, sizeof *mesh.normals);
    for (int i = 0; i < 4; i++) /* leaning along x: -0.5 at x = 0, 0.5 at x = 10 */
        mesh.normals[i] =
            bsq_oct_pack(bsq_unit3(bsq_v3(i == 1 || i == 2 ? 0.5f : -0.5f, 0.0f, 1.0f)));
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    voxelize(f, 0, 1.0);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    for (int32_t x = 0; x < 10; x++) {
        uint64_t index = fmt_nvdb_find(&grid, (int32_t[3]){x, 4, 0});
        struct bsq_vec3 n = bsq_oct_unpack(fmt_nvdb_get(&grid, index).normal);
        /* Both ends have the same length, so the slope x / z is linear. */
        assert_true(fabsf(n.x / n.z - ((float)x + 0.5f - 5.0f) / 10.0f) < 1e-3f);
    }
    fmt_nvdb_close(f->ctx, &grid);
}

static double to_linear(double srgb)
{
    return srgb <= 0.04045 ? srgb / 12.92 : pow((srgb + 0.055) / 1.055, 2.4);
}

static double to_srgb(double linear)
{
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1.0 / 2.4) - 0.055;
}

static void test_vertex_colors_are_mixed_in_linear_light(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(4, 2);
    set_quad(&mesh, 0, (double[3]){0, 0, 0.5}, (double[3]){10, 0, 0}, (double[3]){0, 10, 0});
    mesh.colors = calloc(4, sizeof *mesh.colors);
    for (int i = 0; i < 4; i++)
        mesh.colors[i] = i == 1 || i == 2 ? 0xff3050ffu : 0xff305000u;
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    struct vox_voxelize_report report = voxelize(f, 0, 1.0);
    assert_true(report.has_color);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    for (int32_t x = 0; x < 10; x++)
        for (int32_t y = 0; y < 10; y++) {
            uint64_t index = fmt_nvdb_find(&grid, (int32_t[3]){x, y, 0});
            uint32_t color = fmt_nvdb_get(&grid, index).color;
            /* Red rises linearly in light along x; a voxel on the diagonal has two pieces. */
            double expected = 255.0 * to_srgb((x + 0.5) / 10.0);
            assert_true(fabs((double)(color & 0xff) - expected) <= 0.51);
            assert_int_equal(color >> 8, 0xff3050);
        }
    fmt_nvdb_close(f->ctx, &grid);
}

static void test_materials_color_what_has_no_other(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(8, 4);
    struct fmt_tris_material materials[2] = {{NULL, {0.0f, 0.5f, 1.0f}},
                                             {NULL, {1.0f, 0.5f, 0.2f}}};
    /* Two halves of voxel (0, 0, 0) in two materials, and a voxel without one. */
    set_quad(&mesh, 0, (double[3]){0, 0, 0.5}, (double[3]){0.5, 0, 0}, (double[3]){0, 0.9, 0});
    set_quad(&mesh, 1, (double[3]){2.1, 0, 0.5}, (double[3]){0.5, 0, 0}, (double[3]){0, 0.9, 0});
    mesh.materials = calloc(4, sizeof *mesh.materials);
    mesh.materials[1] = 1;
    mesh.materials[2] = mesh.materials[3] = UINT32_MAX;
    scan_write(f->ctx, f->tris, &mesh, NULL, materials, 2, 4000);
    scan_mesh_free(&mesh);
    assert_true(voxelize(f, 0, 1.0).has_color);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    uint32_t mixed = fmt_nvdb_get(&grid, fmt_nvdb_find(&grid, (int32_t[3]){0, 0, 0})).color;
    for (int k = 0; k < 3; k++) {
        double linear = 0.5 * (to_linear((double)materials[0].diffuse[k]) +
                               to_linear((double)materials[1].diffuse[k]));
        assert_true(fabs((double)(mixed >> (8 * k) & 0xff) - 255.0 * to_srgb(linear)) <= 0.51);
    }
    assert_int_equal(mixed >> 24, 255);
    assert_int_equal(fmt_nvdb_get(&grid, fmt_nvdb_find(&grid, (int32_t[3]){2, 0, 0})).color, 0);
    fmt_nvdb_close(f->ctx, &grid);
}

/* A texture that rises linearly in light, red with u and green with v, so that its mean over a
 * piece is its value at the centroid. */
static void write_ramp(const struct fixture *f)
{
    enum { SIZE = 40 };
    static float texel[SIZE][SIZE][3];
    struct fmt_png_options options = {
        .width = SIZE, .height = SIZE, .channel_count = 3, .bits = 16, .srgb = true};
    struct fmt_png_writer *writer;
    for (int row = 0; row < SIZE; row++)
        for (int column = 0; column < SIZE; column++) {
            texel[row][column][0] = ((float)column + 0.5f) / SIZE;
            texel[row][column][1] = 1.0f - ((float)row + 0.5f) / SIZE;
            texel[row][column][2] = 0.25f;
        }
    assert_int_equal(fmt_png_create(f->ctx, f->image, &options, &writer), 0);
    assert_int_equal(fmt_png_write_rows(writer, &texel[0][0][0], SIZE), 0);
    assert_int_equal(fmt_png_commit(writer), 0);
}

static void test_texture_is_sampled_where_the_piece_lies(void **state)
{
    struct fixture *f = *state;
    write_ramp(f);
    struct scan_mesh mesh = scan_mesh_new(4, 2);
    set_quad(&mesh, 0, (double[3]){0, 0, 0.5}, (double[3]){10, 0, 0}, (double[3]){0, 10, 0});
    mesh.texcoords = calloc(4, sizeof *mesh.texcoords);
    for (int i = 0; i < 4; i++) {
        mesh.texcoords[i][0] = i == 1 || i == 2;
        mesh.texcoords[i][1] = i >= 2;
    }
    mesh.colors = calloc(4, sizeof *mesh.colors); /* the texture takes precedence */
    mesh.materials = calloc(2, sizeof *mesh.materials);
    struct fmt_tris_material material = {f->image, {1.0f, 0.0f, 0.0f}};
    scan_write(f->ctx, f->tris, &mesh, NULL, &material, 1, 4000);
    scan_mesh_free(&mesh);
    assert_true(voxelize(f, 0, 1.0).has_color);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    for (int32_t x = 0; x < 10; x++)
        for (int32_t y = 0; y < 10; y++) {
            /* Boxes of the two pieces on the diagonal reach over the texture's edge at its ends. */
            if (x == y && (x == 0 || x == 9))
                continue;
            uint64_t index = fmt_nvdb_find(&grid, (int32_t[3]){x, y, 0});
            uint32_t color = fmt_nvdb_get(&grid, index).color;
            const double linear[3] = {(x + 0.5) / 10.0, (y + 0.5) / 10.0, 0.25};
            for (int k = 0; k < 3; k++)
                assert_true(fabs((double)(color >> (8 * k) & 0xff) - 255.0 * to_srgb(linear[k])) <
                            0.6);
        }
    fmt_nvdb_close(f->ctx, &grid);
}

static void test_missing_texture(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(4, 2);
    set_quad(&mesh, 0, (double[3]){0, 0, 0.5}, (double[3]){10, 0, 0}, (double[3]){0, 10, 0});
    mesh.texcoords = calloc(4, sizeof *mesh.texcoords);
    mesh.materials = calloc(2, sizeof *mesh.materials);
    struct fmt_tris_material material = {f->image, {1.0f, 0.0f, 0.0f}};
    scan_write(f->ctx, f->tris, &mesh, NULL, &material, 1, 4000);
    scan_mesh_free(&mesh);
    expect_failure(f, 10, 0.0, BSQ_ENOINPUT, "texture.png");
}

/* ---- sums ---- */

static void test_a_million_triangles_in_one_voxel(void **state)
{
    struct fixture *f = *state;
    /* Large ones that face up, then tiny ones of the same total area that lean: all must count. */
    const uint32_t tiny = 1000000;
    struct scan_mesh mesh = scan_mesh_new(4 + 3, 2 + tiny);
    set_quad(&mesh, 0, (double[3]){0, 0, 0.5}, (double[3]){0.9, 0, 0}, (double[3]){0, 0.9, 0});
    /* Area of each: 0.81 / 1e6; normal (1, 0, 1) / sqrt(2). */
    double side = sqrt(2.0 * 0.81e-6);
    set_vertex(&mesh, 4, 0.5, 0.5, 0.5);
    set_vertex(&mesh, 5, 0.5, 0.5 + side, 0.5);
    set_vertex(&mesh, 6, 0.5 - side / sqrt(2.0), 0.5, 0.5 + side / sqrt(2.0));
    for (uint32_t i = 0; i < tiny; i++)
        set_triangle(&mesh, 2 + i, 4, 5, 6);
    scan_write(f->ctx, f->tris, &mesh, NULL, NULL, 0, 65536);
    scan_mesh_free(&mesh);
    voxelize(f, 0, 1.0);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    struct fmt_nvdb_record record =
        fmt_nvdb_get(&grid, fmt_nvdb_find(&grid, (int32_t[3]){0, 0, 0}));
    struct bsq_vec3 n = bsq_oct_unpack(record.normal);
    /* The mean of two unit vectors 45 degrees apart leans by 22.5. */
    assert_true(fabs(atan2((double)n.x, (double)n.z) - acos(-1.0) / 8.0) < 1e-3);
    assert_true(fabs(coverage(record) - cos(acos(-1.0) / 8.0)) < 1.0 / 255.0);
    fmt_nvdb_close(f->ctx, &grid);
}

/* ---- same bytes ---- */

static void assert_same_file(const char *a, const char *b)
{
    struct bsq_ctx *ctx = make_context(16, 1);
    struct bsq_map x, y;
    assert_int_equal(bsq_map_open(ctx, a, &x), 0);
    assert_int_equal(bsq_map_open(ctx, b, &y), 0);
    assert_int_equal(x.size, y.size);
    assert_memory_equal(x.data, y.data, x.size);
    bsq_map_close(ctx, &x);
    bsq_map_close(ctx, &y);
    bsq_ctx_destroy(ctx);
}

static void check_same_bytes(const struct fixture *f, uint32_t resolution)
{
    static const struct {
        uint64_t mebibytes;
        unsigned threads;
    } ways[] = {{1024, 1}, {1024, 2}, {1024, 7}, {32, 1}, {128, 3}};
    for (size_t i = 0; i < sizeof ways / sizeof ways[0]; i++) {
        struct bsq_ctx *ctx = make_context(ways[i].mebibytes, ways[i].threads);
        struct vox_voxelize_options options = {
            .tris_path = f->tris,
            .grid_path = i == 0 ? f->grid : f->other,
            .resolution = resolution,
        };
        struct vox_voxelize_report report;
        int status = vox_voxelize(ctx, &options, &report);
        if (status != 0)
            print_message("%s\n", bsq_error(ctx));
        assert_int_equal(status, 0);
        assert_true(bsq_memory_high(ctx) <= ways[i].mebibytes << 20);
        assert_int_equal(bsq_memory_used(ctx), 0);
        bsq_ctx_destroy(ctx);
        if (i > 0)
            assert_same_file(f->grid, f->other);
    }
}

/* Triangles of all sizes everywhere: fills most voxels, so that small budgets work in parts. */
static void test_noise_gives_the_same_bytes(void **state)
{
    struct fixture *f = *state;
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
        set_triangle(&mesh, t, 3 * t, 3 * t + 1, 3 * t + 2);
    }
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    check_same_bytes(f, 100);
}

/* Parallel sheets, one in every layer (the last two share theirs): 2 million voxels in each of the regions, whose records alone
 * are more than the budget. */
static void test_solid_regions_in_little_memory(void **state)
{
    struct fixture *f = *state;
    const uint32_t size = 144;
    struct scan_mesh mesh = scan_mesh_new(4 * size, 2 * size);
    for (uint32_t i = 0; i < size; i++)
        set_quad(&mesh, i, (double[3]){0, 0, i + 0.5}, (double[3]){size, 0, 0},
                 (double[3]){0, size, 0});
    scan_write(f->ctx, f->tris, &mesh, NULL, NULL, 0, 64);
    scan_mesh_free(&mesh);
    static const struct {
        uint64_t mebibytes;
        unsigned threads;
    } ways[] = {{256, 2}, {20, 4}, {12, 1}};
    for (size_t i = 0; i < sizeof ways / sizeof ways[0]; i++) {
        struct bsq_ctx *ctx = make_context(ways[i].mebibytes, ways[i].threads);
        struct vox_voxelize_options options = {
            .tris_path = f->tris,
            .grid_path = i == 0 ? f->grid : f->other,
            .resolution = size,
        };
        struct vox_voxelize_report report;
        int status = vox_voxelize(ctx, &options, &report);
        if (status != 0)
            print_message("%s\n", bsq_error(ctx));
        assert_int_equal(status, 0);
        assert_int_equal(report.voxels, (uint64_t)size * size * (size - 1));
        assert_int_equal(report.lowers, 8);
        assert_true(bsq_memory_high(ctx) <= ways[i].mebibytes << 20);
        bsq_ctx_destroy(ctx);
        if (i > 0)
            assert_same_file(f->grid, f->other);
    }
}

static void test_sphere_gives_the_same_bytes(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_sphere(100.0, 0.7);
    scan_sort(&mesh);
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    check_same_bytes(f, 300);
    check_same_bytes(f, 40);
}

/* ---- far and wide ---- */

/* Voxels at both ends of the index, across many root tiles: nothing is held for what lies between.
 */
static void test_sparse_and_huge(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(6, 2);
    const double far = 1073741000.0 / 1024.0;
    for (int s = 0; s < 2; s++) {
        double x = s ? far : -far;
        set_vertex(&mesh, 3 * (uint32_t)s, x, x, x);
        set_vertex(&mesh, 3 * (uint32_t)s + 1, x + 0.125, x, x);
        set_vertex(&mesh, 3 * (uint32_t)s + 2, x, x + 0.125, x);
        set_triangle(&mesh, (uint32_t)s, 3 * (uint32_t)s, 3 * (uint32_t)s + 1, 3 * (uint32_t)s + 2);
    }
    scan_write(f->ctx, f->tris, &mesh, NULL, NULL, 0, 1);
    voxelize(f, 0, 1.0 / 1024.0);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    for (int s = 0; s < 2; s++) {
        int32_t at = (int32_t)floor((double)mesh.positions[3 * s][0] * 1024.0);
        assert_int_not_equal(fmt_nvdb_find(&grid, (int32_t[3]){at, at, at}), 0);
        assert_int_equal(fmt_nvdb_find(&grid, (int32_t[3]){at, at, at + 1}), 0);
    }
    scan_mesh_free(&mesh);
    fmt_nvdb_close(f->ctx, &grid);
}

/* A large origin must not cost precision: same voxels and records as without it. */
static void test_origin_only_moves_the_grid(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_sphere(10.0, 0.5);
    const double origin[3] = {500000.0, -4000000.0, 1024.0};
    scan_write(f->ctx, f->tris, &mesh, NULL, NULL, 0, 4000);
    struct vox_voxelize_report plain = voxelize(f, 64, 0.0);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    double translation[3];
    memcpy(translation, grid.info.translation, sizeof translation);
    fmt_nvdb_close(f->ctx, &grid);
    scan_write(f->ctx, f->tris, &mesh, origin, NULL, 0, 4000);
    scan_mesh_free(&mesh);
    struct vox_voxelize_report moved = voxelize(f, 64, 0.0);
    assert_int_equal(plain.voxels, moved.voxels);
    assert_int_equal(fmt_nvdb_open(f->ctx, f->grid, &grid), 0);
    for (int a = 0; a < 3; a++) {
        assert_true(fabs(grid.info.translation[a] - translation[a] - origin[a]) < 1e-9);
        assert_true(fabs(grid.info.scan_max[a] - origin[a] - 10.0) < 1e-9);
    }
    fmt_nvdb_close(f->ctx, &grid);
}

/* ---- errors ---- */

static void test_bad_sizes(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_mesh_new(4, 2);
    set_quad(&mesh, 0, (double[3]){0, 0, 0}, (double[3]){2, 0, 0}, (double[3]){0, 1, 0});
    write_scan(f, &mesh);
    expect_failure(f, 0, 0.0, BSQ_EUSAGE, "voxel size of 0");
    expect_failure(f, 0, -1.0, BSQ_EUSAGE, "voxel size of -1");
    expect_failure(f, 0, (double)NAN, BSQ_EUSAGE, "voxel size of");
    expect_failure(f, 0, 1e-10, BSQ_EUSAGE, "from index 0 to 20000000000 along x");
    expect_failure(f, 0, 1e-300, BSQ_EUSAGE, "from index 0 to 2e+300 along x");
    expect_failure(f, 2000000000, 0.0, BSQ_EUSAGE, "2000000000");

    set_quad(&mesh, 0, (double[3]){3, 4, 5}, (double[3]){0, 0, 0}, (double[3]){0, 0, 0});
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    expect_failure(f, 100, 0.0, BSQ_EDATA, "(3, 4, 5)");
    assert_int_equal(voxelize(f, 0, 1.0).voxels, 1);
}

static void test_missing_and_damaged_input(void **state)
{
    struct fixture *f = *state;
    expect_failure(f, 100, 0.0, BSQ_ENOINPUT, "scan.tris");
    struct scan_mesh mesh = scan_sphere(10.0, 0.5);
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    /* A byte in the middle of a chunk: found when it is loaded, with the output under way. */
    FILE *file = fopen(f->tris, "r+b");
    assert_non_null(file);
    assert_int_equal(fseek(file, 5000, SEEK_SET), 0);
    int byte = fgetc(file);
    assert_int_equal(fseek(file, 5000, SEEK_SET), 0);
    fputc(byte ^ 1, file);
    fclose(file);
    expect_failure(f, 100, 0.0, BSQ_EDATA, "scan.tris");
}

static void test_budget_too_small(void **state)
{
    struct fixture *f = *state;
    struct scan_mesh mesh = scan_sphere(10.0, 0.5);
    write_scan(f, &mesh);
    scan_mesh_free(&mesh);
    for (uint64_t kib = 64; kib <= 16384; kib *= 2) {
        struct bsq_ctx *ctx;
        struct bsq_ctx_options options = {.memory_bytes = kib << 10, .threads = 2};
        assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
        struct vox_voxelize_options what = {
            .tris_path = f->tris, .grid_path = f->other, .resolution = 100};
        struct vox_voxelize_report report;
        int status = vox_voxelize(ctx, &what, &report);
        if (kib == 64)
            assert_true(status == BSQ_EUSAGE || status == BSQ_ENOMEM);
        if (kib == 16384)
            assert_int_equal(status, 0);
        if (status != 0)
            assert_non_null(strstr(bsq_error(ctx), "budget"));
        assert_int_equal(bsq_memory_used(ctx), 0);
        bsq_ctx_destroy(ctx);
    }
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(test_sphere_touches_the_voxels_of_the_exact_one),
        TEST(test_sphere_records),
        TEST(test_box_that_ends_on_the_bounds),
        TEST(test_box_on_the_lattice_of_a_voxel_size),
        TEST(test_flat_scan),
        TEST(test_plate_thinner_than_a_voxel),
        TEST(test_second_sheet_is_the_smaller),
        TEST(test_vertex_normals_are_interpolated),
        TEST(test_vertex_colors_are_mixed_in_linear_light),
        TEST(test_materials_color_what_has_no_other),
        TEST(test_texture_is_sampled_where_the_piece_lies),
        TEST(test_missing_texture),
        TEST(test_a_million_triangles_in_one_voxel),
        TEST(test_noise_gives_the_same_bytes),
        TEST(test_solid_regions_in_little_memory),
        TEST(test_sphere_gives_the_same_bytes),
        TEST(test_sparse_and_huge),
        TEST(test_origin_only_moves_the_grid),
        TEST(test_bad_sizes),
        TEST(test_missing_and_damaged_input),
        TEST(test_budget_too_small),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
