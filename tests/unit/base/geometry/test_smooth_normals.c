/* test_smooth_normals.c - sums over one-rings have the bits of scalar code; weights are those of
 * their definitions; creases begin at a fold of 60 degrees. */
#include "base/geometry/smooth_normals.h"
#include "tests/unit/test.h"

enum { VERTICES = 40, TRIANGLES = 300, RINGS = 30 };

static double difference(const float *a, const float *b, int axis)
{
    return (double)a[axis] - (double)b[axis];
}

/* Adds a triangle to the sums of the one-ring of its corner `i`. */
static void add_triangle(const float (*positions)[3], const uint32_t v[3], int i, double (*sums)[4],
                         double unit[4])
{
    const float *c[3] = {positions[v[0]], positions[v[1]], positions[v[2]]};
    const float *at = c[i], *next = c[(i + 1) % 3], *previous = c[(i + 2) % 3];
    double vector[3];
    for (int k = 0; k < 3; k++) {
        const int y = (k + 1) % 3, z = (k + 2) % 3;
        vector[k] = difference(c[1], c[0], y) * difference(c[2], c[0], z) -
                    difference(c[1], c[0], z) * difference(c[2], c[0], y);
    }
    const double area = sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]);
    for (int k = 0; k < 3; k++) {
        sums[0][k] += vector[k];
        sums[1][k] += area * (difference(next, at, k) - difference(at, previous, k));
        unit[k] += area > 0 ? vector[k] * (1 / area) : 0;
    }
    sums[0][3] += area;
    unit[3] += area > 0 ? area * (1 / area) : 0;
}

TEST(test_sums_over_one_rings)
{
    uint64_t seed = test_seed();
    float positions[VERTICES][3];
    uint32_t triangles[TRIANGLES][3], rings[TRIANGLES][3];
    double sums[2 * RINGS][4] = {{0}}, expected[2 * RINGS][4] = {{0}};
    double units[RINGS][4] = {{0}}, expected_units[RINGS][4] = {{0}};
    for (int i = 0; i < 3 * VERTICES; i++)
        positions[i / 3][i % 3] = (float)(int32_t)test_random(&seed) * 0x1p-20F;
    for (int i = 0; i < 3 * TRIANGLES; i++) {
        triangles[i / 3][i % 3] = (uint32_t)(test_random(&seed) % VERTICES);
        rings[i / 3][i % 3] = triangles[i / 3][i % 3] % RINGS;
    }
    for (int i = 0; i < 3 * TRIANGLES; i++) {
        const uint32_t ring = rings[i / 3][i % 3];
        add_triangle((const float(*)[3])positions, triangles[i / 3], i % 3, &expected[2 * ring],
                     expected_units[ring]);
    }
    for (uint32_t begin = 0; begin < TRIANGLES; begin += TRIANGLES / 2)
        bsq_add_one_rings((const float(*)[3])positions, (const uint32_t(*)[3]) & triangles[begin],
                          (const uint32_t(*)[3]) & rings[begin], TRIANGLES / 2,
                          BSQ_SCAN_NORMALS_AREA, sums, units);
    assert_memory_equal(sums, expected, sizeof sums);
    assert_memory_equal(units, expected_units, sizeof units);
}

/* Right angles, and angles down to 1e-9 and up to nearly pi. */
TEST(test_angles)
{
    assert_true(fabs(row_number(bsq_angles(2, row_of(0, 2, -2, 0)), 0) - acos(0)) < 1e-10);
    for (double ratio = 1e-9; ratio < 1e10; ratio *= 1.7) {
        const double along[4] = {ratio, -ratio, 1 / ratio, -1 / ratio};
        const struct row angles = bsq_angles(3, row_times(3, row_load(along)));
        for (int i = 0; i < 4; i++) {
            const double expected = atan2(1, along[i]);
            assert_true(fabs(row_number(angles, i) - expected) < 1e-10 * expected);
        }
    }
}

/* Sets the unit normal of vertex 0. */
static void normal_of_first(const float (*positions)[3], const uint32_t (*triangles)[3],
                            uint32_t count, enum bsq_scan_normals weights, double out[3])
{
    double sums[VERTICES * BSQ_RING_ROWS][4] = {{0}};
    double units[VERTICES][4] = {{0}};
    bsq_add_one_rings(positions, triangles, triangles, count, weights, sums, units);
    const double *s = sums[0], length = sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2]);
    for (int k = 0; k < 3; k++)
        out[k] = s[k] / length;
}

/* Max's weights are exact on a sphere, however its points are chosen; the others are not. */
TEST(test_max_on_a_sphere)
{
    enum { RIM = 7 };
    uint64_t seed = test_seed();
    float positions[RIM + 1][3] = {{0, 0, 1}};
    uint32_t triangles[RIM][3];
    double largest[BSQ_SCAN_NORMALS_FLAT] = {0};
    for (int round = 0; round < 100; round++) {
        for (uint32_t i = 0; i < RIM; i++) {
            const double turn =
                (i + 0.8 * (double)(test_random(&seed) >> 11) * 0x1p-53) * 2 * BSQ_PI / RIM;
            const double tilt = 0.05 + 0.6 * (double)(test_random(&seed) >> 11) * 0x1p-53;
            const double at[3] = {sin(tilt) * cos(turn), sin(tilt) * sin(turn), cos(tilt)};
            for (int k = 0; k < 3; k++)
                positions[i + 1][k] = (float)at[k];
            triangles[i][0] = 0;
            triangles[i][1] = i + 1;
            triangles[i][2] = (i + 1) % RIM + 1;
        }
        for (unsigned w = BSQ_SCAN_NORMALS_AREA; w < BSQ_SCAN_NORMALS_FLAT; w++) {
            double n[3];
            normal_of_first((const float(*)[3])positions, (const uint32_t(*)[3])triangles, RIM,
                            (enum bsq_scan_normals)w, n);
            largest[w] = fmax(largest[w], hypot(n[0], n[1]));
        }
    }
    assert_true(largest[BSQ_SCAN_NORMALS_MAX] < 1e-5);
    assert_true(largest[BSQ_SCAN_NORMALS_AREA] > 0.01);
    assert_true(largest[BSQ_SCAN_NORMALS_ANGLE] > 0.01);
}

/* Angles do not depend on how faces are cut. Three squares meet at the corner of a cube; the
 * diagonal of the first one ends there. */
TEST(test_angles_at_a_cube)
{
    const float positions[7][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0},
                                   {0, 1, 1}, {0, 0, 1}, {1, 0, 1}};
    const uint32_t triangles[4][3] = {{0, 1, 2}, {0, 2, 3}, {0, 3, 5}, {0, 5, 1}};
    double n[3];
    normal_of_first(positions, triangles, 4, BSQ_SCAN_NORMALS_ANGLE, n);
    for (int k = 0; k < 3; k++)
        assert_true(fabs(n[k] - 1 / sqrt(3)) < 1e-9);
    normal_of_first(positions, triangles, 4, BSQ_SCAN_NORMALS_AREA, n);
    assert_true(fabs(n[2] - 2 / sqrt(6)) < 1e-9);
}

/* A triangle without an area has no weight. */
TEST(test_no_area)
{
    const float positions[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {2, 0, 0}};
    const uint32_t triangles[3][3] = {{0, 1, 2}, {0, 1, 3}, {0, 0, 2}};
    for (unsigned w = BSQ_SCAN_NORMALS_AREA; w < BSQ_SCAN_NORMALS_FLAT; w++) {
        double n[3];
        normal_of_first(positions, triangles, 3, (enum bsq_scan_normals)w, n);
        assert_true(n[0] == 0 && n[1] == 0 && n[2] == 1);
    }
}

TEST(test_creases)
{
    for (int degrees = 0; degrees <= 180; degrees++) {
        const double length = 2 * cos(degrees * 0.5 * acos(-1) / 180);
        assert_int_equal(bsq_is_smooth(length, 2), degrees <= 60);
    }
    assert_false(bsq_is_smooth(0, 0));
}

RUN_TESTS(NULL, NULL)
