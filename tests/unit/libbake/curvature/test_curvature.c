/* test_curvature.c - the mean curvature of surfaces that have a formula, from voxels and from
 * triangles: a sphere, a cylinder, a saddle and a torus. */
#include "libbake/curvature/curvature.h"
#include "tests/unit/test.h"
#include "tests/unit/libbake/analytic_grid.h"
#include "tests/unit/libbake/triangle_scan.h"

static const double pi = 3.14159265358979323846;
enum { WIDTH = 60, HEIGHT = 50, CHANNELS = 1 + 6, SCAN_STEPS = 300 };

/* A surface by two parameters from 0 to 1. Lengths are voxels of the grid. */
struct shape {
    const char *name;
    void (*point)(double u, double v, double out[3]);
    double (*curvature)(double u, double v);
    double border;    /* the map leaves out this share at the borders of v, and of u if open */
    bool closed;      /* in u */
    double tolerance; /* of triangles, in 1 / voxel */
    double voxel_tolerance; /* of voxels, for 95 % of the texels */
};

static void sphere(double u, double v, double out[3])
{
    const double polar = pi * (0.15 + 0.7 * v), angle = 2 * pi * u;
    out[0] = 24 * sin(polar) * cos(angle);
    out[1] = 24 * sin(polar) * sin(angle);
    out[2] = -24 * cos(polar);
}

static double sphere_curvature(double u, double v)
{
    (void)u;
    (void)v;
    return 1 / 24.0;
}

static void cylinder(double u, double v, double out[3])
{
    out[0] = 16 * cos(2 * pi * u);
    out[1] = 16 * sin(2 * pi * u);
    out[2] = 60 * v - 30;
}

static double cylinder_curvature(double u, double v)
{
    (void)u;
    (void)v;
    return 1 / 32.0;
}

/* z = (x^2 - y^2) / 80 has no mean curvature at its centre. */
static void saddle(double u, double v, double out[3])
{
    out[0] = 40 * u - 20;
    out[1] = 40 * v - 20;
    out[2] = (out[0] * out[0] - out[1] * out[1]) / 80;
}

/* From the derivatives of the height field (do Carmo, "Differential Geometry of Curves and
 * Surfaces", 1976, section 3-3), positive where the surface is convex from above. */
static double saddle_curvature(double u, double v)
{
    const double x = (40 * u - 20) / 40, y = -(40 * v - 20) / 40;
    const double square = 1 + x * x + y * y;
    return -((1 + y * y) / 40 - (1 + x * x) / 40) / (2 * square * sqrt(square));
}

static void torus(double u, double v, double out[3])
{
    const double ring = 30 + 12 * cos(2 * pi * v);
    out[0] = ring * cos(2 * pi * u);
    out[1] = ring * sin(2 * pi * u);
    out[2] = 12 * sin(2 * pi * v);
}

static double torus_curvature(double u, double v)
{
    (void)u;
    return (30 + 24 * cos(2 * pi * v)) / (24 * (30 + 12 * cos(2 * pi * v)));
}

/* Errors of voxels are those of their normals, about 0.2 degrees, over the distance of two points,
 * 4 voxels or less. */
static const struct shape shapes[] = {
    {"sphere", sphere, sphere_curvature, 0.15, true, 1e-5, 2e-3},
    {"cylinder", cylinder, cylinder_curvature, 0.15, true, 1e-5, 2e-3},
    {"saddle", saddle, saddle_curvature, 0.2, false, 1e-5, 2e-3},
    {"torus", torus, torus_curvature, 0, true, 8e-4, 2.5e-3},
};
enum { SHAPES = sizeof shapes / sizeof *shapes };

/* Computes the unit normal and returns the area of a unit of the parameters. */
static double normal_at(const struct shape *shape, double u, double v, double n[3])
{
    const double h = 1e-5;
    double a[2][3], b[2][3];
    for (int i = 0; i < 2; i++) {
        shape->point(u + (2 * i - 1) * h, v, a[i]);
        shape->point(u, v + (2 * i - 1) * h, b[i]);
    }
    for (int k = 0; k < 3; k++) {
        a[0][k] = (a[1][k] - a[0][k]) / (2 * h);
        b[0][k] = (b[1][k] - b[0][k]) / (2 * h);
    }
    for (int k = 0; k < 3; k++)
        n[k] = a[0][(k + 1) % 3] * b[0][(k + 2) % 3] - a[0][(k + 2) % 3] * b[0][(k + 1) % 3];
    const double area = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int k = 0; k < 3; k++)
        n[k] /= area;
    return area;
}

/* ---- scans ---- */

static const char *path_of(const struct shape *shape, bool exact)
{
    static char path[4][128];
    static int next;
    char *out = path[next = (next + 1) % 4];
    snprintf(out, sizeof path[0], "%s.%s", shape->name, exact ? "tris" : "nvdb");
    return out;
}

static void write_triangles(const struct shape *shape)
{
    const double origin[3] = {0, 0, 0};
    enum { ROW = SCAN_STEPS + 1 };
    struct triangle_scan scan = triangle_scan_new(ROW * ROW, 2 * SCAN_STEPS * SCAN_STEPS);
    for (uint32_t i = 0; i < ROW * ROW; i++) {
        double p[3];
        uint32_t column = i % ROW;
        column = shape->closed && column == SCAN_STEPS ? 0 : column;
        shape->point((double)column / SCAN_STEPS, (double)(i / ROW) / SCAN_STEPS, p);
        for (int k = 0; k < 3; k++)
            scan.positions[i][k] = (float)p[k];
    }
    for (uint32_t q = 0; q < SCAN_STEPS * SCAN_STEPS; q++) {
        uint32_t a = q / SCAN_STEPS * ROW + q % SCAN_STEPS, c = a + ROW;
        memcpy(scan.triangles[2 * q], (uint32_t[3]){a, a + 1, c + 1}, 12);
        memcpy(scan.triangles[2 * q + 1], (uint32_t[3]){a, c + 1, c}, 12);
    }
    scan.smooth = true;
    triangle_scan_write(&scan, origin, 5000, path_of(shape, true));
    triangle_scan_free(&scan);
}

static void write_grid(const struct shape *shape)
{
    enum { STEPS = 600 };
    struct analytic_grid *grid = analytic_grid_create();
    for (uint32_t i = 0; i < STEPS * STEPS; i++) {
        const double u = (i % STEPS + 0.5) / STEPS, v = ((double)(i / STEPS) + 0.5) / STEPS;
        double p[3], n[3];
        const double area = normal_at(shape, u, v, n) / STEPS / STEPS;
        shape->point(u, v, p);
        analytic_grid_add(grid, p, n, area, NULL);
    }
    analytic_grid_write(grid, false, path_of(shape, false));
    analytic_grid_free(grid);
}

static int make_scans(void **state)
{
    (void)state;
    for (int s = 0; s < SHAPES; s++) {
        write_triangles(&shapes[s]);
        write_grid(&shapes[s]);
    }
    return 0;
}

/* ---- measuring ---- */

static void parameters(const struct shape *shape, uint32_t texel, double *u, double *v)
{
    const double border = shape->border, side = shape->closed ? 0 : border;
    *u = side + (1 - 2 * side) * (texel % WIDTH + 0.5) / WIDTH;
    *v = border + (1 - 2 * border) * ((double)(texel / WIDTH) + 0.5) / HEIGHT;
}

/* Fills an image with points of the surface. Texel 7 has no value. */
static struct bake_image *make_image(struct bsq_ctx *ctx, const struct shape *shape,
                                     const struct bake_surface *surface, bool in_memory)
{
    const struct bake_image_options options = {.width = WIDTH,
                                               .height = HEIGHT,
                                               .channels = CHANNELS,
                                               .memory_bytes = in_memory ? UINT64_MAX : 0,
                                               .beside = path_of(shape, true)};
    struct bake_image *image;
    assert_int_equal(bake_image_create(ctx, &options, &image), 0);
    for (uint32_t i = 0; i < WIDTH * HEIGHT; i++) {
        double u, v, p[3], n[3];
        float texel[CHANNELS] = {i == 7 ? BAKE_MISSED : 1};
        parameters(shape, i, &u, &v);
        shape->point(u, v, p);
        normal_at(shape, u, v, n);
        for (int k = 0; k < 3; k++) {
            texel[1 + k] = (float)(p[k] - surface->translation[k]);
            texel[4 + k] = (float)n[k];
        }
        assert_int_equal(bake_image_write(image, i % WIDTH, i / WIDTH, 1, 1, texel), 0);
    }
    return image;
}

/* Measures the curvature of all texels of the image. device: name, or NULL. Returns the counts. */
static struct bake_curvature_counts measure(struct bsq_ctx *ctx, const struct shape *shape,
                                            bool exact, const char *device, bool in_memory,
                                            double radius, float *out)
{
    struct bake_options options;
    struct bake_surface surface;
    struct bake_curvature_counts counts = {0};
    float row[WIDTH * CHANNELS];
    bake_defaults(&options);
    options.scan_path = path_of(shape, exact);
    assert_int_equal(bake_surface_open(ctx, &options, &surface), 0);
    bake_surface_set_params(&surface, &options, BAKE_MAP_CURVATURE);
    struct bake_image *image = make_image(ctx, shape, &surface, in_memory);
    const struct bake_scene scene = {
        .grid = &surface.scans->grid, .patch_texels = 1, .params = surface.params};
    struct bake_curvature job = {
        .surface = &surface, .image = image, .offset = 1, .radius = radius};
    if (device)
        assert_int_equal(bake_device_open(ctx, device, &scene, &job.device), 0);
    assert_int_equal(bake_curvature_trace(ctx, &job, &counts), 0);
    bake_device_close(job.device);
    for (uint32_t y = 0; y < HEIGHT; y++) {
        const float *rows;
        assert_int_equal(bake_image_rows(image, y, 1, row, &rows), 0);
        for (uint32_t x = 0; x < WIDTH; x++)
            out[y * WIDTH + x] = rows[(size_t)x * CHANNELS + 1];
    }
    bake_image_free(image);
    bake_surface_close(&surface);
    return counts;
}

static void check_shape(const struct shape *shape, bool exact, double radius)
{
    struct bsq_ctx *ctx = test_context(2, 0);
    float *found = malloc(WIDTH * HEIGHT * sizeof *found);
    double *errors = malloc(WIDTH * HEIGHT * sizeof *errors), mean = 0;
    measure(ctx, shape, exact, NULL, true, radius, found);
    for (uint32_t i = 0; i < WIDTH * HEIGHT; i++) {
        double u, v;
        parameters(shape, i, &u, &v);
        errors[i] = i == 7 ? 0 : (double)found[i] - shape->curvature(u, v);
        mean += errors[i] / (WIDTH * HEIGHT);
        errors[i] = fabs(errors[i]);
    }
    qsort(errors, WIDTH * HEIGHT, sizeof *errors, analytic_by_value);
    const double p95 = errors[WIDTH * HEIGHT * 95 / 100], most = errors[WIDTH * HEIGHT - 1];
    print_message("%s, %s: mean %.2g, 95 %% %.2g, most %.2g\n", shape->name,
                  exact ? "triangles" : "voxels", mean, p95, most);
    if (exact)
        assert_true(most < shape->tolerance);
    else
        assert_true(p95 < shape->voxel_tolerance && fabs(mean) < 1e-3);
    free(errors);
    free(found);
    test_context_end(ctx);
}

TEST(test_triangles_have_the_curvature_of_the_formula)
{
    for (int s = 0; s < SHAPES; s++)
        check_shape(&shapes[s], true, 2);
}

TEST(test_voxels_have_the_curvature_of_the_formula)
{
    for (int s = 0; s < SHAPES; s++)
        check_shape(&shapes[s], false, 2);
}

/* With a device, each worker traces its texels by itself; without one, all trace them together. */
TEST(test_a_device_gives_the_same_bytes)
{
    static float together[WIDTH * HEIGHT], found[WIDTH * HEIGHT];
    for (int i = 0; i < 4; i++) {
        struct bsq_ctx *ctx = test_context(1 + i, 0);
        const struct bake_curvature_counts all =
            measure(ctx, &shapes[i % SHAPES], false, NULL, true, 2, together);
        const struct bake_curvature_counts counts =
            measure(ctx, &shapes[i % SHAPES], false, "cpu", i & 1, 2, found);
        assert_memory_equal(found, together, sizeof found);
        assert_memory_equal(&counts, &all, sizeof all);
        test_context_end(ctx);
    }
}

/* ---- edges ---- */

/* Writes a floor at z = 0 that ends at x = 0, with a wall there that goes up or down. */
static void write_edge(const char *path, float wall)
{
    const double origin[3] = {0, 0, 0};
    static const float corners[6][2] = {{-20, 0}, {-20, 0}, {0, 0}, {0, 0}, {0, 1}, {0, 1}};
    struct triangle_scan scan = triangle_scan_new(6, 4);
    for (int i = 0; i < 6; i++) {
        scan.positions[i][0] = corners[i][0];
        scan.positions[i][1] = i & 1 ? 20 : -20;
        scan.positions[i][2] = corners[i][1] * wall;
    }
    static const uint32_t triangles[4][3] = {{0, 2, 3}, {0, 3, 1}, {2, 4, 5}, {2, 5, 3}};
    memcpy(scan.triangles, triangles, sizeof triangles);
    triangle_scan_write(&scan, origin, 4, path);
    triangle_scan_free(&scan);
}

/* Measures the curvature at points of the floor with these distances from the edge. */
static void measure_edge(const char *path, const float *distances, uint32_t count, float *out)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct bake_options options;
    struct bake_surface surface;
    const struct bake_image_options shape = {.width = count,
                                             .height = 1,
                                             .channels = CHANNELS,
                                             .memory_bytes = UINT64_MAX,
                                             .beside = path};
    struct bake_curvature_counts counts = {0};
    struct bake_image *image;
    const float *texels;
    bake_defaults(&options);
    options.scan_path = path;
    options.scan_normals = BSQ_SCAN_NORMALS_FLAT;
    assert_int_equal(bake_surface_open(ctx, &options, &surface), 0);
    assert_int_equal(bake_image_create(ctx, &shape, &image), 0);
    for (uint32_t i = 0; i < count; i++) {
        const float texel[CHANNELS] = {1, -distances[i], 0, 0, 0, 0, 1};
        assert_int_equal(bake_image_write(image, i, 0, 1, 1, texel), 0);
    }
    const struct bake_curvature job = {
        .surface = &surface, .image = image, .offset = 1, .radius = 1};
    assert_int_equal(bake_curvature_trace(ctx, &job, &counts), 0);
    assert_int_equal(bake_image_rows(image, 0, 1, NULL, &texels), 0);
    for (uint32_t i = 0; i < count; i++)
        out[i] = texels[i * CHANNELS + 1];
    bake_image_free(image);
    bake_surface_close(&surface);
    test_context_end(ctx);
}

/* A right angle is white or black beside the edge, and leaves no trace beyond the radius. The rays
 * that find the wall lean. */
TEST(test_edges_are_found_on_both_sides)
{
    static const float distances[] = {0.05f, 0.2f, 0.4f, 0.6f, 0.8f, 1.1f, 3};
    enum { COUNT = sizeof distances / sizeof *distances };
    static const char path[] = "edge.tris";
    for (int convex = 0; convex < 2; convex++) {
        float found[COUNT];
        write_edge(path, convex ? -20 : 20);
        measure_edge(path, distances, COUNT, found);
        unlink(path);
        for (int i = 0; i < COUNT; i++) {
            const float value = convex ? found[i] : -found[i];
            print_message("%s, at %.2f: %.3f\n", convex ? "convex" : "concave",
                          (double)distances[i], (double)found[i]);
            assert_true(i < COUNT - 2 ? value > 0.1f : value == 0);
            assert_true(i == 0 || value <= (convex ? found[i - 1] : -found[i - 1]) + 1e-6f);
        }
        assert_true(fabsf(found[0]) > 0.6f); /* 1 / radius for a pair across, 0 along the edge */
    }
}

/* On a sphere, any two points have its curvature, so the points that are found suffice. Far outside
 * the sphere, none are. */
TEST(test_a_radius_that_leaves_the_scan_counts_texels_without_a_value)
{
    static const double radii[] = {25, 200};
    static float found[WIDTH * HEIGHT];
    for (int i = 0; i < 2; i++) {
        struct bsq_ctx *ctx = test_context(2, 0);
        const struct bake_curvature_counts counts =
            measure(ctx, &shapes[0], true, NULL, true, radii[i], found);
        assert_int_equal(counts.texels, WIDTH * HEIGHT - 1);
        assert_int_equal(counts.alone, i == 0 ? 0 : WIDTH * HEIGHT - 1);
        for (uint32_t t = 0; t < WIDTH * HEIGHT; t++)
            assert_true(t == 7 || fabs((double)found[t] - (i == 0 ? 1 / 24.0 : 0)) < 1e-4);
        test_context_end(ctx);
    }
}

RUN_TESTS(make_scans, NULL)
