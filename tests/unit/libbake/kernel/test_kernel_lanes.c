/* test_kernel_lanes.c - the kernel gives the same bits for any number of lanes and order of
 * samples, and for secondary rays that go through the tree of leaves. Compares groups of four,
 * eight and sixteen in Morton order to single samples, row by row. */
#include "libbake/kernel/bk_sample.h"
#include "libbake/device/native/native_code.h"
#include "libbake/grid_tree/tree_rays.h"
#include "tests/unit/libbake/analytic_grid.h"
#include "tests/unit/libbake/walked_ray.h"
#include "tests/unit/sanitized.h"
#include "tests/unit/test.h"

/* No multiples of a square or a group; with three samples an axis, groups span texels. */
/* Rows and columns end within a square of 8 x 8 texels. */
enum { WIDTH = TEST_SANITIZED ? 21 : 45, HEIGHT = TEST_SANITIZED ? 11 : 27 };
enum { SAMPLES = 3, TEXELS = WIDTH * HEIGHT, TRIANGLES = 40 };
enum { MAPS = 1 << BK_MAP_normal | 1 << BK_MAP_color };
enum { RAYS = 164 };            /* from a hit, at most */
enum { FLOATS = BK_SUMS + 12 }; /* the most: with BK_SECONDARY_MAPS */

struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_nvdb_grid file;
    struct bk_grid grid;
    struct bk_params params;
    struct bk_triangle triangles[TRIANGLES];
    uint32_t samples[TEXELS * SAMPLES * SAMPLES];
};

static double between(uint64_t *seed, double low, double high)
{
    return low + (high - low) * analytic_random(seed);
}

/* Fills crossing sheets and clutter over the borders of leaves, lower and upper nodes: many second
 * records, runs that begin and end, cells across up to eight leaves. */
static void fill(struct fixture *f, uint64_t *seed)
{
    struct analytic_grid *grid = analytic_grid_create();
    const double centre[3] = {2, 127, 4095};
    const struct analytic_sine sine = analytic_sine_make(9, 20, centre);
    analytic_sine_add(grid, &sine, 3);
    analytic_sphere(grid, centre, 11, 3);
    for (int i = 0; i < 3000; i++) {
        double p[3], n[3];
        float color[3];
        for (int k = 0; k < 3; k++) {
            p[k] = centre[k] + between(seed, -24, 24);
            color[k] = (float)analytic_random(seed);
        }
        analytic_random_unit(seed, n);
        analytic_grid_add(grid, p, n, 1, color);
    }
    analytic_grid_open(f->ctx, grid, true, &f->file);
    analytic_grid_free(grid);
}

static void make_triangle(struct bk_triangle *triangle, uint64_t *seed)
{
    const double centre[3] = {2, 127, 4095};
    *triangle = (struct bk_triangle){.b1 = {1.f / WIDTH, 0, 0}, .b2 = {0, 1.f / HEIGHT, 0}};
    for (int corner = 0; corner < 3; corner++) {
        double normal[3], tangent[3];
        analytic_random_unit(seed, normal);
        analytic_random_unit(seed, tangent);
        for (int k = 0; k < 3; k++) {
            triangle->position[corner][k] = (float)(centre[k] + between(seed, -20, 20));
            triangle->direction[corner][k] = triangle->normal[corner][k] = (float)normal[k];
            triangle->tangent[corner][k] = (float)tangent[k];
        }
        triangle->tangent[corner][3] = corner & 1 ? -1.f : 1.f;
        triangle->reach[corner] = (float)between(seed, 0, 12);
    }
}

static int setup(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);
    uint64_t seed = 20080312;
    f->ctx = test_context(0, 0);
    fill(f, &seed);
    bake_params_from_grid(&f->file, &f->params);
    f->params.maps = MAPS;
    f->params.unit = 1;
    f->params.samples = SAMPLES;
    f->params.front = 9;
    f->params.back = 14;
    bake_kernel_grid(&f->file, &f->params, &f->grid);
    for (int i = 0; i < TRIANGLES; i++)
        make_triangle(&f->triangles[i], &seed);
    /* A triangle without a normal covers texels and finds nothing. */
    memset(f->triangles[7].normal, 0, sizeof f->triangles[7].normal);
    /* Runs of one triangle, single samples of others, and holes. */
    uint32_t current = 0;
    for (size_t i = 0; i < sizeof f->samples / sizeof *f->samples; i++) {
        if (analytic_random(&seed) < 0.1)
            current = (uint32_t)(TRIANGLES * analytic_random(&seed));
        f->samples[i] = analytic_random(&seed) < 0.1 ? BK_NO_TRIANGLE : current;
    }
    *state = f;
    return 0;
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    fmt_nvdb_close(f->ctx, &f->file);
    bsq_ctx_destroy(f->ctx);
    free(f);
    return 0;
}

/* Traces the rays from a viewpoint voxel by voxel. */
static void look_around(const struct fixture *f, const struct bk_params *params,
                        const bk_viewpoint *from, float *found)
{
    for (uint32_t open = from->side != 0 ? 2 : 0; open-- > 0;) {
        const bk_rays rays = bk_rays_of(params, open);
        for (uint32_t i = 0; i < rays.count; i++)
            *found++ = walked_ray(&f->grid, params, &rays, from, bk_ray_directions(&rays, from, i));
    }
}

/* Traces a texel as GPUs do: viewpoints, the rays from them, and what these found. */
static void trace_texel(const struct fixture *f, const struct bk_params *params,
                        const struct bk_patch *patch, uint32_t column, uint32_t row, float *texel)
{
    static bk_viewpoint points[SAMPLES * SAMPLES];
    static float found[SAMPLES * SAMPLES * RAYS];
    const uint32_t rays = bk_ray_count(params);
    const bk_batch batch = {row, row + 1, column, column + 1, 0, params->samples};
    bk_looks looks = {rays > 0 ? BK_POINTS : BK_ADD, points, found};
    bk_cache cache = bk_cache_empty();
    assert_true(rays <= RAYS && params->samples <= SAMPLES);
    bk_clear_texel(params->maps, texel);
    bk_sample_texel(&f->grid, params, &cache, f->triangles, patch, &batch, f->samples, column, row,
                    &looks, texel);
    if (rays == 0)
        return;
    for (uint32_t i = 0; i < params->samples * params->samples; i++)
        look_around(f, params, &points[i], &found[i * rays]);
    looks.stage = BK_ADD_FOUND;
    bk_sample_texel(&f->grid, params, &cache, f->triangles, patch, &batch, f->samples, column, row,
                    &looks, texel);
}

static void one_by_one(const struct fixture *f, const struct bk_params *params,
                       const struct bk_patch *patch, float *texels)
{
    for (uint32_t row = 0; row < HEIGHT; row++)
        for (uint32_t column = 0; column < WIDTH; column++)
            trace_texel(f, params, patch, column, row,
                        texels + (row * WIDTH + column) * bk_texel_floats(params->maps));
}

/* Compares patches that are traced with the widest lanes to be had and with all narrower ones.
 * tree: for secondary rays; NULL: there are none. */
static void compare(const struct fixture *f, const struct bk_params *params,
                    const struct bake_tree *tree)
{
    static float expected[TEXELS * FLOATS], found[TEXELS * FLOATS];
    static float results[BAKE_NATIVE_HITS * RAYS];
    static struct bake_tree_stream stream;
    const struct bake_native_memory memory = {tree, &stream, results};
    const struct bk_patch patch = {.x = 3, .y = 1, .width = WIDTH, .height = HEIGHT};
    const uint64_t entries = bk_texel_floats(params->maps);
    uint64_t covered = 0, hits = 0;

    assert_true(entries <= FLOATS && params->open_rays + params->thickness_rays <= RAYS);
    one_by_one(f, params, &patch, expected);
    for (uint64_t i = 0; i < TEXELS; i++) {
        covered += (uint64_t)expected[i * entries + BK_COVERED];
        hits += (uint64_t)expected[i * entries + BK_HITS];
    }
    print_message("flags %u: %u of %u rays hit\n", (unsigned)params->flags, (unsigned)hits,
                  (unsigned)covered);
    assert_true(hits > covered / 4 && hits < covered);
    if (bsq_simd_best() < BSQ_SIMD_AVX512)
        print_message("this processor cannot run all levels of instructions\n");
    for (unsigned level = BSQ_SIMD_BASE; level <= bsq_simd_best(); level++) {
        bake_native_patch_fn *code = BSQ_SIMD_PICK(level, bake_native_patch);
        memset(found, 0xff, sizeof found);
        code(&f->grid, params, f->triangles, &patch, 0, patch.height, f->samples, &memory, found);
        assert_memory_equal(found, expected, TEXELS * entries * sizeof *found);
    }
}

static void compare_flags(const struct fixture *f, uint32_t flags)
{
    struct bk_params params = f->params;
    params.flags |= flags;
    compare(f, &params, NULL);
}

TEST(test_lanes)
{
    compare_flags(*state, 0);
    compare_flags(*state, BK_TWO_SIDED);
    compare_flags(*state, BK_NEAREST);
    compare_flags(*state, BK_OBJECT_SPACE);
    compare_flags(*state, BK_OBJECT_SPACE | BK_NEAREST | BK_TWO_SIDED);
}

/* Secondary rays give the same bits through the tree of leaves. Their numbers are no multiples of a
 * group; the most are in two bundles, and all of a group in several streams. */
TEST(test_rays_from_hits)
{
    static const uint32_t counts[][2] = {{11, 5}, {1, 0}, {100, 64}};
    const struct fixture *f = *state;
    struct bk_params params = f->params;
    struct bake_tree tree;
    assert_int_equal(bake_tree_build(f->ctx, &f->file, &tree), 0);
    params.flags |= BK_TWO_SIDED;
    params.open_sine2 = 1;
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
        params.open_rays = counts[i][0];
        params.thickness_rays = counts[i][1];
        params.maps = MAPS | BK_OPEN_MAPS | (counts[i][1] ? 1u << BK_MAP_thickness : 0);
        params.flags &= ~(uint32_t)BK_OPEN_FALLOFF;
        params.open_limit = i == 1 ? 7 : 300;
        params.coarse = i == 2 ? 12.5f : BK_FAR;
        params.thickness_limit = 30;
        compare(f, &params, &tree);
        params.flags |= BK_OPEN_FALLOFF;
        compare(f, &params, &tree);
    }
    bake_tree_free(f->ctx, &tree);
}

RUN_TESTS(setup, teardown)
