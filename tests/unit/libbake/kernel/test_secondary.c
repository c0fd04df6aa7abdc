/* test_secondary.c - open shares, bent directions and thickness against formulas. */
#include "libbake/bake.h"
#include "libbake/device/scene/scene.h"
#include "libbake/kernel/bk_sample.h"
#include "libbake/grid_tree/leaf_tree.h"
#include "tests/unit/test.h"
#include "tests/unit/libbake/analytic_grid.h"

#define PI 3.14159265358979323846

enum { RAYS = 4096 };

struct scene {
    struct bsq_ctx *ctx;
    struct analytic_grid *samples;
    struct fmt_nvdb_grid file;
    struct bk_grid grid;
    struct bake_tree tree;
    struct bk_params params;
};

static struct scene begin(void)
{
    return (struct scene){.ctx = test_context(0, 0), .samples = analytic_grid_create()};
}

/* Adds a rectangle: centre, two half sides that are at right angles, and the side it faces. */
static void add_rectangle(struct scene *s, const double centre[3], const double u[3],
                          const double v[3], double sign)
{
    const double step = 0.4;
    double lengths[2] = {sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]),
                         sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])};
    double n[3];
    const int counts[2] = {(int)(2 * lengths[0] / step), (int)(2 * lengths[1] / step)};
    for (int k = 0; k < 3; k++)
        n[k] = sign * (u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]) /
               (lengths[0] * lengths[1]);
    for (int i = 0; i < counts[0]; i++)
        for (int j = 0; j < counts[1]; j++) {
            double p[3], a = (2 * i + 1.0) / counts[0] - 1, b = (2 * j + 1.0) / counts[1] - 1;
            for (int k = 0; k < 3; k++)
                p[k] = centre[k] + a * u[k] + b * v[k];
            analytic_grid_add(s->samples, p, n, step * step, NULL);
        }
}

static void open_scene(struct scene *s)
{
    analytic_grid_open(s->ctx, s->samples, false, &s->file);
    bake_params_from_grid(&s->file, &s->params);
    bake_kernel_grid(&s->file, &s->params, &s->grid);
    assert_int_equal(bake_tree_build(s->ctx, &s->file, &s->tree), 0);
    s->grid.nodes = (const bk_ulong2 *)(const void *)s->tree.nodes;
    s->grid.blocks = (const bk_ulong *)(const void *)s->tree.blocks;
    s->params.maps = BK_SECONDARY_MAPS;
    s->params.samples = 1;
    s->params.open_rays = s->params.thickness_rays = RAYS;
    s->params.open_limit = BK_FAR;
    s->params.thickness_limit = 1000;
    s->params.open_sine2 = 1;
    s->params.coarse = BAKE_AO_COARSE;
}

static void end(struct scene *s)
{
    bake_tree_free(s->ctx, &s->tree);
    fmt_nvdb_close(s->ctx, &s->file);
    analytic_grid_free(s->samples);
    test_context_end(s->ctx);
}

static bk_surroundings look(const struct scene *s, const double position[3], const double normal[3])
{
    static float found[2 * RAYS];
    const bk_vec3 at = bk_v3((float)position[0], (float)position[1], (float)position[2]);
    const bk_vec3 up = bk_v3((float)normal[0], (float)normal[1], (float)normal[2]);
    const bk_viewpoint from = {.open_from = bk_add_scaled(at, BK_LIFT, up),
                               .solid_from = at,
                               .normal = up,
                               .side = 1,
                               .share.seed =
                                   bk_hash((bk_uint)(int)(1000 * position[0] + position[1]))};
    for (bk_uint ray = 0; ray < bk_ray_count(&s->params); ray++)
        bk_look_from(&s->grid, &s->params, &from, ray, &found[ray]);
    return bk_add_up(&s->params, &from, found);
}

static void assert_near(double value, double expected, double tolerance, const char *what)
{
    if (!(fabs(value - expected) <= tolerance))
        print_error("%s: %g, expected %g\n", what, value, expected);
    assert_true(fabs(value - expected) <= tolerance);
}

/* ---- directions ---- */

static bk_vec3w direction(const bk_rays *rays, bk_uint seed, bk_uint i)
{
    const bk_share share = {.seed = seed, .first = i % rays->samples};
    return bk_cone_directions(rays, share, i / rays->samples);
}

TEST(directions_are_cosine_weighted)
{
    const bk_rays all = {.open = 1, .count = RAYS, .samples = 1, .sine2 = 1};
    for (bk_uint seed = 0; seed < 100; seed++) {
        double mean[3] = {0}, square = 0;
        for (bk_uint i = 0; i < RAYS; i++) {
            bk_vec3w d = direction(&all, bk_hash(seed), i);
            assert_near(bk_dotw(d, d), 1, 1e-5, "length");
            mean[0] += d.x / RAYS;
            mean[1] += d.y / RAYS;
            mean[2] += d.z / RAYS;
            square += d.z * d.z / RAYS;
        }
        assert_near(mean[0], 0, 1e-3, "mean x");
        assert_near(mean[1], 0, 1e-3, "mean y");
        assert_near(mean[2], 2.0 / 3, 1e-3, "mean cosine");
        assert_near(square, 0.5, 1e-3, "mean squared cosine");
    }
}

/* The samples of a texel share its seed, and each has a part of its own of every ring. */
TEST(samples_share_directions)
{
    for (bk_uint n = 1; n <= 4; n++) {
        const bk_uint count = 144 / (n * n);
        const bk_rays part = {.open = 1, .count = count, .samples = n * n, .sine2 = 1};
        bool taken[144] = {false};
        for (bk_uint s = 0; s < n * n; s++) {
            const bk_uint column = s % n, row = s / n;
            const float x = 70.0f + ((float)column + 0.5f) / (float)n;
            const float y = 5.0f + ((float)row + 0.5f) / (float)n;
            const bk_share share = bk_sample_share(x, y, n);
            assert_int_equal(share.seed, bk_sample_share(70.5f, 5.5f, 1).seed);
            for (bk_uint i = 0; i < count; i++) {
                const bk_vec3w d = bk_cone_directions(&part, share, i);
                const bk_uint ring = (bk_uint)(144 * (d.x * d.x + d.y * d.y));
                taken[ring < 144 ? ring : 143] = true;
            }
        }
        bk_uint rings = 0;
        for (bk_uint i = 0; i < 144; i++)
            rings += taken[i];
        assert_true(rings >= 142); /* but for rounding at their borders */
    }
}

/* Returns the root mean square error of areas cut off the disc by lines, as rays of m of n x n
 * samples find them. */
static double error_of_cuts(bk_uint n, bk_uint m, bk_uint count)
{
    const bk_rays part = {.open = 1, .count = count, .samples = n * n, .sine2 = 1};
    const int cuts = 40;
    double sum = 0;
    for (bk_uint seed = 0; seed < 50; seed++)
        for (int cut = 0; cut < cuts; cut++) {
            const double p = (2 * cut + 1.0) / cuts - 1;
            const double area = 1 - (acos(p) - p * sqrt(1 - p * p)) / acos(-1);
            double below = 0;
            for (bk_uint s = 0; s < m; s++)
                for (bk_uint i = 0; i < count; i++) {
                    const bk_share share = {.seed = bk_hash(seed),
                                            .first = (seed + s) % part.samples};
                    below += bk_cone_directions(&part, share, i).x < p;
                }
            sum += pow(below / (m * count) - area, 2);
        }
    return sqrt(sum / (50 * cuts));
}

/* Samples that see the same find as much as one with all of their rays, and each sample alone as
 * much as one with as few. */
TEST(samples_share_an_even_set)
{
    for (bk_uint n = 2; n <= 3; n++)
        for (bk_uint count = 4; count <= 64; count *= 4) {
            const double one = error_of_cuts(1, 1, n * n * count);
            assert_true(error_of_cuts(n, n * n, count) < 1.1 * one);
            assert_true(error_of_cuts(n, 1, count) < 1.1 * error_of_cuts(1, 1, count));
        }
}

TEST(cones_and_frames)
{
    const bk_rays cone = {.open = 1, .count = 64, .samples = 1, .sine2 = 0.25f};
    uint64_t seed = test_seed();
    for (int i = 0; i < 2000; i++) {
        double n[3];
        analytic_random_unit(&seed, n);
        if (i == 0)
            n[0] = n[1] = 0, n[2] = -1;
        bk_vec3 axis = bk_unit(bk_v3((float)n[0], (float)n[1], (float)n[2]));
        bk_vec3w d = bk_around(direction(&cone, (bk_uint)i, (bk_uint)i % 64), axis);
        assert_near(bk_dotw(d, d), 1, 1e-5, "length");
        assert_true(bk_dot(bk_lane3(&d, 0), axis) > 0.8659f);
    }
    for (int i = 0; i <= 100000; i++) {
        float u = (float)i / 100000, sine, cosine;
        bk_turn_sine(u, &sine, &cosine);
        assert_near(sine, sin(2 * PI * (double)u), 5e-7, "sine");
        assert_near(cosine, cos(2 * PI * (double)u), 5e-7, "cosine");
    }
}

/* ---- open ---- */

/* A floor beside a wall of height h: the floor sees it from distance d under the form factor (1 - d
 * / sqrt(d^2 + h^2)) / 2 (Howell, "A Catalog of Radiation Heat Transfer Configuration Factors",
 * B-1), so a large wall hides one half. */
TEST(a_wall_hides_half_of_a_floor)
{
    struct scene s = begin();
    const double h = 150;
    add_rectangle(&s, (double[]){60, 0.3, 0.1}, (double[]){60, 0, 0}, (double[]){0, 600, 0}, 1);
    add_rectangle(&s, (double[]){0.2, 0.3, h / 2 + 0.1}, (double[]){0, 0, h / 2},
                  (double[]){0, 600, 0}, -1);
    open_scene(&s);
    for (int i = 1; i < 7; i++) {
        const double d = 1 << i;
        const double at[3] = {0.2 + d, 0.3, 0.1}, up[3] = {0, 0, 1};
        const bk_surroundings found = look(&s, at, up);
        const bk_vec3 bent = bk_unit(found.bent);
        assert_near(found.open, 0.5 + d / sqrt(d * d + h * h) / 2, 0.01, "beside a wall");
        assert_near(bent.y, 0, 0.03, "bent along the wall");
        /* The mean of a half disc, 4 / (3 pi), over that of its heights, 2 / 3. */
        if (d < 5)
            assert_near(atan2(bent.x, bent.z), atan(2 / PI), 0.03, "bent away from the wall");
    }
    end(&s);
}

/* Returns what the rays find from the hit of a line down onto a floor at (x, y). */
static bk_surroundings look_from_hit(const struct scene *s, double x, double y)
{
    static float found[2 * RAYS];
    const bk_lines lines = {.count = 1,
                            .origin = bk_v3w((float)x, (float)y, 0),
                            .direction = bk_v3w(0, 0, 1),
                            .facing = bk_v3w(0, 0, 1),
                            .t_min = -4,
                            .t_max = 4};
    bk_cache cache = bk_cache_empty();
    bk_hits hits;
    bk_trace(&s->grid, &s->params, &cache, &lines, &hits);
    assert_int_equal(hits.found, 1);
    const bk_vec3 at = bk_v3((float)x, (float)y, hits.t), up = bk_lane3(&hits.up, 0);
    const bk_uint crowded = bk_crowded_by(&hits, 0);
    const bk_viewpoint from = {.open_from = bk_add_scaled(at, crowded ? 0 : BK_LIFT, up),
                               .solid_from = at,
                               .normal = up,
                               .crowded = crowded,
                               .side = 1,
                               .share.seed = bk_hash((bk_uint)(int)(1000 * x))};
    for (bk_uint ray = 0; ray < bk_ray_count(&s->params); ray++)
        bk_look_from(&s->grid, &s->params, &from, ray, &found[ray]);
    return bk_add_up(&s->params, &from, found);
}

/* On both sides of a wall, the floor sees half of the sky close to it too: in the voxel in which
 * both meet, wherever the wall stands in that. */
TEST(a_wall_hides_half_of_its_foot)
{
    for (int place = 0; place < 5; place++) {
        struct scene s = begin();
        const double h = 150, wall = 0.2 * place;
        add_rectangle(&s, (double[]){0.3, 0.3, 0.1}, (double[]){60, 0, 0}, (double[]){0, 600, 0},
                      1);
        add_rectangle(&s, (double[]){wall, 0.3, h / 2 + 0.1}, (double[]){0, 0, h / 2},
                      (double[]){0, 600, 0}, -1);
        open_scene(&s);
        for (int i = -8; i <= 8; i++)
            if (i < -1 || i > 1)
                assert_near(look_from_hit(&s, wall + 0.2 * i, 0.3).open, 0.5, 0.07,
                            "at the foot of a wall");
        end(&s);
    }
}

/* The floor's middle of a round well sees the sky under the cone tan = r / h: r^2 / (r^2 + h^2).
 * Whole voxels of the rim, 73 voxels away, narrow it by up to one voxel. */
TEST(a_tube_leaves_a_cone)
{
    struct scene s = begin();
    const double r = 40.3, h = 61;
    const int rings = (int)(h / 0.4), steps = (int)(2 * PI * r / 0.4);
    for (int ring = 0; ring < rings; ring++)
        for (int step = 0; step < steps; step++) {
            const double z = 0.2 + 0.4 * ring, a = 2 * PI * step / steps;
            const double n[3] = {-cos(a), -sin(a), 0};
            analytic_grid_add(s.samples, (double[]){r * cos(a), r * sin(a), z}, n, 0.16, NULL);
        }
    add_rectangle(&s, (double[]){0, 0, 0}, (double[]){r, 0, 0}, (double[]){0, r, 0}, 1);
    open_scene(&s);
    const double at[3] = {0.1, 0.2, 0}, up[3] = {0, 0, 1};
    s.params.coarse = BK_FAR;
    assert_near(look(&s, at, up).open, r * r / (r * r + (h - BK_LIFT) * (h - BK_LIFT)), 0.01,
                "in a tube");
    s.params.open_sine2 = 0.1f; /* a cone that fits through the opening */
    assert_near(look(&s, at, up).open, 1, 0, "in a cone");
    s.params.open_sine2 = 0.6f;
    const float open = look(&s, at, up).open;
    assert_near(open, r * r / (r * r + (h - BK_LIFT) * (h - BK_LIFT)) / 0.6, 0.01,
                "in a wider cone");
    s.params.coarse = BAKE_AO_COARSE;
    assert_near(open - look(&s, at, up).open, 0.013, 0.01, "behind a coarse rim");
    s.params.coarse = BK_FAR;
    s.params.open_sine2 = 1;
    s.params.open_limit = (float)r - 2;
    assert_near(look(&s, at, up).open, 1, 0, "with short rays");
    end(&s);
}

/* A ceiling at height h hides rays of length t = h / cos by 1 - t / limit. Their mean share under a
 * large ceiling is 2 (h / l) (1 - h / l) + (h / l)^2, with cosines below h / l open. */
TEST(falloff_is_linear)
{
    struct scene s = begin();
    const double h = 20.4, l = 100;
    add_rectangle(&s, (double[]){0, 0, 0}, (double[]){4, 0, 0}, (double[]){0, 4, 0}, 1);
    add_rectangle(&s, (double[]){0, 0, h}, (double[]){120, 0, 0}, (double[]){0, 120, 0}, -1);
    open_scene(&s);
    s.params.open_limit = (float)l;
    const double share = (h - BK_LIFT) / l;
    const double at[3] = {0.1, 0.2, 0}, up[3] = {0, 0, 1};
    assert_near(look(&s, at, up).open, share * share, 0.01, "below a ceiling");
    s.params.flags |= BK_OPEN_FALLOFF;
    assert_near(look(&s, at, up).open, 2 * share * (1 - share) + share * share, 0.01,
                "with falloff");
    end(&s);
}

/* A ray along a floor, a fifth of a voxel above it, does not cross it. From coarse on the
 * floor's voxels hide it: the first one that it enters there. */
TEST(far_voxels_hide)
{
    struct scene s = begin();
    const bk_vec3 start = bk_v3(-20.2f, 0.1f, 0.3f);
    const bk_viewpoint from = {.open_from = start, .solid_from = start, .side = 1};
    bk_rays rays = {.open = 1, .count = 1, .sine2 = 1, .limit = BK_FAR};
    add_rectangle(&s, (double[]){60, 0, 0.1}, (double[]){60, 0, 0}, (double[]){0, 9, 0}, 1);
    open_scene(&s);
    s.params.flags |= BK_OPEN_FALLOFF; /* distances count */
    const struct {
        float coarse, limit;
        bk_uint open;
        double found;
    } cases[] = {{BK_FAR, BK_FAR, 1, -1},
                 {64, BK_FAR, 1, 44.5 + 20.2},
                 {64.6f, BK_FAR, 1, 64.7},
                 {64.8f, BK_FAR, 1, 65.7},
                 {64, 64.5f, 1, -1},
                 {64, 64.8f, 1, 64.7},
                 {64, BK_FAR, 0, 64.7 + BK_FAR_DEPTH},
                 {BK_FAR, BK_FAR, 0, -1},
                 {1, BK_FAR, 1, 19.7}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        s.params.coarse = cases[i].coarse;
        rays.limit = cases[i].limit;
        rays.open = cases[i].open;
        const float t = bk_tree_look(&s.grid, &s.params, &rays, &from, bk_v3w(1, 0, 0));
        assert_near(t, cases[i].found, 1e-4, "along a floor");
    }
    end(&s);
}

/* ---- convex bodies, and thickness ---- */

/* A ball does not hide itself, and the mean chord is 4 r / 3. */
TEST(a_ball_is_open_and_thick)
{
    static const double radii[] = {5.3, 12, 40.7};
    for (int i = 0; i < 3; i++) {
        struct scene s = begin();
        const double centre[3] = {3.3, -2.1, 7.7}, r = radii[i];
        uint64_t seed = test_seed();
        analytic_sphere(s.samples, centre, r, 3);
        open_scene(&s);
        s.params.open_rays = s.params.thickness_rays = 256;
        double open = 0, thickness = 0;
        for (int k = 0; k < 100; k++) {
            double n[3], at[3];
            analytic_random_unit(&seed, n);
            for (int axis = 0; axis < 3; axis++)
                at[axis] = centre[axis] + r * n[axis];
            const bk_surroundings found = look(&s, at, n);
            open += found.open / 100;
            thickness += found.thickness / found.solids / 100;
            assert_near(found.open, 1, 0, "of a ball");
            assert_near(found.thickness / found.solids, 4 * r / 3, 0.05 * r + 0.5,
                        "thickness of a ball");
        }
        assert_near(thickness, 4 * r / 3, 0.02 * r, "mean thickness of a ball");
        end(&s);
    }
}

/* A slab of height h, with rays of at most l: 2 h - h^2 / l. Thin ones have two records a voxel. */
TEST(a_slab_is_as_thick_as_it_is)
{
    static const double heights[] = {0.4, 1.2, 3.3, 20.6};
    for (int i = 0; i < 4; i++) {
        struct scene s = begin();
        const double h = heights[i], l = 60;
        add_rectangle(&s, (double[]){0, 0, 0.1}, (double[]){90, 0, 0}, (double[]){0, 90, 0}, -1);
        add_rectangle(&s, (double[]){0, 0, h + 0.1}, (double[]){90, 0, 0}, (double[]){0, 90, 0}, 1);
        open_scene(&s);
        s.params.thickness_limit = (float)l;
        const double at[3] = {0.3, 0.2, h + 0.1}, up[3] = {0, 0, 1};
        const bk_surroundings found = look(&s, at, up);
        assert_near(found.thickness / found.solids, 2 * h - h * h / l, 0.02 * h + 0.1,
                    "thickness of a slab");
        assert_near(found.open, 1, 0, "above a slab");
        end(&s);
    }
}

RUN_TESTS(NULL, NULL)
