/* test_exact_reference.c - hits against brute force, and at edges and vertices. */
#include "tests/unit/libbake/exact/exact_fixture.h"
#include "tests/unit/test.h"

/* ---- brute force ---- */

struct candidate {
    double t, least; /* least: smallest barycentric weight */
    bool along;
};

/* Intersects the line of a ray with a triangle (Moller & Trumbore, 1997). */
static struct candidate meet(const struct triangle_scan *mesh, uint32_t triangle,
                             const struct bake_ray *ray)
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

/* Checks a hit of a ray that starts at `reach`: hits below it are passed one after another, and
 * those above it as if the ray came from -reach back to +reach first. */
static void check_by_force(const struct triangle_scan *mesh, const struct exact_setup *setup,
                           const struct bake_ray *ray, double reach, const struct bake_hit *hit)
{
    const double slack = 1e-9, t_max = setup->from_reach ? reach : setup->t_max;
    double nearest = INFINITY; /* of the triangles that are hit for certain */
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        struct candidate c = meet(mesh, t, ray);
        if (c.least > slack && c.t > setup->t_min + slack && c.t < t_max - slack &&
            (setup->two_sided || c.along != setup->facing_origin))
            nearest = fmin(nearest, c.t < reach ? reach - c.t : c.t + reach);
    }
    if (hit->triangle == BAKE_NO_HIT) {
        assert_true(isinf(nearest));
        return;
    }
    struct candidate c = meet(mesh, (uint32_t)hit->triangle, ray);
    assert_true((hit->t <= reach ? reach - hit->t : hit->t + reach) <= nearest + slack);
    assert_true(fabs(hit->t - c.t) < slack);
    assert_true(c.least > -slack);
    assert_true(hit->t >= setup->t_min && hit->t <= t_max);
    assert_true(setup->two_sided || c.along != setup->facing_origin);
}

/* Rays of a bundle share the list of leaves; scattered ones walk the tree alone. */
TEST(test_neighbours_hit_what_they_hit_alone)
{
    enum { SIDE = 64, RAYS = SIDE * SIDE, STEP = 1013 };
    static struct bake_ray rays[RAYS], scattered[RAYS];
    static struct bake_hit hits[RAYS], others[RAYS];
    struct triangle_scan mesh = exact_torus(300, 150);
    uint32_t found = 0;
    exact_write_scan(&mesh, 40000);
    for (uint32_t i = 0; i < RAYS; i++) {
        const float u = (float)(i % SIDE) / SIDE, v = (float)(i / SIDE) / SIDE;
        const float from[3] = {0.9f + 0.2f * u, 0.1f * v - 0.05f, 0.3f + 0.2f * v};
        rays[i] = (struct bake_ray){.origin = {from[0], from[1], from[2]}};
        exact_toward(from, (double[3]){1.0 + (double)u, 0.3 * (double)v, 1}, rays[i].direction);
    }
    for (uint32_t i = 0; i < RAYS; i++)
        scattered[i] = rays[(uint64_t)i * STEP % RAYS];
    const struct exact_setup setup = {.threads = 2, .t_min = -0.7, .t_max = 0.7};
    exact_trace(&setup, rays, RAYS, hits);
    exact_trace(&setup, scattered, RAYS, others);
    for (uint32_t i = 0; i < RAYS; i++) {
        const struct bake_hit *hit = &hits[(uint64_t)i * STEP % RAYS];
        found += hit->triangle != BAKE_NO_HIT;
        assert_true(hit->triangle == others[i].triangle);
        assert_true(hit->t == others[i].t);
        if (i % 16 == 0)
            check_by_force(&mesh, &setup, &scattered[i], 0, &others[i]);
    }
    assert_true(found > RAYS / 2);
    triangle_scan_free(&mesh);
}

TEST(test_soup_agrees_with_brute_force)
{
    enum { RAYS = 6000 };
    static struct bake_ray rays[RAYS];
    static struct bake_hit hits[RAYS];
    static float reaches[RAYS];
    struct triangle_scan mesh = exact_soup(2000);
    exact_write_scan(&mesh, 97);
    for (uint32_t r = 0; r < RAYS; r++)
        reaches[r] = 0.05f * (float)(r % 8);
    for (int variant = 0; variant < 6; variant++) {
        struct exact_setup setup = {.threads = 2,
                                    .two_sided = variant == 1,
                                    .facing_origin = variant == 2,
                                    .reaches = variant >= 4 ? reaches : NULL,
                                    .from_reach = variant == 5,
                                    .t_min = variant == 3 ? 0.05 : -0.3,
                                    .t_max = 0.4};
        uint64_t found = 0;
        exact_random_rays(rays, RAYS, -0.2, 1.2);
        exact_trace(&setup, rays, RAYS, hits);
        for (uint32_t r = 0; r < RAYS; r++) {
            check_by_force(&mesh, &setup, &rays[r], setup.reaches ? (double)reaches[r] : 0,
                           &hits[r]);
            found += hits[r].triangle != BAKE_NO_HIT;
        }
        assert_in_range(found, RAYS / 10, RAYS);
    }
    triangle_scan_free(&mesh);
}

/* ---- watertightness ---- */

/* From inside the closed torus every ray must hit, also through vertices and points of edges. */
TEST(test_no_ray_slips_through_edges_and_vertices)
{
    enum { RAYS = 1 << 20 };
    struct bake_ray *rays = calloc(RAYS, sizeof *rays);
    struct bake_hit *hits = calloc(RAYS, sizeof *hits);
    struct triangle_scan mesh = exact_torus(120, 90);
    struct exact_setup setup = {
        .threads = 2, .normals = BSQ_SCAN_NORMALS_FLAT, .two_sided = true, .t_max = 0.7};
    exact_write_scan(&mesh, 50);
    for (uint32_t r = 0; r < RAYS; r++) {
        const uint32_t triangle = (uint32_t)((uint64_t)r * mesh.triangle_count / RAYS);
        const uint32_t *v = mesh.triangles[triangle];
        const float *a = mesh.positions[v[r % 3]], *b = mesh.positions[v[(r + 1) % 3]];
        const double w = r % 2 ? 0 : exact_uniform();
        const double around = atan2((double)a[1], (double)a[0]) + 0.3 * exact_uniform() - 0.15;
        double to[3];
        for (int k = 0; k < 3; k++)
            to[k] = (double)a[k] + w * ((double)b[k] - (double)a[k]);
        rays[r].origin[0] = (float)cos(around);
        rays[r].origin[1] = (float)sin(around);
        exact_toward(rays[r].origin, to, rays[r].direction);
    }
    exact_trace(&setup, rays, RAYS, hits);
    for (uint32_t r = 0; r < RAYS; r++)
        if (hits[r].triangle == BAKE_NO_HIT)
            fail_msg("ray %u slipped through", r);
    free(rays);
    free(hits);
    triangle_scan_free(&mesh);
}

/* Rays through the vertices and edges of a flat grid, without rounding. */
TEST(test_rays_that_meet_edges_exactly_hit)
{
    enum { SIDE = 64, STEPS = 4 * SIDE + 1, RAYS = STEPS * STEPS };
    static struct bake_ray rays[RAYS];
    static struct bake_hit hits[RAYS];
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
    exact_write_scan(&mesh, 37);
    for (int axis = 0; axis < 3; axis++) {
        struct exact_setup setup = {.threads = 2, .two_sided = true, .t_min = -1, .t_max = 1};
        for (uint32_t r = 0; r < RAYS; r++) {
            float tilt[3] = {0, 0, -1};
            tilt[axis % 2] = axis < 2 ? 0.5f : 0.0f;
            rays[r].origin[0] = 0.25f * (float)(r % STEPS);
            rays[r].origin[1] = 0.25f * (float)(r / STEPS);
            rays[r].origin[2] = 0.0f;
            memcpy(rays[r].direction, tilt, sizeof tilt);
        }
        exact_trace(&setup, rays, RAYS, hits);
        for (uint32_t r = 0; r < RAYS; r++) {
            assert_true(hits[r].triangle != BAKE_NO_HIT);
            assert_true(hits[r].t == 0.0);
            assert_true(hits[r].normal[2] == -1.0f); /* the rays meet the square's back */
        }
    }
    triangle_scan_free(&mesh);
}

int main(void)
{
    print_message("seed %llu\n", (unsigned long long)exact_seed);
    return test_run(NULL, NULL);
}
