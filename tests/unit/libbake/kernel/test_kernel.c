/* test_kernel.c - compares the kernel's parts to naive versions of them. */
#include "base/geometry/vec.h"
#include "libbake/device/scene/scene.h"
#include "libbake/kernel/bk_sample.h"
#include "libbake/kernel/bk_srgb.h"
#include "tests/unit/test.h"
#include "tests/unit/libbake/analytic_grid.h"
#include "tests/grid_lookup.h"

SHARED_CONTEXT(context, 0)

/* ---- parts ---- */

TEST(test_srgb_table)
{
    for (int i = 0; i < 256; i++) {
        double c = i / 255.0, linear = c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4);
        assert_true(fabs(bk_srgb[i] - linear) <= 1e-7 * linear);
    }
}

/* The kernel may differ from base/geometry/vec.h if a coordinate is -32768, which the encoder never
 * writes. */
TEST(test_decode_normal)
{
    uint64_t seed = test_seed();
    for (int i = 0; i < 200000; i++) {
        uint32_t word = (uint32_t)(analytic_random(&seed) * 4294967296.0);
        struct bsq_vec3 expected = bsq_oct_unpack(word);
        bk_vec3w lanes = bk_decode_normalw((bk_int)word);
        bk_vec3 n = bk_lane3(&lanes, 0);
        bool written = (word & 0xffff) != 0x8000 && word >> 16 != 0x8000;
        float tolerance = written ? 1e-6f : 1e-4f;
        assert_true(fabsf(n.x - expected.x) < tolerance && fabsf(n.y - expected.y) < tolerance &&
                    fabsf(n.z - expected.z) < tolerance);
        assert_true(fabsf(bk_dot(n, n) - 1) < 1e-6f);
    }
}

/* m.x T + m.y B + m.z N, which a shader computes, must be parallel to the normal for any frame. */
TEST(test_tangent_space)
{
    uint64_t seed = test_seed();
    for (int i = 0; i < 100000; i++) {
        double n[3], t[3], target[3];
        analytic_random_unit(&seed, n);
        analytic_random_unit(&seed, t);
        analytic_random_unit(&seed, target);
        float scale = 0.5f + (float)analytic_random(&seed);
        bk_point point = {.normal = {(float)n[0] * scale, (float)n[1] * scale, (float)n[2] * scale},
                          .tangent = {(float)t[0], (float)t[1], (float)t[2]},
                          .handedness = i & 1 ? 1.f : -1.f};
        bk_vec3w b = bk_scalew(bk_crossw(point.normal, point.tangent), point.handedness);
        if (bk_dotw(b, b) < 0.01f)
            continue; /* tangent along the normal */
        bk_vec3w m = bk_to_tangent_space(
            &point, bk_v3w((float)target[0], (float)target[1], (float)target[2]));
        float back[3] = {m.x * point.tangent.x + m.y * b.x + m.z * point.normal.x,
                         m.x * point.tangent.y + m.y * b.y + m.z * point.normal.y,
                         m.x * point.tangent.z + m.y * b.z + m.z * point.normal.z};
        assert_true(fabsf(bk_dotw(m, m) - 1) < 1e-5f);
        assert_true(analytic_degrees(target, back) < 0.01);
    }
}

/* ---- random grids against naive lookups and walks ---- */

/* Fills clusters of voxels in several leaves, regions and root tiles, on both sides of 0. */
static void random_grid(uint64_t *seed, struct fmt_nvdb_grid *out, int32_t corners[8][3])
{
    struct analytic_grid *grid = analytic_grid_create();
    for (int c = 0; c < 8; c++) {
        static const int far[8][3] = {{0},           {-8},         {4090, -3, 5}, {120, 120, 120},
                                      {-4100, 7, 9}, {3, 250, -7}, {-1, -1, -1},  {5, 9, 4095}};
        memcpy(corners[c], far[c], sizeof corners[c]);
        for (int i = 0; i < 150; i++) {
            double p[3], n[3];
            for (int k = 0; k < 3; k++)
                p[k] = corners[c][k] + 14 * analytic_random(seed);
            analytic_random_unit(seed, n);
            analytic_grid_add(grid, p, n, 1, NULL);
        }
    }
    analytic_grid_open(context, grid, false, out);
    analytic_grid_free(grid);
}

static struct bk_grid kernel_grid(const struct fmt_nvdb_grid *grid, struct bk_params *params)
{
    struct bk_grid kernel;
    bake_params_from_grid(grid, params);
    bake_kernel_grid(grid, params, &kernel);
    return kernel;
}

TEST(test_lookup)
{
    uint64_t seed = test_seed(), active = 0, seconds = 0;
    struct bk_params params = {0};
    struct fmt_nvdb_grid grid;
    int32_t corners[8][3];
    random_grid(&seed, &grid, corners);
    struct bk_grid kernel = kernel_grid(&grid, &params);
    struct bk_cache cache = bk_cache_empty();

    for (int i = 0; i < 300000; i++) {
        const int32_t *corner = corners[(i / 50) % 8];
        int32_t at[3];
        for (int k = 0; k < 3; k++)
            at[k] = corner[k] - 6 + (int32_t)(26 * analytic_random(&seed));
        if (i % 100 == 0)
            at[i / 100 % 3] += 1 << (i / 300 % 30);
        uint64_t expected = grid_find(&grid, at), found = 0;
        uint32_t level = bk_locate(&kernel, &cache, at[0], at[1], at[2]);
        if (level == 0)
            found = bk_leaf_value(&kernel, cache.leaf, at[0], at[1], at[2]);
        assert_int_equal(found, expected);
        active += expected != 0;
        if (expected && fmt_nvdb_second(&grid, expected)) {
            assert_int_equal(bk_second(&kernel, expected), fmt_nvdb_second(&grid, expected));
            seconds++;
        }
        bk_ulong corner_values[8];
        bk_uint present = bk_cell_values(&kernel, &cache, at[0], at[1], at[2], corner_values);
        for (int c = 0; c < 8; c++) {
            int32_t near[3] = {at[0] + (c >> 2), at[1] + (c >> 1 & 1), at[2] + (c & 1)};
            assert_int_equal(corner_values[c], grid_find(&grid, near));
            assert_int_equal(present >> c & 1, corner_values[c] != 0);
        }
    }
    assert_true(active > 1000 && seconds > 10);
    fmt_nvdb_close(context, &grid);
}

/* The result of the naive walk: sorts all voxel faces that the ray crosses and looks up each voxel
 * by itself, in double. */
struct naive {
    bool found, doubtful; /* doubtful: depends on rounding */
    double t;
};

enum { NAIVE_FACES = 600 };

static int naive_faces(const double origin[3], const double direction[3], double limit,
                       double *faces)
{
    int count = 0;
    faces[count++] = 0;
    for (int k = 0; k < 3; k++) {
        if (direction[k] == 0)
            continue;
        double a = origin[k] + 0.5, b = a + limit * direction[k];
        for (double f = ceil(fmin(a, b)); f <= fmax(a, b) && count < NAIVE_FACES - 1; f++)
            faces[count++] = (f - a) / direction[k];
    }
    faces[count++] = limit;
    qsort(faces, (size_t)count, sizeof *faces, analytic_by_value);
    return count;
}

static bool nearly(double a, double b)
{
    return fabs(a - b) < 1e-3;
}

/* Returns the margin: a fifth of a voxel, and more if the record's mean normal hides a fold. */
static double naive_margin(const struct fmt_nvdb_record *record)
{
    double coverage = (record->plane >> 16 & 255) / 255.0;
    return 0.2 + 0.4 * sqrt(fmax(0.98 - coverage * coverage, 0));
}

/* Applies the rules of bk_trace.h to one sheet that faces `facing`, along a half ray. */
static struct naive naive_trace(const struct fmt_nvdb_grid *grid, const double origin[3],
                                const double direction[3], double limit, const double facing[3])
{
    struct naive result = {.t = limit};
    double faces[NAIVE_FACES], outside = 0, ahead = 0, margin = 0;
    int count = naive_faces(origin, direction, limit, faces), side = BK_APART;

    for (int i = 0; i + 1 < count && !result.found; i++) {
        double t_in = faces[i], t_out = faces[i + 1], middle = (t_in + t_out) / 2;
        int32_t at[3];
        if (t_out - t_in < 1e-3) {
            /* An edge, or a start on a face: which voxels are met depends on rounding. */
            result.doubtful |= i + 2 < count;
            continue;
        }
        for (int k = 0; k < 3; k++)
            at[k] = (int32_t)floor(origin[k] + middle * direction[k] + 0.5);
        uint64_t v = grid_find(grid, at), numbers[2] = {v, 0};
        int before = side;
        double below = outside, next = ahead, reach = margin;
        side = BK_APART;
        if (v)
            numbers[1] = fmt_nvdb_second(grid, v);
        for (int r = 0; v && r < 2; r++) {
            if (!numbers[r])
                continue;
            struct fmt_nvdb_record record = grid_get(grid, numbers[r]);
            struct bsq_vec3 u = bsq_oct_unpack(record.normal);
            double n[3] = {u.x, u.y, u.z}, f = -(int16_t)record.plane / 32767.0;
            double slope = 0, facing_dot = 0, t;
            for (int k = 0; k < 3; k++) {
                f += n[k] * (origin[k] - at[k]);
                slope += n[k] * direction[k];
                facing_dot += n[k] * facing[k];
            }
            result.doubtful |= nearly(facing_dot, 0);
            if (facing_dot <= 0)
                continue;
            f = slope < 0 ? -f : f;
            slope = fabs(slope);
            double f_in = f + slope * t_in, f_out = f + slope * t_out;
            double own = naive_margin(&record);
            result.doubtful |= nearly(f_in, 0) || nearly(f_out, 0) || nearly(f_in, own) ||
                               nearly(f_in, slope) || nearly(-f_out, slope);
            if (f_out < 0) {
                /* Of two sheets ahead, the run goes on with the nearer one. */
                double left = -f_out < slope ? -f_out : 1;
                result.doubtful |= side == BK_BELOW && nearly(left, outside);
                if (side == BK_BELOW && left >= outside)
                    continue;
                side = BK_BELOW;
                margin = own;
                outside = left;
                ahead = t_out - f_out / slope;
                continue;
            }
            side = side == BK_BELOW ? BK_BELOW : BK_ABOVE;
            if (f_in <= 0)
                t = -f / slope;
            else if (before == BK_BELOW)
                t = t_in;
            else if (before == BK_APART && f_in <= own && f_in < slope && t_in > 0)
                t = fmax(t_in - f_in / slope, 0);
            else
                continue;
            if (!result.found || t < result.t)
                result.t = t;
            result.found = true;
        }
        if (side == BK_APART && before == BK_BELOW && !result.found) {
            result.doubtful |= nearly(below, reach) || nearly(next, limit);
            result.found = below <= reach && next <= limit;
            result.t = result.found ? next : result.t;
        }
    }
    if (!result.found && side == BK_BELOW)
        result.doubtful |= outside <= 2 * margin; /* at the end of the ray */
    return result;
}

TEST(test_traversal)
{
    uint64_t seed = test_seed();
    struct bk_params params = {.flags = BK_NEAREST};
    struct fmt_nvdb_grid grid;
    int32_t corners[8][3];
    int compared = 0, found = 0, rays = 100000;

    random_grid(&seed, &grid, corners);
    bake_params_from_grid(&grid, &params);
    for (int i = 0; i < rays; i++) {
        const int32_t *corner = corners[i % 8];
        double origin[3], direction[3];
        float o[3], d[3];
        struct traced_hit hit;
        analytic_random_unit(&seed, direction);
        if (i % 5 == 0) /* along an axis */
            for (int k = 0; k < 3; k++)
                direction[k] = k != i / 5 % 3 ? 0 : i & 1 ? -1 : 1;
        if (i % 5 == 1) { /* in a plane of the axes */
            double *zero = &direction[i / 5 % 3];
            double rest = sqrt(1 - *zero * *zero);
            *zero = 0;
            for (int k = 0; k < 3; k++)
                direction[k] /= rest;
        }
        double away = i % 3 == 0 ? 60 * analytic_random(&seed) : 0, limit = 80;
        for (int k = 0; k < 3; k++) {
            o[k] = (float)(corner[k] - 1 + 16 * analytic_random(&seed) - away * direction[k]);
            if (i % 7 == 0)
                o[k] = floorf(o[k]) + (i & 8 ? 0.5f : 0.f); /* on voxel faces or centres */
            d[k] = (float)direction[k];
            origin[k] = o[k];
            direction[k] = d[k];
        }
        struct naive expected = naive_trace(&grid, origin, direction, limit, direction);
        if (expected.doubtful)
            continue;
        hit = analytic_trace(&grid, &params, o, d, 0, (float)limit, 1);
        compared++;
        found += expected.found;
        assert_int_equal(hit.found, expected.found);
        if (hit.found)
            assert_true(fabs(hit.t - expected.t) < 2e-3);
    }
    print_message("compared %d of %d rays, %d of them hit\n", compared, rays, found);
    assert_true(compared > rays / 2 && found > rays / 10);
    fmt_nvdb_close(context, &grid);
}

/* Invalid and far rays terminate. */
TEST(test_degenerate_rays)
{
    uint64_t seed = test_seed();
    struct bk_params params = {0};
    struct fmt_nvdb_grid grid;
    int32_t corners[8][3];
    static const float odd[] = {0, -0.0f, 1, -1, 1e-30f, -1e-12f, 1e9f, -3e38f, NAN, INFINITY};
    enum { ODD = sizeof odd / sizeof *odd };

    random_grid(&seed, &grid, corners);
    bake_params_from_grid(&grid, &params);
    for (int i = 0; i < 200000; i++) {
        float v[6], t_min, t_max;
        struct traced_hit hit;
        for (int k = 0; k < 6; k++)
            v[k] = odd[(int)(ODD * analytic_random(&seed))];
        t_min = odd[(int)(ODD * analytic_random(&seed))];
        t_max = odd[(int)(ODD * analytic_random(&seed))];
        hit = analytic_trace(&grid, &params, v, v + 3, t_min, t_max, 1);
        if (hit.found)
            assert_true(isfinite(hit.t) && isfinite(hit.normal[0]));
    }
    fmt_nvdb_close(context, &grid);
}

RUN_TESTS(open_context, close_context)
