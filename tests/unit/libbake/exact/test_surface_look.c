/* test_surface_look.c - secondary rays on triangles: against formulas, against Embree with the same
 * rays, and with any number of threads and any budget. */
#include <embree3/rtcore.h>
#include <float.h>

#include "libbake/kernel/bk_secondary.h"
#include "libbake/surface/surface.h"
#include "tests/unit/test.h"
#include "tests/unit/libbake/exact/exact_fixture.h"

static const double pi = 3.14159265358979323846;

/* ---- looking ---- */

/* Rays, their hits and what the rays from the hits found. */
struct view {
    uint64_t count;
    struct bake_ray *rays, *open; /* open: the first open ray of each hit */
    struct bake_hit *hits;
    bk_share *shares;
    bk_surroundings *found;
    uint64_t loads;
};

static struct view view_new(uint64_t count)
{
    struct view view = {.count = count,
                        .rays = calloc(count, sizeof *view.rays),
                        .open = calloc(count, sizeof *view.open),
                        .hits = calloc(count, sizeof *view.hits),
                        .shares = calloc(count, sizeof *view.shares),
                        .found = calloc(count, sizeof *view.found)};
    for (uint64_t i = 0; i < count; i++)
        view.shares[i].seed = bk_hash((uint32_t)i);
    return view;
}

static void view_free(struct view *view)
{
    free(view->rays);
    free(view->open);
    free(view->hits);
    free(view->shares);
    free(view->found);
}

static struct bk_params usual(uint32_t rays)
{
    return (struct bk_params){.maps = BK_SECONDARY_MAPS,
                              .unit = 1,
                              .samples = 1,
                              .open_rays = rays,
                              .thickness_rays = rays,
                              .open_limit = FLT_MAX,
                              .thickness_limit = 1000,
                              .open_sine2 = 1};
}

/* Returns the first open ray of a hit. */
static struct bake_ray open_ray(const struct bake_exact *exact, const struct bk_params *params,
                                const struct view *view, uint64_t i)
{
    const struct bake_hit *hit = &view->hits[i];
    const double lift = (double)bake_exact_lift(exact);
    const bk_rays kind = bk_rays_of(params, 1);
    const bk_viewpoint viewpoint = {.normal = bk_v3(hit->normal[0], hit->normal[1], hit->normal[2]),
                                    .facet = bk_v3(hit->facet[0], hit->facet[1], hit->facet[2]),
                                    .share = view->shares[i]};
    const bk_vec3w d = bk_ray_directions(&kind, &viewpoint, 0);
    struct bake_ray ray = {.direction = {d.x, d.y, d.z}};
    for (int k = 0; k < 3; k++)
        ray.origin[k] =
            (float)((double)view->rays[i].origin[k] + hit->t * (double)view->rays[i].direction[k] +
                    lift * (double)hit->facet[k]);
    return ray;
}

static void look(const struct exact_setup *setup, const struct bk_params *params, struct view *view)
{
    struct bsq_ctx *ctx = test_context(setup->threads, setup->memory);
    const struct bake_ray_batch batch = {.rays = view->rays,
                                         .hits = view->hits,
                                         .count = view->count,
                                         .t_min = setup->t_min,
                                         .t_max = setup->t_max,
                                         .facing_origin = setup->facing_origin};
    const struct bake_look_hits hits = {
        .rays = view->rays, .hits = view->hits, .shares = view->shares, .count = view->count};
    struct bake_options options;
    struct bake_surface surface;
    struct bake_look *looking;
    bake_defaults(&options);
    options.scan_path = exact_scan_path;
    options.scan_normals = setup->normals;
    options.two_sided = setup->two_sided;
    assert_int_equal(bake_surface_open(ctx, &options, &surface), 0);
    surface.params = surface.scans->params = *params;
    assert_int_equal(bake_look_create(&surface, view->count, &looking), 0);
    assert_int_equal(bake_exact_trace(surface.scans->exact, &batch), 0);
    const uint64_t loads = bake_surface_loads(&surface);
    assert_int_equal(bake_look_around(looking, &hits, view->found), 0);
    for (uint64_t i = 0; i < view->count; i++)
        if (view->hits[i].triangle != BAKE_NO_HIT)
            view->open[i] = open_ray(surface.scans->exact, params, view, i);
    view->loads = bake_surface_loads(&surface) - loads;
    bake_look_free(looking);
    bake_surface_close(&surface);
    assert_int_equal(bsq_memory_used(ctx), 0);
    assert_true(setup->memory == 0 || bsq_memory_high(ctx) <= setup->memory);
    bsq_ctx_destroy(ctx);
}

static void assert_near(double value, double expected, double tolerance, const char *what)
{
    if (!(fabs(value - expected) <= tolerance))
        print_error("%s: %g, expected %g\n", what, value, expected);
    assert_true(fabs(value - expected) <= tolerance);
}

/* ---- formulas ---- */

/* Adds a rectangle: a corner and two sides, whose cross product is its front. */
static void add_rectangle(struct triangle_scan *mesh, const float corner[3], const float u[3],
                          const float v[3])
{
    const uint32_t first = mesh->vertex_count, t = mesh->triangle_count;
    for (uint32_t i = 0; i < 4; i++)
        for (int k = 0; k < 3; k++)
            mesh->positions[first + i][k] =
                corner[k] + (i == 1 || i == 2 ? u[k] : 0) + (i >= 2 ? v[k] : 0);
    memcpy(mesh->triangles[t], (uint32_t[3]){first, first + 1, first + 2}, 12);
    memcpy(mesh->triangles[t + 1], (uint32_t[3]){first, first + 2, first + 3}, 12);
    mesh->vertex_count += 4;
    mesh->triangle_count += 2;
}

static struct triangle_scan begin_mesh(uint32_t rectangles)
{
    struct triangle_scan mesh = triangle_scan_new(4 * rectangles, 2 * rectangles);
    mesh.vertex_count = mesh.triangle_count = 0;
    return mesh;
}

/* Writes the mesh, so that its chunks have two triangles, and frees it. */
static void end_mesh(struct triangle_scan *mesh)
{
    exact_write_scan(mesh, 2);
    triangle_scan_free(mesh);
}

/* Two squares close to each other hide each other, also where coordinates are large. */
TEST(test_a_narrow_gap_is_dark)
{
    static const float places[] = {0, 8000};
    for (int i = 0; i < 2; i++) {
        const float x = places[i];
        const struct exact_setup setup = {.threads = 1, .facing_origin = true, .t_max = 1};
        const struct bk_params params = usual(1024);
        struct view view = view_new(1);
        struct triangle_scan mesh = begin_mesh(2);
        add_rectangle(&mesh, (float[]){x, 0, 0}, (float[]){1, 0, 0}, (float[]){0, 1, 0});
        add_rectangle(&mesh, (float[]){x, 0, 0.004f}, (float[]){0, 1, 0}, (float[]){1, 0, 0});
        end_mesh(&mesh);
        view.rays[0] = (struct bake_ray){{x + 0.5f, 0.4f, 0.002f}, {0, 0, -1}};
        look(&setup, &params, &view);
        assert_true(view.hits[0].triangle != BAKE_NO_HIT);
        assert_near((double)view.found[0].open, 0, 0.001, "in a narrow gap");
        view_free(&view);
    }
}

/* A ball of facets hides nothing of itself, although rays follow smooth normals. Its mean chord is
 * 4 r / 3. With both sides, a ball that is wound inwards is the same. */
TEST(test_a_ball_is_open_and_thick)
{
    enum { ACROSS = 40, ROWS = 20, POINTS = 300 };
    struct triangle_scan mesh = triangle_scan_new((ACROSS + 1) * (ROWS + 1), 2 * ACROSS * ROWS);
    const double r = 7;
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        const double polar = pi * (v / (ACROSS + 1)) / ROWS;
        const double angle = 2 * pi * (v % (ACROSS + 1) % ACROSS) / ACROSS;
        mesh.positions[v][0] = (float)(r * sin(polar) * cos(angle));
        mesh.positions[v][1] = (float)(r * sin(polar) * sin(angle));
        mesh.positions[v][2] = (float)(r * cos(polar));
    }
    for (int inwards = 0; inwards < 2; inwards++) {
        const struct exact_setup setup = {
            .threads = 2, .two_sided = inwards, .facing_origin = true, .t_max = 20};
        const struct bk_params params = usual(256);
        struct view view = view_new(POINTS);
        for (uint32_t q = 0; q < ACROSS * ROWS; q++) {
            const uint32_t a = q / ACROSS * (ACROSS + 1) + q % ACROSS, c = a + ACROSS + 1;
            const uint32_t second = inwards ? c + 1 : c, third = inwards ? c : c + 1;
            memcpy(mesh.triangles[2 * q], (uint32_t[3]){a, second, third}, 12);
            memcpy(mesh.triangles[2 * q + 1],
                   (uint32_t[3]){a, inwards ? a + 1 : c + 1, inwards ? c + 1 : a + 1}, 12);
        }
        exact_write_scan(&mesh, 100);
        for (int i = 0; i < POINTS; i++) {
            const float origin[3] = {exact_between(9, 12), exact_between(-9, 9),
                                     exact_between(-9, 9)};
            memcpy(view.rays[i].origin, origin, sizeof origin);
            exact_toward(origin, (double[]){0.3, 0.2, -0.1}, view.rays[i].direction);
        }
        look(&setup, &params, &view);
        for (int i = 0; i < POINTS; i++) {
            assert_true(view.hits[i].triangle != BAKE_NO_HIT);
            assert_int_equal(view.hits[i].reversed, inwards);
            assert_near((double)view.found[i].open, 1, 0, "of a ball");
            assert_near((double)(view.found[i].thickness / view.found[i].solids), 4 * r / 3,
                        0.02 * r, "thickness of a ball");
        }
        view_free(&view);
    }
    triangle_scan_free(&mesh);
}

/* ---- Embree ---- */

static RTCScene embree_scene(RTCDevice device, const struct triangle_scan *mesh)
{
    RTCScene scene = rtcNewScene(device);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12,
                                   mesh->vertex_count),
           mesh->positions, 12 * mesh->vertex_count);
    memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12,
                                   mesh->triangle_count),
           mesh->triangles, 12 * mesh->triangle_count);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    rtcCommitScene(scene);
    return scene;
}

static bool embree_occluded(RTCScene scene, const struct bake_ray *ray, float limit)
{
    struct RTCIntersectContext context;
    struct RTCRay query = {.org_x = ray->origin[0],
                           .org_y = ray->origin[1],
                           .org_z = ray->origin[2],
                           .dir_x = ray->direction[0],
                           .dir_y = ray->direction[1],
                           .dir_z = ray->direction[2],
                           .tfar = limit,
                           .mask = UINT32_MAX};
    rtcInitIntersectContext(&context);
    rtcOccluded1(scene, &context, &query);
    return query.tfar < 0;
}

/* One open ray from each hit has the same bit in Embree, which works in float. */
TEST(test_rays_are_hidden_where_embree_hides_them)
{
    enum { RAYS = 30000 };
    static const float limits[] = {FLT_MAX, 0.3f};
    struct triangle_scan mesh = exact_torus(300, 200);
    const struct exact_setup setup = {.threads = 2, .two_sided = true, .t_min = -1, .t_max = 1};
    struct view view = view_new(RAYS);
    exact_write_scan(&mesh, 1500);
    exact_random_rays(view.rays, RAYS, -1.5, 1.5);
    RTCDevice device = rtcNewDevice("threads=1,set_affinity=0");
    RTCScene scene = embree_scene(device, &mesh);
    for (int i = 0; i < 2; i++) {
        struct bk_params params = usual(1);
        uint32_t count = 0, same = 0, open = 0;
        params.maps = 1u << BK_MAP_ao;
        params.open_limit = limits[i];
        look(&setup, &params, &view);
        for (uint32_t r = 0; r < RAYS; r++) {
            if (view.hits[r].triangle == BAKE_NO_HIT)
                continue;
            const bool hidden = view.found[r].open == 0;
            count++;
            open += !hidden;
            same += hidden == embree_occluded(scene, &view.open[r], limits[i]);
        }
        print_message("%u secondary rays, %u open, %u differ from Embree\n", count, open,
                      count - same);
        assert_true(count > RAYS / 4 && open > count / 4 && open < count - count / 40);
        assert_true(count - same <= count / 1000);
    }
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
    view_free(&view);
    triangle_scan_free(&mesh);
}

/* ---- threads and memory ---- */

/* Chunks pass through memory in groups if they do not fit, for one batch of viewpoints after
 * another.
 */
TEST(test_results_depend_on_neither_threads_nor_memory)
{
    enum { RAYS = 800, CHUNKS = 80 };
    static const struct {
        unsigned threads;
        uint64_t memory;
    } runs[] = {{1, 0}, {5, 0}, {2, UINT64_C(5) << 19}, {1, UINT64_C(3) << 19}};
    struct triangle_scan mesh = exact_torus(300, 200);
    struct view expected = view_new(RAYS), view = view_new(RAYS);
    exact_write_scan(&mesh, 1500);
    exact_random_rays(expected.rays, RAYS, -1.5, 1.5);
    memcpy(view.rays, expected.rays, RAYS * sizeof *view.rays);
    for (int falloff = 0; falloff < 2; falloff++) {
        struct bk_params params = usual(100);
        params.flags = falloff ? BK_OPEN_FALLOFF : 0;
        params.open_limit = falloff ? 0.5f : FLT_MAX;
        for (size_t r = 0; r < sizeof runs / sizeof *runs; r++) {
            const struct exact_setup setup = {.threads = runs[r].threads,
                                              .memory = runs[r].memory,
                                              .two_sided = true,
                                              .t_min = -1,
                                              .t_max = 1};
            struct view *to = r == 0 ? &expected : &view;
            look(&setup, &params, to);
            print_message("%u threads, %llu bytes: %llu chunks loaded\n", runs[r].threads,
                          (unsigned long long)runs[r].memory, (unsigned long long)to->loads);
            if (runs[r].memory == 0)
                assert_int_equal(to->loads, CHUNKS);
            else
                assert_true(to->loads > CHUNKS);
            assert_memory_equal(to->found, expected.found, RAYS * sizeof *view.found);
        }
    }
    view_free(&view);
    view_free(&expected);
    triangle_scan_free(&mesh);
}

/* Chunks that short rays cannot reach are not loaded, if not all fit. */
TEST(test_short_rays_load_few_chunks)
{
    enum { RAYS = 200 };
    struct triangle_scan mesh = exact_torus(300, 200);
    struct exact_setup setup = {
        .threads = 1, .memory = UINT64_C(3) << 19, .two_sided = true, .t_min = -1, .t_max = 1};
    struct bk_params params = usual(64);
    struct view view = view_new(RAYS);
    exact_write_scan(&mesh, 1500);
    for (int i = 0; i < RAYS; i++) {
        view.rays[i] = (struct bake_ray){{exact_between(1.1, 1.3), 0, 0.6f}, {0, 0, -1}};
        view.rays[i].origin[1] = exact_between(-0.1, 0.1);
    }
    params.maps = 1u << BK_MAP_ao;
    params.open_limit = 0.05f;
    look(&setup, &params, &view);
    assert_in_range(view.loads, 1, 20);
    view_free(&view);
    triangle_scan_free(&mesh);
}

int main(void)
{
    print_message("seed %llu\n", (unsigned long long)exact_seed);
    return test_run(NULL, NULL);
}
