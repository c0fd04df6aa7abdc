/* Tests when a scan's own normals contradict its triangles. */
#include "libvoxel/voxelize/cache/chunk_content.h"
#include "tests/unit/test.h"

enum { SIDE = 32, VERTICES = (SIDE + 1) * (SIDE + 1), TRIANGLES = 2 * SIDE * SIDE };

static double points[VERTICES][4];
static float normals[VERTICES][4];
static uint32_t triangles[TRIANGLES][3];

/* Makes z = height sin(turn x) sin(turn y) in triangles of this edge, with the formula's normals.
 * Their slopes along x are too steep by `extra`, and they are rounded to multiples of `step` unless
 * it is 0. */
static void make_waves(double edge, double height, double turn, double extra, double step)
{
    for (uint32_t v = 0; v < VERTICES; v++) {
        const double x = edge * (v % (SIDE + 1)), y = edge * (v / (SIDE + 1));
        const double p[3] = {x, y, height * sin(turn * x) * sin(turn * y)};
        double n[3] = {-height * turn * cos(turn * x) * sin(turn * y) - extra,
                       -height * turn * sin(turn * x) * cos(turn * y), 1.0};
        const double length = sqrt(n[0] * n[0] + n[1] * n[1] + 1.0);
        for (int a = 0; a < 3; a++) {
            n[a] /= length;
            points[v][a] = p[a];
            normals[v][a] = (float)(step > 0.0 ? step * round(n[a] / step) : n[a]);
        }
    }
    for (uint32_t t = 0; t < TRIANGLES; t++) {
        const uint32_t at = t / 2 % SIDE + t / 2 / SIDE * (SIDE + 1), above = at + SIDE + 1;
        triangles[t][0] = t & 1 ? above + 1 : at;
        triangles[t][1] = t & 1 ? above : at + 1;
        triangles[t][2] = t & 1 ? at + 1 : above;
    }
}

static bool inconsistent(void)
{
    const struct vox_own_normals of = {(const uint32_t(*)[3])triangles, (const double(*)[4])points,
                                       (const float(*)[4])normals};
    return vox_own_normals_inconsistent(&of, 0, TRIANGLES);
}

/* Triangles measure a quarter of a voxel to two voxels, on waves of 16 of them or more with slopes
 * up to 20 degrees. Their planes differ from the normals at the corners by up to 8 degrees. */
TEST(test_normals_of_the_surface_are_consistent)
{
    for (double edge = 0.25; edge <= 2.0; edge *= 2.0)
        for (double wave = 16.0; wave <= 64.0; wave *= 2.0) {
            const double turn = 6.283185307 / (wave * edge);
            make_waves(edge, 0.36 / turn, turn, 0.0, 0.0);
            assert_false(inconsistent());
        }
}

/* Normals lean by 2 degrees, on a plane and on waves of 16 voxels. */
TEST(test_leaning_normals_are_inconsistent)
{
    for (double edge = 0.25; edge <= 2.0; edge *= 2.0)
        for (double height = 0.0; height < 1.0; height += 0.9) {
            make_waves(edge, height, 6.283185307 / 16.0, 0.035, 0.0);
            assert_true(inconsistent());
        }
}

/* Two decimals round by up to a quarter of a degree; a voxel has many triangles. */
TEST(test_rounding_is_no_contradiction)
{
    make_waves(0.25, 0.9, 6.283185307 / 16.0, 0.0, 0.01);
    assert_false(inconsistent());
}

/* With waves as short as 4 voxels, planes are worth more than 2 degrees. */
TEST(test_planes_of_short_waves_are_kept)
{
    make_waves(0.25, 0.23, 6.283185307 / 4.0, 0.035, 0.0);
    assert_false(inconsistent());
}

TEST(test_no_area_is_no_contradiction)
{
    make_waves(0.0, 0.0, 1.0, 0.5, 0.0);
    assert_false(inconsistent());
}

RUN_TESTS(NULL, NULL)
