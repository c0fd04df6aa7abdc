
#include "tests/unit/fixture.h"
#include "tests/unit/libbake/exact/exact_fixture.h"

/* ---- random numbers ---- */

uint64_t exact_seed = 20081;

double exact_uniform(void)
{
    exact_seed = exact_seed * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (double)(exact_seed >> 11) / 9007199254740992.0;
}

float exact_between(double low, double high)
{
    return (float)(low + (high - low) * exact_uniform());
}

static void random_direction(float out[3])
{
    double z = 2 * exact_uniform() - 1, a = 6.283185307179586 * exact_uniform(),
           r = sqrt(1 - z * z);
    out[0] = (float)(r * cos(a));
    out[1] = (float)(r * sin(a));
    out[2] = (float)z;
}

void exact_toward(const float from[3], const double to[3], float out[3])
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

struct triangle_scan exact_soup(uint32_t triangles)
{
    struct triangle_scan mesh = triangle_scan_new(3 * triangles, triangles);
    for (uint32_t t = 0; t < triangles; t++) {
        double size = pow(10, -2 + 1.5 * exact_uniform());
        float centre[3] = {exact_between(0, 1), exact_between(0, 1), exact_between(0, 1)};
        for (int i = 0; i < 3; i++) {
            mesh.triangles[t][i] = 3 * t + (uint32_t)i;
            for (int k = 0; k < 3; k++)
                mesh.positions[3 * t + (uint32_t)i][k] = centre[k] + exact_between(-size, size);
        }
    }
    return mesh;
}

struct triangle_scan exact_torus(uint32_t nu, uint32_t nv)
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

struct triangle_scan exact_square(void)
{
    struct triangle_scan mesh = triangle_scan_new(4, 2);
    memcpy(mesh.positions, (float[4][3]){{0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {0, 2, 0}}, 48);
    memcpy(mesh.triangles, (uint32_t[2][3]){{0, 1, 2}, {0, 2, 3}}, 24);
    return mesh;
}

void exact_write_scan(const struct triangle_scan *mesh, uint32_t chunk_triangles)
{
    triangle_scan_write(mesh, (const double[3]){100, 0, -7}, chunk_triangles, exact_scan_path);
}

/* ---- tracing ---- */

void exact_trace(const struct exact_setup *setup, const struct bake_ray *rays, uint64_t count,
                 struct bake_hit *hits)
{
    struct bsq_ctx *ctx = test_context(setup->threads, setup->memory);
    const struct bake_options options = {.scan_normals = setup->normals,
                                         .two_sided = setup->two_sided};
    struct bake_exact *exact;
    assert_int_equal(bake_exact_open(ctx, exact_scan_path, &options, &exact), 0);
    assert_int_equal(bake_exact_use(exact, &options, setup->color ? BAKE_MAP_COLOR : 0), 0);
    assert_int_equal(bake_exact_wants_footprints(exact), setup->footprint != NULL);
    uint32_t *footprints = setup->footprint ? calloc(count, 4) : NULL;
    uint64_t capacity = bake_exact_capacity(exact, 0);
    for (uint64_t at = 0; at < count; at += capacity) {
        struct bake_ray_batch batch = {.rays = rays + at,
                                       .hits = hits + at,
                                       .count = count - at < capacity ? count - at : capacity,
                                       .t_min = setup->t_min,
                                       .t_max = setup->t_max,
                                       .facing_origin = setup->facing_origin,
                                       .reaches = setup->reaches ? setup->reaches + at : NULL,
                                       .from_reach = setup->from_reach,
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

void exact_random_rays(struct bake_ray *rays, uint64_t count, double low, double high)
{
    for (uint64_t r = 0; r < count; r++) {
        for (int k = 0; k < 3; k++)
            rays[r].origin[k] = exact_between(low, high);
        random_direction(rays[r].direction);
        if (r % 16 == 0) /* along an axis */
            for (int k = 0; k < 3; k++)
                rays[r].direction[k] = k == (int)(r / 16 % 3) ? (r % 32 ? 1.0f : -1.0f) : 0.0f;
    }
}

struct bake_hit exact_trace_one(const struct exact_setup *setup, float x, float y, float z,
                                float dz)
{
    struct bake_ray ray = {{x, y, z}, {0, 0, dz}};
    struct bake_hit hit;
    exact_trace(setup, &ray, 1, &hit);
    return hit;
}
