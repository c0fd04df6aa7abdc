/* Tests edge collapse region by region: what one mesh in memory keeps, regions keep, and where they
 * met does not show. */
#include <stdio.h>

#include "libvoxel/simplify/steps.h"
#include "libvoxel/voxel.h"
#include "tests/unit/libvoxel/simplify/torus.h"
#include "tests/unit/test.h"

enum { SIDE = 160, ROWS = 4, REGION = 8000, TARGET = SIDE * SIDE / 4 };

/* A square of side 4, waves in one half. */
static void half_flat(double x, double y, float *p)
{
    p[0] = (float)(4 * x);
    p[1] = (float)(4 * y);
    p[2] = (float)(x < 0.5 ? 0 : 0.05 * sin(20 * PI * x) * sin(20 * PI * y));
}

/* Makes a level of a grid of SIDE x SIDE squares in parts of ROWS rows; its sides meet if `closed`.
 * In parts, vertices of positions that are equal are one. */
static void make_level(struct bsq_ctx *ctx, bool closed, void (*place)(double, double, float *),
                       struct vox_level *level)
{
    const struct vox_level none = {.ctx = ctx, .beside = "x"};
    assert_int_equal(vox_level_begin(&none, SIDE / ROWS, false, level), 0);
    for (unsigned first = 0; first < SIDE; first += ROWS) {
        struct vox_mesh part;
        assert_int_equal(
            vox_mesh_allocate(ctx, (SIDE + 1) * (ROWS + 1), 2 * SIDE * ROWS, false, &part), 0);
        for (unsigned y = 0, i = 0; y <= ROWS; y++)
            for (unsigned x = 0; x <= SIDE; x++)
                place((double)(closed ? x % SIDE : x) / SIDE,
                      (double)(closed ? (first + y) % SIDE : first + y) / SIDE,
                      part.positions[i++]);
        for (unsigned y = 0, t = 0; y < ROWS; y++)
            for (unsigned x = 0; x < SIDE; x++) {
                const uint32_t a = y * (SIDE + 1) + x, d = a + SIDE + 2;
                memcpy(part.triangles[t++], (uint32_t[3]){a, a + 1, d}, sizeof *part.triangles);
                memcpy(part.triangles[t++], (uint32_t[3]){a, d, d - 1}, sizeof *part.triangles);
            }
        assert_int_equal(vox_mesh_weld(ctx, &part), 0);
        assert_int_equal(vox_level_add(level, &part, 1), 0);
        vox_mesh_free(ctx, &part);
    }
}

static int compare_edges(const void *a, const void *b)
{
    return memcmp(a, b, 2 * sizeof(uint32_t));
}

/* Counts edges, those with one triangle, with more than two, and those shorter than `least`. */
static void count_edges(const struct vox_mesh *mesh, double least, unsigned counts[4])
{
    const unsigned count = 3 * mesh->triangle_count;
    uint32_t(*edges)[2] = malloc(count * sizeof *edges);
    assert_non_null(edges);
    for (unsigned i = 0; i < count; i++) {
        const uint32_t *t = mesh->triangles[i / 3], a = t[i % 3], b = t[(i + 1) % 3];
        edges[i][0] = a < b ? a : b;
        edges[i][1] = a < b ? b : a;
    }
    qsort(edges, count, sizeof *edges, compare_edges);
    memset(counts, 0, 4 * sizeof *counts);
    for (unsigned i = 0, same; i < count; i += same) {
        const float *a = mesh->positions[edges[i][0]], *b = mesh->positions[edges[i][1]];
        for (same = 1; i + same < count && compare_edges(edges[i], edges[i + same]) == 0; same++)
            ;
        counts[0]++;
        counts[1] += same == 1;
        counts[2] += same > 2;
        counts[3] +=
            hypot(hypot((double)a[0] - b[0], (double)a[1] - b[1]), (double)a[2] - b[2]) < least;
    }
    free(edges);
}

static double volume_of(const struct vox_mesh *mesh)
{
    double volume = 0;
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const float *a = mesh->positions[mesh->triangles[t][0]];
        double n[3];
        vox_triangle_normal((const float(*)[3])mesh->positions, mesh->triangles[t], n);
        volume += ((double)a[0] * n[0] + (double)a[1] * n[1] + (double)a[2] * n[2]) / 6;
    }
    return volume;
}

/* Makes a level, collapses it in regions, and joins it to a mesh. Returns the status. */
static int collapse(struct bsq_ctx *ctx, bool closed, void (*place)(double, double, float *),
                    struct vox_mesh *mesh)
{
    struct vox_removed removed = {0};
    struct vox_level level;
    make_level(ctx, closed, place, &level);
    assert_int_equal(level.triangles, 2 * SIDE * SIDE);
    int status = vox_collapse_regions(&level, TARGET, REGION, &removed);
    if (status == 0)
        status = vox_level_join(&level, mesh);
    vox_level_free(&level, NULL);
    return status;
}

/* A torus stays one, with its volume. Where regions met in any pass, edges are as long as
 * elsewhere: few are as short as those of the grid. */
CONTEXT_TEST(a_torus_stays_one, 2, 0)
{
    struct vox_mesh mesh = {0};
    unsigned counts[4];
    assert_int_equal(collapse(ctx, true, on_torus, &mesh), 0);
    count_edges(&mesh, 1.2 * 2 * PI / SIDE, counts);
    assert_in_range(mesh.triangle_count, TARGET * 99 / 100, TARGET);
    assert_int_equal(mesh.vertex_count + mesh.triangle_count, counts[0]);
    assert_int_equal(counts[1] + counts[2], 0);
    assert_true(fabs(fabs(volume_of(&mesh)) / (6 * PI * PI) - 1) < 0.005);
    assert_true(counts[3] < counts[0] / 100);
    vox_mesh_free(ctx, &mesh);
}

/* Open borders collapse, too, and triangles go to where the surface needs them. */
CONTEXT_TEST(flat_regions_lose_more, 1, 0)
{
    struct vox_mesh mesh = {0};
    unsigned counts[4], flat = 0;
    assert_int_equal(collapse(ctx, false, half_flat, &mesh), 0);
    count_edges(&mesh, 0, counts);
    assert_int_equal(counts[2], 0);
    assert_in_range(counts[1], 4, SIDE);
    for (uint32_t t = 0; t < mesh.triangle_count; t++)
        flat += mesh.positions[mesh.triangles[t][0]][0] < 2;
    assert_in_range(flat, 2, TARGET / 10);
    vox_mesh_free(ctx, &mesh);
}

/* Results do not depend on threads and budgets. If memory runs out, there is one error, and nothing
 * leaks. */
TEST(bytes_are_the_same_in_little_memory)
{
    struct bsq_ctx *large = test_context(4, 0);
    struct vox_mesh wanted = {0};
    int status = BSQ_ENOMEM;
    assert_int_equal(collapse(large, true, on_torus, &wanted), 0);
    for (uint64_t budget = 2 << 20; status == BSQ_ENOMEM; budget += 400000) {
        struct bsq_ctx *small = test_context(2, budget);
        struct vox_mesh mesh = {0};
        status = collapse(small, true, on_torus, &mesh);
        if (status == 0) {
            assert_int_equal(mesh.triangle_count, wanted.triangle_count);
            assert_memory_equal(mesh.triangles, wanted.triangles,
                                mesh.triangle_count * sizeof *mesh.triangles);
            assert_memory_equal(mesh.positions, wanted.positions,
                                mesh.vertex_count * sizeof *mesh.positions);
        }
        vox_mesh_free(small, &mesh);
        test_context_end(small);
    }
    assert_int_equal(status, 0);
    vox_mesh_free(large, &wanted);
    test_context_end(large);
}

/* Writes the waves of a square of side 4, of n x n squares. */
static void write_waves(const char *path, unsigned n)
{
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    for (unsigned i = 0; i < (n + 1) * (n + 1); i++) {
        float p[3];
        half_flat(i % (n + 1) / (double)n, i / (n + 1) / (double)n, p);
        fprintf(file, "v %.9g %.9g %.9g\n", (double)p[0], (double)p[1], (double)p[2]);
    }
    for (unsigned i = 0; i < n * n; i++) {
        const unsigned a = i / n * (n + 1) + i % n + 1;
        fprintf(file, "f %u %u %u %u\n", a, a + 1, a + n + 2, a + n + 1);
    }
    assert_int_equal(fclose(file), 0);
}

static void check_near(double value, double wanted, double share)
{
    assert_true(fabs(value - wanted) <= share * wanted);
}

static struct fmt_tris_file *sort_waves(struct bsq_ctx *ctx)
{
    const char *path = "waves.obj";
    struct vox_sort_options options;
    struct vox_sort_report report = {.size = sizeof report};
    struct fmt_tris_file *file;
    write_waves(path, 400);
    vox_sort_defaults(&options);
    options.scan_paths = &path;
    options.scan_count = 1;
    options.tris_path = "waves.tris";
    assert_int_equal(vox_sort(ctx, &options, &report), 0);
    assert_int_equal(fmt_tris_open(ctx, "waves.tris", &file), 0);
    assert_true(fmt_tris_get_header(file)->chunk_count > 4);
    return file;
}

/* Region by region, distances are those of a mesh that is measured at once, also of boxes. */
CONTEXT_TEST(regions_are_measured_as_the_whole, 2, 0)
{
    struct fmt_tris_file *file = sort_waves(ctx);
    struct vox_mesh mesh = {0};
    struct vox_distances there[2], back[2];
    struct vox_measured_box boxes[2][2];
    assert_int_equal(collapse(ctx, false, half_flat, &mesh), 0);
    for (int i = 0; i < 2; i++) {
        for (int k = 0; k < 2; k++)
            boxes[i][k] =
                (struct vox_measured_box){.low = {k ? 3 : -INFINITY, -INFINITY, -INFINITY},
                                          .high = {k ? INFINITY : 3, INFINITY, INFINITY}};
        assert_int_equal(vox_measure(ctx, file, &mesh, NULL, boxes[i], 2, i ? 1000 : TARGET,
                                     &there[i], &back[i]),
                         0);
    }
    check_near(there[1].mean, there[0].mean, 0.01);
    check_near(there[1].rms, there[0].rms, 0.01);
    check_near(there[1].max, there[0].max, 0.011);
    check_near(back[1].mean, back[0].mean, 0.05);
    check_near(back[1].max, back[0].max, 0.011);
    for (int k = 0; k < 2; k++) {
        check_near(boxes[1][k].from_scan.mean, boxes[0][k].from_scan.mean, 0.01);
        check_near(boxes[1][k].from_scan.max, boxes[0][k].from_scan.max, 0.011);
        check_near(boxes[1][k].from_mesh.mean, boxes[0][k].from_mesh.mean, 0.05);
        check_near(boxes[1][k].from_mesh.max, boxes[0][k].from_mesh.max, 0.03);
    }
    vox_mesh_free(ctx, &mesh);
    fmt_tris_close(file);
}

/* Regions of the scan where the mesh has nothing count, too. */
CONTEXT_TEST(regions_far_from_the_mesh_are_measured, 2, 0)
{
    struct fmt_tris_file *file = sort_waves(ctx);
    struct vox_mesh mesh = {0};
    struct vox_distances there[2], back[2];
    uint32_t count = 0;
    assert_int_equal(collapse(ctx, false, half_flat, &mesh), 0);
    for (uint32_t t = 0; t < mesh.triangle_count; t++)
        if (mesh.positions[mesh.triangles[t][0]][0] > 3.5F)
            vox_mesh_move_triangle(&mesh, count++, t);
    mesh.triangle_count = count;
    for (int i = 0; i < 2; i++)
        assert_int_equal(vox_measure(ctx, file, &mesh, NULL, NULL, 0, i ? count / 10 : count,
                                     &there[i], &back[i]),
                         0);
    check_near(there[0].max, 3.5, 0.02);
    assert_true(there[1].max >= 0.989 * there[0].max && there[1].max <= 1.05 * there[0].max);
    check_near(there[1].mean, there[0].mean, 0.05);
    check_near(back[1].max, back[0].max, 0.011);
    vox_mesh_free(ctx, &mesh);
    fmt_tris_close(file);
}

RUN_TESTS(NULL, NULL)
