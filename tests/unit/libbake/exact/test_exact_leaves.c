/* test_exact_leaves.c - a ray through leaves finds the very hit that testing all triangles in
 * double finds, at any scale, on the processor and in the functions of devices. */
#include <stdlib.h>

#include "libbake/exact/exact_leaves.h"
#include "libbake/exact/exact_line.h"
#include "libbake/kernel/bk_meet.h"
#include "tests/unit/libbake/exact/exact_fixture.h"
#include "tests/unit/test.h"

enum { TRIANGLES = 1500, CHUNKS = 3, RAYS = 400 };

struct scene {
    double scale, offset;
    float positions[CHUNKS][TRIANGLES + 3][3];
    uint32_t triangles[CHUNKS][TRIANGLES][3];
    struct fmt_tris_chunk chunks[CHUNKS];
    struct exact_leaves leaves[CHUNKS];
    struct exact_group group;
    void *memory[CHUNKS], *tree_memory;
    char *area; /* as devices have it */
};

/* Strips of slim triangles, so that neighbours share edges, and needles are among them. */
static void fill_scene(struct scene *scene)
{
    for (int c = 0; c < CHUNKS; c++) {
        for (int v = 0; v < TRIANGLES + 2; v++)
            for (int k = 0; k < 3; k++)
                scene->positions[c][v][k] =
                    v >= 2 && v % 3 > 0
                        ? (float)((double)scene->positions[c][v - 2][k] +
                                  scene->scale * (double)exact_between(-0.05, 0.05))
                        : (float)(scene->scale * (scene->offset + (double)exact_between(-1, 1)));
        for (uint32_t t = 0; t < TRIANGLES; t++)
            for (uint32_t k = 0; k < 3; k++)
                scene->triangles[c][t][k] = t + k;
        /* A chunk's last leaf need not be full. */
        scene->chunks[c] =
            (struct fmt_tris_chunk){.triangle_count = (uint32_t)(TRIANGLES - 7 * c),
                                    .vertex_count = TRIANGLES + 2,
                                    .positions = (const float(*)[3])scene->positions[c],
                                    .triangles = (const uint32_t(*)[3])scene->triangles[c]};
    }
}

static void fill_area(struct scene *scene)
{
    uint64_t at = bake_exact_table_bytes(CHUNKS);
    scene->area = aligned_alloc(BSQ_ALIGNMENT, at + CHUNKS * bake_exact_leaves_bytes(TRIANGLES));
    bake_exact_table_set(&scene->group, CHUNKS, scene->area);
    for (int c = 0; c < CHUNKS; c++) {
        const uint64_t bytes = bake_exact_leaves_bytes(scene->chunks[c].triangle_count);
        memcpy(scene->area + at, scene->memory[c], bytes);
        at += bytes;
    }
}

static void build_scene(struct scene *scene, bool sorted)
{
    struct exact_box boxes[CHUNKS];
    void *scratch = aligned_alloc(BSQ_ALIGNMENT, bake_exact_leaves_scratch_bytes(TRIANGLES));
    for (int c = 0; c < CHUNKS; c++) {
        scene->memory[c] = aligned_alloc(BSQ_ALIGNMENT, bake_exact_leaves_bytes(TRIANGLES));
        bake_exact_leaves_build(&scene->chunks[c], sorted, true, scene->memory[c], scratch,
                                &scene->leaves[c]);
        boxes[c] = EXACT_EMPTY_BOX;
        for (int v = 0; v < TRIANGLES + 2; v++)
            exact_box_grow(&boxes[c], scene->positions[c][v], scene->positions[c][v]);
    }
    free(scratch);
    scene->tree_memory = aligned_alloc(BSQ_ALIGNMENT, bake_exact_tree_bytes(CHUNKS));
    bake_exact_tree_build(&scene->group.tree, CHUNKS, boxes, scene->tree_memory);
    scene->group.chunks = scene->leaves;
    fill_area(scene);
}

static void free_scene(struct scene *scene)
{
    for (int c = 0; c < CHUNKS; c++)
        free(scene->memory[c]);
    free(scene->tree_memory);
    free(scene->area);
}

/* Returns a ray from a point near the scan to a corner, a point of an edge, or any other place. */
static struct bake_ray random_ray(const struct scene *scene)
{
    const uint32_t chunk = (uint32_t)(exact_uniform() * CHUNKS),
                   vertex = (uint32_t)(exact_uniform() * TRIANGLES);
    const float *a = scene->positions[chunk][vertex], *b = scene->positions[chunk][vertex + 1];
    const double share = exact_uniform() < 0.5 ? 0 : exact_uniform();
    struct bake_ray ray;
    double length = 0, direction[3];
    for (int k = 0; k < 3; k++) {
        const double to = (double)a[k] + share * ((double)b[k] - (double)a[k]);
        ray.origin[k] = (float)(scene->scale * (scene->offset + (double)exact_between(-1.5, 1.5)));
        /* Some are parallel to an axis. */
        if (vertex % 5 == 0 && k != (int)(vertex % 3))
            ray.origin[k] = (float)to;
        direction[k] = to - (double)ray.origin[k];
        length += direction[k] * direction[k] / (scene->scale * scene->scale);
    }
    length = sqrt(length) * scene->scale;
    for (int k = 0; k < 3; k++)
        ray.direction[k] = length > 0 ? (float)(direction[k] / length) : 0.0f;
    return ray;
}

static bool trace_all(const struct scene *scene, const struct bake_ray *ray,
                      const struct exact_look_limits *limits, double *t)
{
    bk_line line;
    bk_shear shear;
    bool found = false;
    *t = limits->t_max;
    if (!bk_line_set(&line, ray->origin, ray->direction))
        return false;
    bk_shear_set(&shear, ray->origin, ray->direction);
    for (int c = 0; c < CHUNKS; c++)
        for (uint32_t i = 0; i < scene->chunks[c].triangle_count; i++) {
            const float(*p)[3] = &scene->chunks[c].positions[i];
            bk_line_hit crossing;
            if (!exact_cross_triangle(&shear, p[0], p[1], p[2], &crossing) ||
                !(crossing.t >= 0 && crossing.t <= *t) ||
                (!limits->two_sided && crossing.along == limits->facing_origin))
                continue;
            *t = crossing.t;
            found = true;
        }
    return found;
}

/* Traces a ray as devices do. */
static bool meet(const struct scene *scene, const struct bake_ray *ray,
                 const struct exact_look_limits *limits, double *t)
{
    bk_meeting m = {.any = limits->any,
                    .sides = limits->two_sided       ? 0u
                             : limits->facing_origin ? (bk_uint)BK_AGAINST
                                                     : (bk_uint)BK_ALONG};
    if (!bk_meeting_set(&m, ray->origin, ray->direction))
        return false;
    bk_set_nearest(&m, (double)(float)limits->t_max);
    bk_meet_group(&m, (const bk_float4 *)(const void *)scene->area);
    *t = m.nearest;
    return m.found;
}

static void check_ray(const struct scene *scene, const struct bake_ray *ray,
                      struct exact_look_limits limits, uint32_t *hits)
{
    struct exact_path path;
    double expected, t;
    const bool there = trace_all(scene, ray, &limits, &expected);
    limits.any = true;
    assert_int_equal(meet(scene, ray, &limits, &t), there);
    limits.any = false;
    assert_int_equal(meet(scene, ray, &limits, &t), there);
    assert_true(!there || t == expected);
    for (enum bsq_simd level = BSQ_SIMD_BASE; level <= bsq_simd_best(); level++) {
        limits.any = false;
        BSQ_SIMD_PICK(level, bake_exact_path_find)(&scene->group, ray->origin, &path);
        const bool hit = trace_all(scene, ray, &limits, &expected);
        *hits += hit;
        assert_int_equal(BSQ_SIMD_PICK(level, bake_exact_group_trace)(&scene->group, &path,
                                                                      ray->direction, &limits, &t),
                         hit);
        assert_true(!hit || t == expected);
        limits.any = true;
        assert_int_equal(BSQ_SIMD_PICK(level, bake_exact_group_trace)(&scene->group, &path,
                                                                      ray->direction, &limits, &t),
                         hit);
    }
}

/* ---- first rays ---- */

/* Returns a chunk as a device has it for first rays, to be freed. */
static char *place_of(const struct scene *scene, int chunk)
{
    const uint64_t table = bake_exact_table_bytes(1),
                   bytes = bake_exact_leaves_bytes(scene->chunks[chunk].triangle_count);
    struct exact_leaves leaves = scene->leaves[chunk];
    struct exact_group group = {.chunks = &leaves};
    struct exact_box box = EXACT_EMPTY_BOX;
    struct exact_box8 node;
    char *place = aligned_alloc(BSQ_ALIGNMENT, table + bytes);
    for (int v = 0; v < TRIANGLES + 2; v++)
        exact_box_grow(&box, scene->positions[chunk][v], scene->positions[chunk][v]);
    bake_exact_tree_build(&group.tree, 1, &box, &node);
    bake_exact_table_set(&group, 1, place);
    memcpy(place + table, scene->memory[chunk], bytes);
    return place;
}

/* Returns whether a hit counts and wins over another one. */
static bool takes(const bk_limits *limits, const bk_first_ray *ray, const bk_line_hit *crossing,
                  uint32_t triangle, const bk_first_hit *best, bool met)
{
    const double t = crossing->t, reach = (double)ray->reach;
    return t >= limits->t_min && t <= limits->t_max && fabs(t) >= limits->gap &&
           !(limits->from_reach && t > reach) &&
           (limits->sides == 0 || (limits->sides == BK_ALONG) == (crossing->along != 0)) &&
           (!met || bk_wins(t, triangle, best->t, best->triangle, reach));
}

/* Tests all triangles of a chunk. */
static bk_first_hit first_of_all(const struct scene *scene, int chunk, const bk_limits *limits,
                                 const bk_first_ray *ray)
{
    bk_first_hit best = {.t = ray->t, .triangle = BK_NO_TRIANGLE};
    bool met = ray->met;
    bk_line line;
    bk_shear shear;
    if (!bk_line_set(&line, ray->origin, ray->direction))
        return best;
    bk_shear_set(&shear, ray->origin, ray->direction);
    for (uint32_t i = 0; i < scene->chunks[chunk].triangle_count; i++) {
        const float(*p)[3] = &scene->chunks[chunk].positions[i];
        bk_line_hit crossing;
        if (!exact_cross_triangle(&shear, p[0], p[1], p[2], &crossing) ||
            !takes(limits, ray, &crossing, i, &best, met))
            continue;
        best = (bk_first_hit){crossing.t, crossing.w1, crossing.w2, i, 0};
        met = true;
    }
    return best;
}

TEST(devices_find_the_first_hit_that_wins)
{
    static const double scales[][2] = {{1, 0}, {1, 1000}, {1e-3, 1e5}, {1e-25, 3}, {1e25, 3}};
    static struct scene scene;
    exact_seed = test_seed();
    uint32_t hits = 0, kept = 0;
    for (uint32_t i = 0; i < sizeof scales / sizeof *scales; i++) {
        scene.scale = scales[i][0];
        scene.offset = scales[i][1];
        fill_scene(&scene);
        build_scene(&scene, false);
        for (int c = 0; c < CHUNKS; c++) {
            char *place = place_of(&scene, c);
            for (int r = 0; r < RAYS; r++) {
                const struct bake_ray from = random_ray(&scene);
                bk_first_ray ray = {.reach = (float)(scene.scale * (double)exact_between(0, 1)),
                                    .met = r % 3 == 0,
                                    .t = scene.scale * (double)exact_between(-1, 1)};
                const bk_limits limits = {.t_min = r % 5 ? -scene.scale : -3 * scene.scale,
                                          .t_max = r % 7 ? 2 * scene.scale : scene.scale / 2,
                                          .gap = r % 11 == 0 ? scene.scale / 8 : 0,
                                          .sides = (bk_uint)r % 4 % 3,
                                          .from_reach = r % 13 == 0};
                memcpy(ray.origin, from.origin, sizeof ray.origin);
                memcpy(ray.direction, from.direction, sizeof ray.direction);
                const bk_first_hit expected = first_of_all(&scene, c, &limits, &ray);
                bk_first_hit hit;
                bk_meet_first((const bk_float4 *)(const void *)place, &limits, &ray, &hit);
                assert_int_equal(hit.triangle, expected.triangle);
                hits += hit.triangle != BK_NO_TRIANGLE;
                kept += hit.triangle == BK_NO_TRIANGLE && ray.met;
                if (hit.triangle != BK_NO_TRIANGLE)
                    assert_true(hit.t == expected.t && hit.w1 == expected.w1 &&
                                hit.w2 == expected.w2);
            }
            free(place);
        }
        free_scene(&scene);
    }
    assert_true(hits > RAYS && kept > RAYS / 4);
}

TEST(leaves_hide_no_hit)
{
    static const double scales[][2] = {{1, 0},     {1, 1000},  {1e-3, 1e5}, {1e-25, 0},
                                       {1e-25, 3}, {1e-38, 0}, {1e25, 0},   {1e25, 3}};
    static struct scene scene;
    exact_seed = test_seed();
    uint32_t hits = 0;
    for (uint32_t i = 0; i < 2 * sizeof scales / sizeof *scales; i++) {
        scene.scale = scales[i / 2][0];
        scene.offset = scales[i / 2][1];
        fill_scene(&scene);
        build_scene(&scene, i % 2 > 0);
        for (int r = 0; r < RAYS; r++) {
            const struct bake_ray ray = random_ray(&scene);
            check_ray(&scene, &ray,
                      (struct exact_look_limits){.t_max = r % 7 == 0 ? scene.scale : INFINITY,
                                                 .two_sided = r % 2 > 0,
                                                 .facing_origin = r % 4 < 2},
                      &hits);
        }
        free_scene(&scene);
    }
    assert_true(hits > 2 * RAYS);
}

RUN_TESTS(NULL, NULL)
