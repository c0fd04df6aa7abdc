/* test_exact.c - exact rays against brute force, against Embree, and against themselves with other
 * chunks, threads and budgets. */
#include <embree3/rtcore.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>

#include "base/octahedral.h"
#include "formats/png_image.h"
#include "libbake/exact_internal.h"
#include "libbake/exact_tree_internal.h"
#include "tests/unit/libbake/triangle_scan.h"

static char directory[64];
static char scan_path[96], picture_path[96];

/* ---- random numbers ---- */

static uint64_t seed = 20081; /* printed by main */

static double uniform(void)
{
    seed = seed * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (double)(seed >> 11) / 9007199254740992.0;
}

static float between(double low, double high)
{
    return (float)(low + (high - low) * uniform());
}

static void random_direction(float out[3])
{
    double z = 2 * uniform() - 1, a = 6.283185307179586 * uniform(), r = sqrt(1 - z * z);
    out[0] = (float)(r * cos(a));
    out[1] = (float)(r * sin(a));
    out[2] = (float)z;
}

static void toward(const float from[3], const double to[3], float out[3])
{
    double d[3], square = 0;
    for (int k = 0; k < 3; k++) {
        d[k] = to[k] - (double)from[k];
        square += d[k] * d[k];
    }
    for (int k = 0; k < 3; k++)
        out[k] = (float)(d[k] / sqrt(square));
}

/* ---- meshes ---- */

/* Triangles of all directions and sizes without common vertices. */
static struct triangle_scan make_soup(uint32_t triangles)
{
    struct triangle_scan mesh = triangle_scan_new(3 * triangles, triangles);
    for (uint32_t t = 0; t < triangles; t++) {
        double size = pow(10, -2 + 1.5 * uniform());
        float centre[3] = {between(0, 1), between(0, 1), between(0, 1)};
        for (int i = 0; i < 3; i++) {
            mesh.triangles[t][i] = 3 * t + (uint32_t)i;
            for (int k = 0; k < 3; k++)
                mesh.positions[3 * t + (uint32_t)i][k] = centre[k] + between(-size, size);
        }
    }
    return mesh;
}

/* A bumpy torus of nu x nv quads: closed, each vertex in six triangles. In the order of `stride`
 * and not of rows, so that borders of chunks are everywhere. */
static struct triangle_scan make_torus(uint32_t nu, uint32_t nv)
{
    struct triangle_scan mesh = triangle_scan_new(nu * nv, 2 * nu * nv);
    const double tau = 6.283185307179586;
    for (uint32_t i = 0; i < nu; i++)
        for (uint32_t j = 0; j < nv; j++) {
            double u = tau * i / nu, v = tau * j / nv;
            double r = 0.4 + 0.03 * sin(7 * u) * cos(5 * v);
            float *p = mesh.positions[i * nv + j];
            p[0] = (float)((1 + r * cos(v)) * cos(u));
            p[1] = (float)((1 + r * cos(v)) * sin(u));
            p[2] = (float)(r * sin(v));
        }
    for (uint32_t q = 0; q < nu * nv; q++) {
        uint32_t i = q / nv, j = q % nv, in = (i + 1) % nu, jn = (j + 1) % nv;
        uint32_t a = i * nv + j, b = in * nv + j, c = in * nv + jn, d = i * nv + jn;
        memcpy(mesh.triangles[2 * q], (uint32_t[3]){a, b, c}, 12);
        memcpy(mesh.triangles[2 * q + 1], (uint32_t[3]){a, c, d}, 12);
    }
    return mesh;
}

/* Two triangles over the square 0 .. 2 x 0 .. 2 at z = 0 that face upwards, corners (0 0) (2 0) (2
 * 2) (0 2). */
static struct triangle_scan make_square(void)
{
    struct triangle_scan mesh = triangle_scan_new(4, 2);
    memcpy(mesh.positions, (float[4][3]){{0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {0, 2, 0}}, 48);
    memcpy(mesh.triangles, (uint32_t[2][3]){{0, 1, 2}, {0, 2, 3}}, 24);
    return mesh;
}

static struct bsq_ctx *new_context(unsigned threads, uint64_t memory)
{
    struct bsq_ctx_options options = {.threads = threads, .memory_bytes = memory, .tmpdir = "/tmp"};
    struct bsq_ctx *ctx;
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    return ctx;
}

static void write_scan(const struct triangle_scan *mesh, uint32_t chunk_triangles)
{
    triangle_scan_write(mesh, (const double[3]){100, 0, -7}, chunk_triangles, scan_path);
}

/* ---- tracing ---- */

struct setup {
    unsigned threads;
    uint64_t memory;
    bool two_sided, flat, color, against;
    double t_min, t_max;
    const struct bake_exact_footprint *footprint; /* of all rays */
};

static void trace(const struct setup *setup, const struct bake_exact_ray *rays, uint64_t count,
                  struct bake_exact_hit *hits)
{
    struct bsq_ctx *ctx = new_context(setup->threads, setup->memory);
    struct bake_exact_options options = {.path = scan_path,
                                         .normals = setup->flat ? BAKE_SCAN_NORMALS_FLAT
                                                                : BAKE_SCAN_NORMALS_SMOOTH,
                                         .two_sided = setup->two_sided};
    struct bake_exact *exact;
    assert_int_equal(bake_exact_open(ctx, &options, &exact), 0);
    if (setup->color)
        assert_int_equal(bake_exact_use_color(exact), 0);
    assert_int_equal(bake_exact_wants_footprints(exact), setup->footprint != NULL);
    uint32_t *footprints = setup->footprint ? calloc(count, 4) : NULL;
    uint64_t capacity = bake_exact_capacity(exact);
    for (uint64_t at = 0; at < count; at += capacity) {
        struct bake_exact_batch batch = {.rays = rays + at,
                                         .hits = hits + at,
                                         .count = count - at < capacity ? count - at : capacity,
                                         .t_min = setup->t_min,
                                         .t_max = setup->t_max,
                                         .against = setup->against,
                                         .footprints = footprints,
                                         .footprint_table = setup->footprint};
        int status = bake_exact_trace(exact, &batch);
        if (status < 0)
            print_message("%s\n", bsq_error(ctx));
        assert_int_equal(status, 0);
    }
    free(footprints);
    bake_exact_close(exact);
    assert_int_equal(bsq_memory_used(ctx), 0);
    if (setup->memory > 0)
        assert_true(bsq_memory_high(ctx) <= setup->memory);
    bsq_ctx_destroy(ctx);
}

static void random_rays(struct bake_exact_ray *rays, uint64_t count, double low, double high)
{
    for (uint64_t r = 0; r < count; r++) {
        for (int k = 0; k < 3; k++)
            rays[r].origin[k] = between(low, high);
        random_direction(rays[r].direction);
        if (r % 16 == 0) /* along an axis */
            for (int k = 0; k < 3; k++)
                rays[r].direction[k] = k == (int)(r / 16 % 3) ? (r % 32 ? 1.0f : -1.0f) : 0.0f;
    }
}

/* ---- the curve ---- */

/* Each cell of a lattice has a place of its own, and neighbours on the curve are neighbours in
 * space. */
static void test_curve_goes_from_neighbour_to_neighbour(void **state)
{
    (void)state;
    enum { CELLS = 16, ALL = CELLS * CELLS * CELLS };
    static int cell_at[ALL];
    static const float low[3] = {-2, 5, 0};
    memset(cell_at, 0xff, sizeof cell_at);
    for (int c = 0; c < ALL; c++) {
        const int cell[3] = {c % CELLS, c / CELLS % CELLS, c / CELLS / CELLS};
        float point[3];
        for (int k = 0; k < 3; k++)
            point[k] = low[k] + 3 * ((float)cell[k] + 0.5f) / CELLS;
        const uint64_t place = exact_curve_place(point, low, 3) >> (33 - 12);
        assert_in_range(place, 0, ALL - 1);
        assert_int_equal(cell_at[place], -1);
        cell_at[place] = c;
    }
    for (int p = 1; p < ALL; p++) {
        int steps = 0;
        for (int k = 1; k < ALL; k *= CELLS)
            steps += abs(cell_at[p] / k % CELLS - cell_at[p - 1] / k % CELLS);
        assert_int_equal(steps, 1);
    }
}

/* ---- brute force ---- */

struct candidate {
    double t, least; /* smallest barycentric weight */
    bool along;
};

/* Moller & Trumbore 1997. */
static struct candidate meet(const struct triangle_scan *mesh, uint32_t triangle,
                             const struct bake_exact_ray *ray)
{
    double e[2][3], s[3], p[3], q[3], d[3], determinant = 0, u = 0, v = 0, t = 0;
    const float *a = mesh->positions[mesh->triangles[triangle][0]];
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < 2; i++)
            e[i][k] = (double)mesh->positions[mesh->triangles[triangle][i + 1]][k] - (double)a[k];
        s[k] = (double)ray->origin[k] - (double)a[k];
        d[k] = (double)ray->direction[k];
    }
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        p[k] = d[i] * e[1][j] - d[j] * e[1][i];
        q[k] = s[i] * e[0][j] - s[j] * e[0][i];
    }
    for (int k = 0; k < 3; k++) {
        determinant += e[0][k] * p[k];
        u += s[k] * p[k];
        v += d[k] * q[k];
        t += e[1][k] * q[k];
    }
    u /= determinant;
    v /= determinant;
    /* d . (e0 x e1) = - determinant */
    return (struct candidate){t / determinant, fmin(fmin(u, v), 1 - u - v), determinant < 0};
}

static void check_by_force(const struct triangle_scan *mesh, const struct setup *setup,
                           const struct bake_exact_ray *ray, const struct bake_exact_hit *hit)
{
    const double slack = 1e-9;
    double nearest = INFINITY; /* of those that are hit beyond doubt */
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        struct candidate c = meet(mesh, t, ray);
        if (c.least > slack && c.t > setup->t_min + slack && c.t < setup->t_max - slack &&
            (setup->two_sided || c.along != setup->against))
            nearest = fmin(nearest, fabs(c.t));
    }
    if (hit->triangle == BAKE_EXACT_NONE) {
        assert_true(isinf(nearest));
        return;
    }
    struct candidate c = meet(mesh, (uint32_t)hit->triangle, ray);
    assert_true(fabs(hit->t) <= nearest + slack);
    assert_true(fabs(hit->t - c.t) < slack);
    assert_true(c.least > -slack);
    assert_true(hit->t >= setup->t_min && hit->t <= setup->t_max);
    assert_true(setup->two_sided || c.along != setup->against);
}

static void test_soup_agrees_with_brute_force(void **state)
{
    (void)state;
    enum { RAYS = 6000 };
    static struct bake_exact_ray rays[RAYS];
    static struct bake_exact_hit hits[RAYS];
    struct triangle_scan mesh = make_soup(2000);
    write_scan(&mesh, 97);
    for (int variant = 0; variant < 4; variant++) {
        struct setup setup = {.threads = 2,
                              .two_sided = variant == 1,
                              .against = variant == 2,
                              .t_min = variant == 3 ? 0.05 : -0.3,
                              .t_max = 0.4};
        uint64_t found = 0;
        random_rays(rays, RAYS, -0.2, 1.2);
        trace(&setup, rays, RAYS, hits);
        for (uint32_t r = 0; r < RAYS; r++) {
            check_by_force(&mesh, &setup, &rays[r], &hits[r]);
            found += hits[r].triangle != BAKE_EXACT_NONE;
        }
        assert_in_range(found, RAYS / 10, RAYS);
    }
    triangle_scan_free(&mesh);
}

/* ---- independence ---- */

static void test_hits_do_not_depend_on_chunks_threads_or_budget(void **state)
{
    (void)state;
    enum { RAYS = 60000 };
    static const struct {
        uint32_t chunk;
        unsigned threads;
        uint64_t memory;
    } cases[] = {{60000, 1, 0},      {60000, 4, 6 << 20}, {5000, 3, 0},
                 {1000, 2, 2 << 20}, {333, 5, 3 << 20},   {20, 2, 0}};
    struct bake_exact_ray *rays = calloc(RAYS, sizeof *rays);
    struct bake_exact_hit *first = calloc(RAYS, sizeof *first), *hits = calloc(RAYS, sizeof *hits);
    struct triangle_scan mesh = make_torus(150, 100);
    mesh.attributes = FMT_TRIS_COLORS;
    for (uint32_t v = 0; v < mesh.vertex_count; v++)
        mesh.colors[v] = (uint32_t)(uniform() * 4294967295.0);
    random_rays(rays, RAYS, -1.5, 1.5);
    for (uint32_t r = 0; r < RAYS / 2;
         r++) { /* half of them through vertices, where triangles tie */
        const float *p = mesh.positions[(uint32_t)(uniform() * mesh.vertex_count)];
        double to[3] = {(double)p[0], (double)p[1], (double)p[2]};
        toward(rays[r].origin, to, rays[r].direction);
    }
    for (unsigned c = 0; c < sizeof cases / sizeof *cases; c++) {
        struct setup setup = {.threads = cases[c].threads,
                              .memory = cases[c].memory,
                              .color = true,
                              .t_min = -0.8,
                              .t_max = 1.1};
        write_scan(&mesh, cases[c].chunk);
        trace(&setup, rays, RAYS, c == 0 ? first : hits);
        if (c > 0)
            assert_memory_equal(hits, first, RAYS * sizeof *hits);
    }
    free(rays);
    free(first);
    free(hits);
    triangle_scan_free(&mesh);
}

/* ---- Embree ---- */

static void embree_nearest(RTCScene scene, const struct bake_exact_ray *ray, double sign,
                           double reach, uint32_t *triangle, double *t)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    struct RTCRayHit query = {.ray = {.org_x = ray->origin[0],
                                      .org_y = ray->origin[1],
                                      .org_z = ray->origin[2],
                                      .dir_x = (float)sign * ray->direction[0],
                                      .dir_y = (float)sign * ray->direction[1],
                                      .dir_z = (float)sign * ray->direction[2],
                                      .tfar = (float)reach,
                                      .mask = UINT32_MAX},
                              .hit = {.geomID = RTC_INVALID_GEOMETRY_ID}};
    rtcIntersect1(scene, &context, &query);
    if (query.hit.geomID != RTC_INVALID_GEOMETRY_ID && (double)query.ray.tfar < fabs(*t)) {
        *t = sign * (double)query.ray.tfar;
        *triangle = query.hit.primID;
    }
}

static void test_whole_scan_in_embree_agrees(void **state)
{
    (void)state;
    enum { RAYS = 100000 };
    struct bake_exact_ray *rays = calloc(RAYS, sizeof *rays);
    struct bake_exact_hit *hits = calloc(RAYS, sizeof *hits);
    struct triangle_scan mesh = make_torus(300, 200);
    struct setup setup = {.threads = 2, .two_sided = true, .t_min = -0.7, .t_max = 0.9};
    uint32_t same = 0, found = 0;
    write_scan(&mesh, 1500);
    random_rays(rays, RAYS, -1.5, 1.5);
    trace(&setup, rays, RAYS, hits);

    RTCDevice device = rtcNewDevice("threads=1,set_affinity=0");
    RTCScene scene = rtcNewScene(device);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12,
                                   mesh.vertex_count),
           mesh.positions, 12 * mesh.vertex_count);
    memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12,
                                   mesh.triangle_count),
           mesh.triangles, 12 * mesh.triangle_count);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    rtcCommitScene(scene);
    for (uint32_t r = 0; r < RAYS; r++) {
        uint32_t triangle = UINT32_MAX;
        double t = INFINITY;
        embree_nearest(scene, &rays[r], 1, setup.t_max, &triangle, &t);
        embree_nearest(scene, &rays[r], -1, -setup.t_min, &triangle, &t);
        bool hit = hits[r].triangle != BAKE_EXACT_NONE;
        found += hit;
        same += hit == (triangle != UINT32_MAX) &&
                (!hit || hits[r].triangle == triangle || fabs(hits[r].t - t) < 1e-5);
    }
    rtcReleaseGeometry(geometry);
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
    /* Embree works in float: at silhouettes and at the ends of rays it may differ. */
    print_message("%u hits, %u rays differ from Embree\n", found, RAYS - same);
    assert_true(found > RAYS / 4);
    assert_true(RAYS - same <= 3);
    free(rays);
    free(hits);
    triangle_scan_free(&mesh);
}

/* ---- watertightness ---- */

/* From inside the closed torus every ray must hit, wherever it aims: vertices, points of edges. */
static void test_no_ray_slips_through_edges_and_vertices(void **state)
{
    (void)state;
    enum { RAYS = 1 << 20 };
    struct bake_exact_ray *rays = calloc(RAYS, sizeof *rays);
    struct bake_exact_hit *hits = calloc(RAYS, sizeof *hits);
    struct triangle_scan mesh = make_torus(120, 90);
    struct setup setup = {.threads = 2, .flat = true, .two_sided = true, .t_max = 0.7};
    write_scan(&mesh, 50);
    for (uint32_t r = 0; r < RAYS; r++) {
        const uint32_t triangle = (uint32_t)((uint64_t)r * mesh.triangle_count / RAYS);
        const uint32_t *v = mesh.triangles[triangle];
        const float *a = mesh.positions[v[r % 3]], *b = mesh.positions[v[(r + 1) % 3]];
        const double w = r % 2 ? 0 : uniform();
        const double around = atan2((double)a[1], (double)a[0]) + 0.3 * uniform() - 0.15;
        double to[3];
        for (int k = 0; k < 3; k++)
            to[k] = (double)a[k] + w * ((double)b[k] - (double)a[k]);
        rays[r].origin[0] = (float)cos(around);
        rays[r].origin[1] = (float)sin(around);
        toward(rays[r].origin, to, rays[r].direction);
    }
    trace(&setup, rays, RAYS, hits);
    for (uint32_t r = 0; r < RAYS; r++)
        if (hits[r].triangle == BAKE_EXACT_NONE)
            fail_msg("ray %u slipped through", r);
    free(rays);
    free(hits);
    triangle_scan_free(&mesh);
}

/* Rays straight down on the lattice of a flat grid meet vertices and edges exactly. */
static void test_rays_that_meet_edges_exactly_hit(void **state)
{
    (void)state;
    enum { SIDE = 64, STEPS = 4 * SIDE + 1, RAYS = STEPS * STEPS };
    static struct bake_exact_ray rays[RAYS];
    static struct bake_exact_hit hits[RAYS];
    struct triangle_scan mesh = triangle_scan_new((SIDE + 1) * (SIDE + 1), 2 * SIDE * SIDE);
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        mesh.positions[v][0] = (float)(v % (SIDE + 1));
        mesh.positions[v][1] = (float)(v / (SIDE + 1));
    }
    for (uint32_t q = 0; q < SIDE * SIDE; q++) {
        uint32_t a = q / SIDE * (SIDE + 1) + q % SIDE;
        memcpy(mesh.triangles[2 * q], (uint32_t[3]){a, a + 1, a + SIDE + 2}, 12);
        memcpy(mesh.triangles[2 * q + 1], (uint32_t[3]){a, a + SIDE + 2, a + SIDE + 1}, 12);
    }
    write_scan(&mesh, 37);
    for (int axis = 0; axis < 3; axis++) {
        struct setup setup = {.threads = 2, .two_sided = true, .t_min = -1, .t_max = 1};
        for (uint32_t r = 0; r < RAYS; r++) {
            float tilt[3] = {0, 0, -1};
            tilt[axis % 2] = axis < 2 ? 0.5f : 0.0f;
            rays[r].origin[0] = 0.25f * (float)(r % STEPS);
            rays[r].origin[1] = 0.25f * (float)(r / STEPS);
            rays[r].origin[2] = 0.0f;
            memcpy(rays[r].direction, tilt, sizeof tilt);
        }
        trace(&setup, rays, RAYS, hits);
        for (uint32_t r = 0; r < RAYS; r++) {
            assert_true(hits[r].triangle != BAKE_EXACT_NONE);
            assert_true(hits[r].t == 0.0);
            assert_true(hits[r].normal[2] == 1.0f);
        }
    }
    triangle_scan_free(&mesh);
}

/* ---- which hit wins ---- */

static struct bake_exact_hit trace_one(const struct setup *setup, float x, float y, float z,
                                       float dz)
{
    struct bake_exact_ray ray = {{x, y, z}, {0, 0, dz}};
    struct bake_exact_hit hit;
    trace(setup, &ray, 1, &hit);
    return hit;
}

static void test_facing(void **state)
{
    (void)state;
    struct triangle_scan mesh = make_square();
    struct setup setup = {.threads = 1, .t_min = -1, .t_max = 1};
    write_scan(&mesh, 1);
    /* The low mesh below looks up: the square's front is met from its back. */
    struct bake_exact_hit hit = trace_one(&setup, 1.5f, 0.5f, -0.5f, 1);
    assert_int_equal(hit.triangle, 0);
    assert_true(hit.t == 0.5 && hit.normal[2] == 1.0f);
    hit = trace_one(&setup, 1.5f, 0.5f, -0.5f, -1);
    assert_true(hit.triangle == BAKE_EXACT_NONE);
    setup.against = true; /* a camera above sees it */
    hit = trace_one(&setup, 0.5f, 1.5f, 0.75f, -1);
    assert_int_equal(hit.triangle, 1);
    assert_true(hit.t == 0.75);
    hit = trace_one(&setup, 0.5f, 1.5f, -0.75f, 1);
    assert_true(hit.triangle == BAKE_EXACT_NONE);
    setup.two_sided = true;
    hit = trace_one(&setup, 0.5f, 1.5f, -0.75f, 1);
    assert_true(hit.t == 0.75 && hit.normal[2] == 1.0f);
    hit = trace_one(&setup, 0.5f, 1.5f, -1.25f, 1);
    assert_true(hit.triangle == BAKE_EXACT_NONE);
    triangle_scan_free(&mesh);
}

/* Vertex normals say which side is outside, whatever the winding. */
static void test_normals_decide_on_the_outside(void **state)
{
    (void)state;
    struct triangle_scan mesh = make_square();
    struct setup setup = {.threads = 1, .t_min = -1, .t_max = 1};
    mesh.attributes = FMT_TRIS_NORMALS;
    for (int v = 0; v < 4; v++)
        mesh.normals[v] = bsq_oct_pack(bsq_v3(0, 0, -1));
    write_scan(&mesh, 2);
    assert_true(trace_one(&setup, 1.5f, 0.5f, -0.5f, 1).triangle == BAKE_EXACT_NONE);
    struct bake_exact_hit hit = trace_one(&setup, 1.5f, 0.5f, -0.5f, -1);
    assert_true(hit.t == -0.5);
    assert_true(hit.normal[2] == -1.0f);
    triangle_scan_free(&mesh);
}

/* Of two sheets as far away, the one in front wins; of the same place, the first in the file. */
static void test_ties(void **state)
{
    (void)state;
    struct triangle_scan mesh = triangle_scan_new(9, 3);
    for (uint32_t v = 0; v < 9; v++) {
        mesh.positions[v][0] = v % 3 == 1 ? 4.0f : 0.0f;
        mesh.positions[v][1] = v % 3 == 2 ? 4.0f : 0.0f;
        mesh.positions[v][2] = v < 3 ? -1.0f : 1.0f;
        mesh.triangles[v / 3][v % 3] = v;
    }
    struct setup setup = {.threads = 2, .t_min = -2, .t_max = 2};
    for (uint32_t chunk = 1; chunk <= 3; chunk++) {
        write_scan(&mesh, chunk);
        struct bake_exact_hit hit = trace_one(&setup, 1, 1, 0, 1);
        assert_true(hit.t == 1.0);
        assert_int_equal(hit.triangle, 1);
    }
    triangle_scan_free(&mesh);
}

static void test_rays_that_are_none_find_nothing(void **state)
{
    (void)state;
    struct triangle_scan mesh = make_square();
    struct setup setup = {.threads = 1, .two_sided = true, .t_min = -1, .t_max = 1};
    write_scan(&mesh, 1);
    assert_true(trace_one(&setup, 1, 1, 0, 0).triangle == BAKE_EXACT_NONE);
    assert_true(trace_one(&setup, NAN, 1, 0, 1).triangle == BAKE_EXACT_NONE);
    assert_true(trace_one(&setup, INFINITY, 1, 0, 1).triangle == BAKE_EXACT_NONE);
    assert_true(trace_one(&setup, 1, 1, 0, NAN).triangle == BAKE_EXACT_NONE);
    assert_true(trace_one(&setup, 1, 1, 0.5f, 1).t == -0.5);
    triangle_scan_free(&mesh);
}

/* ---- normals ---- */

/* Area-weighted normals of the whole mesh, in the order of its triangles. */
static double (*smooth_normals(const struct triangle_scan *mesh))[3]
{
    double(*sums)[3] = calloc(mesh->vertex_count, sizeof *sums);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles[t];
        double e[2][3];
        for (int i = 0; i < 2; i++)
            for (int k = 0; k < 3; k++)
                e[i][k] = (double)mesh->positions[v[i + 1]][k] - (double)mesh->positions[v[0]][k];
        for (int k = 0; k < 3; k++) {
            double c =
                e[0][(k + 1) % 3] * e[1][(k + 2) % 3] - e[0][(k + 2) % 3] * e[1][(k + 1) % 3];
            for (int i = 0; i < 3; i++)
                sums[v[i]][k] += c;
        }
    }
    return sums;
}

/* Rays down on a vertex from straight above it get its normal, on whatever border it lies. */
static void test_smooth_normals_across_borders(void **state)
{
    (void)state;
    struct triangle_scan mesh = make_torus(60, 40);
    double(*expected)[3] = smooth_normals(&mesh);
    struct bake_exact_ray *rays = calloc(mesh.vertex_count, sizeof *rays);
    struct bake_exact_hit *hits = calloc(mesh.vertex_count, sizeof *hits);
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        memcpy(rays[v].origin, mesh.positions[v], 12);
        double to[3];
        for (int k = 0; k < 3; k++)
            to[k] = (double)mesh.positions[v][k] + expected[v][k];
        toward(rays[v].origin, to, rays[v].direction);
    }
    for (uint32_t chunk = 7; chunk < 8000; chunk *= 5) {
        struct setup setup = {.threads = 2, .t_min = -0.01, .t_max = 0.01};
        write_scan(&mesh, chunk);
        trace(&setup, rays, mesh.vertex_count, hits);
        for (uint32_t v = 0; v < mesh.vertex_count; v++) {
            double length = sqrt(expected[v][0] * expected[v][0] + expected[v][1] * expected[v][1] +
                                 expected[v][2] * expected[v][2]);
            assert_true(hits[v].t == 0.0);
            for (int k = 0; k < 3; k++)
                assert_true(fabs((double)hits[v].normal[k] - expected[v][k] / length) < 1e-6);
        }
    }
    free(rays);
    free(hits);
    free(expected);
    triangle_scan_free(&mesh);
}

/* A roof of this height: two squares that meet in the ridge x = 0, whose vertices differ in their colours. */
static struct triangle_scan make_roof(float height)
{
    const float corners[8][3] = {{-1, 0, 0},      {0, 0, height}, {0, 2, height}, {-1, 2, 0},
                                 {0, 0, height},  {1, 0, 0},      {1, 2, 0},      {-0.0f, 2, height}};
    struct triangle_scan mesh = triangle_scan_new(8, 4);
    memcpy(mesh.positions, corners, sizeof corners);
    memcpy(mesh.triangles, (uint32_t[4][3]){{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}}, 48);
    mesh.attributes = FMT_TRIS_COLORS;
    for (uint32_t v = 4; v < 8; v++)
        mesh.colors[v] = 0xffffff;
    return mesh;
}

/* A seam in texture space repeats vertices; it must not show in the normals. */
static void test_smooth_normals_ignore_repeated_vertices(void **state)
{
    (void)state;
    const float height = 0.25f;
    struct triangle_scan mesh = make_roof(height);
    struct setup setup = {.threads = 1, .t_min = -2, .t_max = 2};
    for (uint32_t chunk = 1; chunk <= 4; chunk++) {
        write_scan(&mesh, chunk);
        /* The ridge's front vertex has one triangle of the left square and two of the right one. */
        const double left[3] = {-0.5, 0, 2}, right[3] = {0.5, 0, 2};
        double sum[3], length = 0;
        for (int k = 0; k < 3; k++) {
            sum[k] = left[k] + 2 * right[k];
            length += sum[k] * sum[k];
        }
        struct bake_exact_hit hit = trace_one(&setup, 0, 0, 0, 1);
        assert_true(hit.t == (double)height);
        for (int k = 0; k < 3; k++)
            assert_true(fabs((double)hit.normal[k] - sum[k] / sqrt(length)) < 1e-6);
    }
    setup.flat = true;
    struct bake_exact_hit hit = trace_one(&setup, 0.25f, 0.5f, 0, 1);
    assert_true(fabs((double)hit.normal[0] - 0.25 / sqrt(1.0625)) < 1e-6);
    triangle_scan_free(&mesh);
}

/* Steep roofs keep the normals of their sides up to the ridge. */
static void test_smooth_normals_end_at_creases(void **state)
{
    (void)state;
    struct triangle_scan mesh = make_roof(1);
    struct setup setup = {.threads = 1, .t_min = -2, .t_max = 2};
    write_scan(&mesh, 2);
    for (int side = -1; side <= 1; side += 2) {
        struct bake_exact_hit hit = trace_one(&setup, (float)side * 1e-3f, 1, 0, 1);
        assert_true(fabs((double)hit.normal[0] - side * sqrt(0.5)) < 1e-6);
        assert_true(fabs((double)hit.normal[2] - sqrt(0.5)) < 1e-6);
    }
    triangle_scan_free(&mesh);
}

static void test_vertex_normals_are_interpolated(void **state)
{
    (void)state;
    struct triangle_scan mesh = make_square();
    struct setup setup = {.threads = 1, .t_min = -1, .t_max = 1};
    mesh.attributes = FMT_TRIS_NORMALS;
    for (int v = 0; v < 4; v++)
        mesh.normals[v] = bsq_oct_pack(v == 1 ? bsq_v3(0.6f, 0, 0.8f) : bsq_v3(0, 0, 1));
    write_scan(&mesh, 1);
    struct bake_exact_hit hit = trace_one(&setup, 1.5f, 0.5f, 0, 1);
    /* Weights: 1/4 of (0 0), 1/2 of (2 0), 1/4 of (2 2). */
    const double x = 0.5 * 0.6, z = 0.5 * 0.8 + 0.5, length = sqrt(x * x + z * z);
    assert_true(fabs((double)hit.normal[0] - x / length) < 1e-4);
    assert_true(fabs((double)hit.normal[2] - z / length) < 1e-4);
    triangle_scan_free(&mesh);
}

/* ---- colours ---- */

static double linear(double srgb)
{
    return srgb <= 0.04045 ? srgb / 12.92 : pow((srgb + 0.055) / 1.055, 2.4);
}

static void expect_color(const struct bake_exact_hit *hit, double r, double g, double b, double by)
{
    const double expected[3] = {r, g, b};
    for (int k = 0; k < 3; k++)
        if (!(fabs((double)hit->color[k] - expected[k]) <= by))
            fail_msg("channel %d is %g, not %g", k, (double)hit->color[k], expected[k]);
}

static void test_vertex_colors_mix_in_linear_light(void **state)
{
    (void)state;
    struct triangle_scan mesh = make_square();
    struct setup setup = {.threads = 1, .color = true, .t_min = -1, .t_max = 1};
    mesh.attributes = FMT_TRIS_COLORS;
    mesh.colors[1] = 0xff0080ff; /* R 255, G 128, B 0 */
    write_scan(&mesh, 2);
    struct bake_exact_hit hit = trace_one(&setup, 1.5f, 0.5f, 0, 1);
    expect_color(&hit, 0.5, 0.5 * linear(128 / 255.0), 0, 1e-6);
    triangle_scan_free(&mesh);
}

static void write_picture(uint32_t side)
{
    struct bsq_ctx *ctx = new_context(1, 0);
    struct fmt_png_options options = {
        .width = side, .height = side, .channel_count = 3, .bits = 8, .srgb = true};
    struct fmt_png_writer *png;
    float *row = calloc(3 * side, sizeof *row);
    assert_int_equal(fmt_png_create(ctx, picture_path, &options, &png), 0);
    for (uint32_t y = 0; y < side; y++) { /* black and white by columns, v upwards in blue */
        for (uint32_t x = 0; x < side; x++) {
            row[3 * x] = row[3 * x + 1] = x % 2 ? 1.0f : 0.0f;
            row[3 * x + 2] = 2 * y < side ? 1.0f : 0.0f;
        }
        assert_int_equal(fmt_png_write_rows(png, row, 1), 0);
    }
    assert_int_equal(fmt_png_finish(png), 0);
    assert_int_equal(fmt_png_commit(png), 0);
    free(row);
    bsq_ctx_destroy(ctx);
}

static void test_textures_and_materials(void **state)
{
    (void)state;
    struct triangle_scan mesh = make_square();
    struct bake_exact_footprint narrow = {{{0, 0, 0}, {0, 0, 0}}};
    struct bake_exact_footprint wide = {{{0.25f, 0, 0}, {0, 0.001f, 0}}};
    struct setup setup = {
        .threads = 1, .color = true, .t_min = -1, .t_max = 1, .footprint = &narrow};
    write_picture(64);
    mesh.attributes = FMT_TRIS_TEXCOORDS | FMT_TRIS_MATERIALS;
    mesh.material_count = 2;
    mesh.material[0] = (struct fmt_tris_material){picture_path, {1, 1, 1}};
    mesh.material[1] = (struct fmt_tris_material){NULL, {0.5f, 1, 0}};
    mesh.materials[1] = 1;
    for (int v = 0; v < 4; v++)
        for (int k = 0; k < 2; k++)
            mesh.texcoords[v][k] = 0.5f * mesh.positions[v][k];
    write_scan(&mesh, 1);
    /* Texel centres of column 41, which is white, low and high in v. */
    const float x = 2 * 41.5f / 64;
    struct bake_exact_hit hit = trace_one(&setup, x, 0.25f, 0, 1);
    expect_color(&hit, 1, 1, 0, 1e-3);
    hit = trace_one(&setup, x, 1.25f, 0, 1);
    expect_color(&hit, 1, 1, 1, 1e-3);
    hit = trace_one(&setup, x - 2 / 64.0f, 0.25f, 0, 1);
    expect_color(&hit, 0, 0, 0, 1e-3);
    setup.footprint = &wide; /* eight texels */
    hit = trace_one(&setup, x, 0.25f, 0, 1);
    expect_color(&hit, 0.5, 0.5, 0, 0.1);
    hit = trace_one(&setup, 0.25f, 1.75f, 0, 1);
    expect_color(&hit, linear(0.5), 1, 0, 1e-6);
    triangle_scan_free(&mesh);
}

/* ---- failures ---- */

static void test_damaged_chunk_is_reported(void **state)
{
    (void)state;
    struct triangle_scan mesh = make_torus(20, 20);
    write_scan(&mesh, 100);
    FILE *file = fopen(scan_path, "r+b");
    assert_non_null(file);
    assert_int_equal(fseek(file, 3000, SEEK_SET), 0);
    int byte = fgetc(file);
    fseek(file, 3000, SEEK_SET);
    fputc(byte ^ 0x55, file);
    fclose(file);
    struct bsq_ctx *ctx = new_context(2, 0);
    struct bake_exact_options options = {.path = scan_path};
    struct bake_exact *exact;
    struct bake_exact_ray rays[400];
    struct bake_exact_hit hits[400];
    random_rays(rays, 400, -1, 1);
    assert_int_equal(bake_exact_open(ctx, &options, &exact), 0);
    struct bake_exact_batch batch = {
        .rays = rays, .hits = hits, .count = 400, .t_min = -3, .t_max = 3};
    assert_int_equal(bake_exact_trace(exact, &batch), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(ctx), "checksum"));
    bake_exact_close(exact);
    assert_int_equal(bsq_memory_used(ctx), 0);
    bsq_ctx_destroy(ctx);
    triangle_scan_free(&mesh);
}

/* ---- main ---- */

static int make_directory(void **state)
{
    (void)state;
    strcpy(directory, "/tmp/bsq-exact-XXXXXX");
    if (!mkdtemp(directory))
        return -1;
    snprintf(scan_path, sizeof scan_path, "%s/scan.tris", directory);
    snprintf(picture_path, sizeof picture_path, "%s/picture.png", directory);
    return 0;
}

static int remove_directory(void **state)
{
    (void)state;
    unlink(scan_path);
    unlink(picture_path);
    return rmdir(directory);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_curve_goes_from_neighbour_to_neighbour),
        cmocka_unit_test(test_soup_agrees_with_brute_force),
        cmocka_unit_test(test_hits_do_not_depend_on_chunks_threads_or_budget),
        cmocka_unit_test(test_whole_scan_in_embree_agrees),
        cmocka_unit_test(test_no_ray_slips_through_edges_and_vertices),
        cmocka_unit_test(test_rays_that_meet_edges_exactly_hit),
        cmocka_unit_test(test_facing),
        cmocka_unit_test(test_normals_decide_on_the_outside),
        cmocka_unit_test(test_ties),
        cmocka_unit_test(test_rays_that_are_none_find_nothing),
        cmocka_unit_test(test_smooth_normals_across_borders),
        cmocka_unit_test(test_smooth_normals_ignore_repeated_vertices),
        cmocka_unit_test(test_smooth_normals_end_at_creases),
        cmocka_unit_test(test_vertex_normals_are_interpolated),
        cmocka_unit_test(test_vertex_colors_mix_in_linear_light),
        cmocka_unit_test(test_textures_and_materials),
        cmocka_unit_test(test_damaged_chunk_is_reported),
    };
    print_message("seed %llu\n", (unsigned long long)seed);
    return cmocka_run_group_tests(tests, make_directory, remove_directory);
}
