/* Compares clipping of a triangle to voxels with a separating-axis test (Akenine-Moeller 2001) and
 * with sampled points. Checks properties that hold for any division into fragments. */
#include "libvoxel/voxelize/clip/clip.h"
#include "libvoxel/voxelize/clip/divide_lanes.h"
#include "tests/unit/libvoxel/scan_fixture.h"
#include "tests/unit/test.h"

enum { MAX_FRAGMENTS = 20000 };

struct fragments {
    uint32_t count;
    struct vox_fragment fragment[MAX_FRAGMENTS];
};

static struct fragments *results[2];

static int set_up(void **state)
{
    (void)state;
    for (int i = 0; i < 2; i++)
        results[i] = calloc(1, sizeof *results[i]);
    return results[0] && results[1] ? 0 : -1;
}

static int tear_down(void **state)
{
    (void)state;
    free(results[0]);
    free(results[1]);
    return 0;
}

static int collect(void *arg, const struct vox_fragment *fragment)
{
    struct fragments *fragments = arg;
    assert_true(fragments->count < MAX_FRAGMENTS);
    struct vox_fragment *to = &fragments->fragment[fragments->count++];
    memcpy(to->cell, fragment->cell, sizeof to->cell);
    to->fraction = fragment->fraction;
    memcpy(to->b, fragment->b, sizeof to->b);
    return 0;
}

static const struct vox_box everywhere = {{-100000, -100000, -100000}, {100000, 100000, 100000}};

static struct vox_box cells_of(const double (*c)[3])
{
    struct vox_box cells;
    for (int a = 0; a < 3; a++) {
        cells.lo[a] = (int32_t)floor(fmin(c[0][a], fmin(c[1][a], c[2][a])));
        cells.hi[a] = (int32_t)floor(fmax(c[0][a], fmax(c[1][a], c[2][a])));
    }
    return cells;
}

static void clip(const double (*c)[3], const struct vox_box *region, const struct vox_box *window,
                 struct fragments *out)
{
    struct vox_box cells = cells_of(c);
    struct vox_clip_triangle triangle = {.corner = {c[0], c[1], c[2]}, .cells = &cells};
    assert_int_equal(vox_clip(&triangle, region, window, collect, out), 0);
}

static struct fragments *clip_all(const double (*c)[3])
{
    results[0]->count = 0;
    clip(c, &everywhere, &everywhere, results[0]);
    return results[0];
}

static const struct vox_fragment *find(const struct fragments *fragments, int32_t x, int32_t y,
                                       int32_t z)
{
    for (uint32_t i = 0; i < fragments->count; i++)
        if (fragments->fragment[i].cell[0] == x && fragments->fragment[i].cell[1] == y &&
            fragments->fragment[i].cell[2] == z)
            return &fragments->fragment[i];
    return NULL;
}

static void random_triangle(uint64_t *seed, double size, double (*c)[3])
{
    double at[3];
    for (int a = 0; a < 3; a++)
        at[a] = 20.0 * scan_random(seed) - 10.0;
    for (int i = 0; i < 3; i++)
        for (int a = 0; a < 3; a++)
            c[i][a] = at[a] + size * (scan_random(seed) - 0.5);
}

/* ---- the separating-axis test ---- */

/* Returns the largest gap between the projections of triangle and unit voxel on any of the 13 axes,
 * in units of length. Negative: they overlap by at least as much on each. */
static double separation(const double (*c)[3], const int32_t cell[3])
{
    double v[3][3], e[3][3], axis[13][3], gap = -INFINITY;
    int count = 0;
    for (int i = 0; i < 3; i++)
        for (int a = 0; a < 3; a++)
            v[i][a] = c[i][a] - (cell[a] + 0.5);
    for (int i = 0; i < 3; i++)
        for (int a = 0; a < 3; a++)
            e[i][a] = v[(i + 1) % 3][a] - v[i][a];
    memset(axis, 0, sizeof axis);
    for (int a = 0; a < 3; a++)
        axis[count++][a] = 1.0;
    for (int a = 0; a < 3; a++)
        axis[count][a] =
            e[0][(a + 1) % 3] * e[1][(a + 2) % 3] - e[0][(a + 2) % 3] * e[1][(a + 1) % 3];
    count++;
    for (int i = 0; i < 3; i++)
        for (int a = 0; a < 3; a++, count++) {
            axis[count][(a + 1) % 3] = -e[i][(a + 2) % 3];
            axis[count][(a + 2) % 3] = e[i][(a + 1) % 3];
        }
    for (int k = 0; k < 13; k++) {
        double min = INFINITY, max = -INFINITY, radius = 0.0, length = 0.0;
        for (int a = 0; a < 3; a++) {
            radius += 0.5 * fabs(axis[k][a]);
            length += axis[k][a] * axis[k][a];
        }
        for (int i = 0; i < 3; i++) {
            double p = axis[k][0] * v[i][0] + axis[k][1] * v[i][1] + axis[k][2] * v[i][2];
            min = fmin(min, p);
            max = fmax(max, p);
        }
        if (length > 1e-20)
            gap = fmax(gap, fmax(min - radius, -max - radius) / sqrt(length));
    }
    return gap;
}

static void check_against_axes(const double (*c)[3])
{
    const double tolerance = 1e-9;
    const struct fragments *fragments = clip_all(c);
    struct vox_box cells = cells_of(c);
    for (int32_t x = cells.lo[0] - 1; x <= cells.hi[0] + 1; x++)
        for (int32_t y = cells.lo[1] - 1; y <= cells.hi[1] + 1; y++)
            for (int32_t z = cells.lo[2] - 1; z <= cells.hi[2] + 1; z++) {
                double gap = separation(c, (int32_t[3]){x, y, z});
                bool set = find(fragments, x, y, z) != NULL;
                if (gap < -tolerance)
                    assert_true(set);
                else if (gap > tolerance)
                    assert_false(set);
            }
}

TEST(test_same_voxels_as_separating_axes)
{
    uint64_t seed = 20240607;
    print_message("seed %llu\n", (unsigned long long)seed);
    static const double sizes[] = {0.3, 1.0, 3.0, 9.0};
    for (int s = 0; s < 4; s++)
        for (int i = 0; i < 300; i++) {
            double c[3][3];
            random_triangle(&seed, sizes[s], c);
            check_against_axes((const double(*)[3])c);
        }
}

/* ---- what holds of any division ---- */

static void check_division(const double (*c)[3], const struct fragments *fragments)
{
    double area = 0.0, moment[2] = {0.0, 0.0};
    for (uint32_t i = 0; i < fragments->count; i++) {
        const struct vox_fragment *p = &fragments->fragment[i];
        area += p->fraction;
        for (int k = 0; k < 2; k++)
            moment[k] += p->fraction * p->b[k];
        for (int a = 0; a < 3; a++) {
            double at = c[0][a] + p->b[0] * (c[1][a] - c[0][a]) + p->b[1] * (c[2][a] - c[0][a]);
            assert_true(at >= p->cell[a] - 1e-9 && at <= p->cell[a] + 1 + 1e-9);
        }
    }
    assert_true(fabs(area - 1.0) < 1e-12);
    assert_true(fabs(moment[0] - 1.0 / 3.0) < 1e-12 && fabs(moment[1] - 1.0 / 3.0) < 1e-12);
}

TEST(test_fragments_add_up)
{
    uint64_t seed = 77;
    print_message("seed %llu\n", (unsigned long long)seed);
    for (int i = 0; i < 3000; i++) {
        double c[3][3];
        random_triangle(&seed, pow(10.0, 3.0 * scan_random(&seed) - 1.5), c);
        check_division((const double(*)[3])c, clip_all((const double(*)[3])c));
    }
}

TEST(test_needles_add_up)
{
    uint64_t seed = 5;
    print_message("seed %llu\n", (unsigned long long)seed);
    for (int i = 0; i < 2000; i++) {
        double c[3][3];
        random_triangle(&seed, 8.0, c);
        double t = scan_random(&seed), width = pow(10.0, -12.0 * scan_random(&seed));
        for (int a = 0; a < 3; a++)
            c[2][a] = c[0][a] + t * (c[1][a] - c[0][a]) + width * (scan_random(&seed) - 0.5);
        check_division((const double(*)[3])c, clip_all((const double(*)[3])c));
    }
}

/* ---- regions and windows ---- */

TEST(test_window_does_not_change_fragments)
{
    uint64_t seed = 99;
    print_message("seed %llu\n", (unsigned long long)seed);
    for (int i = 0; i < 500; i++) {
        double c[3][3];
        random_triangle(&seed, 12.0, c);
        struct vox_box region = {{-4, -4, -4}, {3, 3, 3}}, window;
        for (int a = 0; a < 3; a++) {
            int32_t p = (int32_t)(8.0 * scan_random(&seed)) - 4;
            int32_t q = (int32_t)(8.0 * scan_random(&seed)) - 4;
            window.lo[a] = p < q ? p : q;
            window.hi[a] = p < q ? q : p;
        }
        results[0]->count = results[1]->count = 0;
        clip((const double(*)[3])c, &region, &region, results[0]);
        clip((const double(*)[3])c, &region, &window, results[1]);
        uint32_t found = 0;
        for (uint32_t k = 0; k < results[0]->count; k++) {
            const struct vox_fragment *p = &results[0]->fragment[k];
            bool inside = true;
            for (int a = 0; a < 3; a++)
                inside = inside && p->cell[a] >= window.lo[a] && p->cell[a] <= window.hi[a];
            if (!inside)
                continue;
            assert_true(found < results[1]->count);
            const struct vox_fragment *q = &results[1]->fragment[found++];
            assert_memory_equal(p->cell, q->cell, sizeof p->cell);
            assert_memory_equal(&p->fraction, &q->fraction, sizeof p->fraction);
            assert_memory_equal(p->b, q->b, sizeof p->b);
        }
        assert_int_equal(found, results[1]->count);
    }
}

TEST(test_regions_share_a_triangle)
{
    uint64_t seed = 123;
    print_message("seed %llu\n", (unsigned long long)seed);
    for (int i = 0; i < 300; i++) {
        double c[3][3];
        random_triangle(&seed, 20.0, c);
        results[0]->count = 0;
        for (int32_t x = -24; x < 24; x += 8)
            for (int32_t y = -24; y < 24; y += 8)
                for (int32_t z = -24; z < 24; z += 8) {
                    struct vox_box region = {{x, y, z}, {x + 7, y + 7, z + 7}};
                    clip((const double(*)[3])c, &region, &region, results[0]);
                }
        check_division((const double(*)[3])c, results[0]);
        for (uint32_t k = 0; k < results[0]->count; k++)
            assert_ptr_equal(find(results[0], results[0]->fragment[k].cell[0],
                                  results[0]->fragment[k].cell[1], results[0]->fragment[k].cell[2]),
                             &results[0]->fragment[k]);
        results[1]->count = 0;
        clip((const double(*)[3])c, &everywhere, &everywhere, results[1]);
        assert_int_equal(results[0]->count, results[1]->count);
    }
}

/* ---- side by side ---- */

/* Puts a triangle's corners, relative to its lowest voxel, into a lane. Returns false if the
 * triangle is not small. */
static bool put_in_lane(const double (*c)[3], int lane, doubles p[3][3], int planes[3])
{
    struct vox_box cells = cells_of(c);
    for (int a = 0; a < 3; a++) {
        planes[a] = cells.hi[a] - cells.lo[a];
        if (planes[a] > DIVIDE_MAX_PLANES)
            return false;
        for (int i = 0; i < 3; i++)
            p[i][a][lane] = c[i][a] - cells.lo[a];
    }
    return true;
}

/* Divides triangles, and returns all doubtful ones. */
static lane_mask divide(const doubles p[3][3], const int planes[3],
                        struct divide_fragment *fragments)
{
    lane_mask doubtful = divide_small(p, planes, fragments);
    for (int i = 0; i < (planes[0] + 1) * (planes[1] + 1) * (planes[2] + 1); i++)
        divide_touching(&fragments[i], &doubtful);
    return doubtful;
}

/* Compares the fragments of one lane with those from clipping polygons. */
static void check_lane(const double (*c)[3], int lane, const int planes[3],
                       const struct divide_fragment *fragment)
{
    const struct fragments *fragments = clip_all(c);
    struct vox_box cells = cells_of(c);
    uint32_t count = 0;
    for (int x = 0; x <= planes[0]; x++)
        for (int y = 0; y <= planes[1]; y++)
            for (int z = 0; z <= planes[2]; z++, fragment++) {
                const struct vox_fragment *expected =
                    find(fragments, cells.lo[0] + x, cells.lo[1] + y, cells.lo[2] + z);
                assert_true((fragment->share[lane] != 0.0) == (expected != NULL));
                if (!expected)
                    continue;
                count++;
                assert_true(fabs(fragment->share[lane] - expected->fraction) < 1e-11);
                for (int k = 0; k < 2; k++)
                    assert_true(fabs(fragment->moment[k][lane] / (3.0 * fragment->share[lane]) -
                                     expected->b[k]) < 1e-7);
            }
    assert_int_equal(count, fragments->count);
}

/* Lanes hold different triangles of one kind. Few may be doubtful. */
TEST(test_small_triangles_side_by_side)
{
    uint64_t seed = 4711;
    print_message("seed %llu\n", (unsigned long long)seed);
    static double waiting[4][4][4][LANE_COUNT][3][3];
    static int counts[4][4][4];
    uint32_t checked = 0, doubtful = 0;
    for (int n = 0; n < 30000; n++) {
        double c[3][3];
        doubles p[3][3];
        int planes[3];
        random_triangle(&seed, pow(10.0, 1.3 * scan_random(&seed) - 0.7), c);
        if (!put_in_lane((const double(*)[3])c, 0, p, planes))
            continue;
        int *count = &counts[planes[0]][planes[1]][planes[2]];
        double(*batch)[3][3] = waiting[planes[0]][planes[1]][planes[2]];
        memcpy(batch[(*count)++], c, sizeof c);
        if (*count < LANE_COUNT)
            continue;
        *count = 0;
        struct divide_fragment fragments[DIVIDE_MAX_CELLS];
        for (int l = 0; l < LANE_COUNT; l++)
            put_in_lane((const double(*)[3])batch[l], l, p, planes);
        lane_mask doubt = divide((const doubles(*)[3])p, planes, fragments);
        for (int l = 0; l < LANE_COUNT; l++) {
            checked++;
            doubtful += lanes_bits(doubt) >> l & 1;
            if (!(lanes_bits(doubt) >> l & 1))
                check_lane((const double(*)[3])batch[l], l, planes, fragments);
        }
    }
    assert_true(checked > 20000);
    assert_true(doubtful < checked / 20);
}

/* What half-open boxes decide is left to clip.h: corners and edges on planes, crossings on edges,
 * three planes that meet in the triangle. */
TEST(test_touching_planes_is_doubtful)
{
    static const double table[][3][3] = {
        {{2.0, 2.0, 2.0}, {1.5, 1.25, 1.5}, {1.25, 1.5, 1.5}},
        {{1.0, 0.5, 0.5}, {1.0, 1.5, 0.5}, {0.5, 0.75, 0.25}},
        {{0.5, 0.5, 0.25}, {1.5, 1.5, 0.25}, {1.5, 1.5, 0.75}},
        {{0.5, 0.5, 2.0}, {0.5, 2.0, 0.5}, {2.0, 0.5, 0.5}},
    };
    for (size_t i = 0; i < sizeof table / sizeof table[0]; i++) {
        struct divide_fragment fragments[DIVIDE_MAX_CELLS];
        doubles p[3][3];
        int planes[3];
        for (int l = 0; l < LANE_COUNT; l++)
            assert_true(put_in_lane(table[i], l, p, planes));
        lane_mask doubt = divide((const doubles(*)[3])p, planes, fragments);
        for (int l = 0; l < LANE_COUNT; l++)
            assert_true(lanes_bits(doubt) >> l & 1);
    }
}

/* ---- borders ---- */

TEST(test_plane_on_a_border_fills_the_upper_layer)
{
    static const double c[3][3] = {{3.0, 0.5, 0.5}, {3.0, 4.5, 0.5}, {3.0, 0.5, 4.5}};
    for (int axis = 0; axis < 3; axis++) {
        double turned[3][3];
        for (int i = 0; i < 3; i++)
            for (int a = 0; a < 3; a++)
                turned[i][(a + axis) % 3] = c[i][a];
        const struct fragments *fragments = clip_all((const double(*)[3])turned);
        /* 15 voxels of the layer share area with it. Its longest side, u + v = 5, runs through the
         * lower corners of four more. */
        assert_int_equal(fragments->count, 15 + 4);
        for (uint32_t i = 0; i < fragments->count; i++)
            assert_int_equal(fragments->fragment[i].cell[axis], 3);
    }
}

/* The plane x = y runs through the edges of voxels (i, i) and lies inside these only. */
TEST(test_diagonal_plane_fills_the_diagonal)
{
    static const double c[3][3] = {{0.0, 0.0, 0.25}, {8.0, 8.0, 0.25}, {8.0, 8.0, 0.75}};
    const struct fragments *fragments = clip_all(c);
    for (uint32_t i = 0; i < fragments->count; i++)
        assert_int_equal(fragments->fragment[i].cell[0], fragments->fragment[i].cell[1]);
    /* Voxel 8 gets only the last edge, by half-open boxes. */
    assert_int_equal(fragments->count, 9);
    assert_true(find(fragments, 8, 8, 0)->fraction == 0.0);
}

TEST(test_corner_that_touches)
{
    /* The corner (2, 2, 2) belongs to voxel (2, 2, 2), the rest to (1, 1, 1). */
    static const double c[3][3] = {{2.0, 2.0, 2.0}, {1.5, 1.25, 1.5}, {1.25, 1.5, 1.5}};
    const struct fragments *fragments = clip_all(c);
    assert_int_equal(fragments->count, 2);
    assert_true(find(fragments, 1, 1, 1)->fraction == 1.0);
    assert_true(find(fragments, 2, 2, 2)->fraction == 0.0);
}

/* Corners at quarters of a voxel and weights in 64ths: every sum below is exact. */
TEST(test_every_point_has_its_voxel)
{
    uint64_t seed = 31337;
    print_message("seed %llu\n", (unsigned long long)seed);
    for (int n = 0; n < 200; n++) {
        double c[3][3];
        for (int i = 0; i < 3; i++)
            for (int a = 0; a < 3; a++)
                c[i][a] = floor(scan_random(&seed) * 16.0) / 4.0;
        const struct fragments *fragments = clip_all((const double(*)[3])c);
        for (int i = 0; i <= 64; i++)
            for (int j = 0; i + j <= 64; j++) {
                double p[3];
                for (int a = 0; a < 3; a++)
                    p[a] = (c[0][a] * (64 - i - j) + c[1][a] * i + c[2][a] * j) / 64.0;
                /* Cuts of slanted edges are rounded, so points on a border may go to either
                 * side. */
                bool on_border = false;
                for (int a = 0; a < 3; a++)
                    on_border = on_border || p[a] == floor(p[a]);
                bool corner = i == 64 || j == 64 || i + j == 0;
                if (!on_border || corner)
                    assert_non_null(find(fragments, (int32_t)floor(p[0]), (int32_t)floor(p[1]),
                                         (int32_t)floor(p[2])));
            }
    }
}

RUN_TESTS(set_up, tear_down)
