/* test_bake_values.c - maps of lengths and positions: a sphere is baked onto a smaller sphere of
 * facets, from voxels and from triangles, and compared with the formula. */
#include <png.h>

#include "formats/image/exr_read.h"
#include "libbake/bake.h"
#include "tests/unit/image_file.h"
#include "tests/unit/test.h"
#include "tests/unit/libbake/analytic_grid.h"
#include "tests/unit/libbake/triangle_scan.h"

/* Radii of both spheres, in voxels of the grid. The low-poly sphere has quads from a tenth to nine
 * tenths of the way from pole to pole; the map has 3 x 6 texels a quad. */
static const double radius = 20, low_radius = 17;
enum { STEPS = 48, BANDS = 24, SIZE = 144, SCAN_STEPS = 400, SCAN_BANDS = 200 };
static const double pi = 3.14159265358979323846;

/* The scans: where the sphere is, and how far maps may be from the formula. */
struct scan {
    const char *scan, *low;
    double centre[3], tolerance;
    double bend; /* relative error of curvature */
    bool inward; /* the scan is wound inwards */
};
static const struct scan scans[] = {
    {"grid.nvdb", "low.obj", {70, -31, 45}, 0.02, 0.1, false},
    {"scan.tris", "low.obj", {70, -31, 45}, 0.002, 0.02, false},
    /* Steps of float32 are 0.03 here. */
    {"far.tris", "far.obj", {500000.123, 4400000.75, 45}, 0.002, 0.02, false},
};
enum { SCANS = sizeof scans / sizeof *scans };
static const struct scan inward_scans[] = {
    {"inward.nvdb", "low.obj", {70, -31, 45}, 0.02, 0.1, true},
    {"inward.tris", "low.obj", {70, -31, 45}, 0.002, 0.02, true},
};

/* ---- the scene ---- */

/* Computes the unit vector at texture coordinates in 0..1. */
static void direction_at(double u, double v, double out[3])
{
    double polar = pi * (0.9 - 0.8 * v), angle = 2 * pi * u;
    out[0] = sin(polar) * cos(angle);
    out[1] = sin(polar) * sin(angle);
    out[2] = cos(polar);
}

/* Computes the point of the low-poly sphere at texture coordinates, relative to its centre. */
static void low_point(double u, double v, double out[3])
{
    double column = floor(u * STEPS), row = floor(v * BANDS), corner[4][3];
    double a = u * STEPS - column, b = v * BANDS - row;
    for (int i = 0; i < 4; i++)
        direction_at((column + (i & 1)) / STEPS, (row + (i >> 1)) / BANDS, corner[i]);
    for (int k = 0; k < 3; k++) {
        double x = a > b ? corner[1][k] - corner[0][k] : corner[3][k] - corner[2][k];
        double y = a > b ? corner[3][k] - corner[1][k] : corner[2][k] - corner[0][k];
        out[k] = low_radius * (corner[0][k] + a * x + b * y);
    }
}

/* Writes the low-poly sphere, or with another radius its cage. */
static void write_low(const struct scan *scan, const char *name, double size)
{
    FILE *file = fopen(name, "w");
    assert_non_null(file);
    for (int j = 0; j <= BANDS; j++)
        for (int i = 0; i <= STEPS; i++) {
            double n[3];
            direction_at((double)i / STEPS, (double)j / BANDS, n);
            fprintf(file, "v %.15g %.15g %.15g\n", scan->centre[0] + size * n[0],
                    scan->centre[1] + size * n[1], scan->centre[2] + size * n[2]);
            fprintf(file, "vt %.9g %.9g\nvn %.9g %.9g %.9g\n", (double)i / STEPS, (double)j / BANDS,
                    n[0], n[1], n[2]);
        }
    for (int j = 0; j < BANDS; j++)
        for (int i = 0; i < STEPS; i++) {
            int a = j * (STEPS + 1) + i + 1, b = a + 1, c = a + STEPS + 1, d = c + 1;
            fprintf(file, "f %d/%d/%d %d/%d/%d %d/%d/%d\n", a, a, a, b, b, b, d, d, d);
            fprintf(file, "f %d/%d/%d %d/%d/%d %d/%d/%d\n", a, a, a, d, d, d, c, c, c);
        }
    fclose(file);
}

static void write_triangles(const struct scan *scan)
{
    const double origin[3] = {round(scan->centre[0]), round(scan->centre[1]), 45};
    struct triangle_scan sphere =
        triangle_scan_new((SCAN_STEPS + 1) * (SCAN_BANDS + 1), 2 * SCAN_STEPS * SCAN_BANDS);
    for (uint32_t v = 0; v < sphere.vertex_count; v++) {
        double polar = pi * (v / (SCAN_STEPS + 1)) / SCAN_BANDS;
        double angle = 2 * pi * (v % (SCAN_STEPS + 1) % SCAN_STEPS) / SCAN_STEPS;
        const double n[3] = {sin(polar) * cos(angle), sin(polar) * sin(angle), cos(polar)};
        for (int k = 0; k < 3; k++)
            sphere.positions[v][k] = (float)(scan->centre[k] + radius * n[k] - origin[k]);
    }
    for (uint32_t q = 0; q < SCAN_STEPS * SCAN_BANDS; q++) {
        uint32_t a = q / SCAN_STEPS * (SCAN_STEPS + 1) + q % SCAN_STEPS, c = a + SCAN_STEPS + 1;
        memcpy(sphere.triangles[2 * q], (uint32_t[3]){a, c, c + 1}, 12);
        memcpy(sphere.triangles[2 * q + 1], (uint32_t[3]){a, c + 1, a + 1}, 12);
        for (uint32_t t = 2 * q; scan->inward && t < 2 * q + 2; t++) {
            const uint32_t second = sphere.triangles[t][1];
            sphere.triangles[t][1] = sphere.triangles[t][2];
            sphere.triangles[t][2] = second;
        }
    }
    sphere.smooth = true;
    triangle_scan_write(&sphere, origin, 5000, scan->scan);
    triangle_scan_free(&sphere);
}

/* Adds a sphere whose surface faces its centre, with points along a spiral from pole to pole. */
static void add_inward_sphere(struct analytic_grid *grid, const struct scan *scan)
{
    enum { POINTS = 200000 };
    for (int i = 0; i < POINTS; i++) {
        const double z = 1 - (2 * i + 1.0) / POINTS, r = sqrt(1 - z * z), a = 2.399963 * i;
        const double out[3] = {r * cos(a), r * sin(a), z};
        double at[3], n[3];
        for (int k = 0; k < 3; k++) {
            at[k] = scan->centre[k] + radius * out[k];
            n[k] = -out[k];
        }
        analytic_grid_add(grid, at, n, 4 * pi * radius * radius / POINTS, NULL);
    }
}

static void write_grid(const struct scan *scan)
{
    struct analytic_grid *grid = analytic_grid_create();
    if (scan->inward)
        add_inward_sphere(grid, scan);
    else
        analytic_sphere(grid, scan->centre, radius, 8);
    analytic_grid_write(grid, false, scan->scan);
    analytic_grid_free(grid);
}

static int make_scene(void **state)
{
    (void)state;
    write_grid(&scans[0]);
    write_triangles(&scans[1]);
    write_triangles(&scans[2]);
    write_grid(&inward_scans[0]);
    write_triangles(&inward_scans[1]);
    write_low(&scans[1], scans[1].low, low_radius);
    write_low(&scans[2], scans[2].low, low_radius);
    return 0;
}

/* ---- baking ---- */

static struct bake_options options_for(const struct scan *scan, const char *output)
{
    struct bake_options options;
    bake_defaults(&options);
    options.scan_path = scan->scan;
    options.mesh_path = scan->low;
    options.output_path = output;
    options.maps = BAKE_MAP_HEIGHT | BAKE_MAP_POSITION | BAKE_MAP_CURVATURE;
    options.width = options.height = SIZE;
    options.samples = 1;
    options.device = "cpu";
    return options;
}

static struct bake_report bake(const struct bake_options *options, unsigned threads,
                               uint64_t memory)
{
    struct bsq_ctx *ctx = test_context(threads, memory);
    struct bake_report report = {.size = sizeof report};
    int status = bake_run(ctx, options, &report);
    if (status < 0)
        fail_msg("%s", bsq_error(ctx));
    assert_int_equal((bsq_temp_bytes(ctx) > 0), memory > 0);
    bake_report_free(&report);
    test_context_end(ctx);
    return report;
}

static struct fmt_exr_image take_exr(struct bsq_ctx *ctx, const char *name)
{
    struct fmt_exr_image image;
    assert_int_equal(fmt_exr_read(ctx, name, &image), 0);
    assert_int_equal(image.width, SIZE);
    unlink(name);
    return image;
}

static double sample(const struct fmt_exr_image *image, uint32_t texel, const char *channel)
{
    return (double)
        image->samples[(size_t)texel * image->channel_count + fmt_exr_channel(image, channel)];
}

static void position_at(const struct fmt_exr_image *image, uint32_t texel, double out[3])
{
    out[0] = sample(image, texel, "R");
    out[1] = sample(image, texel, "G");
    out[2] = sample(image, texel, "B");
}

static double length(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* ---- heights and positions ---- */

/* The normals of the low-poly sphere's corners are radial, so every ray is. */
static void check_texel(const struct scan *scan, const struct bake_value_encoding *encoding,
                        uint32_t texel, double height, const double position[3])
{
    double low[3], at[3], difference[3], displaced[3];
    low_point((texel % SIZE + 0.5) / SIZE, 1 - (texel / SIZE + 0.5) / SIZE, low);
    const double low_length = length(low);
    for (int k = 0; k < 3; k++) {
        at[k] = (encoding->origin[k] - scan->centre[k]) + position[k];
        difference[k] = at[k] - low[k] * radius / low_length;
        displaced[k] = low[k] * (1 + height / low_length) - at[k];
    }
    assert_true(fabs(height - (radius - low_length)) < scan->tolerance);
    assert_true(length(difference) < scan->tolerance);
    /* The height leads from the low-poly mesh to the position, up to rounding. */
    assert_true(length(displaced) < 1e-4);
}

TEST(test_values_are_those_of_the_formula)
{
    for (int s = 0; s < SCANS; s++) {
        struct bsq_ctx *ctx = test_context(1, 0);
        struct bake_options options = options_for(&scans[s], "<MAP>.exr");
        const struct bake_report report = bake(&options, 2, 0);
        const struct bake_value_encoding *encodings = report.encodings;
        struct fmt_exr_image height = take_exr(ctx, "height.exr");
        struct fmt_exr_image position = take_exr(ctx, "position.exr");
        struct fmt_exr_image curvature = take_exr(ctx, "curvature.exr");
        double largest = 0;
        assert_int_equal(report.misses, 0);
        assert_int_equal(report.covered_texels, SIZE * SIZE);
        for (uint32_t i = 0; i < SIZE * SIZE; i++) {
            double at[3], h = sample(&height, i, "Y");
            position_at(&position, i, at);
            check_texel(&scans[s], &encodings[4], i, h, at);
            assert_true(fabs(sample(&curvature, i, "Y") * radius - 1) < scans[s].bend);
            largest = fmax(largest, fabs(h));
        }
        assert_string_equal(fmt_exr_image_attribute(&height, "bisque:unit"), "mesh unit");
        assert_string_equal(fmt_exr_image_attribute(&height, "bisque:scale"), "1");
        assert_string_equal(fmt_exr_image_attribute(&position, "bisque:offset"), "0 0 0");
        assert_true(encodings[3].range == largest);
        assert_string_equal(fmt_exr_image_attribute(&curvature, "bisque:unit"), "1 / mesh unit");
        fmt_exr_image_free(ctx, &curvature);
        fmt_exr_image_free(ctx, &height);
        fmt_exr_image_free(ctx, &position);
        test_context_end(ctx);
    }
}

/* ---- skew maps ---- */

/* Returns the skew of a texel. */
static float skew_of(uint32_t texel)
{
    return (float)((texel % SIZE * 7 + texel / SIZE * 13) % 101) / 100;
}

static void write_skew(void)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    const struct fmt_image_options options = {
        .width = SIZE, .height = SIZE, .channel_count = 1, .type = FMT_FLOAT};
    struct fmt_image_writer *image;
    float row[SIZE];
    assert_int_equal(fmt_image_create(ctx, &fmt_exr_format, "skew.exr", &options, &image), 0);
    for (uint32_t texel = 0; texel < SIZE * SIZE; texel++) {
        row[texel % SIZE] = skew_of(texel);
        if (texel % SIZE == SIZE - 1)
            assert_int_equal(fmt_image_write_rows(image, row, 1), 0);
    }
    assert_int_equal(fmt_image_finish(image), 0);
    assert_int_equal(test_commit_image(image), 0);
    bsq_ctx_destroy(ctx);
}

/* Computes the unit normal of the facet at texture coordinates. */
static void facet_normal(double u, double v, double out[3])
{
    const double step = 1e-4;
    double at[3], right[3], up[3];
    /* Steps from the point towards the middle of the facet stay inside of it. */
    const double a = u * STEPS - floor(u * STEPS), b = v * BANDS - floor(v * BANDS);
    const double x = (a > b ? 2.0 / 3 : 1.0 / 3) > a ? step : -step;
    const double y = (a > b ? 1.0 / 3 : 2.0 / 3) > b ? step : -step;
    low_point(u, v, at);
    low_point(u + x, v, right);
    low_point(u, v + y, up);
    for (int k = 0; k < 3; k++) {
        const int p = (k + 1) % 3, q = (k + 2) % 3;
        out[k] = (right[p] - at[p]) * (up[q] - at[q]) - (right[q] - at[q]) * (up[p] - at[p]);
    }
    const double sign = out[0] * at[0] + out[1] * at[1] + out[2] * at[2] < 0 ? -1 : 1;
    const double size = sign * length(out);
    for (int k = 0; k < 3; k++)
        out[k] /= size;
}

/* Rays run along the blend of the smooth unit direction, which is radial here, and the facet's. */
static void check_skewed(const struct scan *scan, uint32_t texel, double height,
                         const double position[3])
{
    const double s = (double)skew_of(texel), u = (texel % SIZE + 0.5) / SIZE,
                 v = 1 - (texel / SIZE + 0.5) / SIZE;
    double low[3], n[3], d[3], off[3], along = 0, size;
    low_point(u, v, low);
    facet_normal(u, v, n);
    for (int k = 0; k < 3; k++)
        d[k] = (1 - s) * low[k] / length(low) + s * n[k];
    size = length(d);
    for (int k = 0; k < 3; k++)
        along += low[k] * d[k] / size;
    const double square = length(low) * length(low);
    const double expected = sqrt(along * along + radius * radius - square) - along;
    for (int k = 0; k < 3; k++)
        off[k] = position[k] - scan->centre[k] - low[k] - expected * d[k] / size;
    assert_true(fabs(height - expected) < scan->tolerance);
    assert_true(length(off) < scan->tolerance);
}

/* On a grid and on triangles, with a cage and without. */
TEST(test_skews_turn_rays)
{
    write_skew();
    write_low(&scans[1], "cage.obj", radius + 2);
    for (int i = 0; i < 4; i++) {
        struct bsq_ctx *ctx = test_context(1, 0);
        const struct scan *scan = &scans[i / 2];
        struct bake_options options = options_for(scan, "<MAP>.exr");
        options.maps = BAKE_MAP_HEIGHT | BAKE_MAP_POSITION;
        options.skew_path = "skew.exr";
        options.cage_path = i % 2 ? "cage.obj" : NULL;
        const struct bake_report report = bake(&options, 2, 0);
        struct fmt_exr_image height = take_exr(ctx, "height.exr");
        struct fmt_exr_image position = take_exr(ctx, "position.exr");
        assert_int_equal(report.misses, 0);
        for (uint32_t texel = 0; texel < SIZE * SIZE; texel++) {
            double at[3];
            position_at(&position, texel, at);
            check_skewed(scan, texel, sample(&height, texel, "Y"), at);
        }
        fmt_exr_image_free(ctx, &height);
        fmt_exr_image_free(ctx, &position);
        test_context_end(ctx);
    }
    unlink("skew.exr");
    unlink("cage.obj");
}

/* Means of many samples are as exact as single samples. */
CONTEXT_TEST(test_means_lose_no_precision, 1, 0)
{
    struct bake_options options = options_for(&scans[0], "p.exr");
    options.maps = BAKE_MAP_POSITION;
    options.width = options.height = 1;
    options.samples = BAKE_MAX_SAMPLES;
    bake(&options, 1, 0);
    struct fmt_exr_image image;
    assert_int_equal(fmt_exr_read(ctx, "p.exr", &image), 0);
    /* The mean over whole turns is the axis; float32 has steps of 7.6e-6 at 70. */
    assert_true(fabs(sample(&image, 0, "R") - scans[0].centre[0]) < 1e-4);
    assert_true(fabs(sample(&image, 0, "G") - scans[0].centre[1]) < 1e-4);
    assert_true(fabs(sample(&image, 0, "B") - scans[0].centre[2]) < 1e-4);
    fmt_exr_image_free(ctx, &image);
    unlink("p.exr");
}

/* ---- scans that are wound inwards ---- */

/* With two_sided, the back of a surface that faces away is a front: normals and curvature have the
 * signs of a scan that is wound outwards, like the secondary rays. */
TEST(test_backs_are_fronts_if_both_sides_count)
{
    for (int s = 0; s < 2; s++) {
        const struct scan *scan = &inward_scans[s];
        struct bsq_ctx *ctx = test_context(1, 0);
        struct bake_options options = options_for(scan, "<MAP>.exr");
        options.two_sided = true;
        options.normal_space = BAKE_OBJECT_SPACE;
        options.front = options.back = 6;
        options.ao_rays = options.thickness_rays = 4;
        options.maps =
            BAKE_MAP_NORMAL | BAKE_MAP_CURVATURE | BAKE_MAP_AO | BAKE_MAP_BENT | BAKE_MAP_THICKNESS;
        bake(&options, 2, 0);
        struct fmt_exr_image curvature = take_exr(ctx, "curvature.exr");
        struct fmt_exr_image maps[4] = {take_exr(ctx, "normal.exr"), take_exr(ctx, "bent.exr"),
                                        take_exr(ctx, "ao.exr"), take_exr(ctx, "thickness.exr")};
        for (uint32_t i = 0; i < SIZE * SIZE; i++) {
            double n[3], low[3];
            low_point((i % SIZE + 0.5) / SIZE, 1 - (i / SIZE + 0.5) / SIZE, low);
            for (int m = 0; m < 2; m++) {
                position_at(&maps[m], i, n);
                const double along =
                    (2 * n[0] - 1) * low[0] + (2 * n[1] - 1) * low[1] + (2 * n[2] - 1) * low[2];
                assert_true(along / length(low) > (m == 0 ? 0.99 : 0.5));
            }
            assert_true(fabs(sample(&curvature, i, "Y") * radius - 1) < scan->bend);
            assert_true(sample(&maps[2], i, "Y") == 1);
            assert_true(fabs(sample(&maps[3], i, "Y") / radius - 4 / 3.0) < 0.5);
        }
        fmt_exr_image_free(ctx, &curvature);
        for (int m = 0; m < 4; m++)
            fmt_exr_image_free(ctx, &maps[m]);
        test_context_end(ctx);
    }
}

/* ---- PNG ---- */

struct png_image {
    png_structp png;
    png_infop info;
};

static struct png_image take_png(const char *name)
{
    struct png_image image;
    FILE *file = fopen(name, "rb");
    assert_non_null(file);
    image.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    image.info = png_create_info_struct(image.png);
    png_init_io(image.png, file);
    png_read_png(image.png, image.info, PNG_TRANSFORM_IDENTITY, NULL);
    fclose(file);
    unlink(name);
    return image;
}

/* Returns the first number of a text. */
static double png_number(const struct png_image *image, const char *key)
{
    png_textp texts;
    const int count = png_get_text(image->png, image->info, &texts, NULL);
    for (int i = 0; i < count; i++)
        if (strcmp(texts[i].key, key) == 0)
            return strtod(texts[i].text, NULL);
    fail_msg("no text %s", key);
    return NAN;
}

/* Checks that all samples of a PNG stand for the values of the EXR, up to half a step. */
static void check_png(struct bsq_ctx *ctx, const char *map, const struct bake_value_encoding *exr,
                      const struct bake_value_encoding *png)
{
    static const char *const names[2][3] = {{"Y", NULL, NULL}, {"R", "G", "B"}};
    char name[32];
    snprintf(name, sizeof name, "%s.exr", map);
    struct fmt_exr_image raw = take_exr(ctx, name);
    snprintf(name, sizeof name, "%s.png", map);
    struct png_image image = take_png(name);
    const png_bytepp rows = png_get_rows(image.png, image.info);
    assert_int_equal(png_get_bit_depth(image.png, image.info), 16);
    assert_true(fabs(png_number(&image, "bisque:scale") - png->scale[0]) < 1e-8 * png->scale[0]);
    assert_true(fabs(png_number(&image, "bisque:offset") - png->offset[0]) < 1e-6);
    for (uint32_t i = 0; i < SIZE * SIZE; i++)
        for (uint32_t c = 0; c < png->channels; c++) {
            const png_bytep at = rows[i / SIZE] + 2 * (i % SIZE * png->channels + c);
            const double stored = (at[0] << 8 | at[1]) / 65535.0;
            const double low = (png->origin[c] - exr->origin[c]) + png->offset[c];
            const double high = low + png->scale[c], step = png->scale[c] / 65535;
            const double value = sample(&raw, i, names[png->channels == 3][c]);
            /* Values out of range are cut off. */
            const double expected = fmin(fmax(value, low), high);
            assert_true(fabs(low + png->scale[c] * stored - expected) <
                        0.51 * step + 2e-7 * fabs(value));
        }
    png_destroy_read_struct(&image.png, &image.info, NULL);
    fmt_exr_image_free(ctx, &raw);
}

TEST(test_png_files_decode_to_the_values)
{
    for (int s = 0; s < SCANS; s++)
        for (int variant = 0; variant < 2; variant++) {
            struct bsq_ctx *ctx = test_context(1, 0);
            struct bake_options raw = options_for(&scans[s], "<MAP>.exr");
            struct bake_options scaled = options_for(&scans[s], "<MAP>.png");
            scaled.height_range = variant == 0 ? -1 : 5;
            scaled.curvature_range = variant == 0 ? -1 : 0.1;
            scaled.position_in = variant == 0 ? BAKE_IN_SPHERE : BAKE_IN_BOX;
            const struct bake_report exr = bake(&raw, 1, 0), png = bake(&scaled, 1, 0);
            assert_true(png.encodings[3].range == (variant == 0 ? exr.encodings[3].range : 5));
            assert_true(fabs(png.encodings[4].range - (variant == 0 ? sqrt(3) : 1) * radius) <
                        0.01);
            check_png(ctx, "height", &exr.encodings[3], &png.encodings[3]);
            assert_true(png.encodings[5].range == (variant == 0 ? exr.encodings[5].range : 0.1));
            check_png(ctx, "curvature", &exr.encodings[5], &png.encodings[5]);
            check_png(ctx, "position", &exr.encodings[4], &png.encodings[4]);
            test_context_end(ctx);
        }
}

/* ---- determinism ---- */

RUN_TESTS(make_scene, NULL)
