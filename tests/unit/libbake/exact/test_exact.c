/* test_exact.c - which hit wins, for any chunks, threads and budgets; damaged scans. */
#include "base/geometry/vec.h"
#include "libbake/exact/exact_tree.h"
#include "tests/unit/test.h"
#include "tests/unit/libbake/exact/exact_fixture.h"

/* ---- the curve ---- */

/* Each cell of a cube has a place of its own, and neighbours on the curve are neighbours in space.
 */
TEST(test_curve_goes_from_neighbour_to_neighbour)
{
    enum { CELLS = 16, ALL = CELLS * CELLS * CELLS };
    static int cell_at[ALL];
    static const float low[3] = {-2, 5, 0};
    memset(cell_at, 0xff, sizeof cell_at);
    for (int c = 0; c < ALL; c++) {
        const int cell[3] = {c % CELLS, c / CELLS % CELLS, c / CELLS / CELLS};
        float point[3];
        for (int k = 0; k < 3; k++)
            point[k] = low[k] + 3 * ((float)cell[k] + 0.5f) / CELLS;
        const uint64_t place = bake_exact_curve_index(point, low, 3) >> (33 - 12);
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

/* ---- independence ---- */

TEST(test_hits_do_not_depend_on_chunks_threads_or_budget)
{
    enum { RAYS = 60000 };
    static const struct {
        uint32_t chunk;
        unsigned threads;
        uint64_t memory;
    } cases[] = {{60000, 1, 0},      {60000, 4, 6 << 20}, {5000, 3, 0},
                 {1000, 2, 2 << 20}, {333, 5, 3 << 20},   {20, 2, 0}};
    struct bake_ray *rays = calloc(RAYS, sizeof *rays);
    struct bake_hit *first = calloc(RAYS, sizeof *first), *hits = calloc(RAYS, sizeof *hits);
    struct triangle_scan mesh = exact_torus(150, 100);
    mesh.attributes = FMT_TRIS_COLORS;
    for (uint32_t v = 0; v < mesh.vertex_count; v++)
        mesh.colors[v] = (uint32_t)(exact_uniform() * 4294967295.0);
    exact_random_rays(rays, RAYS, -1.5, 1.5);
    for (uint32_t r = 0; r < RAYS / 2;
         r++) { /* half of them through vertices, where several triangles are hit at the same t */
        const float *p = mesh.positions[(uint32_t)(exact_uniform() * mesh.vertex_count)];
        double to[3] = {(double)p[0], (double)p[1], (double)p[2]};
        exact_toward(rays[r].origin, to, rays[r].direction);
    }
    for (unsigned c = 0; c < sizeof cases / sizeof *cases; c++) {
        struct exact_setup setup = {.threads = cases[c].threads,
                                    .memory = cases[c].memory,
                                    .color = true,
                                    .t_min = -0.8,
                                    .t_max = 1.1};
        exact_write_scan(&mesh, cases[c].chunk);
        exact_trace(&setup, rays, RAYS, c == 0 ? first : hits);
        if (c > 0)
            assert_memory_equal(hits, first, RAYS * sizeof *hits);
    }
    free(rays);
    free(first);
    free(hits);
    triangle_scan_free(&mesh);
}

/* ---- which hit wins ---- */

TEST(test_facing)
{
    struct triangle_scan mesh = exact_square();
    struct exact_setup setup = {.threads = 1, .t_min = -1, .t_max = 1};
    exact_write_scan(&mesh, 1);
    /* Rays of a low-poly mesh below go upwards and hit the square from its back. */
    struct bake_hit hit = exact_trace_one(&setup, 1.5f, 0.5f, -0.5f, 1);
    assert_int_equal(hit.triangle, 0);
    assert_true(hit.t == 0.5 && hit.normal[2] == 1.0f);
    hit = exact_trace_one(&setup, 1.5f, 0.5f, -0.5f, -1);
    assert_true(hit.triangle == BAKE_NO_HIT);
    setup.facing_origin = true; /* as from a camera above */
    hit = exact_trace_one(&setup, 0.5f, 1.5f, 0.75f, -1);
    assert_int_equal(hit.triangle, 1);
    assert_true(hit.t == 0.75);
    hit = exact_trace_one(&setup, 0.5f, 1.5f, -0.75f, 1);
    assert_true(hit.triangle == BAKE_NO_HIT);
    setup.two_sided = true;
    hit = exact_trace_one(&setup, 0.5f, 1.5f, -0.75f, 1);
    assert_true(hit.t == 0.75 && hit.normal[2] == -1.0f); /* a back shows its normal turned */
    hit = exact_trace_one(&setup, 0.5f, 1.5f, -1.25f, 1);
    assert_true(hit.triangle == BAKE_NO_HIT);
    triangle_scan_free(&mesh);
}

/* Vertex normals say which side is outside, whatever the winding. */
TEST(test_normals_decide_on_the_outside)
{
    struct triangle_scan mesh = exact_square();
    struct exact_setup setup = {.threads = 1, .t_min = -1, .t_max = 1};
    mesh.attributes = FMT_TRIS_NORMALS;
    for (int v = 0; v < 4; v++)
        mesh.normals[v] = bsq_oct_pack(bsq_v3(0, 0, -1));
    exact_write_scan(&mesh, 2);
    assert_true(exact_trace_one(&setup, 1.5f, 0.5f, -0.5f, 1).triangle == BAKE_NO_HIT);
    struct bake_hit hit = exact_trace_one(&setup, 1.5f, 0.5f, -0.5f, -1);
    assert_true(hit.t == -0.5);
    assert_true(hit.normal[2] == -1.0f);
    triangle_scan_free(&mesh);
}

/* Of two sheets at the same distance, the one in front wins; of two at the same place, the first in
 * the file. */
TEST(test_ties)
{
    struct triangle_scan mesh = triangle_scan_new(9, 3);
    for (uint32_t v = 0; v < 9; v++) {
        mesh.positions[v][0] = v % 3 == 1 ? 4.0f : 0.0f;
        mesh.positions[v][1] = v % 3 == 2 ? 4.0f : 0.0f;
        mesh.positions[v][2] = v < 3 ? -1.0f : 1.0f;
        mesh.triangles[v / 3][v % 3] = v;
    }
    struct exact_setup setup = {.threads = 2, .t_min = -2, .t_max = 2};
    for (uint32_t chunk = 1; chunk <= 3; chunk++) {
        exact_write_scan(&mesh, chunk);
        struct bake_hit hit = exact_trace_one(&setup, 1, 1, 0, 1);
        assert_true(hit.t == 1.0);
        assert_int_equal(hit.triangle, 1);
    }
    triangle_scan_free(&mesh);
}

TEST(test_rays_without_direction_hit_nothing)
{
    struct triangle_scan mesh = exact_square();
    struct exact_setup setup = {.threads = 1, .two_sided = true, .t_min = -1, .t_max = 1};
    exact_write_scan(&mesh, 1);
    assert_true(exact_trace_one(&setup, 1, 1, 0, 0).triangle == BAKE_NO_HIT);
    assert_true(exact_trace_one(&setup, NAN, 1, 0, 1).triangle == BAKE_NO_HIT);
    assert_true(exact_trace_one(&setup, INFINITY, 1, 0, 1).triangle == BAKE_NO_HIT);
    assert_true(exact_trace_one(&setup, 1, 1, 0, NAN).triangle == BAKE_NO_HIT);
    assert_true(exact_trace_one(&setup, 1, 1, 0.5f, 1).t == -0.5);
    triangle_scan_free(&mesh);
}

/* Rays are traced by bundles. What else is in a bundle, and where one ends, changes no hit. */
TEST(test_bundles_with_gaps)
{
    enum { RAYS = 501, GAPS = 3 * RAYS };
    struct triangle_scan mesh = exact_torus(60, 40);
    struct exact_setup setup = {.threads = 2, .t_min = -0.3, .t_max = 0.4};
    struct bake_ray *rays = calloc(RAYS, sizeof *rays), *gaps = calloc(GAPS, sizeof *gaps);
    struct bake_hit *hits = calloc(RAYS, sizeof *hits), *others = calloc(GAPS, sizeof *hits);
    uint32_t found = 0;
    exact_random_rays(rays, RAYS, -1.2, 1.2);
    for (uint32_t r = 0; r < RAYS; r++)
        gaps[3 * r + 1] = rays[r];
    exact_write_scan(&mesh, 300);
    exact_trace(&setup, rays, RAYS, hits);
    exact_trace(&setup, gaps, GAPS, others);
    for (uint32_t r = 0; r < RAYS; r++) {
        found += hits[r].triangle != BAKE_NO_HIT;
        assert_memory_equal(&others[3 * r + 1], &hits[r], sizeof *hits);
        assert_true(others[3 * r].triangle == BAKE_NO_HIT);
        assert_true(others[3 * r + 2].triangle == BAKE_NO_HIT);
    }
    assert_true(found > 20);
    free(rays);
    free(gaps);
    free(hits);
    free(others);
    triangle_scan_free(&mesh);
}

/* ---- failures ---- */

TEST(test_damaged_chunk_is_reported)
{
    struct triangle_scan mesh = exact_torus(20, 20);
    exact_write_scan(&mesh, 100);
    FILE *file = fopen(exact_scan_path, "r+b");
    assert_non_null(file);
    assert_int_equal(fseek(file, 3000, SEEK_SET), 0);
    int byte = fgetc(file);
    fseek(file, 3000, SEEK_SET);
    fputc(byte ^ 0x55, file);
    fclose(file);
    struct bsq_ctx *ctx = test_context(2, 0);
    const struct bake_options options = {0};
    struct bake_exact *exact;
    struct bake_ray rays[400];
    struct bake_hit hits[400];
    exact_random_rays(rays, 400, -1, 1);
    assert_int_equal(bake_exact_open(ctx, exact_scan_path, &options, &exact), 0);
    struct bake_ray_batch batch = {
        .rays = rays, .hits = hits, .count = 400, .t_min = -3, .t_max = 3};
    assert_int_equal(bake_exact_trace(exact, &batch), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(ctx), "checksum"));
    bake_exact_close(exact);
    test_context_end(ctx);
    triangle_scan_free(&mesh);
}

int main(void)
{
    print_message("seed %llu\n", (unsigned long long)exact_seed);
    return test_run(NULL, NULL);
}
