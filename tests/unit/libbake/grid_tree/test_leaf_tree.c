/* test_leaf_tree.c - the tree of leaves contains all voxels, and rays through it find what
 * rays from voxel to voxel find, also if they go through edges and corners of voxels. */
#include "base/context.h"
#include "libbake/device/scene/scene.h"
#include "libbake/grid_tree/tree_rays.h"
#include "tests/unit/libbake/analytic_grid.h"
#include "tests/unit/libbake/walked_ray.h"
#include "tests/unit/test.h"

enum { POINTS = 200, RAYS = BAKE_TREE_BUNDLE }; /* all rays that go together */

struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_nvdb_grid file;
    struct bk_grid grid;
    struct bk_params params;
    struct bake_tree tree;
};

static void open_fixture(struct fixture *f, const struct analytic_grid *grid)
{
    f->ctx = test_context(0, 0);
    analytic_grid_open(f->ctx, grid, false, &f->file);
    memset(&f->params, 0, sizeof f->params);
    bake_params_from_grid(&f->file, &f->params);
    bake_kernel_grid(&f->file, &f->params, &f->grid);
    assert_int_equal(bake_tree_build(f->ctx, &f->file, &f->tree), 0);
}

static void close_fixture(struct fixture *f)
{
    bake_tree_free(f->ctx, &f->tree);
    fmt_nvdb_close(f->ctx, &f->file);
    bsq_ctx_destroy(f->ctx);
}

static double between(uint64_t *seed, double low, double high)
{
    return low + (high - low) * analytic_random(seed);
}

/* Adds planes through voxels in a cube around `centre`. */
static void add_clutter(struct analytic_grid *grid, const double centre[3], double half, int count,
                        uint64_t *seed)
{
    for (int i = 0; i < count; i++) {
        double p[3], n[3];
        for (int k = 0; k < 3; k++)
            p[k] = centre[k] + between(seed, -half, half);
        analytic_random_unit(seed, n);
        analytic_grid_add(grid, p, n, 1, NULL);
    }
}

/* ---- boxes ---- */

struct box {
    int32_t low[3], high[3];
};

static struct box child_box(const struct bake_tree_node *node, int child)
{
    struct box box;
    for (int k = 0; k < 3; k++) {
        const int32_t corner = bake_tree_corner(node, k);
        box.low[k] = corner + (node->borders[k][0][child] << bake_tree_shift(node));
        box.high[k] = corner + (node->borders[k][1][child] << bake_tree_shift(node));
    }
    return box;
}

/* Checks that a leaf's boxes are those of its voxels. Returns the number of voxels. */
static uint64_t check_leaf(const struct bk_grid *grid, const struct bake_tree_node *node)
{
    uint64_t count = 0;
    for (int block = 0; block < 8; block++) {
        struct box tight = {{INT32_MAX, INT32_MAX, INT32_MAX}, {INT32_MIN, INT32_MIN, INT32_MIN}};
        uint64_t voxels = 0;
        for (int i = 0; i < 64; i++) {
            const int32_t v[3] = {bake_tree_corner(node, 0) + ((block >> 2 & 1) * 4 + (i >> 4)),
                                  bake_tree_corner(node, 1) + ((block >> 1 & 1) * 4 + (i >> 2 & 3)),
                                  bake_tree_corner(node, 2) + ((block & 1) * 4 + (i & 3))};
            bk_cache cache = bk_cache_empty();
            if (bk_locate(grid, &cache, v[0], v[1], v[2]) != 0 ||
                bk_leaf_value(grid, cache.leaf, v[0], v[1], v[2]) == 0)
                continue;
            assert_int_equal(cache.leaf, node->first);
            voxels++;
            for (int k = 0; k < 3; k++) {
                tight.low[k] = v[k] < tight.low[k] ? v[k] : tight.low[k];
                tight.high[k] = v[k] + 1 > tight.high[k] ? v[k] + 1 : tight.high[k];
            }
        }
        const struct box box = child_box(node, block);
        if (voxels == 0)
            assert_true(node->borders[0][0][block] > node->borders[0][1][block]);
        else
            assert_memory_equal(&box, &tight, sizeof box);
        count += voxels;
    }
    return count;
}

/* Checks that the boxes of a node's children contain theirs. Returns the voxels below the node. */
static uint64_t check_node(const struct fixture *f, uint64_t number, const struct box *outer)
{
    const struct bake_tree_node *node = &f->tree.nodes[number];
    uint64_t count = 0;
    if (bake_tree_is_leaf(node))
        return check_leaf(&f->grid, node);
    for (int i = 0; i < BAKE_TREE_WIDTH; i++) {
        if (node->borders[0][0][i] > node->borders[0][1][i])
            continue;
        const struct box box = child_box(node, i);
        for (int k = 0; k < 3 && outer; k++)
            assert_true(box.low[k] >= outer->low[k] && box.high[k] <= outer->high[k]);
        assert_true(node->first > number && node->first + (uint64_t)i < f->tree.count);
        count += check_node(f, node->first + (uint64_t)i, &box);
    }
    return count;
}

TEST(test_all_voxels_are_in_the_tree)
{
    const double centres[][3] = {{2, 127, 4095}, {-3000, 500, -9}, {-1, -1, -1}, {60000, 3, 4}};
    uint64_t seed = 7;
    (void)state;
    struct analytic_grid *grid = analytic_grid_create();
    for (size_t i = 0; i < sizeof centres / sizeof *centres; i++)
        add_clutter(grid, centres[i], 5 + 20 * (double)i, 1500, &seed);
    struct fixture f;
    open_fixture(&f, grid);
    assert_int_equal(check_node(&f, 0, NULL), f.file.voxel_count);
    close_fixture(&f);
    analytic_grid_free(grid);
}

TEST(test_one_voxel)
{
    const double at[3] = {-7, 8, 100}, up[3] = {0, 0, 1};
    (void)state;
    struct analytic_grid *grid = analytic_grid_create();
    analytic_grid_add(grid, at, up, 1, NULL);
    struct fixture f;
    open_fixture(&f, grid);
    assert_int_equal(f.tree.count, 1);
    assert_int_equal(check_node(&f, 0, NULL), 1);
    close_fixture(&f);
    analytic_grid_free(grid);
}

/* With any budget there is the whole tree, or a failure after which nothing stays allocated. A grid
 * that is too wide has no tree. */
TEST(test_limits)
{
    const double far[3] = {BAKE_TREE_EXTENT + 1000.0, 0, 0}, centre[3] = {0, 0, 0};
    const double up[3] = {0, 0, 1};
    uint64_t seed = 3;
    (void)state;
    struct analytic_grid *grid = analytic_grid_create();
    add_clutter(grid, centre, 60, 3000, &seed);
    struct fixture f;
    open_fixture(&f, grid);
    const uint64_t all = f.tree.count;
    struct bake_tree tree;
    bool some = false, none = false;
    for (uint64_t memory = 1; memory < 400 * all; memory += 5 * all + 1) {
        struct bsq_ctx *ctx = test_context(0, memory);
        const int status = bake_tree_build(ctx, &f.file, &tree);
        assert_true(status == 0 ? tree.count == all : status == BSQ_ENOMEM && !tree.nodes);
        some |= status == 0;
        none |= status < 0;
        bake_tree_free(ctx, &tree);
        assert_int_equal(bsq_memory_used(ctx), 0);
        bsq_ctx_destroy(ctx);
    }
    assert_true(some && none);
    const uint64_t used = bsq_memory_used(f.ctx);
    bsq_interrupt(f.ctx);
    assert_int_equal(bake_tree_build(f.ctx, &f.file, &tree), BSQ_EINTR);
    assert_null(tree.nodes);
    assert_int_equal(bsq_memory_used(f.ctx), used);
    close_fixture(&f);
    analytic_grid_add(grid, far, up, 1, NULL);
    f.ctx = test_context(0, 0);
    analytic_grid_open(f.ctx, grid, false, &f.file);
    assert_int_equal(bake_tree_build(f.ctx, &f.file, &f.tree), BSQ_EDATA);
    close_fixture(&f);
    analytic_grid_free(grid);
}

/* ---- rays ---- */

/* Sends the rays of a point through the tree one by one. */
static void look_one_by_one(const struct fixture *f, const bk_rays *kind, const bk_viewpoint *point,
                            float *found)
{
    bk_grid grid = f->grid;
    grid.nodes = (const bk_ulong2 *)(const void *)f->tree.nodes;
    grid.blocks = (const bk_ulong *)(const void *)f->tree.blocks;
    for (uint32_t ray = 0; ray < RAYS; ray++)
        found[ray] =
            bk_tree_look(&grid, &f->params, kind, point, bk_ray_directions(kind, point, ray));
}

/* Returns a point from which open rays start as from hits of grids; two of three are crowded, one
 * of them by walls. */
static bk_viewpoint point_at(bk_vec3 position, bk_vec3 normal, float side, bk_uint seed)
{
    const bk_uint crowded = bk_hash(seed) % 3u;
    return (bk_viewpoint){.open_from = bk_add_scaled(position, crowded ? 0 : BK_LIFT, normal),
                          .crowded = crowded,
                          .solid_from = position,
                          .normal = normal,
                          .side = side,
                          .share.seed = seed};
}

/* A grid without voxels hides nothing. */
TEST(test_no_voxels)
{
    struct fixture f;
    (void)state;
    struct analytic_grid *grid = analytic_grid_create();
    add_clutter(grid, (double[3]){0, 0, 0}, 9, 300, &(uint64_t){5});
    open_fixture(&f, grid);
    bake_tree_free(f.ctx, &f.tree);
    const uint32_t leaves = f.file.leaf_count;
    f.file.leaf_count = f.file.lower_count = f.file.root_tile_count = 0;
    assert_int_equal(bake_tree_build(f.ctx, &f.file, &f.tree), 0);
    const bk_viewpoint point = point_at(bk_v3(0, 0, 0), bk_v3(0, 0, 1), 1, 7);
    const bk_rays kind = {.open = 1, .count = RAYS, .samples = 1, .sine2 = 1, .limit = 40};
    static struct bake_tree_stream stream;
    float found[RAYS] = {0};
    BSQ_SIMD_PICK(bsq_simd_best(), bake_tree_look)
    (&f.grid, &f.params, &f.tree, &kind, &point, 1, found, RAYS, &stream);
    for (int i = 0; i < RAYS; i++)
        assert_true(found[i] < 0);
    look_one_by_one(&f, &kind, &point, found);
    for (int i = 0; i < RAYS; i++)
        assert_true(found[i] < 0);
    f.file.leaf_count = leaves;
    close_fixture(&f);
    analytic_grid_free(grid);
}

/* Checks what rays found. exact: distances count, not only whether a ray meets something. */
static void check_found(const float *found, const float *expected, bool exact)
{
    for (uint32_t i = 0; i < POINTS * RAYS; i++)
        if (exact)
            assert_memory_equal(&found[i], &expected[i], sizeof *found);
        else
            assert_true(expected[i] < 0 ? found[i] < 0 : found[i] >= 0);
}

/* Compares rays through the tree with rays from voxel to voxel, at all levels of instructions.
 * exact: distances count, not only whether a ray meets something. */
static void compare(const struct fixture *f, const bk_rays *kind, const bk_viewpoint *points,
                    bool exact)
{
    static float found[POINTS * RAYS], expected[POINTS * RAYS];
    static struct bake_tree_stream stream;
    uint32_t hits = 0;
    for (uint32_t i = 0; i < POINTS; i++)
        for (uint32_t ray = 0; ray < RAYS; ray++) {
            const float t = walked_ray(&f->grid, &f->params, kind, &points[i],
                                       bk_ray_directions(kind, &points[i], ray));
            expected[i * RAYS + ray] = t;
            hits += t >= 0 && t < kind->limit;
        }
    print_message("%u of %u rays meet something\n", hits, POINTS * RAYS);
    assert_in_range(hits, POINTS * RAYS / 20, POINTS * RAYS * 19 / 20);
    for (unsigned level = BSQ_SIMD_BASE; level <= bsq_simd_best(); level++) {
        memset(found, 0xff, sizeof found);
        BSQ_SIMD_PICK(level, bake_tree_look)
        (&f->grid, &f->params, &f->tree, kind, points, POINTS, found, RAYS, &stream);
        check_found(found, expected, exact);
    }
    memset(found, 0xff, sizeof found);
    for (uint32_t i = 0; i < POINTS; i++)
        look_one_by_one(f, kind, &points[i], &found[i * RAYS]);
    check_found(found, expected, exact);
}

static void compare_kinds(struct fixture *f, const bk_viewpoint *points, float sine2, float limit)
{
    static const float coarse[] = {BK_FAR, 64.0f, 9.5f, 1.0f};
    bk_rays kind = {.open = 1, .count = RAYS, .samples = 1, .sine2 = sine2, .limit = limit};
    f->params.open_limit = kind.limit;
    for (size_t i = 0; i < sizeof coarse / sizeof *coarse; i++) {
        f->params.coarse = coarse[i];
        f->params.flags = 0;
        compare(f, &kind, points, false);
        f->params.flags = BK_OPEN_FALLOFF;
        compare(f, &kind, points, true);
        kind.open = 0;
        compare(f, &kind, points, true);
        kind.open = 1;
    }
}

/* A cone without width has all its rays along the normal. So rays start at corners and edges of
 * voxels and go along axes, diagonals of faces and of voxels: many borders have the same t. */
TEST(test_edges_and_corners)
{
    const double centre[3] = {3, -4, 5};
    static bk_viewpoint points[POINTS];
    uint64_t seed = 11;
    (void)state;
    struct analytic_grid *grid = analytic_grid_create();
    add_clutter(grid, centre, 20, 2500, &seed);
    struct fixture f;
    open_fixture(&f, grid);
    for (int i = 0; i < POINTS; i++) {
        bk_vec3 n = bk_v3(0, 0, 0);
        while (n.x == 0 && n.y == 0 && n.z == 0)
            n = bk_v3((float)floor(between(&seed, -1, 2)), (float)floor(between(&seed, -1, 2)),
                      (float)floor(between(&seed, -1, 2)));
        const bk_vec3 at = bk_v3((float)floor(between(&seed, -40, 46)) / 2,
                                 (float)floor(between(&seed, -48, 32)) / 2,
                                 (float)floor(between(&seed, -30, 50)) / 2);
        points[i] = point_at(at, bk_unit(n), i % 3 ? 1.0f : -1.0f, (bk_uint)i);
    }
    compare_kinds(&f, points, 0.0f, 40);
    close_fixture(&f);
    analytic_grid_free(grid);
}

/* Returns a point in a cube around `centre`, with any normal. */
static bk_viewpoint random_point(const double centre[3], double half, uint64_t *seed)
{
    double n[3], p[3];
    analytic_random_unit(seed, n);
    for (int k = 0; k < 3; k++)
        p[k] = centre[k] + between(seed, -half, half);
    return point_at(bk_v3((float)p[0], (float)p[1], (float)p[2]),
                    bk_v3((float)n[0], (float)n[1], (float)n[2]), 1.0f, (bk_uint)*seed);
}

/* Points in and around a grid, some far outside of it. */
TEST(test_points_everywhere)
{
    const double centre[3] = {2, 127, 4095};
    static bk_viewpoint points[POINTS];
    uint64_t seed = 5;
    (void)state;
    struct analytic_grid *grid = analytic_grid_create();
    add_clutter(grid, centre, 12, 1000, &seed);
    struct fixture f;
    open_fixture(&f, grid);
    for (int i = 0; i < POINTS; i++)
        points[i] = random_point(centre, i % 4 ? 14 : 200, &seed);
    /* Some outside look at the grid from afar. */
    for (int i = 0; i < POINTS; i += 8) {
        const bk_vec3 p = points[i].solid_from;
        const bk_vec3 n =
            bk_unit(bk_v3((float)centre[0] - p.x, (float)centre[1] - p.y, (float)centre[2] - p.z));
        points[i] = point_at(p, n, 1.0f, points[i].share.seed);
    }
    /* Invalid points are not traced. */
    points[5].solid_from.x = points[5].open_from.x = NAN;
    points[6].normal.y = INFINITY;
    compare_kinds(&f, points, 1.0f, 40);
    compare_kinds(&f, points, 0.02f, 500);
    compare_kinds(&f, points, 0.02f, BK_FAR);
    for (int i = 0; i < POINTS; i += 16) {
        const bk_vec3 n = points[i].normal, p = points[i].solid_from;
        points[i] = point_at(bk_add_scaled(p, -1.0e5f, n), n, 1.0f, points[i].share.seed);
    }
    compare_kinds(&f, points, 0.02f, BK_FAR);
    close_fixture(&f);
    analytic_grid_free(grid);
}

/* The widest grid with a tree: borders are steps of 2^14 voxels. Clutter at both ends; rays in
 * each. */
TEST(test_wide_grid)
{
    const double ends[2] = {128 - 0.5 * BAKE_TREE_EXTENT, 0.5 * BAKE_TREE_EXTENT - 128};
    static bk_viewpoint points[POINTS];
    uint64_t seed = 9;
    (void)state;
    struct analytic_grid *grid = analytic_grid_create();
    for (int e = 0; e < 2; e++)
        add_clutter(grid, (double[3]){ends[e], ends[1 - e], 3}, 10, 2000, &seed);
    struct fixture f;
    open_fixture(&f, grid);
    assert_true(bake_tree_shift(&f.tree.nodes[0]) >= 12);
    assert_int_equal(check_node(&f, 0, NULL), f.file.voxel_count);
    for (int i = 0; i < POINTS; i++)
        points[i] = random_point((double[3]){ends[i % 2], ends[1 - i % 2], 3}, 11, &seed);
    compare_kinds(&f, points, 1.0f, 40);
    /* Boxes have margins of some voxels here, so narrow cones meet most blocks on their way. */
    compare_kinds(&f, points, 0.02f, 16);
    close_fixture(&f);
    analytic_grid_free(grid);
}

RUN_TESTS(NULL, NULL)
