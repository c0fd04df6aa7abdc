/* test_smooth_normals.c - sums over one-rings have the bits of scalar code; creases begin at a fold
 * of 60 degrees. */
#include "base/smooth_normals.h"
#include "tests/unit/fixture.h"

enum { VERTICES = 40, TRIANGLES = 300, RINGS = 30 };

static double difference(const float *a, const float *b, int axis)
{
    return (double)a[axis] - (double)b[axis];
}

/* Adds a triangle to sums[0] and sums[1] of the one-ring of its corner `i`. */
static void add_triangle(const float (*positions)[3], const uint32_t v[3], int i, double (*sums)[4])
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
    }
    sums[0][3] += area;
}

static void test_sums_over_one_rings(void **state)
{
    (void)state;
    uint64_t seed = test_seed();
    float positions[VERTICES][3];
    uint32_t triangles[TRIANGLES][3], ring_of[VERTICES];
    double sums[2 * RINGS][4] = {{0}}, expected[2 * RINGS][4] = {{0}}, short_sums[RINGS][4] = {{0}};
    for (int i = 0; i < 3 * VERTICES; i++)
        positions[i / 3][i % 3] = (float)(int32_t)test_random(&seed) * 0x1p-20F;
    for (uint32_t i = 0; i < VERTICES; i++)
        ring_of[i] = i < RINGS ? i : 0;
    for (int i = 0; i < 3 * TRIANGLES; i++)
        triangles[i / 3][i % 3] = (uint32_t)(test_random(&seed) % VERTICES);
    for (int i = 0; i < 3 * TRIANGLES; i++) {
        const uint32_t *v = triangles[i / 3];
        add_triangle((const float(*)[3])positions, v, i % 3, &expected[2 * ring_of[v[i % 3]]]);
    }
    for (uint32_t begin = 0; begin < TRIANGLES; begin += TRIANGLES / 2) {
        const uint32_t end = begin + TRIANGLES / 2;
        bsq_add_one_rings((const float(*)[3])positions, (const uint32_t(*)[3])triangles, begin, end,
                          ring_of, 2, sums);
        bsq_add_one_rings((const float(*)[3])positions, (const uint32_t(*)[3])triangles, begin, end,
                          ring_of, 1, short_sums);
    }
    assert_memory_equal(sums[2], expected[2], sizeof sums - 2 * sizeof sums[0]);
    for (int ring = 1; ring < RINGS; ring++)
        assert_memory_equal(short_sums[ring], expected[2 * ring], sizeof short_sums[0]);
}

static void test_creases(void **state)
{
    (void)state;
    for (int degrees = 0; degrees <= 180; degrees++) {
        const double length = 2 * cos(degrees * 0.5 * acos(-1) / 180);
        assert_int_equal(bsq_is_smooth(length, 2), degrees <= 60);
        assert_int_equal(lanes_bits(bsq_are_smooth(lanes_all(length), lanes_all(2))) & 1,
                         degrees <= 60);
    }
    assert_false(bsq_is_smooth(0, 0));
    assert_int_equal(lanes_bits(bsq_are_smooth(lanes_all(0), lanes_all(0))) & 1, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_sums_over_one_rings),
        cmocka_unit_test(test_creases),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
