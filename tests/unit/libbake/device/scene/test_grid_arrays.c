/* test_grid_arrays.c - a map gets the same bits from the arrays of a device as from the mapped
 * file. */
#include "libbake/kernel/bk_grid.h"
#include "libbake/device/scene/scene.h"
#include "libbake/device/native/native_code.h"
#include "tests/unit/libbake/analytic_grid.h"
#include "tests/unit/test.h"

enum { WIDTH = 64, HEIGHT = 48, SAMPLES = 2, TEXELS = WIDTH * HEIGHT, TRIANGLES = 24 };

/* A texel of the maps that the fixture selects: normal and color. */
struct sums {
    float covered, hits, normal[3], color[3];
};

struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_nvdb_grid grid;
    struct bake_scene job;
    struct bk_triangle triangles[TRIANGLES];
    uint32_t samples[TEXELS * SAMPLES * SAMPLES];
};

/* Fills the corner of eight upper nodes with sheets, a sphere, and clutter with second records. */
static const double centre[3] = {3, -2, 4095};

static double between(uint64_t *seed, double low, double high)
{
    return low + (high - low) * analytic_random(seed);
}

static void fill(struct fixture *f, uint64_t *seed)
{
    struct analytic_grid *grid = analytic_grid_create();
    const struct analytic_sine sine = analytic_sine_make(20, 150, centre);
    analytic_sine_add(grid, &sine, 2);
    analytic_sphere(grid, centre, 90, 2);
    for (int i = 0; i < 20000; i++) {
        double p[3], n[3];
        float color[3];
        for (int k = 0; k < 3; k++) {
            p[k] = centre[k] + between(seed, -120, 120);
            color[k] = (float)analytic_random(seed);
        }
        analytic_random_unit(seed, n);
        analytic_grid_add(grid, p, n, 1, color);
        for (int k = 0; k < 3; k++)
            n[k] = -n[k];
        if (i % 3 == 0)
            analytic_grid_add(grid, p, n, 1, color);
    }
    analytic_grid_open(f->ctx, grid, true, &f->grid);
    analytic_grid_free(grid);
}

/* Makes a random patch of about ten voxels. */
static void make_triangle(struct bk_triangle *triangle, uint64_t *seed)
{
    double at[3], normal[3], tangent[3];
    *triangle = (struct bk_triangle){.b1 = {1.f / WIDTH, 0, 0}, .b2 = {0, 1.f / HEIGHT, 0}};
    analytic_random_unit(seed, normal);
    for (int k = 0; k < 3; k++)
        at[k] = centre[k] + between(seed, -100, 100);
    for (int corner = 0; corner < 3; corner++) {
        analytic_random_unit(seed, tangent);
        for (int k = 0; k < 3; k++) {
            triangle->position[corner][k] = (float)(at[k] + between(seed, -12, 12));
            triangle->direction[corner][k] = triangle->normal[corner][k] =
                (float)(normal[k] + between(seed, -0.3, 0.3));
            triangle->tangent[corner][k] = (float)tangent[k];
        }
        triangle->tangent[corner][3] = 1;
        triangle->reach[corner] = (float)between(seed, 0, 6);
    }
}

static int setup(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);
    uint64_t seed = 20080312;
    f->ctx = test_context(0, 0);
    fill(f, &seed);
    for (int i = 0; i < TRIANGLES; i++)
        make_triangle(&f->triangles[i], &seed);
    memset(f->triangles[5].normal, 0, sizeof f->triangles[5].normal);
    for (uint32_t j = 0; j < HEIGHT * SAMPLES; j++)
        for (uint32_t i = 0; i < WIDTH * SAMPLES; i++)
            f->samples[j * WIDTH * SAMPLES + i] =
                i % 37 == 0 ? BK_NO_TRIANGLE : (i / 20 * 5 + j / 16 * 7) % TRIANGLES;
    f->job = (struct bake_scene){.grid = &f->grid,
                                 .triangles = f->triangles,
                                 .triangle_count = TRIANGLES,
                                 .patch_texels = TEXELS,
                                 .params = {.maps = BAKE_MAP_NORMAL | BAKE_MAP_COLOR,
                                            .samples = SAMPLES,
                                            .unit = 1,
                                            .front = 30,
                                            .back = 22}};
    bake_params_from_grid(&f->grid, &f->job.params);
    *state = f;
    return 0;
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    fmt_nvdb_close(f->ctx, &f->grid);
    test_context_end(f->ctx);
    free(f);
    return 0;
}

/* ---- a device in memory ---- */

/* Copies the arrays to separate allocations, so that sanitizers notice reads outside of an array.
 */
static void load(const struct bake_grid_arrays *list, char *arrays[BAKE_GRID_ARRAYS],
                 struct bk_grid *grid)
{
    uint64_t total = 0;
    for (int i = 0; i < BAKE_GRID_ARRAYS; i++) {
        const struct bake_grid_array *array = &list->arrays[i];
        uint64_t at = 0;
        arrays[i] = malloc(array->bytes + !array->bytes);
        for (int k = 0; k < BAKE_ARRAY_RANGES; k++) {
            assert_true(array->ranges[k].bytes <= array->bytes - at);
            if (array->ranges[k].bytes > 0)
                memcpy(arrays[i] + at, array->ranges[k].data, array->ranges[k].bytes);
            at += array->ranges[k].bytes;
        }
        assert_int_equal(at, array->bytes);
        assert_true(at <= list->largest);
        total += at;
    }
    assert_int_equal(total, list->bytes);
    bk_grid_from_params(grid, &list->params);
    grid->root_tiles = (const bk_ulong *)(void *)arrays[BAKE_ROOT_TILES];
    grid->uppers = (const bk_ulong *)(void *)arrays[BAKE_UPPERS];
    grid->lowers = (const bk_ulong *)(void *)arrays[BAKE_LOWERS];
    grid->leaves = (const bk_ulong *)(void *)arrays[BAKE_LEAVES];
    grid->normals = (const bk_uint *)(void *)arrays[BAKE_NORMALS];
    grid->planes = (const bk_uint *)(void *)arrays[BAKE_PLANES];
    grid->srgb = (const float *)(void *)arrays[BAKE_COLORS];
    grid->colors = (const bk_uint *)(void *)arrays[BAKE_COLORS] + 256;
    grid->seconds = (const bk_uint *)(void *)arrays[BAKE_SECONDS];
}

static void trace(const struct fixture *f, const struct bk_grid *grid,
                  const struct bk_params *params, struct sums *texels)
{
    const struct bk_patch map = {0, 0, WIDTH, HEIGHT};
    bake_native_patch_base(grid, params, f->triangles, &map, 0, HEIGHT, f->samples,
                           &(struct bake_native_memory){0}, (float *)texels);
}

TEST(test_same_bits)
{
    struct fixture *f = *state;
    static const uint32_t flags[] = {0, BK_TWO_SIDED, BK_NEAREST | BK_OBJECT_SPACE};
    static struct sums expected[TEXELS], texels[TEXELS];

    assert_true(f->grid.upper_count == 8 && f->grid.lower_count > 8);
    assert_true(f->grid.record_count - 1 - f->grid.voxel_count > 1000);
    for (size_t i = 0; i < sizeof flags / sizeof *flags; i++) {
        char *arrays[BAKE_GRID_ARRAYS];
        struct bake_grid_arrays list;
        struct bk_grid mapped, copied;
        uint64_t hits = 0, covered = 0;
        f->job.params.flags |= flags[i];
        bake_kernel_grid(&f->grid, &f->job.params, &mapped);
        trace(f, &mapped, &f->job.params, expected);
        for (int t = 0; t < TEXELS; t++) {
            hits += (uint64_t)expected[t].hits;
            covered += (uint64_t)expected[t].covered;
        }
        print_message("%u of %u rays hit\n", (unsigned)hits, (unsigned)covered);
        assert_true(hits > covered / 20 && hits < covered);
        bake_list_arrays(&f->job, &list);
        load(&list, arrays, &copied);
        trace(f, &copied, &list.params, texels);
        assert_memory_equal(texels, expected, sizeof expected);
        for (int a = 0; a < BAKE_GRID_ARRAYS; a++)
            free(arrays[a]);
        f->job.params.flags &= ~flags[i];
    }
}

RUN_TESTS(setup, teardown)
