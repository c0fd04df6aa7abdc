/* test_passes.c - a piece of the map gets the same bits from a subgrid as from the whole grid, and
 * passes fit the memory that they are planned for. */
#include "libbake/kernel/bk_grid.h"
#include "libbake/device/native/native_code.h"
#include "libbake/device/subgrid/subgrid.h"
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
    struct bake_job job;
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
    f->job = (struct bake_job){.grid = &f->grid,
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

struct memory {
    char *data;
    uint64_t used, bytes;
};

static int put(void *arg, const void *data, uint64_t bytes)
{
    struct memory *memory = arg;
    assert_true(bytes <= memory->bytes - memory->used);
    memcpy(memory->data + memory->used, data, bytes);
    memory->used += bytes;
    return 0;
}

static void load(const struct bake_subgrid *subgrid, struct memory arrays[BAKE_SUBGRID_ARRAYS],
                 struct bk_grid *grid)
{
    for (int i = 0; i < BAKE_SUBGRID_ARRAYS; i++) {
        /* Separate allocations, so that sanitizers notice reads outside of an array. */
        arrays[i] =
            (struct memory){malloc(subgrid->bytes[i] + !subgrid->bytes[i]), 0, subgrid->bytes[i]};
        assert_int_equal(bake_subgrid_send(subgrid, i, put, &arrays[i]), 0);
        assert_int_equal(arrays[i].used, subgrid->bytes[i]);
    }
    bk_grid_from_params(grid, &subgrid->params);
    grid->tiles = (const bk_ulong *)(void *)arrays[BAKE_TILES].data;
    grid->uppers = (const bk_ulong *)(void *)arrays[BAKE_UPPERS].data;
    grid->lowers = (const bk_ulong *)(void *)arrays[BAKE_LOWERS].data;
    grid->leaves = (const bk_ulong *)(void *)arrays[BAKE_LEAVES].data;
    grid->normals = (const bk_uint *)(void *)arrays[BAKE_NORMALS].data;
    grid->planes = (const bk_uint *)(void *)arrays[BAKE_PLANES].data;
    grid->srgb = (const float *)(void *)arrays[BAKE_COLORS].data;
    grid->colors = (const bk_uint *)(void *)arrays[BAKE_COLORS].data + 256;
    grid->seconds = (const bk_uint *)(void *)arrays[BAKE_SECONDS].data;
}

static void trace(const struct fixture *f, const struct bake_subgrid *subgrid,
                  const struct bk_patch *patch, const uint32_t *samples, struct sums *texels)
{
    struct memory arrays[BAKE_SUBGRID_ARRAYS];
    struct bk_grid grid;
    load(subgrid, arrays, &grid);
    bake_native_patch_base(&grid, &subgrid->params, f->triangles, patch, 0, patch->height, samples,
                           &(struct bake_native_memory){0}, (float *)texels);
    for (int i = 0; i < BAKE_SUBGRID_ARRAYS; i++)
        free(arrays[i].data);
}

/* Traces a rectangle with the nodes that its rays look up. expected: texels of the whole map. */
static uint64_t compare(const struct fixture *f, const struct bake_rectangle *r,
                        const struct sums *expected)
{
    const struct bk_patch map = {0, 0, WIDTH, HEIGHT}, patch = {r->x, r->y, r->width, r->height};
    const uint32_t row = r->width * SAMPLES;
    uint32_t *samples = malloc(sizeof *samples * row * r->height * SAMPLES);
    struct sums *texels = malloc(sizeof *texels * r->width * r->height);
    struct bake_lower_set set;
    struct bake_subgrid subgrid;
    uint64_t lowers;
    assert_int_equal(bake_lower_set_create(f->ctx, &f->grid, &set), 0);
    assert_int_equal(bake_lower_set_add_rays(f->ctx, &set, &f->job, &map, f->samples, r), 0);
    lowers = set.count;
    assert_int_equal(bake_subgrid_create(f->ctx, &set, &f->job.params, &subgrid), 0);
    for (uint32_t j = 0; j < r->height * SAMPLES; j++)
        memcpy(samples + j * row,
               f->samples + (r->y * SAMPLES + j) * WIDTH * SAMPLES + r->x * SAMPLES,
               row * sizeof *samples);
    trace(f, &subgrid, &patch, samples, texels);
    for (uint32_t y = 0; y < r->height; y++)
        assert_memory_equal(texels + y * r->width, expected + (r->y + y) * WIDTH + r->x,
                            r->width * sizeof *texels);
    bake_subgrid_free(f->ctx, &subgrid);
    bake_lower_set_free(f->ctx, &set);
    free(samples);
    free(texels);
    return lowers;
}

TEST(test_same_bits)
{
    struct fixture *f = *state;
    static const uint32_t flags[] = {0, BK_TWO_SIDED, BK_NEAREST | BK_OBJECT_SPACE};
    static const struct bake_rectangle rectangles[] = {
        {0, 0, WIDTH, HEIGHT}, {0, 0, 32, 16}, {17, 9, 1, 1}, {40, 31, 13, 9}, {3, 40, 60, 8}};
    static struct sums expected[TEXELS];
    const struct bk_patch map = {0, 0, WIDTH, HEIGHT};

    for (size_t i = 0; i < sizeof flags / sizeof *flags; i++) {
        struct bake_subgrid whole;
        uint64_t hits = 0, covered = 0;
        f->job.params.flags |= flags[i];
        bake_subgrid_whole(&f->grid, &f->job.params, &whole);
        trace(f, &whole, &map, f->samples, expected);
        for (int t = 0; t < TEXELS; t++) {
            hits += (uint64_t)expected[t].hits;
            covered += (uint64_t)expected[t].covered;
        }
        print_message("%u of %u rays hit\n", (unsigned)hits, (unsigned)covered);
        assert_true(hits > covered / 20 && hits < covered);
        for (size_t r = 0; r < sizeof rectangles / sizeof *rectangles; r++) {
            const uint64_t lowers = compare(f, &rectangles[r], expected);
            print_message("%u x %u texels: %u of %u lower nodes\n", (unsigned)rectangles[r].width,
                          (unsigned)rectangles[r].height, (unsigned)lowers,
                          (unsigned)f->grid.lower_count);
            /* A texel's rays are 52 voxels long, less than a lower node. */
            assert_true(lowers <= f->grid.lower_count);
            assert_true(rectangles[r].width > 1 || lowers <= 8);
        }
        f->job.params.flags &= ~flags[i];
    }
}

/* A set of all nodes gives the grid itself. */
TEST(test_whole_set)
{
    struct fixture *f = *state;
    struct bake_lower_set set;
    struct bake_subgrid subgrid, whole;
    struct memory a[BAKE_SUBGRID_ARRAYS], b[BAKE_SUBGRID_ARRAYS];
    struct bk_grid grid;
    assert_int_equal(bake_lower_set_create(f->ctx, &f->grid, &set), 0);
    for (uint32_t i = 0; i < f->grid.lower_count; i++)
        assert_int_equal(bake_lower_set_add(f->ctx, &set, i), 0);
    assert_int_equal(bake_subgrid_create(f->ctx, &set, &f->job.params, &subgrid), 0);
    bake_subgrid_whole(&f->grid, &f->job.params, &whole);
    assert_memory_equal(&subgrid.counts, &whole.counts, sizeof subgrid.counts);
    assert_true(whole.counts.seconds > 1000 && f->grid.upper_count == 8);
    assert_memory_equal(&subgrid.params, &whole.params, sizeof subgrid.params);
    load(&subgrid, a, &grid);
    load(&whole, b, &grid);
    for (int i = 0; i < BAKE_SUBGRID_ARRAYS; i++) {
        assert_int_equal(a[i].bytes, b[i].bytes);
        /* Subgrids have zeros in table entries without a child. */
        if (i != BAKE_UPPERS && i != BAKE_LOWERS)
            assert_memory_equal(a[i].data, b[i].data, a[i].bytes);
        free(a[i].data);
        free(b[i].data);
    }
    bake_subgrid_free(f->ctx, &subgrid);
    bake_lower_set_free(f->ctx, &set);
}

/* Counts of lower nodes are enough for any subgrid, and not much more. */
TEST(test_counts)
{
    struct fixture *f = *state;
    uint64_t seed = 7, bytes[BAKE_SUBGRID_ARRAYS];
    for (int i = 0; i < 40; i++) {
        struct bake_subgrid_counts counts = {.values = 1};
        struct bake_lower_set set;
        struct bake_subgrid subgrid;
        assert_int_equal(bake_lower_set_create(f->ctx, &f->grid, &set), 0);
        for (int n = 0; n < i; n++) {
            const uint32_t lower = (uint32_t)between(&seed, 0, f->grid.lower_count);
            if (!set.has[lower])
                bake_subgrid_count(&f->grid, lower, &counts);
            assert_int_equal(bake_lower_set_add(f->ctx, &set, lower), 0);
        }
        assert_int_equal(bake_subgrid_create(f->ctx, &set, &f->job.params, &subgrid), 0);
        assert_int_equal(subgrid.counts.lowers, counts.lowers);
        assert_int_equal(subgrid.counts.leaves, counts.leaves);
        assert_int_equal(subgrid.counts.seconds, counts.seconds);
        assert_in_range(subgrid.counts.values, counts.values - 64 * counts.lowers, counts.values);
        bake_subgrid_sizes(&f->grid, &counts, bytes);
        for (int a = 0; a < BAKE_SUBGRID_ARRAYS; a++)
            assert_true(subgrid.bytes[a] <= bytes[a]);
        bake_subgrid_free(f->ctx, &subgrid);
        bake_lower_set_free(f->ctx, &set);
    }
}

RUN_TESTS(setup, teardown)
