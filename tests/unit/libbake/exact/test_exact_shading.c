/* test_exact_shading.c - normals and colours of hits. */
#include "base/geometry/vec.h"
#include "tests/unit/image_file.h"
#include "tests/unit/test.h"
#include "tests/unit/libbake/exact/exact_fixture.h"

/* ---- normals ---- */

/* Sums the area-weighted normals of the whole mesh, in the order of its triangles. */
static double (*smooth_normals(const struct triangle_scan *mesh))[3]
{
    double(*sums)[3] = calloc(mesh->vertex_count, sizeof *sums);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles[t];
        double e[2][3];
        for (int i = 0; i < 2; i++)
            for (int k = 0; k < 3; k++)
                e[i][k] = (double)mesh->positions[v[i + 1]][k] - (double)mesh->positions[v[0]][k];
        for (int k = 0; k < 3; k++) {
            double c =
                e[0][(k + 1) % 3] * e[1][(k + 2) % 3] - e[0][(k + 2) % 3] * e[1][(k + 1) % 3];
            for (int i = 0; i < 3; i++)
                sums[v[i]][k] += c;
        }
    }
    return sums;
}

/* A hit at a vertex has its normal, even if the vertex lies on the border of chunks. */
TEST(test_smooth_normals_across_borders)
{
    struct triangle_scan mesh = exact_torus(60, 40);
    mesh.smooth = true;
    double(*expected)[3] = smooth_normals(&mesh);
    struct bake_ray *rays = calloc(mesh.vertex_count, sizeof *rays);
    struct bake_hit *hits = calloc(mesh.vertex_count, sizeof *hits);
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        memcpy(rays[v].origin, mesh.positions[v], 12);
        double to[3];
        for (int k = 0; k < 3; k++)
            to[k] = (double)mesh.positions[v][k] + expected[v][k];
        exact_toward(rays[v].origin, to, rays[v].direction);
    }
    for (uint32_t chunk = 7; chunk < 8000; chunk *= 5) {
        struct exact_setup setup = {.threads = 2, .t_min = -0.01, .t_max = 0.01};
        exact_write_scan(&mesh, chunk);
        exact_trace(&setup, rays, mesh.vertex_count, hits);
        for (uint32_t v = 0; v < mesh.vertex_count; v++) {
            double length = sqrt(expected[v][0] * expected[v][0] + expected[v][1] * expected[v][1] +
                                 expected[v][2] * expected[v][2]);
            assert_true(hits[v].t == 0.0);
            for (int k = 0; k < 3; k++)
                assert_true(fabs((double)hits[v].normal[k] - expected[v][k] / length) < 1e-6);
        }
    }
    free(rays);
    free(hits);
    free(expected);
    triangle_scan_free(&mesh);
}

/* The file's normals are used unless facets are asked for; others are refused by name. */
TEST(test_normals_are_those_of_the_file)
{
    struct triangle_scan mesh = exact_torus(30, 20);
    struct bake_hit hits[BSQ_SCAN_NORMALS_FLAT + 1];
    const double to[3] = {0, 0, 0};
    struct bake_ray ray;
    for (int k = 0; k < 3; k++)
        ray.origin[k] = 1.1f * mesh.positions[0][k] - 0.3f * mesh.positions[31][k] +
                        0.2f * mesh.positions[1][k];
    exact_toward(ray.origin, to, ray.direction);
    mesh.smooth = true;
    exact_write_scan(&mesh, 100);
    for (unsigned w = 0; w <= BSQ_SCAN_NORMALS_FLAT; w++) {
        const struct exact_setup setup = {.threads = 2,
                                          .two_sided = true,
                                          .t_min = -9,
                                          .t_max = 9,
                                          .normals = (enum bsq_scan_normals)w};
        if (w == BSQ_SCAN_NORMALS_ANGLE || w == BSQ_SCAN_NORMALS_MAX)
            continue;
        exact_trace(&setup, &ray, 1, &hits[w]);
        assert_true(hits[w].triangle != BAKE_NO_HIT);
    }
    assert_memory_equal(hits[BSQ_SCAN_NORMALS_AUTO].normal, hits[BSQ_SCAN_NORMALS_AREA].normal, 12);
    assert_memory_not_equal(hits[BSQ_SCAN_NORMALS_AUTO].normal, hits[BSQ_SCAN_NORMALS_FLAT].normal,
                            12);
    struct bsq_ctx *ctx = test_context(1, 0);
    const struct bake_options options = {.scan_normals = BSQ_SCAN_NORMALS_ANGLE};
    struct bake_exact *exact;
    assert_int_equal(bake_exact_open(ctx, exact_scan_path, &options, &exact), BSQ_EUSAGE);
    assert_non_null(strstr(bsq_error(ctx), "--scan-normals angle"));
    bsq_ctx_destroy(ctx);
    triangle_scan_free(&mesh);
}

/* Returns a roof: two squares that meet in the ridge x = 0, where their vertices have different
 * colours. */
static struct triangle_scan make_roof(float height)
{
    const float corners[8][3] = {{-1, 0, 0}, {0, 0, height},    {0, 2, height},
                                 {-1, 2, 0}, {0, 0, height},    {1, 0, 0},
                                 {1, 2, 0},  {-0.0f, 2, height}};
    struct triangle_scan mesh = triangle_scan_new(8, 4);
    memcpy(mesh.positions, corners, sizeof corners);
    memcpy(mesh.triangles, (uint32_t[4][3]){{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}}, 48);
    mesh.attributes = FMT_TRIS_COLORS;
    mesh.smooth = true;
    for (uint32_t v = 4; v < 8; v++)
        mesh.colors[v] = 0xffffff;
    return mesh;
}

/* Seams repeat vertices with other attributes; normals must not show them. */
TEST(test_smooth_normals_ignore_repeated_vertices)
{
    const float height = 0.25f;
    struct triangle_scan mesh = make_roof(height);
    struct exact_setup setup = {.threads = 1, .t_min = -2, .t_max = 2};
    for (uint32_t chunk = 1; chunk <= 4; chunk++) {
        exact_write_scan(&mesh, chunk);
        /* One triangle of the left square and two of the right one meet at the ridge's front
         * vertex. */
        const double left[3] = {-0.5, 0, 2}, right[3] = {0.5, 0, 2};
        double sum[3], length = 0;
        for (int k = 0; k < 3; k++) {
            sum[k] = left[k] + 2 * right[k];
            length += sum[k] * sum[k];
        }
        struct bake_hit hit = exact_trace_one(&setup, 0, 0, 0, 1);
        assert_true(hit.t == (double)height);
        for (int k = 0; k < 3; k++)
            assert_true(fabs((double)hit.normal[k] - sum[k] / sqrt(length)) < 1e-6);
    }
    setup.normals = BSQ_SCAN_NORMALS_FLAT;
    struct bake_hit hit = exact_trace_one(&setup, 0.25f, 0.5f, 0, 1);
    assert_true(fabs((double)hit.normal[0] - 0.25 / sqrt(1.0625)) < 1e-6);
    triangle_scan_free(&mesh);
}

/* The sides of a steep roof keep their normals up to the ridge. */
TEST(test_smooth_normals_end_at_creases)
{
    struct triangle_scan mesh = make_roof(1);
    struct exact_setup setup = {.threads = 1, .t_min = -2, .t_max = 2};
    exact_write_scan(&mesh, 2);
    for (int side = -1; side <= 1; side += 2) {
        struct bake_hit hit = exact_trace_one(&setup, (float)side * 1e-3f, 1, 0, 1);
        assert_true(fabs((double)hit.normal[0] - side * sqrt(0.5)) < 1e-6);
        assert_true(fabs((double)hit.normal[2] - sqrt(0.5)) < 1e-6);
    }
    triangle_scan_free(&mesh);
}

TEST(test_vertex_normals_are_interpolated)
{
    struct triangle_scan mesh = exact_square();
    struct exact_setup setup = {.threads = 1, .t_min = -1, .t_max = 1};
    mesh.attributes = FMT_TRIS_NORMALS;
    for (int v = 0; v < 4; v++)
        mesh.normals[v] = bsq_oct_pack(v == 1 ? bsq_v3(0.6f, 0, 0.8f) : bsq_v3(0, 0, 1));
    exact_write_scan(&mesh, 1);
    struct bake_hit hit = exact_trace_one(&setup, 1.5f, 0.5f, 0, 1);
    /* Weights: 1/4 of (0 0), 1/2 of (2 0), 1/4 of (2 2). */
    const double x = 0.5 * 0.6, z = 0.5 * 0.8 + 0.5, length = sqrt(x * x + z * z);
    assert_true(fabs((double)hit.normal[0] - x / length) < 1e-4);
    assert_true(fabs((double)hit.normal[2] - z / length) < 1e-4);
    triangle_scan_free(&mesh);
}

/* ---- colours ---- */

static double linear(double srgb)
{
    return srgb <= 0.04045 ? srgb / 12.92 : pow((srgb + 0.055) / 1.055, 2.4);
}

static void expect_color(const struct bake_hit *hit, double r, double g, double b, double by)
{
    const double expected[3] = {r, g, b};
    for (int k = 0; k < 3; k++)
        if (!(fabs((double)hit->color[k] - expected[k]) <= by))
            fail_msg("channel %d is %g, not %g", k, (double)hit->color[k], expected[k]);
}

TEST(test_vertex_colors_mix_in_linear_light)
{
    struct triangle_scan mesh = exact_square();
    struct exact_setup setup = {.threads = 1, .color = true, .t_min = -1, .t_max = 1};
    mesh.attributes = FMT_TRIS_COLORS;
    mesh.colors[1] = 0xff0080ff; /* R 255, G 128, B 0 */
    exact_write_scan(&mesh, 2);
    struct bake_hit hit = exact_trace_one(&setup, 1.5f, 0.5f, 0, 1);
    expect_color(&hit, 0.5, 0.5 * linear(128 / 255.0), 0, 1e-6);
    triangle_scan_free(&mesh);
}

static void write_picture(uint32_t side)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    const struct fmt_image_options options = {
        .width = side, .height = side, .channel_count = 3, .type = FMT_UINT8, .color = true};
    struct fmt_image_writer *png;
    float *row = calloc(3 * side, sizeof *row);
    assert_int_equal(fmt_image_create(ctx, &fmt_png_format, "picture.png", &options, &png), 0);
    for (uint32_t y = 0; y < side;
         y++) { /* columns alternate black and white; blue is 1 in the upper half */
        for (uint32_t x = 0; x < side; x++) {
            row[3 * x] = row[3 * x + 1] = x % 2 ? 1.0f : 0.0f;
            row[3 * x + 2] = 2 * y < side ? 1.0f : 0.0f;
        }
        assert_int_equal(fmt_image_write_rows(png, row, 1), 0);
    }
    assert_int_equal(fmt_image_finish(png), 0);
    assert_int_equal(test_commit_image(png), 0);
    free(row);
    bsq_ctx_destroy(ctx);
}

TEST(test_textures_and_materials)
{
    struct triangle_scan mesh = exact_square();
    struct bake_footprint narrow = {{{0, 0, 0}, {0, 0, 0}}};
    struct bake_footprint wide = {{{0.25f, 0, 0}, {0, 0.001f, 0}}};
    struct exact_setup setup = {
        .threads = 1, .color = true, .t_min = -1, .t_max = 1, .footprint = &narrow};
    write_picture(64);
    mesh.attributes = FMT_TRIS_TEXCOORDS | FMT_TRIS_MATERIALS;
    mesh.material_count = 2;
    char picture[64];
    snprintf(picture, sizeof picture, "%s/picture.png", test_directory);
    mesh.material[0] = (struct fmt_tris_material){.texture_path = picture, .diffuse = {1, 1, 1}};
    mesh.material[1] = (struct fmt_tris_material){.diffuse = {0.5f, 1, 0}};
    mesh.materials[1] = 1;
    for (int v = 0; v < 4; v++)
        for (int k = 0; k < 2; k++)
            mesh.texcoords[v][k] = 0.5f * mesh.positions[v][k];
    exact_write_scan(&mesh, 1);
    /* Centres of texels of column 41, which is white, at low and at high v. */
    const float x = 2 * 41.5f / 64;
    struct bake_hit hit = exact_trace_one(&setup, x, 0.25f, 0, 1);
    expect_color(&hit, 1, 1, 0, 1e-3);
    hit = exact_trace_one(&setup, x, 1.25f, 0, 1);
    expect_color(&hit, 1, 1, 1, 1e-3);
    hit = exact_trace_one(&setup, x - 2 / 64.0f, 0.25f, 0, 1);
    expect_color(&hit, 0, 0, 0, 1e-3);
    setup.footprint = &wide; /* eight texels wide */
    hit = exact_trace_one(&setup, x, 0.25f, 0, 1);
    expect_color(&hit, 0.5, 0.5, 0, 0.1);
    hit = exact_trace_one(&setup, 0.25f, 1.75f, 0, 1);
    expect_color(&hit, linear(0.5), 1, 0, 1e-6);
    triangle_scan_free(&mesh);
}

int main(void)
{
    print_message("seed %llu\n", (unsigned long long)exact_seed);
    return test_run(NULL, NULL);
}
