/* test_compare.c - colour differences against published values, figures against maps of known
 * errors. */
#include "base/colour_difference.h"
#include "libbake/compare/comparison.h"
#include "tests/unit/image_file.h"
#include "tests/unit/test.h"

/* Pairs and differences from table 1 of Sharma, Wu & Dalal 2005. */
TEST(ciede2000_matches_published_values)
{
    static const double pairs[][7] = {
        {50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425},
        {50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615},
        {50.0000, 2.8361, -74.0200, 50.0000, 0.0000, -82.7485, 3.4412},
        {50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000},
        {50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669},
        {50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792},
        {50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195},
        {50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065},
        {50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492},
        {50.0000, 2.5000, 0.0000, 61.0000, -5.0000, 29.0000, 22.8977},
        {50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030},
        {50.0000, 2.5000, 0.0000, 58.0000, 24.0000, 15.0000, 19.4535},
        {60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644},
        {22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373},
        {90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441},
        {2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082},
    };
    for (unsigned i = 0; i < sizeof pairs / sizeof *pairs; i++) {
        assert_true(fabs(bsq_ciede2000(pairs[i], pairs[i] + 3) - pairs[i][6]) < 1e-4);
        assert_true(fabs(bsq_ciede2000(pairs[i] + 3, pairs[i]) - pairs[i][6]) < 1e-4);
    }
}

TEST(lab_of_known_colours)
{
    double lab[3];
    bsq_lab((const float[3]){1, 1, 1}, lab);
    assert_true(fabs(lab[0] - 100) < 1e-6 && fabs(lab[1]) < 1e-6 && fabs(lab[2]) < 1e-6);
    bsq_lab((const float[3]){0, 0, 0}, lab);
    assert_true(fabs(lab[0]) < 1e-6);
    /* 18.42 % reflectance is mid grey: L* = 50. */
    bsq_lab((const float[3]){0.1842f, 0.1842f, 0.1842f}, lab);
    assert_true(fabs(lab[0] - 50) < 0.01);
    /* Rec. 709 red: L* 53.24, a* 80.09, b* 67.20. */
    bsq_lab((const float[3]){1, 0, 0}, lab);
    assert_true(fabs(lab[0] - 53.24) < 0.01 && fabs(lab[1] - 80.09) < 0.02 &&
                fabs(lab[2] - 67.20) < 0.02);
}

/* ---- maps of known errors ---- */

enum { WIDTH = 10, HEIGHT = 10 };

/* Writes a map whose texel i holds value(i), with `map` as its attribute bisque:map unless NULL.
 * Returns its path. */
static const char *write_map(struct bsq_ctx *ctx, const char *name, uint32_t channels,
                             void (*value)(unsigned i, float *out), const char *map)
{
    const struct fmt_image_attribute attribute = {"bisque:map", map};
    const struct fmt_image_options options = {.width = WIDTH,
                                              .height = HEIGHT,
                                              .channel_count = channels,
                                              .type = FMT_FLOAT,
                                              .attributes = &attribute,
                                              .attribute_count = map ? 1 : 0};
    struct fmt_image_writer *writer;
    float samples[WIDTH * HEIGHT * 3];
    for (unsigned i = 0; i < WIDTH * HEIGHT; i++)
        value(i, samples + i * channels);
    assert_int_equal(fmt_image_create(ctx, &fmt_exr_format, name, &options, &writer), 0);
    assert_int_equal(fmt_image_write_rows(writer, samples, HEIGHT), 0);
    assert_int_equal(test_commit_image(writer), 0);
    return name;
}

static void upright(unsigned i, float *out)
{
    (void)i;
    out[0] = out[1] = 0.5f, out[2] = 1;
}

/* A normal tilted by i / 10 degrees. */
static void tilted(unsigned i, float *out)
{
    double angle = i / 10.0 * 3.14159265358979 / 180;
    out[0] = (float)(sin(angle) / 2 + 0.5), out[1] = 0.5f, out[2] = (float)(cos(angle) / 2 + 0.5);
}

static void upper_half(unsigned i, float *out)
{
    *out = i < 60;
}

static void lower_half(unsigned i, float *out)
{
    *out = i >= 40;
}

static void ramp(unsigned i, float *out)
{
    *out = (float)i;
}

static void steeper_ramp(unsigned i, float *out)
{
    *out = 2 * (float)i;
}

static void compare_two(struct bsq_ctx *ctx, const char *a, const char *b,
                        struct bake_compare_report *out)
{
    const struct bake_compare_options options = {.size = sizeof options, .a_path = a, .b_path = b};
    assert_int_equal(bake_compare(ctx, &options, out), 0);
}

CONTEXT_TEST(angles_have_the_right_distribution, 2, 64 << 20)
{
    struct bake_compare_report r = {.size = sizeof r};
    const char *a = write_map(ctx, "a.exr", 3, tilted, "normal"),
               *b = write_map(ctx, "b.exr", 3, upright, "normal");
    compare_two(ctx, a, b, &r);
    assert_int_equal(r.kind, BAKE_COMPARE_NORMAL);
    assert_int_equal(r.compared, 100);
    assert_true(fabs(r.mean - 4.95) < 1e-3);
    assert_true(fabs(r.median - 4.9) < 1e-3);
    assert_true(fabs(r.p95 - 9.4) < 1e-3);
    assert_true(fabs(r.p99 - 9.8) < 1e-3);
    assert_true(fabs(r.max - 9.9) < 1e-3);
    assert_true(r.max_x == 9 && r.max_y == 9);
    assert_true(fabs(r.above_5 - 0.49) < 0.011); /* 5.0 itself may round to either side */
}

CONTEXT_TEST(masks_give_the_agreement, 2, 64 << 20)
{
    struct bake_compare_report r = {.size = sizeof r};
    const char *a = write_map(ctx, "a.exr", 3, tilted, NULL),
               *b = write_map(ctx, "b.exr", 3, upright, NULL);
    const char *ma = write_map(ctx, "ma.exr", 1, upper_half, NULL),
               *mb = write_map(ctx, "mb.exr", 1, lower_half, NULL);
    struct bake_compare_options options = {.size = sizeof(struct bake_compare_options),
                                           .a_path = a,
                                           .b_path = b,
                                           .a_mask_path = ma,
                                           .b_mask_path = mb};
    assert_int_equal(bake_compare(ctx, &options, &r), 0);
    assert_int_equal(r.kind, BAKE_COMPARE_NORMAL); /* recognised by the values */
    assert_int_equal(r.compared, 20);
    assert_int_equal(r.only_a, 40);
    assert_int_equal(r.only_b, 40);
    assert_true(fabs(r.agreement - 0.2) < 1e-12);
    assert_true(fabs(r.mean - 4.95) < 1e-3); /* 4.0 .. 5.9 */
}

CONTEXT_TEST(data_has_absolute_and_relative_errors, 2, 64 << 20)
{
    struct bake_compare_report r = {.size = sizeof r};
    const char *a = write_map(ctx, "a.exr", 1, steeper_ramp, NULL),
               *b = write_map(ctx, "b.exr", 1, ramp, NULL);
    compare_two(ctx, a, b, &r);
    assert_int_equal(r.kind, BAKE_COMPARE_DATA);
    assert_true(fabs(r.mean - 49.5) < 1e-9);
    assert_true(fabs(r.relative_max - 0.5) < 1e-9);
    assert_true(fabs(r.relative_mean - 0.5 * 99 / 100) < 1e-9);
}

/* A ramp in which NaN and both infinities stand at 10, 20 and 30. */
static void spoiled_ramp(unsigned i, float *out)
{
    *out = i == 10 ? NAN : i == 20 ? INFINITY : i == 30 ? -INFINITY : (float)i + 1;
}

static void spoiled_mask(unsigned i, float *out)
{
    *out = i == 40 ? NAN : i >= 50 ? 0 : 1;
}

CONTEXT_TEST(values_that_are_not_finite_are_counted, 2, 64 << 20)
{
    struct bake_compare_report r = {.size = sizeof r};
    const char *a = write_map(ctx, "a.exr", 1, spoiled_ramp, NULL), *heat = "heat.png";
    const char *b = write_map(ctx, "b.exr", 1, ramp, NULL);
    const char *mask = write_map(ctx, "m.exr", 1, spoiled_mask, NULL);
    struct bake_compare_options options = {.size = sizeof(struct bake_compare_options),
                                           .a_path = a,
                                           .b_path = b,
                                           .heatmap_path = heat};
    for (int i = 0; i < 2; i++) {
        options.ignore_nan = i == 1;
        assert_int_equal(bake_compare(ctx, &options, &r), 0);
        assert_int_equal(r.compared, 97);
        assert_int_equal(r.not_finite, 3);
        assert_int_equal(r.not_finite_a, 3);
        assert_int_equal(r.not_finite_b, 0);
        assert_true(r.mean == 1 && r.rms == 1 && r.p99 == 1 && r.max == 1 && r.agreement == 1);
        assert_true(isfinite(r.relative_mean) && r.relative_max == 1);
    }
    options.b_mask_path = mask;
    assert_int_equal(bake_compare(ctx, &options, &r), 0);
    assert_int_equal(r.compared, 46);
    assert_int_equal(r.not_finite, 4);
    assert_int_equal(r.not_finite_a, 3);
    assert_int_equal(r.not_finite_b, 1);
    assert_int_equal(r.only_a, 50);
    assert_true(r.agreement == 0.5);
}

RUN_TESTS(NULL, NULL)
