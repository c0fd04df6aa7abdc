/* Compares the closest point of a mesh with a search through points of all triangles. */
#include "libvoxel/simplify/closest.h"
#include "tests/unit/test.h"

enum { TRIANGLES = 300, QUERIES = 20, STEPS = 60 };

static float random_number(uint64_t *state)
{
    *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (float)(*state >> 40) / (float)(1 << 24);
}

/* Returns the squared distance from points of a triangle, by bisection: a convex function. */
static double sampled_square(const float (*p)[3], const uint32_t t[3], const double q[3])
{
    double least = INFINITY;
    for (int i = 0; i <= STEPS; i++)
        for (int j = 0; j <= STEPS - i; j++) {
            const double u = (double)i / STEPS, v = (double)j / STEPS;
            double square = 0;
            for (int k = 0; k < 3; k++) {
                const double x = (1 - u - v) * (double)p[t[0]][k] + u * (double)p[t[1]][k] +
                                 v * (double)p[t[2]][k];
                square += (x - q[k]) * (x - q[k]);
            }
            least = square < least ? square : least;
        }
    return least;
}

static void compare_closest(bool in_order)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    float positions[3 * TRIANGLES][3];
    uint32_t triangles[TRIANGLES][3];
    uint64_t seed = test_seed();
    for (int t = 0; t < TRIANGLES; t++) {
        for (int c = 0; c < 3; c++) {
            triangles[t][c] = (uint32_t)(3 * t + c);
            for (int k = 0; k < 3; k++)
                positions[3 * t + c][k] =
                    c == 0 ? random_number(&seed)
                           : positions[3 * t][k] + 0.1f * (random_number(&seed) - 0.5f);
        }
        for (int k = 0; k < 3 && t % 5 == 0; k++) /* a needle */
            positions[3 * t + 2][k] = 0.5f * (positions[3 * t][k] + positions[3 * t + 1][k]) +
                                      1e-6f * random_number(&seed);
    }
    struct vox_closest tree;
    assert_int_equal(vox_closest_build(ctx, (const float(*)[3])positions,
                                       (const uint32_t(*)[3])triangles, TRIANGLES, in_order, &tree),
                     0);
    for (int i = 0; i < QUERIES; i++) {
        const unsigned count = 1 + (unsigned)i % VOX_CLOSEST_BATCH;
        float points[VOX_CLOSEST_BATCH][3];
        double squares[VOX_CLOSEST_BATCH], halves[VOX_CLOSEST_BATCH];
        for (unsigned j = 0; j < count; j++) {
            for (int k = 0; k < 3; k++)
                points[j][k] = 1.4f * random_number(&seed) - 0.2f;
            squares[j] = INFINITY;
        }
        vox_closest_squares(&tree, (const float(*)[3])points, count, squares, NULL);
        for (unsigned j = 0; j < count; j++)
            halves[j] = squares[j] / 2;
        vox_closest_squares(&tree, (const float(*)[3])points, count, halves, NULL);
        for (unsigned j = 0; j < count; j++) {
            const double q[3] = {(double)points[j][0], (double)points[j][1], (double)points[j][2]};
            double sampled = INFINITY;
            for (int t = 0; t < TRIANGLES; t++)
                sampled =
                    fmin(sampled, sampled_square((const float(*)[3])positions, triangles[t], q));
            /* Samples are at most a step of an edge of 0.09 apart from the true point. */
            assert_true(sqrt(squares[j]) <= sqrt(sampled) + 1e-9);
            assert_true(sqrt(squares[j]) >= sqrt(sampled) - 0.09 / STEPS);
            assert_true(halves[j] == squares[j] / 2);
        }
    }
    vox_closest_free(ctx, &tree);
    test_context_end(ctx);
}

TEST(closest_points)
{
    compare_closest(false);
}

TEST(closest_points_of_a_tree_in_order)
{
    compare_closest(true);
}

RUN_TESTS(NULL, NULL)
