/* test_udim.c - the tiles that triangles lie in, the mesh sorted by tile, and messages. */
#include "tests/unit/test.h"

#include "libbake/udim/udim.h"

enum { SIZE = 100, MOST = 400 }; /* texels along a map's side; triangles */

struct fixture {
    struct bsq_ctx *ctx;
    struct bake_lowmesh mesh;
    struct bake_options options;
    struct bake_udim udim;
};

static int set_up(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);
    f->ctx = test_context(1, 0);
    bake_defaults(&f->options);
    f->options.mesh_path = "low.obj";
    f->options.output_path = "<UDIM>.exr";
    f->options.width = f->options.height = SIZE;
    int status = BSQ_CALLOC(f->ctx, "", MOST, &f->mesh.positions);
    status |= BSQ_CALLOC(f->ctx, "", MOST, &f->mesh.normals);
    status |= BSQ_CALLOC(f->ctx, "", MOST, &f->mesh.texcoords);
    status |= BSQ_CALLOC(f->ctx, "", MOST, &f->mesh.tangents);
    status |= BSQ_CALLOC(f->ctx, "", MOST, &f->mesh.directions);
    *state = f;
    return status;
}

static int tear_down(void **state)
{
    struct fixture *f = *state;
    bake_udim_free(f->ctx, &f->udim);
    bake_lowmesh_free(f->ctx, &f->mesh);
    test_context_end(f->ctx);
    free(f);
    return 0;
}
#define FIXTURE_TEST(name) STATE_TEST(name, struct fixture, set_up, tear_down)

/* Adds a triangle, whose other attributes hold its number. */
static void add(struct fixture *f, const float uv[3][2])
{
    const uint64_t t = f->mesh.triangle_count++;
    memcpy(f->mesh.texcoords[t], uv, sizeof *f->mesh.texcoords);
    f->mesh.positions[t][2][2] = (double)t;
    f->mesh.normals[t][2][2] = (float)t;
    f->mesh.tangents[t][2][3] = (float)t;
    f->mesh.directions[t][2][2] = (float)t;
}

/* Adds a right triangle with its right angle at (u, v). */
static void add_corner(struct fixture *f, float u, float v, float side)
{
    add(f, (const float[3][2]){{u, v}, {u + side, v}, {u, v + side}});
}

static void find(struct fixture *f)
{
    bake_udim_free(f->ctx, &f->udim);
    if (bake_udim_find(f->ctx, &f->options, &f->mesh, &f->udim) < 0)
        fail_msg("%s", bsq_error(f->ctx));
}

static void arrange(struct fixture *f)
{
    find(f);
    if (bake_udim_arrange(f->ctx, &f->options, &f->udim, &f->mesh) < 0)
        fail_msg("%s", bsq_error(f->ctx));
}

static void expect_tiles(const struct fixture *f, uint32_t count, const uint32_t *numbers)
{
    assert_int_equal(f->udim.count, count);
    for (uint32_t i = 0; i < count; i++)
        assert_int_equal(f->udim.tiles[i].number, numbers[i]);
}

static void expect_failure(struct fixture *f, const char *text)
{
    bake_udim_free(f->ctx, &f->udim);
    assert_int_equal(bake_udim_find(f->ctx, &f->options, &f->mesh, &f->udim), BSQ_EUSAGE);
    assert_string_equal(bsq_error(f->ctx), text);
    bsq_clear_error(f->ctx);
}

/* Checks that the arranged mesh has these triangles, in this order, with all their attributes. */
static void expect_order(const struct fixture *f, uint64_t count, const uint32_t *order)
{
    assert_int_equal(f->mesh.triangle_count, count);
    for (uint64_t t = 0; t < count; t++) {
        assert_int_equal((int)f->mesh.positions[t][2][2], order[t]);
        assert_int_equal((int)f->mesh.normals[t][2][2], order[t]);
        assert_int_equal((int)f->mesh.tangents[t][2][3], order[t]);
        assert_int_equal((int)f->mesh.directions[t][2][2], order[t]);
    }
}

/* ---- tiles ---- */

FIXTURE_TEST(test_numbers)
{
    add_corner(f, 0.25f, 0.25f, 0.5f);
    add_corner(f, 9.25f, 0.25f, 0.5f);
    add_corner(f, 0.25f, 1.25f, 0.5f);
    add_corner(f, 2.25f, 898.25f, 0.5f);
    find(f);
    expect_tiles(f, 4, (const uint32_t[]){1001, 1010, 1011, 9983});
    for (uint32_t i = 0; i < 4; i++)
        assert_int_equal(f->udim.tiles[i].number, 1001 + bake_udim_column(f->udim.tiles[i].number) +
                                                      10 * bake_udim_row(f->udim.tiles[i].number));
}

FIXTURE_TEST(test_one_tile_stays_as_it_is)
{
    add(f, (const float[3][2]){{0, 0}, {1, 0}, {0, 1}}); /* touches three other tiles */
    add_corner(f, 0.5f, 0.5f, 0);
    add_corner(f, 0.25f, 0.25f, 0.25f);
    f->options.output_path = "map.exr";
    const void *const before = f->mesh.texcoords;
    arrange(f);
    expect_tiles(f, 1, (const uint32_t[]){1001});
    assert_int_equal(f->udim.tiles[0].count, 3);
    assert_ptr_equal(f->mesh.texcoords, before);
    assert_int_equal(f->udim.outside_triangles, 0);
}

FIXTURE_TEST(test_mesh_is_sorted_by_tile)
{
    add_corner(f, 1.25f, 0.25f, 0.25f);
    add_corner(f, 0.25f, 0.25f, 0.25f);
    add_corner(f, 0.5f, 0.125f, 0.75f); /* in both */
    add_corner(f, 5.5f, 5.5f, 0);       /* without area */
    add_corner(f, 1.5f, 0.5f, 0.25f);
    arrange(f);
    expect_tiles(f, 2, (const uint32_t[]){1001, 1002});
    expect_order(f, 6, (const uint32_t[]){1, 2, 3, 0, 2, 4});
    assert_int_equal(f->udim.tiles[0].first, 0);
    assert_int_equal(f->udim.tiles[0].count, 3);
    assert_int_equal(f->udim.tiles[1].first, 3);
    assert_int_equal(f->udim.tiles[1].count, 3);
    assert_true(f->mesh.texcoords[0][0][0] == 0.25f);
    assert_true(f->mesh.texcoords[1][1][0] == 1.25f);
    assert_true(f->mesh.texcoords[3][0][0] == 0.25f && f->mesh.texcoords[3][0][1] == 0.25f);
    assert_true(f->mesh.texcoords[4][0][0] == -0.5f && f->mesh.texcoords[4][0][1] == 0.125f);
    assert_int_equal(f->udim.outside_triangles, 0);
}

FIXTURE_TEST(test_triangles_outside_the_selection_come_last)
{
    add_corner(f, 1.25f, 0.25f, 0.25f);
    add_corner(f, 0.25f, 0.25f, 0.25f);
    add_corner(f, 0.5f, 0.125f, 0.75f);
    add_corner(f, -3.5f, 0.125f, 0.75f);
    add_corner(f, 2.5f, 7.25f, 0.25f);
    const struct bake_tile_range ranges[] = {{1073, 1075}, {1001, 1001}};
    f->options.tile_ranges = ranges;
    f->options.tile_range_count = 2;
    arrange(f);
    expect_tiles(f, 2, (const uint32_t[]){1001, 1073});
    expect_order(f, 5, (const uint32_t[]){1, 2, 4, 0, 3});
    assert_int_equal(f->udim.unused_triangles, 2);
    assert_int_equal(f->udim.outside_triangles, 3);
}

FIXTURE_TEST(test_overshoot_below_half_a_texel_is_no_tile)
{
    const float texel = 1.0f / SIZE;
    add(f, (const float[3][2]){{0.5f, 0.5f}, {1 + 0.49f * texel, 0.5f}, {0.5f, 0.75f}});
    add(f, (const float[3][2]){{0.5f, 0.5f}, {0.75f, 0.5f}, {0.5f, -0.49f * texel}});
    find(f);
    expect_tiles(f, 1, (const uint32_t[]){1001});
    /* Thin enough to overlap neither tile by half a texel. */
    add(f, (const float[3][2]){{0.999f, 0.5f}, {1.0005f, 0.5f}, {1, 0.75f}});
    find(f);
    expect_tiles(f, 1, (const uint32_t[]){1001});
    assert_int_equal(f->udim.tiles[0].count, 3);
    add(f, (const float[3][2]){{0.5f, 0.5f}, {1 + 2 * texel, 0.5f}, {1 + 2 * texel, 0.75f}});
    find(f);
    expect_tiles(f, 2, (const uint32_t[]){1001, 1002});
    /* It is the texel of the tile that is overshot, not that of its neighbour. */
    struct bake_tile_size size = {.tile = 1001, .width = SIZE, .height = SIZE};
    f->options.tile_sizes = &size;
    f->options.tile_size_count = 1;
    f->options.width = SIZE / 5;
    find(f);
    expect_tiles(f, 2, (const uint32_t[]){1001, 1002});
    size.width = SIZE / 5;
    f->options.width = SIZE;
    find(f);
    expect_tiles(f, 1, (const uint32_t[]){1001});
}

FIXTURE_TEST(test_only_flat_triangles)
{
    add_corner(f, 3.5f, 3.5f, 0);
    add_corner(f, 0.5f, 0.5f, 0);
    arrange(f);
    expect_tiles(f, 1, (const uint32_t[]){1001});
    assert_int_equal(f->udim.tiles[0].count, 2);
}

/* ---- against clipping ---- */

/* Cuts a polygon at a line: keeps sign * p[axis] <= sign * at. Returns the number of corners. */
static int cut(double (*p)[2], int count, int axis, double sign, double at)
{
    double out[16][2];
    int kept = 0;
    for (int i = 0; i < count; i++) {
        const double *a = p[i], *b = p[(i + 1) % count];
        const double da = sign * (a[axis] - at), db = sign * (b[axis] - at);
        if (da <= 0)
            memcpy(out[kept++], a, sizeof *out);
        if ((da < 0 && db > 0) || (da > 0 && db < 0)) {
            const double share = da / (da - db);
            for (int k = 0; k < 2; k++)
                out[kept][k] = a[k] + share * (b[k] - a[k]);
            kept++;
        }
    }
    memcpy(p, out, sizeof *out * (size_t)kept);
    return kept;
}

/* Returns the area of a triangle inside a tile that is smaller by half a texel on each side. */
static double area_inside(const float (*uv)[2], uint32_t number)
{
    const double low[2] = {bake_udim_column(number), bake_udim_row(number)};
    double p[16][2], area = 0;
    int count = 3;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 2; k++)
            p[i][k] = uv[i][k];
    for (int k = 0; k < 2; k++) {
        count = cut(p, count, k, -1, low[k] + 0.5 / SIZE);
        count = cut(p, count, k, 1, low[k] + 1 - 0.5 / SIZE);
    }
    for (int i = 0; i < count; i++)
        area += p[i][0] * p[(i + 1) % count][1] - p[i][1] * p[(i + 1) % count][0];
    return fabs(area) / 2;
}

static bool has_tile(const struct fixture *f, uint32_t number)
{
    for (uint32_t i = 0; i < f->udim.count; i++)
        if (f->udim.tiles[i].number == number)
            return true;
    return false;
}

FIXTURE_TEST(test_tiles_are_those_that_triangles_overlap)
{
    uint64_t random = test_seed();
    unsigned found = 0;
    for (int round = 0; round < 500; round++) {
        float uv[3][2];
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 2; k++)
                uv[i][k] = (float)(0.1 + 3.8 * (double)(test_random(&random) >> 11) * 0x1p-53);
        f->mesh.triangle_count = 0;
        add(f, (const float(*)[2])uv);
        find(f);
        for (uint32_t column = 0; column < 5; column++)
            for (uint32_t row = 0; row < 5; row++) {
                const uint32_t number = 1001 + column + 10 * row;
                const double area = area_inside((const float(*)[2])uv, number);
                if (area > 1e-9)
                    assert_true(has_tile(f, number));
                if (area == 0 && f->udim.count > 1)
                    assert_false(has_tile(f, number));
                found += has_tile(f, number);
            }
    }
    assert_true(found > 1000);
}

/* ---- messages ---- */

FIXTURE_TEST(test_messages)
{
    add_corner(f, 0.25f, 0.25f, 0.25f);
    add_corner(f, 2.25f, 3.25f, 0.25f);
    f->options.output_path = "map.exr";
    expect_failure(f,
                   "low.obj is in several UDIM tiles: 1001, 1033; to bake all, put \"<UDIM>\" into "
                   "the output's name; to bake one, select it (--tiles)");
    struct bake_tile_range range = {1033, 1040};
    f->options.tile_ranges = &range;
    f->options.tile_range_count = 1;
    find(f);
    expect_tiles(f, 1, (const uint32_t[]){1033});
    range.first = 1034;
    expect_failure(f, "low.obj: no triangle is in tiles 1034 to 1040; there are triangles in 1001, "
                      "1033");
    const struct bake_tile_range used_and_not[] = {{1001, 1020}, {1002, 1002}};
    f->options.tile_ranges = used_and_not;
    f->options.tile_range_count = 2;
    expect_failure(f, "low.obj: no triangle is in tile 1002; there are triangles in 1001, 1033");
    f->options.tile_ranges = &range;
    f->options.tile_range_count = 1;
    range = (struct bake_tile_range){1033, 1033};
    struct bake_tile_size size = {
        .tile = 1001, .width = 8, .height = 8}; /* not selected, but used */
    f->options.tile_sizes = &size;
    f->options.tile_size_count = 1;
    find(f);
    expect_tiles(f, 1, (const uint32_t[]){1033});
    size.tile = 1034;
    expect_failure(f, "low.obj: no triangle is in tile 1034; there are triangles in 1001, 1033");
    f->options.tile_size_count = 0;
    f->options.tile_range_count = 0;
    f->options.output_path = "<UVTILE>.exr";
    find(f);
    add_corner(f, -1.25f, 0.25f, 0.25f);
    expect_failure(f,
                   "low.obj: 1 triangles have texture coordinates outside of all UDIM tiles, the "
                   "first at (-1.25, 0.25); to leave them out, select tiles to bake (--tiles); "
                   "there are triangles in 1001, 1033");
}

/* The first corner of each triangle lies in a tile. */
FIXTURE_TEST(test_the_corner_outside_of_all_tiles_is_named)
{
    add_corner(f, 9.25f, 0.25f, 1.25f);
    expect_failure(f,
                   "low.obj: 1 triangles have texture coordinates outside of all UDIM tiles, the "
                   "first at (10.5, 0.25); to leave them out, select tiles to bake (--tiles); "
                   "there are triangles in 1010, 1020");
    f->mesh.triangle_count = 0;
    add(f, (const float[3][2]){{0.25f, 0.25f}, {0.5f, -0.5f}, {-0.25f, 0.25f}});
    expect_failure(f,
                   "low.obj: 1 triangles have texture coordinates outside of all UDIM tiles, the "
                   "first at (0.5, -0.5); to leave them out, select tiles to bake (--tiles); "
                   "there are triangles in 1001");
}

FIXTURE_TEST(test_long_lists_are_cut)
{
    for (int v = 0; v < 10; v++)
        for (int u = 0; u < 10; u++)
            add_corner(f, (float)u + 0.25f, (float)v + 0.25f, 0.25f);
    f->options.output_path = "map.exr";
    assert_int_equal(bake_udim_find(f->ctx, &f->options, &f->mesh, &f->udim), BSQ_EUSAGE);
    assert_non_null(strstr(bsq_error(f->ctx), " more; to bake all"));
}

FIXTURE_TEST(test_huge_coordinates_end)
{
    const float far_away[][3][2] = {{{-3e38f, -3e38f}, {3e38f, -3e38f}, {0, 3e38f}},
                                    {{NAN, 0}, {0.5f, 0}, {0, 0.5f}},
                                    {{INFINITY, 0}, {0.5f, 0}, {0, 0.5f}}};
    for (int i = 0; i < 3; i++)
        add(f, far_away[i]);
    add_corner(f, 0.25f, 0.25f, 0.25f);
    assert_int_equal(bake_udim_find(f->ctx, &f->options, &f->mesh, &f->udim), BSQ_EUSAGE);
    const struct bake_tile_range range = {1001, 1001};
    f->options.tile_ranges = &range;
    f->options.tile_range_count = 1;
    find(f);
    expect_tiles(f, 1, (const uint32_t[]){1001});
}

RUN_TESTS(NULL, NULL)
