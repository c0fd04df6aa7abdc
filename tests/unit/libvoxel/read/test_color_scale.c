/* Tests which scale colours get, and that their order does not matter. */
#include "libvoxel/read/scan.h"
#include "tests/unit/test.h"

static float scale_of(const float *values, uint64_t count)
{
    struct color_votes all = {0}, forward = {0}, backward = {0};
    float colors[64][3] = {{0}};
    assert_true(count <= 64);
    for (uint64_t i = 0; i < count; i++)
        colors[i][i % 3] = values[i];
    vox_color_votes_add(&all, colors, count);
    for (uint64_t i = 0; i < count; i++) {
        vox_color_votes_add(&forward, colors + i, 1);
        vox_color_votes_add(&backward, colors + count - 1 - i, 1);
    }
    assert_memory_equal(&all, &forward, sizeof all);
    assert_memory_equal(&all, &backward, sizeof all);
    return vox_color_votes_scale(&all);
}
#define SCALE(...)                                                                                 \
    (double)scale_of((const float[]){__VA_ARGS__}, sizeof((float[]){__VA_ARGS__}) / sizeof(float))

TEST(black_and_pure_colors_do_not_tell)
{
    assert_true(SCALE(0) == 0);
    assert_true(SCALE(0, -0.0f, -1, -0.5f) == 0);
    assert_true(SCALE(0, 1, 0) == 0);
    assert_true(SCALE(2, 1) == 0);
}

TEST(whole_values_tell)
{
    assert_true(SCALE(1, 0, 3) == 1);
    assert_true(SCALE(255, 0, 1, 1, 1, 1) == 1);
}

TEST(fractions_tell)
{
    assert_true(SCALE(0.5f) == 255);
    assert_true(SCALE(1, 1.0001f) == 255);
    assert_true(SCALE(0.5f, 3, 16) == 255); /* bright spots */
    assert_true(SCALE(0.5f, 16.5f) == 1);
    assert_true(SCALE(127.5f, 3.5f) == 1);
    assert_true(SCALE(1e30f) == 1);
}

/* Values that are too large count if there is one for each thousand fractions. */
TEST(damage_does_not_tell)
{
    static float colors[5000][3];
    (void)state;
    for (uint64_t damaged = 0; damaged < 8; damaged++) {
        struct color_votes votes = {0};
        for (uint64_t i = 0; i < 5000; i++)
            colors[i][1] = i < damaged ? 1e10f : 0.25f;
        vox_color_votes_add(&votes, colors, 5000);
        assert_int_equal(votes.bright, damaged);
        assert_int_equal(votes.fractional, 5000 - damaged);
        assert_true(vox_color_votes_scale(&votes) == (damaged < 5 ? 255.0f : 1.0f));
    }
}

RUN_TESTS(NULL, NULL)
