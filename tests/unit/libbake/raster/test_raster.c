/* test_raster.c - rasterisation against a naive reference in double, and properties that hold for
 * any mesh. */
#include "libbake/raster/raster.h"
#include "tests/unit/test.h"

#define SEED UINT64_C(20080611)

/* ---- helpers ---- */

struct fixture {
    struct bsq_ctx *ctx;
    struct bake_lowmesh mesh;
    uint64_t capacity;
    uint64_t random;
};

static int set_up(void **state)
{
    struct fixture *f = calloc(1, sizeof(*f));
    if (f == NULL || bsq_ctx_create(&(struct bsq_ctx_options){.threads = 1}, &f->ctx) < 0)
        return -1;
    f->random = SEED;
    *state = f;
    return 0;
}

static int tear_down(void **state)
{
    struct fixture *f = *state;
    uint64_t used = bsq_memory_used(f->ctx);
    free(f->mesh.positions);
    free(f->mesh.normals);
    free(f->mesh.texcoords);
    free(f->mesh.tangents);
    free(f->mesh.directions);
    free(f->mesh.reaches);
    if (used > 0)
        return -1; /* a failed test does not free its memory */
    bsq_ctx_destroy(f->ctx);
    free(f);
    return 0;
}
#define FIXTURE_TEST(name) STATE_TEST(name, struct fixture, set_up, tear_down)

static double random_between(struct fixture *f, double low, double high)
{
    f->random = f->random * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return low + (high - low) * (double)(f->random >> 11) * 0x1p-53;
}

static void *resized(void *memory, uint64_t count, size_t size)
{
    memory = realloc(memory, count * size);
    assert_non_null(memory);
    return memory;
}

/* Adds a triangle; its other attributes are functions of the texture coordinates. */
static void add_triangle(struct fixture *f, const float a[2], const float b[2], const float c[2])
{
    const float *uv[3] = {a, b, c};
    struct bake_lowmesh *m = &f->mesh;

    if (m->triangle_count == f->capacity) {
        f->capacity = 2 * f->capacity + 16;
        m->positions = resized(m->positions, f->capacity, sizeof(*m->positions));
        m->normals = resized(m->normals, f->capacity, sizeof(*m->normals));
        m->texcoords = resized(m->texcoords, f->capacity, sizeof(*m->texcoords));
        m->tangents = resized(m->tangents, f->capacity, sizeof(*m->tangents));
        m->directions = resized(m->directions, f->capacity, sizeof(*m->directions));
        m->reaches = resized(m->reaches, f->capacity, sizeof(*m->reaches));
    }
    uint64_t t = m->triangle_count++;
    for (int i = 0; i < 3; i++) {
        const double position[3] = {100 + 2.0 * uv[i][0], 200 + 3.0 * uv[i][1], -50.0 * uv[i][0]};
        const float normal[3] = {0, 0, 1}, tangent[4] = {1, 0, 0, i == 0 ? 1.0f : -1.0f};
        memcpy(m->positions[t][i], position, sizeof(position));
        memcpy(m->normals[t][i], normal, sizeof(normal));
        memcpy(m->texcoords[t][i], uv[i], 2 * sizeof(float));
        memcpy(m->tangents[t][i], tangent, sizeof(tangent));
        m->reaches[t][i] = 1.0f + uv[i][0];
    }
}

static void add_quad(struct fixture *f, float u0, float v0, float u1, float v1)
{
    const float a[2] = {u0, v0}, b[2] = {u1, v0}, c[2] = {u1, v1}, d[2] = {u0, v1};
    add_triangle(f, a, b, c);
    add_triangle(f, a, c, d);
}

struct map {
    uint32_t columns, rows; /* samples */
    uint32_t *owners;
    uint64_t overlaps, covered;
    struct bake_raster_report report;
};

static struct bake_raster *create(struct fixture *f, uint32_t width, uint32_t height, uint32_t n,
                                  uint32_t patch_side, struct bake_raster_report *report)
{
    const struct bake_raster_options options = {
        width, height, n, patch_side, 0, f->mesh.triangle_count, NULL, NULL, 0};
    struct bake_raster *raster = NULL;
    if (bake_raster_create(f->ctx, &f->mesh, &options, report, &raster) < 0)
        fail_msg("%s", bsq_error(f->ctx));
    return raster;
}

/* Rasterises all patches and assembles the map. Free map.owners. */
static struct map rasterise(struct fixture *f, uint32_t width, uint32_t height, uint32_t n,
                            uint32_t patch_side)
{
    struct map map = {.columns = width * n, .rows = height * n};
    struct bake_raster *raster = create(f, width, height, n, patch_side, &map.report);
    uint32_t *patch_owners = resized(NULL, (uint64_t)patch_side * patch_side * n * n, 4);

    map.owners = resized(NULL, (uint64_t)map.columns * map.rows, 4);
    memset(map.owners, 0xff, (size_t)map.columns * map.rows * 4);
    for (uint32_t k = 0; k < bake_raster_patch_count(raster); k++) {
        struct bk_patch patch = bake_raster_patch(raster, k);
        uint64_t overlaps = UINT64_MAX;
        assert_int_equal(bake_raster_fill(raster, k, patch_owners, &overlaps), 0);
        map.overlaps += overlaps;
        for (uint32_t y = 0; y < patch.height * n; y++)
            memcpy(map.owners + (uint64_t)(patch.y * n + y) * map.columns + patch.x * n,
                   patch_owners + (uint64_t)y * patch.width * n, patch.width * n * 4);
    }
    for (uint64_t k = 0; k < (uint64_t)map.columns * map.rows; k++)
        map.covered += map.owners[k] != BK_NO_TRIANGLE;
    free(patch_owners);
    bake_raster_free(raster);
    return map;
}

static uint32_t owner(const struct map *map, uint32_t x, uint32_t y)
{
    return map->owners[(uint64_t)y * map->columns + x];
}

/* ---- the naive reference ---- */

/* Returns the distance in samples of a sample's centre from the nearest edge line of a triangle;
 * negative outside. */
static double depth(const struct fixture *f, uint64_t triangle, const struct map *map, uint32_t x,
                    uint32_t y)
{
    double px[3], py[3], smallest = INFINITY;

    for (int i = 0; i < 3; i++) {
        px[i] = (double)f->mesh.texcoords[triangle][i][0] * map->columns;
        py[i] = (1 - (double)f->mesh.texcoords[triangle][i][1]) * map->rows;
    }
    double area = (px[1] - px[0]) * (py[2] - py[0]) - (px[2] - px[0]) * (py[1] - py[0]);
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3;
        double ex = px[j] - px[i], ey = py[j] - py[i];
        double side = ex * (y + 0.5 - py[i]) - ey * (x + 0.5 - px[i]);
        smallest = fmin(smallest, (area < 0 ? -side : side) / hypot(ex, ey));
    }
    return smallest;
}

/* Checks every sample that is not within 1e-3 samples of an edge. */
static void check_against_reference(const struct fixture *f, const struct map *map)
{
    uint64_t overlaps = 0, unclear = 0;

    for (uint32_t y = 0; y < map->rows; y++) {
        for (uint32_t x = 0; x < map->columns; x++) {
            uint32_t expected = BK_NO_TRIANGLE, inside = 0;
            bool clear = true;
            for (uint64_t t = 0; t < f->mesh.triangle_count; t++) {
                double d = depth(f, t, map, x, y);
                clear = clear && fabs(d) > 1e-3;
                if (d > 0 && inside++ == 0)
                    expected = (uint32_t)t;
            }
            overlaps += clear && inside > 1;
            unclear += !clear;
            if (clear && owner(map, x, y) != expected)
                fail_msg("sample %u, %u is of triangle %u, expected %u", x, y, owner(map, x, y),
                         expected);
        }
    }
    assert_in_range(map->overlaps, overlaps, overlaps + unclear);
    assert_true(unclear < (uint64_t)map->columns * map->rows / 5);
}

FIXTURE_TEST(test_random_triangles)
{
    print_message("seed %llu\n", (unsigned long long)SEED);
    for (int round = 0; round < 20; round++) {
        f->mesh.triangle_count = 0;
        for (int t = 0; t < 12; t++) {
            float uv[3][2];
            for (int i = 0; i < 3; i++) {
                uv[i][0] = (float)random_between(f, -0.3, 1.3);
                uv[i][1] = (float)random_between(f, -0.3, 1.3);
            }
            add_triangle(f, uv[0], uv[1], uv[2]);
        }
        struct map map = rasterise(f, 37, 23, 1 + round % 4, 8);
        check_against_reference(f, &map);
        free(map.owners);
    }
}

/* Corners far outside, whose fixed-point coordinates do not fit 32 bits. */
FIXTURE_TEST(test_far_corners)
{
    const double distances[] = {10, 3e3, 1e6};
    for (int k = 0; k < 3; k++) {
        f->mesh.triangle_count = 0;
        for (int t = 0; t < 4; t++) {
            float uv[3][2];
            for (int i = 0; i < 3; i++) {
                double angle = random_between(f, 0, 1) + 2 * i + t;
                uv[i][0] = (float)(0.5 + cos(angle) * distances[k]);
                uv[i][1] = (float)(0.5 + sin(angle) * random_between(f, 0, distances[k]));
            }
            add_triangle(f, uv[0], uv[1], uv[2]);
        }
        struct map map = rasterise(f, 61, 64, 2, 16);
        check_against_reference(f, &map);
        free(map.owners);
    }
}

/* ---- watertightness ---- */

/* Splits the unit square into cells x cells quads with jittered corners and random diagonals. Some
 * triangles are split again at an inner point. */
static void add_jittered_grid(struct fixture *f, uint32_t cells)
{
    float(*p)[2] = resized(NULL, (uint64_t)(cells + 1) * (cells + 1), sizeof(*p));

    for (uint32_t y = 0; y <= cells; y++) {
        for (uint32_t x = 0; x <= cells; x++) {
            double dx = x % cells ? random_between(f, -0.3, 0.3) : 0;
            double dy = y % cells ? random_between(f, -0.3, 0.3) : 0;
            p[y * (cells + 1) + x][0] = (float)((x + dx) / cells);
            p[y * (cells + 1) + x][1] = (float)((y + dy) / cells);
        }
    }
    for (uint32_t y = 0; y < cells; y++) {
        for (uint32_t x = 0; x < cells; x++) {
            float *a = p[y * (cells + 1) + x], *b = a + 2, *d = p[(y + 1) * (cells + 1) + x],
                  *c = d + 2;
            if (random_between(f, 0, 1) < 0.5) {
                add_triangle(f, a, b, c);
                add_triangle(f, a, d, c); /* mirrored */
            } else {
                const float m[2] = {(b[0] + c[0] + d[0]) / 3, (b[1] + c[1] + d[1]) / 3};
                add_triangle(f, d, a, b);
                add_triangle(f, m, b, c);
                add_triangle(f, c, d, m);
                add_triangle(f, b, m, d);
            }
        }
    }
    free(p);
}

static void check_each_sample_once(struct fixture *f, uint32_t width, uint32_t height, uint32_t n,
                                   uint32_t patch_side)
{
    struct map map = rasterise(f, width, height, n, patch_side);
    if (map.covered != (uint64_t)map.columns * map.rows || map.overlaps != 0)
        fail_msg("%u x %u texels, %u samples: %llu covered, %llu overlaps", width, height, n,
                 (unsigned long long)map.covered, (unsigned long long)map.overlaps);
    free(map.owners);
}

FIXTURE_TEST(test_triangulated_square_is_covered_once)
{
    const uint32_t cells[] = {1, 2, 7, 16, 61};
    print_message("seed %llu\n", (unsigned long long)SEED);
    for (int k = 0; k < 5; k++) {
        f->mesh.triangle_count = 0;
        add_jittered_grid(f, cells[k]);
        check_each_sample_once(f, 1, 1, 1, 1);
        check_each_sample_once(f, 64, 64, 1, 16);
        check_each_sample_once(f, 33, 100, 3, 32);
        check_each_sample_once(f, 256, 128, 2, 512);
        check_each_sample_once(f, 65536, 8, 1, 64);
    }
}

/* Corners and edges that pass exactly through the samples' centres. */
FIXTURE_TEST(test_edges_on_sample_centres)
{
    for (uint32_t y = 0; y < 9; y++) {
        for (uint32_t x = 0; x < 9; x++) {
            float low_u = x ? (x - 0.5f) / 8 : 0, low_v = y ? (y - 0.5f) / 8 : 0;
            add_quad(f, low_u, low_v, x < 8 ? (x + 0.5f) / 8 : 1, y < 8 ? (y + 0.5f) / 8 : 1);
        }
    }
    check_each_sample_once(f, 8, 8, 1, 4);
    check_each_sample_once(f, 8, 8, 3, 3);
}

/* Slivers: a fan from one corner of the square to many points on the opposite sides. */
FIXTURE_TEST(test_fan_of_slivers_is_covered_once)
{
    const int count = 700;
    const float apex[2] = {0, 0};
    for (int k = 0; k < count; k++) {
        const float right[2][2] = {{1, (float)k / count}, {1, (float)(k + 1) / count}};
        const float top[2][2] = {{(float)k / count, 1}, {(float)(k + 1) / count, 1}};
        add_triangle(f, apex, right[0], right[1]);
        add_triangle(f, apex, top[0], top[1]);
    }
    check_each_sample_once(f, 100, 100, 2, 32);
    check_each_sample_once(f, 16, 16, 1, 16);
}

/* ---- rules ---- */

FIXTURE_TEST(test_orientation_of_the_map)
{
    add_quad(f, 0.5f, 0.75f, 1, 1); /* right half of the top quarter */
    struct map map = rasterise(f, 8, 4, 1, 4);
    for (uint32_t y = 0; y < 4; y++) {
        for (uint32_t x = 0; x < 8; x++)
            assert_int_equal(owner(&map, x, y) != BK_NO_TRIANGLE, y == 0 && x >= 4);
    }
    free(map.owners);
}

/* A square between the centres of samples (1, 1) and (3, 3) owns its top and left edges only. */
FIXTURE_TEST(test_top_left_rule)
{
    add_quad(f, 1.5f / 8, 1 - 3.5f / 8, 3.5f / 8, 1 - 1.5f / 8);
    struct map map = rasterise(f, 8, 8, 1, 8);
    for (uint32_t y = 0; y < 8; y++) {
        for (uint32_t x = 0; x < 8; x++)
            assert_int_equal(owner(&map, x, y) != BK_NO_TRIANGLE,
                             (x == 1 || x == 2) && (y == 1 || y == 2));
    }
    free(map.owners);
}

FIXTURE_TEST(test_patch_size_does_not_matter)
{
    const uint32_t sizes[] = {1, 5, 16, 31, 200};
    add_jittered_grid(f, 9);
    add_quad(f, 0.1f, 0.1f, 0.6f, 0.7f);
    struct map expected = rasterise(f, 70, 50, 2, 64);
    for (int k = 0; k < 5; k++) {
        struct map map = rasterise(f, 70, 50, 2, sizes[k]);
        assert_memory_equal(map.owners, expected.owners, (size_t)map.columns * map.rows * 4);
        assert_int_equal(map.overlaps, expected.overlaps);
        free(map.owners);
    }
    /* The quad covers 0.5 by 0.6 of the map; its edges lie between samples. */
    assert_int_equal(expected.overlaps, 70 * 60);
    free(expected.owners);
}

FIXTURE_TEST(test_first_triangle_wins)
{
    add_quad(f, 0, 0, 0.5f, 1);
    add_quad(f, 0.25f, 0, 1, 1);
    add_quad(f, 0.25f, 0, 0.5f, 1); /* third layer: its samples already overlap */
    struct map map = rasterise(f, 400, 300, 1, 300);
    assert_int_equal(map.covered, 400 * 300);
    assert_int_equal(map.overlaps, 100 * 300);
    for (uint32_t y = 0; y < 300; y++) {
        for (uint32_t x = 0; x < 400; x++)
            assert_int_equal(owner(&map, x, y) / 2, x < 200 ? 0 : 1);
    }
    free(map.owners);
}

FIXTURE_TEST(test_mirrored_triangles_cover_the_same)
{
    add_jittered_grid(f, 5);
    struct map expected = rasterise(f, 64, 64, 2, 16);
    for (uint64_t t = 0; t < f->mesh.triangle_count; t++) {
        float swapped[2];
        memcpy(swapped, f->mesh.texcoords[t][1], sizeof(swapped));
        memcpy(f->mesh.texcoords[t][1], f->mesh.texcoords[t][2], sizeof(swapped));
        memcpy(f->mesh.texcoords[t][2], swapped, sizeof(swapped));
    }
    struct map map = rasterise(f, 64, 64, 2, 16);
    assert_memory_equal(map.owners, expected.owners, (size_t)map.columns * map.rows * 4);
    free(map.owners);
    free(expected.owners);
}

FIXTURE_TEST(test_degenerate_triangles_are_counted)
{
    const float inside[2] = {0.5f, 0.5f}, corner[2] = {1, 1}, edge[2] = {0, 0.25f};
    const float beyond[2] = {1.5f, 0.5f}, below[2] = {0.5f, -1e-6f}, far_away[2] = {1e30f, 0.5f};
    const float line[3][2] = {{0.1f, 0.1f}, {0.2f, 0.2f}, {0.4f, 0.4f}};
    const float nan_corner[2] = {NAN, 0.5f}, infinite[2] = {0.5f, -INFINITY};

    add_triangle(f, inside, corner, edge); /* touches the border only */
    add_triangle(f, inside, corner, beyond);
    add_triangle(f, inside, edge, below);
    add_triangle(f, inside, edge, far_away);
    add_triangle(f, inside, edge, nan_corner);
    add_triangle(f, inside, edge, infinite);
    add_triangle(f, line[0], line[1], line[2]);
    add_triangle(f, inside, inside, corner);
    struct map map = rasterise(f, 64, 64, 1, 64);
    assert_int_equal(map.report.degenerate_triangles, 2);
    for (uint32_t k = 0; k < 64 * 64; k++)
        assert_true(map.owners[k] == BK_NO_TRIANGLE || map.owners[k] < 3);
    free(map.owners);
}

FIXTURE_TEST(test_empty_patches_are_left_out)
{
    struct bake_raster_report report;
    struct bake_raster *raster = create(f, 64, 64, 1, 16, &report);
    assert_int_equal(bake_raster_patch_count(raster), 0);
    bake_raster_free(raster);

    add_quad(f, 0.26f, 0.01f, 0.49f, 0.19f);
    add_quad(f, 0.3f, 0.8f, 0.7f, 0.9f);
    raster = create(f, 64, 60, 1, 16, &report);
    assert_int_equal(bake_raster_patch_count(raster), 3);
    const struct bk_patch expected[3] = {{16, 0, 16, 16}, {32, 0, 16, 16}, {16, 48, 16, 12}};
    for (uint32_t k = 0; k < 3; k++) {
        struct bk_patch patch = bake_raster_patch(raster, k);
        assert_memory_equal(&patch, &expected[k], sizeof(patch));
    }
    bake_raster_free(raster);
}

/* Time must not be the product of triangles and samples, which would be minutes. */
FIXTURE_TEST(test_many_triangles_over_the_same_texels)
{
    const float corners[3][2] = {{-1, -1}, {3, -1}, {-1, 3}};
    add_triangle(f, corners[0], corners[1], corners[2]);
    struct map map = rasterise(f, 256, 256, 2, 64);
    assert_int_equal(map.overlaps, 0);
    free(map.owners);
    for (int i = 0; i < 200000; i++)
        add_triangle(f, corners[0], corners[1], corners[2]);
    map = rasterise(f, 256, 256, 2, 64);
    assert_int_equal(map.overlaps, 512 * 512);
    for (int i = 0; i < 512 * 512; i++)
        assert_int_equal(map.owners[i], 0);
    free(map.owners);
}

FIXTURE_TEST(test_senseless_options_are_refused)
{
    const struct bake_raster_options options[] = {{0, 64, 1, 16, 0, 0, NULL, NULL, 0},
                                                  {64, 64, 0, 16, 0, 0, NULL, NULL, 0},
                                                  {64, 64, 1, 0, 0, 0, NULL, NULL, 0},
                                                  {UINT32_MAX, 64, 2, 64, 0, 0, NULL, NULL, 0},
                                                  {1 << 20, 64, 1 << 20, 64, 0, 0, NULL, NULL, 0},
                                                  {1 << 20, 1 << 20, 1, 1, 0, 0, NULL, NULL, 0}};
    for (int k = 0; k < 6; k++) {
        struct bake_raster_report report;
        struct bake_raster *raster = NULL;
        bsq_clear_error(f->ctx);
        assert_int_equal(bake_raster_create(f->ctx, &f->mesh, &options[k], &report, &raster),
                         BSQ_EUSAGE);
        assert_null(raster);
        assert_true(strlen(bsq_error(f->ctx)) > 0);
    }
}

/* Rasters of two complementary sets of blocks have all patches, each in one of them, with the same
 * samples; the blocks at the border are smaller. */
FIXTURE_TEST(test_blocks_divide_a_map)
{
    enum { WIDTH = 80, HEIGHT = 50, SIDE = 32, COLUMNS = 3, ROWS = 2, PATCH = 8 };
    static uint32_t owners[PATCH * PATCH], all_owners[PATCH * PATCH];
    struct bake_raster_report report;
    add_jittered_grid(f, 8);
    struct bake_raster *all = create(f, WIDTH, HEIGHT, 1, PATCH, &report);
    uint32_t found = 0;
    for (uint32_t part = 0; part < 2; part++) {
        uint32_t slots[COLUMNS * ROWS], used = 0;
        for (uint32_t b = 0; b < COLUMNS * ROWS; b++)
            slots[b] = b % 2 == part ? used++ : BAKE_NO_PLACE;
        const struct bake_blocks blocks = {SIDE, COLUMNS, ROWS, used, slots};
        const struct bake_raster_options options = {
            WIDTH, HEIGHT, 1, PATCH, 0, f->mesh.triangle_count, &blocks, NULL, 0};
        struct bake_raster *raster = NULL;
        assert_int_equal(bake_raster_create(f->ctx, &f->mesh, &options, &report, &raster), 0);
        uint32_t at = 0;
        for (uint32_t i = 0; i < bake_raster_patch_count(raster); i++, found++) {
            const struct bk_patch patch = bake_raster_patch(raster, i);
            uint64_t overlaps;
            struct bk_patch other = bake_raster_patch(all, at);
            assert_int_equal((patch.y / SIDE * COLUMNS + patch.x / SIDE) % 2, part);
            while (other.x != patch.x || other.y != patch.y)
                other = bake_raster_patch(all, ++at);
            assert_int_equal(bake_raster_fill(raster, i, owners, &overlaps), 0);
            assert_int_equal(bake_raster_fill(all, at, all_owners, &overlaps), 0);
            assert_memory_equal(owners, all_owners,
                                (size_t)patch.width * patch.height * sizeof *owners);
        }
        bake_raster_free(raster);
    }
    assert_int_equal(found, bake_raster_patch_count(all));
    assert_true(found > COLUMNS * ROWS);
    bake_raster_free(all);
}

/* ---- kernel triangles ---- */

/* Checks that the weights at each sample give the position of the sample on the map. */
static void check_weights(const struct fixture *f, const struct map *map, uint32_t n,
                          const struct bk_triangle *triangles, double tolerance)
{
    for (uint32_t y = 0; y < map->rows; y++) {
        for (uint32_t x = 0; x < map->columns; x++) {
            uint32_t t = owner(map, x, y);
            if (t == BK_NO_TRIANGLE)
                continue;
            const struct bk_triangle *k = &triangles[t];
            const float(*uv)[2] = (const float(*)[2])f->mesh.texcoords[t];
            double dx = (x + 0.5) / n - (double)k->x0, dy = (y + 0.5) / n - (double)k->y0;
            double w1 = k->b1[0] * dx + k->b1[1] * dy + k->b1[2];
            double w2 = k->b2[0] * dx + k->b2[1] * dy + k->b2[2], w0 = 1 - w1 - w2;
            double u = w0 * uv[0][0] + w1 * uv[1][0] + w2 * uv[2][0];
            double v = w0 * uv[0][1] + w1 * uv[1][1] + w2 * uv[2][1];
            assert_true(fmin(w0, fmin(w1, w2)) > -0.1);
            if (!(fabs(u * map->columns - x - 0.5) < tolerance &&
                  fabs((1 - v) * map->rows - y - 0.5) < tolerance))
                fail_msg("triangle %u: sample (%u, %u) at (%.9g, %.9g)", t, x, y,
                         u * map->columns - 0.5, (1 - v) * map->rows - 0.5);
        }
    }
}

static void check_attributes(const struct fixture *f, const struct bk_triangle *triangles)
{
    for (uint64_t t = 0; t < f->mesh.triangle_count; t++) {
        const struct bk_triangle *k = &triangles[t];
        assert_true(k->x0 == floorf(k->x0) && k->y0 == floorf(k->y0));
        for (int i = 0; i < 3; i++) {
            const float *uv = f->mesh.texcoords[t][i];
            assert_float_equal(k->position[i][0], 8 * uv[0], 1e-5);
            assert_float_equal(k->position[i][1], 12 * uv[1], 1e-5);
            assert_float_equal(k->position[i][2], -200 * uv[0], 1e-3);
            assert_float_equal(k->reach[i], 4 * (1 + uv[0]), 1e-5);
        }
        assert_memory_equal(k->normal, f->mesh.normals[t], sizeof(k->normal));
        assert_memory_equal(k->tangent, f->mesh.tangents[t], sizeof(k->tangent));
    }
}

/* Checks the weights of a map and returns its triangles; free() them. */
static struct bk_triangle *check_kernel_triangles(struct fixture *f, uint32_t width,
                                                  uint32_t height, uint32_t n, double tolerance)
{
    const double translation[3] = {100, 200, 0};
    struct bake_raster_report report;
    struct bake_raster *raster = create(f, width, height, n, 64, &report);
    struct bk_triangle *triangles = resized(NULL, f->mesh.triangle_count, sizeof(*triangles));
    struct map map = rasterise(f, width, height, n, 64);

    memset(triangles, 0xff, f->mesh.triangle_count * sizeof(*triangles));
    bake_raster_kernel_triangles(raster, translation, 0.25, triangles);
    check_weights(f, &map, n, triangles, tolerance);
    free(map.owners);
    bake_raster_free(raster);
    return triangles;
}

FIXTURE_TEST(test_kernel_triangles)
{
    add_jittered_grid(f, 13);
    struct bk_triangle *triangles = check_kernel_triangles(f, 100, 60, 3, 1e-3);
    check_attributes(f, triangles);
    free(triangles);
    free(check_kernel_triangles(f, 16384, 8, 1, 0.1));
}

/* Slivers along the map's diagonal, some thinner than a step of the sample grid: weights must not
 * extrapolate. Along 2000 samples, float weights are off by a few samples. */
FIXTURE_TEST(test_kernel_triangles_of_slivers)
{
    const float a[2] = {0.01f, 0.013f}, b[2] = {0.97f, 0.96f};
    float last[2] = {0.5f, 0.45f};
    for (int k = 1; k <= 24; k++) {
        const float offset = ldexpf(0.05f, -k);
        const float next[2] = {0.5f, 0.5f - offset};
        add_triangle(f, a, last, next);
        add_triangle(f, b, next, last);
        memcpy(last, next, sizeof(last));
    }
    free(check_kernel_triangles(f, 1024, 1024, 2, 4));
    free(check_kernel_triangles(f, 4096, 64, 4, 4));
}

FIXTURE_TEST(test_kernel_triangles_without_area_are_zero)
{
    const float a[2] = {0.1f, 0.1f}, b[2] = {0.7f, 0.3f};
    struct bake_raster_report report;
    struct bk_triangle triangle, zero;

    add_triangle(f, a, b, a);
    struct bake_raster *raster = create(f, 64, 64, 1, 64, &report);
    memset(&zero, 0, sizeof(zero));
    memset(&triangle, 0xff, sizeof(triangle));
    bake_raster_kernel_triangles(raster, (const double[3]){0, 0, 0}, 1, &triangle);
    assert_memory_equal(&triangle, &zero, sizeof(zero));
    bake_raster_free(raster);
}

RUN_TESTS(NULL, NULL)
