/* test_bake.c - whole bakes of a wavy sheet, compared with the formula of its normals. */
#include "formats/image/exr_read.h"
#include "libbake/bake.h"
#include "tests/unit/test.h"
#include "tests/unit/libbake/analytic_grid.h"

/* In voxels: half the width of the sheet, its wavelength, the depth of the low-poly square below
 * it, and half the width of the square. Its texture coordinates run from `margin` to 1 - margin. */
static const double half = 28, wavelength = 32, depth = 3, margin = 0.1, square = 20;
static const double centre[3] = {70, -31, 45};
enum { SIZE = 160, SAMPLES_A_VOXEL = 8 };

static const char grid_path[] = "grid.nvdb", low_path[] = "low.obj";
static struct analytic_sine sine;

/* ---- the scene ---- */

static void write_grid(void)
{
    struct analytic_grid *grid = analytic_grid_create();
    analytic_sine_add(grid, &sine, SAMPLES_A_VOXEL);
    analytic_grid_write(grid, false, grid_path);
    analytic_grid_free(grid);
}

/* Writes a square whose texture coordinates u are multiplied by `tiles`. */
static void write_square(const char *path, double tiles)
{
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    for (int i = 0; i < 4; ++i) {
        double point[3], u = i & 1 ? square : -square, v = i & 2 ? square : -square;
        analytic_sine_point(&sine, u, v, -depth, point);
        fprintf(file, "v %.9g %.9g %.9g\n", point[0], point[1], point[2]);
        fprintf(file, "vt %.9g %.9g\n", tiles * (i & 1 ? 1 - margin : margin),
                i & 2 ? 1 - margin : margin);
    }
    fprintf(file, "f 1/1 2/2 4/4 3/3\n");
    fclose(file);
}

static int make_scene(void **state)
{
    (void)state;
    sine = analytic_sine_make(wavelength, half, centre);
    write_grid();
    write_square(low_path, 1);
    return 0;
}

static struct bake_options options_for(const char *output)
{
    struct bake_options options;
    bake_defaults(&options);
    options.scan_path = grid_path;
    options.mesh_path = low_path;
    options.output_path = output;
    options.width = options.height = SIZE;
    options.padding = 4;
    options.device = "cpu";
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

static void read_map(struct bsq_ctx *ctx, const char *path, struct fmt_exr_image *image)
{
    assert_int_equal(fmt_exr_read(ctx, path, image), 0);
    assert_int_equal(image->width, SIZE);
    assert_int_equal(image->height, SIZE);
}

static void sample_map(const struct fmt_exr_image *image, uint32_t x, uint32_t y, double out[3])
{
    static const char *const names[3] = {"R", "G", "B"};
    for (int k = 0; k < 3; ++k)
        out[k] = (double)image->samples[((size_t)y * image->width + x) * image->channel_count +
                                        fmt_exr_channel(image, names[k])];
}

/* Finds where the centre of a texel lies on the sheet. Returns false if it is outside the chart,
 * or less than `inset` texels inside. */
static bool place(uint32_t x, uint32_t y, double inset, double *u, double *v)
{
    double s = (x + 0.5) / SIZE, t = 1 - (y + 0.5) / SIZE, low = margin + inset / SIZE;
    *u = ((s - margin) / (1 - 2 * margin) * 2 - 1) * square;
    *v = ((t - margin) / (1 - 2 * margin) * 2 - 1) * square;
    return s > low && s < 1 - low && t > low && t < 1 - low;
}

/* ---- options ---- */

TEST(test_a_device_that_the_library_chooses)
{
    bool given[BAKE_MOST_OPTION_ROWS];
    struct bake_options options = options_for("x.exr");
    struct bsq_ctx *ctx;
    size_t count;
    bake_option_rows(&count);
    memset(given, true, count);
    options.device = NULL;
    assert_int_equal(bsq_ctx_create(NULL, &ctx), 0);
    assert_int_equal(bake_inspect(ctx, &options, given, NULL, NULL), 0);
    bsq_ctx_destroy(ctx);
}

/* ---- normals ---- */

struct errors {
    double mean, largest;
};

/* Measures the angles in degrees between the normals of a map and those of the formula. */
static struct errors normal_errors(const struct fmt_exr_image *image, bool object, bool green_down)
{
    struct errors errors = {0, 0};
    uint64_t count = 0;
    for (uint32_t y = 0; y < SIZE; ++y)
        for (uint32_t x = 0; x < SIZE; ++x) {
            double u, v, m[3], n[3], expected[3], dot = 0, length = 0;
            if (!place(x, y, 1, &u, &v))
                continue;
            sample_map(image, x, y, m);
            for (int k = 0; k < 3; ++k)
                m[k] = 2 * m[k] - 1;
            if (green_down)
                m[1] = -m[1];
            /* The tangent, bitangent and normal of the square are the axes of the sheet. */
            for (int k = 0; k < 3; ++k)
                n[k] = object ? m[k]
                              : m[0] * sine.axes[0][k] + m[1] * sine.axes[1][k] +
                                    m[2] * sine.axes[2][k];
            analytic_sine_normal(&sine, u, v, expected);
            for (int k = 0; k < 3; ++k) {
                dot += n[k] * expected[k];
                length += n[k] * n[k];
            }
            assert_true(fabs(length - 1) < 1e-5);
            double angle = acos(fmin(dot / sqrt(length), 1)) * 180 / acos(-1);
            errors.mean += angle;
            errors.largest = fmax(errors.largest, angle);
            ++count;
        }
    errors.mean /= (double)count;
    return errors;
}

CONTEXT_TEST(test_normals_are_those_of_the_formula, 2, 0)
{
    for (int variant = 0; variant < 3; ++variant) {
        struct bake_options options = options_for("<MAP>.exr");
        options.green_down = variant == 1;
        options.normal_space = variant == 2 ? BAKE_OBJECT_SPACE : BAKE_TANGENT_SPACE;
        struct bake_report report = {.size = sizeof report};
        bake(ctx, &options, &report);
        assert_int_equal(report.misses, 0);
        assert_int_equal(report.low_triangles, 2);
        struct fmt_exr_image image;
        read_map(ctx, "normal.exr", &image);
        struct errors errors = normal_errors(&image, variant == 2, variant == 1);
        print_message("mean %.3f, largest %.3f degrees\n", errors.mean, errors.largest);
        assert_true(errors.mean < 0.3);
        assert_true(errors.largest < 1.5);
        assert_string_equal(fmt_exr_image_attribute(&image, "bisque:green"),
                            variant == 1 ? "down" : "up");
        fmt_exr_image_free(ctx, &image);
        unlink("normal.exr");
    }
}

CONTEXT_TEST(test_report_counts_samples, 2, 0)
{
    struct bake_options options = options_for("n.exr");
    options.samples = 3;
    struct bake_report report = {.size = sizeof report};
    bake(ctx, &options, &report);
    /* The chart covers (1 - 2 margin)^2 of the map. Its border lies between texels. */
    uint64_t side = (uint64_t)lrint(SIZE * (1 - 2 * margin));
    assert_int_equal(report.covered_texels, side * side);
    assert_int_equal(report.samples, side * side * 9);
    assert_int_equal(report.hits, report.samples);
    assert_int_equal(report.overlapping_samples, 0);
    /* The farthest point is depth + amplitude in front of the square; nothing is behind it. */
    double farthest = depth + sine.amplitude;
    assert_true(report.front > farthest && report.front < 1.5 * farthest + 2.1);
    assert_true(report.back >= 2 && report.back < 2.1);
    unlink("n.exr");
}

/* ---- colour, mask, padding ---- */

CONTEXT_TEST(test_misses_are_masked_and_filled, 2, 0)
{
    struct bake_options options = options_for("<MAP>.exr");
    options.maps = BAKE_MAP_NORMAL | BAKE_MAP_MASK;
    options.front = depth; /* rays do not reach the crests */
    options.back = 0;
    options.padding = UINT32_MAX;
    struct bake_report report = {.size = sizeof report};
    bake(ctx, &options, &report);
    assert_int_equal(report.hits + report.misses, report.samples);
    /* By symmetry half of the sheet lies below its middle; blending changes the share slightly. */
    assert_true(fabs((double)report.misses / (double)report.samples - 0.5) < 0.03);
    struct fmt_exr_image mask, normal;
    read_map(ctx, "mask.exr", &mask);
    read_map(ctx, "normal.exr", &normal);
    assert_int_equal(mask.channel_count, 1);
    for (uint32_t y = 0; y < SIZE; ++y)
        for (uint32_t x = 0; x < SIZE; ++x) {
            double u, v, n[3];
            float share = mask.samples[(size_t)y * SIZE + x];
            bool inside = place(x, y, 0, &u, &v);
            double height = analytic_sine_height(&sine, u, v);
            if (!inside || height > 0.4)
                assert_true(share == 0.0f);
            else if (height < -0.4)
                assert_true(share == 1.0f);
            sample_map(&normal, x, y, n);
            double length = 0; /* must be 1 everywhere, as padding fills the map */
            for (int k = 0; k < 3; ++k)
                length += (2 * n[k] - 1) * (2 * n[k] - 1);
            assert_true(fabs(length - 1) < 1e-5);
        }
    fmt_exr_image_free(ctx, &mask);
    fmt_exr_image_free(ctx, &normal);
    unlink("normal.exr");
    unlink("mask.exr");
}

CONTEXT_TEST(test_padding_surrounds_the_chart, 2, 0)
{
    struct bake_options options = options_for("n.exr");
    struct bake_report report = {.size = sizeof report};
    bake(ctx, &options, &report);
    struct fmt_exr_image image;
    read_map(ctx, "n.exr", &image);
    int low = (int)lrint(SIZE * margin), high = SIZE - 1 - low;
    for (int y = 0; y < SIZE; ++y)
        for (int x = 0; x < SIZE; ++x) {
            /* The nearest texel of the square chart. */
            int nx = x < low ? low : x > high ? high : x, ny = y < low ? low : y > high ? high : y;
            double got[3], expected[3] = {0.5, 0.5, 1};
            sample_map(&image, (uint32_t)x, (uint32_t)y, got);
            if ((nx - x) * (nx - x) + (ny - y) * (ny - y) <= 4 * 4)
                sample_map(&image, (uint32_t)nx, (uint32_t)ny, expected);
            for (int k = 0; k < 3; ++k)
                assert_true(got[k] == expected[k]);
        }
    fmt_exr_image_free(ctx, &image);
    unlink("n.exr");
}

/* ---- UDIM tiles ---- */

/* Compares a tile with the columns of a larger map from `first` on. */
static void compare_columns(struct bsq_ctx *ctx, const char *tile_path, const char *whole_path,
                            uint32_t first)
{
    struct fmt_exr_image tile, whole;
    double a[3], b[3];
    uint32_t seen = 0;
    assert_int_equal(fmt_exr_read(ctx, tile_path, &tile), 0);
    assert_int_equal(fmt_exr_read(ctx, whole_path, &whole), 0);
    assert_int_equal(whole.width, 2 * tile.width);
    for (uint32_t y = 0; y < tile.height; ++y)
        for (uint32_t x = 0; x < tile.width; ++x) {
            sample_map(&tile, x, y, a);
            sample_map(&whole, first + x, y, b);
            for (int k = 0; k < 3; ++k)
                assert_true(fabs(a[k] - b[k]) < 1e-5);
            seen += a[0] != 0.5 || a[1] != 0.5;
        }
    assert_true(seen > tile.width * tile.height / 2); /* not background alone */
    fmt_exr_image_free(ctx, &tile);
    fmt_exr_image_free(ctx, &whole);
}

/* Two tiles of a square that spans both are the halves of a map of twice the width. */
CONTEXT_TEST(test_tiles_are_parts_of_one_map, 2, 0)
{
    struct bake_options options = options_for("whole.exr");
    struct bake_report whole = {.size = sizeof whole}, tiles = {.size = sizeof tiles};
    const char *two_path = "two.obj";
    write_square(two_path, 2);
    options.maps = BAKE_MAP_NORMAL;
    options.padding = 0;
    options.width = 2 * SIZE;
    bake(ctx, &options, &whole);
    options.width = SIZE;
    options.mesh_path = two_path;
    options.output_path = "<UDIM>.exr";
    assert_int_equal(bake_run(ctx, &options, &tiles), 0);
    assert_int_equal(tiles.tile_count, 2);
    assert_int_equal(tiles.tiles[1].tile, 1002);
    bake_report_free(&tiles);
    assert_int_equal(tiles.covered_texels, whole.covered_texels);
    assert_int_equal(tiles.samples, whole.samples);
    assert_int_equal(tiles.hits, whole.hits);
    compare_columns(ctx, "1001.exr", "whole.exr", 0);
    compare_columns(ctx, "1002.exr", "whole.exr", SIZE);
    unlink("1001.exr");
    unlink("1002.exr");
    unlink("whole.exr");
    unlink("two.obj");
}

/* ---- rows ---- */

struct taken {
    float *samples[2]; /* of the normal map and the mask */
    uint32_t rows[2], refuse_at;
};

static int take_rows(void *user, const struct bake_rows *rows)
{
    struct taken *taken = user;
    const int mask = strcmp(rows->map, "mask") == 0;
    assert_string_equal(rows->path, mask ? "rows_mask.exr" : "rows_normal.exr");
    assert_int_equal(rows->channels, mask ? 1 : 3);
    assert_int_equal(rows->width, SIZE);
    assert_int_equal(rows->height, SIZE);
    assert_int_equal(rows->first, taken->rows[mask]);
    const size_t row = (size_t)SIZE * rows->channels;
    memcpy(taken->samples[mask] + rows->first * row, rows->samples,
           rows->count * row * sizeof(float));
    taken->rows[mask] += rows->count;
    return taken->rows[mask] > taken->refuse_at ? BSQ_EUSAGE : 0;
}

CONTEXT_TEST(test_rows_are_those_of_files, 2, 64 << 20)
{
    struct bake_options options = options_for("rows_<MAP>.exr");
    struct bake_report report = {.size = sizeof report};
    struct taken taken = {.refuse_at = SIZE};
    struct fmt_exr_image image;
    options.maps = BAKE_MAP_NORMAL | BAKE_MAP_MASK;
    options.on_rows = take_rows;
    options.rows_user = &taken;
    for (int k = 0; k < 2; k++)
        taken.samples[k] = calloc((size_t)SIZE * SIZE * 3, sizeof(float));
    bake(ctx, &options, &report);
    read_map(ctx, "rows_normal.exr", &image);
    for (uint32_t i = 0; i < SIZE * SIZE; i++) {
        double sample[3];
        sample_map(&image, i % SIZE, i / SIZE, sample);
        for (int k = 0; k < 3; k++)
            assert_true(sample[k] == (double)taken.samples[0][3 * i + (uint32_t)k]);
    }
    fmt_exr_image_free(ctx, &image);
    remove("rows_normal.exr");

    memset(taken.rows, 0, sizeof taken.rows);
    options.rows_only = true;
    bake(ctx, &options, &report);
    assert_int_equal(taken.rows[0], SIZE);
    assert_int_equal(access("rows_normal.exr", F_OK), -1);

    memset(taken.rows, 0, sizeof taken.rows);
    bsq_forget_files(ctx);
    taken.refuse_at = 0;
    assert_int_equal(bake_run(ctx, &options, &report), BSQ_EUSAGE);
    assert_non_null(strstr(bsq_error(ctx), "the rows were refused"));
    options.size--;
    bsq_clear_error(ctx);
    assert_int_equal(bake_run(ctx, &options, &report), BSQ_EUSAGE);
    assert_non_null(strstr(bsq_error(ctx), "struct bake_options has "));
    options.size++;
    report.size++;
    bsq_clear_error(ctx);
    assert_int_equal(bake_run(ctx, &options, &report), BSQ_EUSAGE);
    assert_non_null(strstr(bsq_error(ctx), "struct bake_report has "));
    free(taken.samples[0]);
    free(taken.samples[1]);
}

CONTEXT_TEST(test_opacity_needs_a_mask, 1, 0)
{
    const struct bake_transfer opacity = {.name = "opacity", .in_mask = true, .no_file = true};
    struct bake_report report = {.size = sizeof report};
    struct bake_options options = options_for("unmasked.exr");
    options.maps = BAKE_MAP_NORMAL;
    options.transfers = &opacity;
    options.transfer_count = 1;
    assert_int_equal(bake_run(ctx, &options, &report), BSQ_EUSAGE);
    assert_string_equal(bsq_error(ctx), "opacity is part of the mask, which is not baked");
}

RUN_TESTS(make_scene, NULL)
