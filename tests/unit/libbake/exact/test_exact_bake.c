/* test_exact_bake.c - whole bakes from triangles: a wavy sheet whose normals and colours are known
 * from a formula, and a square low-poly mesh below it. */
#include "formats/image/exr_read.h"
#include "libbake/bake.h"
#include "tests/unit/test.h"
#include "tests/unit/libbake/triangle_scan.h"
#include "tests/unit/sanitized.h"

enum { SIZE = 96, SIDE = 300 /* quads of the sheet */ };
static const double origin[3] = {500000.25, -31, 7};

static const char low_path[] = "low.obj";
static const char *const scan_paths[] = {
    "scan0.tris", "scan1.tris", "scan2.tris"}; /* the same sheet in chunks of different sizes */
static const uint32_t chunk_sizes[3] = {60000, 7001, 500};

/* The low-poly mesh spans 0 .. 1 x 0 .. 1 at height 0, the sheet 0.1 more on each side. */
static double height(double x, double y)
{
    return 0.05 + 0.02 * sin(9 * x) * cos(7 * y);
}

static void normal_at(double x, double y, double n[3])
{
    n[0] = -0.02 * 9 * cos(9 * x) * cos(7 * y);
    n[1] = 0.02 * 7 * sin(9 * x) * sin(7 * y);
    n[2] = 1;
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + 1);
    for (int k = 0; k < 3; k++)
        n[k] /= length;
}

/* ---- the scene ---- */

/* Returns the sheet. Red grows along x: sRGB code 255 x, clamped. */
static struct triangle_scan make_sheet(void)
{
    struct triangle_scan sheet = triangle_scan_new((SIDE + 1) * (SIDE + 1), 2 * SIDE * SIDE);
    for (uint32_t v = 0; v < sheet.vertex_count; v++) {
        double x = -0.1 + 1.2 * (v % (SIDE + 1)) / SIDE, y = -0.1 + 1.2 * (v / (SIDE + 1)) / SIDE;
        sheet.positions[v][0] = (float)x;
        sheet.positions[v][1] = (float)y;
        sheet.positions[v][2] = (float)height(x, y);
        sheet.colors[v] = (uint32_t)lrint(255 * fmin(fmax(x, 0), 1));
    }
    for (uint32_t q = 0; q < SIDE * SIDE; q++) {
        uint32_t a = q / SIDE * (SIDE + 1) + q % SIDE, b = a + SIDE + 1;
        memcpy(sheet.triangles[2 * q], (uint32_t[3]){a, a + 1, b + 1}, 12);
        memcpy(sheet.triangles[2 * q + 1], (uint32_t[3]){a, b + 1, b}, 12);
    }
    sheet.attributes = FMT_TRIS_COLORS;
    return sheet;
}

static int make_scene(void **state)
{
    (void)state;
    struct triangle_scan sheet = make_sheet();
    for (int i = 0; i < 3; i++) {
        triangle_scan_write(&sheet, origin, chunk_sizes[i], scan_paths[i]);
    }
    triangle_scan_free(&sheet);
    FILE *file = fopen(low_path, "w");
    for (int i = 0; i < 4; i++)
        fprintf(file, "v %.17g %.17g %.17g\nvt %d %d\n", origin[0] + (i & 1), origin[1] + (i >> 1),
                origin[2], i & 1, i >> 1);
    fprintf(file, "f 1/1 2/2 4/4 3/3\n");
    return fclose(file);
}

static struct bake_options options_for(int scan, const char *output)
{
    struct bake_options options;
    bake_defaults(&options);
    options.scan_path = scan_paths[scan];
    options.mesh_path = low_path;
    options.output_path = output;
    options.width = options.height = SIZE;
    options.sample_type = BAKE_FLOAT;
    return options;
}

static void bake(struct bsq_ctx *ctx, const struct bake_options *options,
                 struct bake_report *report)
{
    int status = bake_run(ctx, options, report);
    if (status < 0)
        print_message("%s\n", bsq_error(ctx));
    assert_int_equal(status, 0);
    bake_report_free(report);
}

static double channel(const struct fmt_exr_image *image, uint32_t x, uint32_t y, const char *name)
{
    return (double)image
        ->samples[((size_t)y * SIZE + x) * image->channel_count + fmt_exr_channel(image, name)];
}

/* ---- tests ---- */

/* Tangent and object space are the same for this low-poly mesh. */
TEST(test_maps_are_those_of_the_formula)
{
    struct bsq_ctx *ctx = test_context(2, 0);
    for (int space = 0; space < 2; space++) {
        struct bake_options options = options_for(1, "<MAP>.exr");
        struct bake_report report = {.size = sizeof report};
        struct fmt_exr_image normal, color;
        double worst = 0, worst_color = 0;
        options.normal_space = space == 0 ? BAKE_TANGENT_SPACE : BAKE_OBJECT_SPACE;
        options.samples = 1;
        bake(ctx, &options, &report);
        assert_int_equal(report.samples, SIZE * SIZE);
        assert_int_equal(report.hits, SIZE * SIZE);
        assert_int_equal(report.misses, 0);
        /* 1.5 times the largest height, and two details of 1.2 / 2048. */
        assert_true(report.front > 0.07 * 1.49 && report.front < 0.07 * 1.5 + 0.0012);
        assert_non_null(strstr(report.device, "exact"));
        assert_int_equal(fmt_exr_read(ctx, "normal.exr", &normal), 0);
        assert_int_equal(fmt_exr_read(ctx, "color.exr", &color), 0);
        assert_string_equal(fmt_exr_image_attribute(&normal, "bisque:sampling"), "exact");
        for (uint32_t i = 0; i < SIZE * SIZE; i++) {
            uint32_t column = i % SIZE, row = i / SIZE;
            double x = (column + 0.5) / SIZE, y = 1 - (row + 0.5) / SIZE, n[3], away = 0;
            normal_at(x, y, n);
            away += pow(2 * channel(&normal, column, row, "R") - 1 - n[0], 2);
            away += pow(2 * channel(&normal, column, row, "G") - 1 - n[1], 2);
            away += pow(2 * channel(&normal, column, row, "B") - 1 - n[2], 2);
            worst = fmax(worst, sqrt(away));
            double red = x <= 0.04045 ? x / 12.92 : pow((x + 0.055) / 1.055, 2.4);
            worst_color = fmax(worst_color, fabs(channel(&color, column, row, "R") - red));
        }
        /* Quads are 0.004 wide; colours are rounded to 1 / 255. */
        print_message("normals are off by %.2g at most, colours by %.2g\n", worst, worst_color);
        assert_true(worst < 5e-4);
        assert_true(worst_color < 5e-3);
        fmt_exr_image_free(ctx, &normal);
        fmt_exr_image_free(ctx, &color);
        unlink("normal.exr");
        unlink("color.exr");
    }
    test_context_end(ctx);
}

TEST(test_bytes_depend_on_neither_chunks_nor_threads_nor_budget)
{
    static const struct {
        int scan;
        unsigned threads;
        uint64_t memory;
    } cases[] = {{0, 1, 0}, {0, 3, 48 << 20}, {1, 2, 8 << 20}, {2, 4, 5 << 20}, {2, 1, 0}};
    uint64_t expected[3] = {0};
    for (unsigned c = 0; c < sizeof cases / sizeof *cases; c++) {
        static const char *const names[3] = {"normal.exr", "color.exr", "look.png"};
        struct bsq_ctx *ctx = test_context(cases[c].threads, cases[c].memory);
        struct bake_options options = options_for(cases[c].scan, "<MAP>.exr");
        struct bake_report report = {.size = sizeof report};
        options.samples = TEST_SANITIZED ? 1 : 3;
        if (cases[c].memory == 0 || cases[c].memory > 16 << 20)
            options.preview_path = "look.png";
        bake(ctx, &options, &report);
        if (cases[c].memory > 0)
            assert_true(bsq_memory_high(ctx) <= cases[c].memory);
        for (int i = 0; i < (options.preview_path ? 3 : 2); i++) {
            uint64_t hash = test_take_hash(names[i]);
            if (c == 0)
                expected[i] = hash;
            assert_true(hash == expected[i]);
        }
        test_context_end(ctx);
    }
}

TEST(test_flat_normals)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct bake_options options = options_for(0, "n.exr");
    struct bake_report report = {.size = sizeof report};
    struct fmt_exr_image image;
    options.maps = BAKE_MAP_NORMAL;
    options.samples = 1;
    options.scan_normals = BSQ_SCAN_NORMALS_FLAT;
    bake(ctx, &options, &report);
    assert_int_equal(fmt_exr_read(ctx, "n.exr", &image), 0);
    /* Finds the quad and the triangle that texel (10, 20) lies in. */
    double x = 10.5 / SIZE, y = 1 - 20.5 / SIZE, step = 1.2 / SIDE;
    double i = floor((x + 0.1) / step), j = floor((y + 0.1) / step);
    bool below = (x + 0.1) / step - i > (y + 0.1) / step - j;
    double x0 = -0.1 + i * step, y0 = -0.1 + j * step, z = height(x0, y0);
    double far_z = height(x0 + step, y0 + step);
    double dx = below ? height(x0 + step, y0) - z : far_z - height(x0, y0 + step);
    double dy = below ? far_z - height(x0 + step, y0) : height(x0, y0 + step) - z;
    double n[3] = {-dx / step, -dy / step, 1};
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + 1);
    assert_true(fabs(2 * channel(&image, 10, 20, "R") - 1 - n[0] / length) < 1e-4);
    assert_true(fabs(2 * channel(&image, 10, 20, "G") - 1 - n[1] / length) < 1e-4);
    fmt_exr_image_free(ctx, &image);
    unlink("n.exr");
    test_context_end(ctx);
}

static void expect_failure(const struct bake_options *options, int expected, const char *text)
{
    struct bsq_ctx *ctx = test_context(2, 0);
    struct bake_report report = {.size = sizeof report};
    assert_int_equal(bake_run(ctx, options, &report), expected);
    if (!strstr(bsq_error(ctx), text))
        fail_msg("\"%s\" has no \"%s\"", bsq_error(ctx), text);
    test_context_end(ctx);
}

TEST(test_errors_name_the_reason)
{
    struct bake_options options = options_for(0, "<MAP>.exr");
    options.sampling = BAKE_NEAREST;
    expect_failure(&options, BSQ_EUSAGE, "triangles");
    options = options_for(0, "<MAP>.exr");
    options.device = "opencl:0";
    expect_failure(&options, BSQ_EUSAGE, "opencl:0");
    options = options_for(0, "<MAP>.exr");
    options.front = options.back = 0.001;
    expect_failure(&options, BSQ_EDATA, "no ray hit");
    options = options_for(0, "<MAP>.exr");
    options.scan_path = low_path;
    expect_failure(&options, BSQ_EDATA, "low.obj");
    /* A chart that is too small to contain a sample. */
    FILE *file = fopen("tiny.obj", "w");
    fprintf(file, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5 0.5\nvt 0.5001 0.5\nvt 0.5 0.5001\n"
                  "f 1/1 2/2 3/3\n");
    fclose(file);
    options = options_for(0, "<MAP>.exr");
    options.mesh_path = "tiny.obj";
    expect_failure(&options, BSQ_EDATA, "no texel lies in a triangle");
    unlink("tiny.obj");
}

RUN_TESTS(make_scene, NULL)
