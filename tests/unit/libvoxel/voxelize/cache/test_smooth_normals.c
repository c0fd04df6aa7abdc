/* Tests that smooth vertex normals do not depend on the division into chunks. */
#include "base/smooth_normals.h"
#include "libvoxel/voxelize/cache/chunk_content.h"
#include "tests/unit/libvoxel/scan_fixture.h"
#include "tests/unit/test.h"

enum { CHUNK_TRIANGLES = 200, CHUNKS_MAX = 64 };

/* A decoded chunk, and what a cache keeps with it. */
struct decoded {
    struct fmt_tris_chunk chunk;
    void *memory;
    struct vox_box *triangle_groups, *vertex_groups;
};

struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_tris_file *file;
    struct vox_transform transform;
    struct vox_smooth *smooth;
    struct scan_mesh mesh;
    uint32_t chunk_count, lent;
    bool lends;
    enum bsq_scan_normals weights;
    struct decoded chunks[CHUNKS_MAX];
};

/* ---- chunks ---- */

static void decode(struct fixture *f, uint32_t index)
{
    struct decoded *d = &f->chunks[index];
    d->memory = malloc(fmt_tris_load_size(f->file, index));
    assert_int_equal(fmt_tris_load(f->file, index, d->memory, &d->chunk), 0);
    d->triangle_groups = calloc(vox_group_count(d->chunk.triangle_count, VOX_GROUP_TRIANGLES),
                                sizeof *d->triangle_groups);
    d->vertex_groups = calloc(vox_group_count(d->chunk.vertex_count, VOX_GROUP_VERTICES),
                              sizeof *d->vertex_groups);
    vox_triangle_groups(&d->chunk, &f->transform, d->triangle_groups);
    vox_vertex_groups(&d->chunk, &f->transform, d->vertex_groups);
}

static int lend(void *arg, uint32_t index, struct vox_loan *out)
{
    struct fixture *f = arg;
    const struct decoded *d = &f->chunks[index];
    *out = f->lends ? (struct vox_loan){&d->chunk, d->triangle_groups, d->vertex_groups}
                    : (struct vox_loan){.chunk = NULL};
    f->lent += f->lends;
    return 0;
}

static void take_back(void *arg, uint32_t index)
{
    struct fixture *f = arg;
    (void)index;
    f->lent--;
}

/* Writes the fixture's mesh in chunks of up to chunk_triangles, and reads all of them. */
static void begin(struct fixture *f, uint32_t chunk_triangles)
{
    f->ctx = test_context(1, 64 << 20);
    scan_write(f->ctx, "scan.tris", &f->mesh, (double[3]){0, 0, 0}, NULL, 0, chunk_triangles);
    assert_int_equal(fmt_tris_open(f->ctx, "scan.tris", &f->file), 0);
    const struct fmt_tris_header *header = fmt_tris_get_header(f->file);
    f->chunk_count = (uint32_t)header->chunk_count;
    assert_true(f->chunk_count > 1 && f->chunk_count <= CHUNKS_MAX);
    assert_int_equal(vox_transform_init(f->ctx, header, "scan.tris", 100, 0.0, &f->transform), 0);
    assert_int_equal(vox_smooth_create(f->ctx, f->file, f->weights, 1, 1 << 20, &f->smooth), 0);
    for (uint32_t i = 0; i < f->chunk_count; i++)
        decode(f, i);
}

static void end(struct fixture *f)
{
    for (uint32_t i = 0; i < f->chunk_count; i++) {
        free(f->chunks[i].memory);
        free(f->chunks[i].triangle_groups);
        free(f->chunks[i].vertex_groups);
    }
    vox_smooth_destroy(f->smooth);
    fmt_tris_close(f->file);
    bsq_ctx_destroy(f->ctx);
    unlink("scan.tris");
    scan_mesh_free(&f->mesh);
}

/* ---- what is expected ---- */

static bool same_place(const float a[3], const float b[3])
{
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

/* Returns the weight of a triangle of twice this area at corner i. */
static double expected_weight(const float *const p[3], int i, double area,
                              enum bsq_scan_normals weights)
{
    double a = 0.0, b = 0.0, dot = 0.0;
    for (int k = 0; k < 3; k++) {
        const double next = (double)p[(i + 1) % 3][k] - p[i][k];
        const double previous = (double)p[(i + 2) % 3][k] - p[i][k];
        a += next * next;
        b += previous * previous;
        dot += next * previous;
    }
    if (area == 0.0 || weights == BSQ_SCAN_NORMALS_AREA)
        return area;
    return weights == BSQ_SCAN_NORMALS_ANGLE ? atan2(area, dot) : area / (a * b);
}

/* Computes the normal as smooth_normals.h defines it, over all triangles of the mesh with a corner
 * at this position. */
static void expected_normal(const struct scan_mesh *mesh, enum bsq_scan_normals weights,
                            const float at[3], double normal[3])
{
    double sum[3] = {0}, total = 0.0;
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const float *p[3];
        double n[3], area;
        for (int i = 0; i < 3; i++)
            p[i] = mesh->positions[mesh->triangles[t][i]];
        for (int a = 0; a < 3; a++) {
            int b = (a + 1) % 3, c = (a + 2) % 3;
            n[a] = ((double)p[1][b] - p[0][b]) * ((double)p[2][c] - p[0][c]) -
                   ((double)p[1][c] - p[0][c]) * ((double)p[2][b] - p[0][b]);
        }
        area = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (int i = 0; i < 3; i++) {
            const double weight = expected_weight(p, i, area, weights);
            if (!same_place(p[i], at))
                continue;
            for (int a = 0; a < 3 && area > 0.0; a++)
                sum[a] += weight * n[a] / area;
            total += weight;
        }
    }
    double length = sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
    for (int a = 0; a < 3; a++)
        normal[a] = length >= BSQ_CREASE_SHARE * total && length > 0 ? sum[a] / length : 0.0;
}

/* Checks the normals of all chunks, with neighbours lent and with neighbours read. */
static void check(struct fixture *f)
{
    const struct vox_smooth_lender lender = {f, lend, take_back};
    for (uint32_t i = 0; i < f->chunk_count; i++) {
        const struct fmt_tris_chunk *chunk = &f->chunks[i].chunk;
        const size_t bytes = chunk->vertex_count * sizeof(float[4]);
        float(*normals)[4] = malloc(bytes), (*read)[4] = malloc(bytes);
        f->lends = true;
        const struct vox_smooth_chunk smooth = {.index = i, .decoded = {.chunk = chunk}};
        assert_int_equal(vox_smooth_normals(f->smooth, &lender, &smooth, &f->transform, normals),
                         0);
        assert_int_equal(f->lent, 0);
        f->lends = false;
        assert_int_equal(vox_smooth_normals(f->smooth, &lender, &smooth, &f->transform, read), 0);
        assert_memory_equal(normals, read, bytes);
        for (uint32_t v = 0; v < chunk->vertex_count; v++) {
            double expected[3];
            expected_normal(&f->mesh, f->weights, chunk->positions[v], expected);
            for (int a = 0; a < 3; a++)
                assert_true(fabs((double)normals[v][a] - expected[a]) < 1e-6);
        }
        free(normals);
        free(read);
    }
}

/* ---- tests ---- */

/* Octants have their own vertices at their borders, and so do chunks. */
TEST(test_sphere)
{
    for (unsigned w = BSQ_SCAN_NORMALS_AREA; w < BSQ_SCAN_NORMALS_FLAT; w++) {
        struct fixture f = {.mesh = scan_sphere(1.0, 0.1), .weights = (enum bsq_scan_normals)w};
        scan_sort(&f.mesh);
        begin(&f, CHUNK_TRIANGLES);
        check(&f);
        end(&f);
    }
}

/* Unordered triangles touch in vertices, lie in creases and stretch across all chunks. */
TEST(test_soup)
{
    enum { VERTICES = 60, TRIANGLES = 700 };
    uint64_t seed = 11;
    print_message("seed %llu\n", (unsigned long long)seed);
    struct fixture f = {.mesh = scan_mesh_new(2 * VERTICES, TRIANGLES)};
    for (uint32_t v = 0; v < VERTICES; v++) {
        const double x = scan_random(&seed), y = scan_random(&seed), z = 0.1 * scan_random(&seed);
        scan_set_vertex(&f.mesh, v, x, y, z);
        scan_set_vertex(&f.mesh, VERTICES + v, x, y, z);
    }
    for (uint32_t t = 0; t < TRIANGLES; t++) {
        uint32_t v[3];
        for (int i = 0; i < 3; i++)
            v[i] = (uint32_t)(scan_random(&seed) * 2 * VERTICES);
        scan_set_triangle(&f.mesh, t, v[0], v[1], v[2]);
    }
    begin(&f, 97);
    check(&f);
    end(&f);
}

/* Puts a fan around vertex `apex`, with its rim at a height above or below the apex. */
static void put_fan(struct scan_mesh *mesh, uint32_t apex, uint32_t first_triangle, uint32_t count,
                    const double at[3], double height)
{
    scan_set_vertex(mesh, apex, at[0], at[1], at[2]);
    for (uint32_t i = 0; i < count; i++) {
        double angle = 2.0 * 3.14159265358979 * i / count;
        scan_set_vertex(mesh, apex + 1 + i, at[0] + cos(angle), at[1] + sin(angle), at[2] + height);
        scan_set_triangle(mesh, first_triangle + i, apex, apex + 1 + i, apex + 1 + (i + 1) % count);
    }
}

/* Each fan is closed and in its own chunk, so no edge shows that there is another one. One is
 * tilted. */
TEST(test_two_closed_fans_with_one_apex)
{
    enum { CORNERS = 100 };
    const double at[3] = {2.0, 3.0, 0.5};
    double alone[3], both[3];
    struct fixture f = {.mesh = scan_mesh_new(2 * (CORNERS + 1), CORNERS)};
    put_fan(&f.mesh, 0, 0, CORNERS, at, -0.3);
    expected_normal(&f.mesh, f.weights, f.mesh.positions[0], alone);
    f.mesh.triangles = realloc(f.mesh.triangles, 2 * CORNERS * sizeof *f.mesh.triangles);
    f.mesh.triangle_count = 2 * CORNERS;
    put_fan(&f.mesh, CORNERS + 1, CORNERS, CORNERS, at, -0.1);
    for (uint32_t i = CORNERS + 2; i < 2 * (CORNERS + 1); i++)
        f.mesh.positions[i][2] += 0.3f * (f.mesh.positions[i][0] - (float)at[0]);
    expected_normal(&f.mesh, f.weights, f.mesh.positions[0], both);
    assert_true(fabs(alone[0] - both[0]) > 0.01);
    begin(&f, CORNERS);
    assert_int_equal(f.chunk_count, 2);
    check(&f);
    end(&f);
}

/* A triangle repeated in another chunk counts twice at its corners, even inside a surface. */
TEST(test_repeated_triangle)
{
    struct fixture f = {.mesh = scan_sphere(1.0, 0.2)};
    const uint32_t count = f.mesh.triangle_count;
    double once[3], twice[3];
    scan_sort(&f.mesh);
    const float *corner = f.mesh.positions[f.mesh.triangles[count / 2][0]];
    expected_normal(&f.mesh, f.weights, corner, once);
    f.mesh.triangles = realloc(f.mesh.triangles, (count + 1) * sizeof *f.mesh.triangles);
    memcpy(f.mesh.triangles[count], f.mesh.triangles[count / 2], sizeof *f.mesh.triangles);
    f.mesh.triangle_count = count + 1;
    expected_normal(&f.mesh, f.weights, corner, twice);
    assert_true(fabs(once[0] - twice[0]) + fabs(once[1] - twice[1]) + fabs(once[2] - twice[2]) >
                1e-3);
    begin(&f, CHUNK_TRIANGLES);
    check(&f);
    end(&f);
}

/* Two quads meet in an edge at x = 0, which one of them stores as -0; in one chunk and in two. */
TEST(test_both_zeros_are_one_place)
{
    for (uint32_t chunk_triangles = 2; chunk_triangles <= 4; chunk_triangles += 2) {
        struct fixture f = {.mesh = scan_mesh_new(12, 6)};
        scan_set_quad(&f.mesh, 0, (double[3]){0.0, 0.0, 0.0}, (double[3]){1.0, 0.0, 0.2},
                      (double[3]){0.0, 1.0, 0.0});
        scan_set_quad(&f.mesh, 1, (double[3]){-1.0, 0.0, 0.0}, (double[3]){1.0, 0.0, 0.0},
                      (double[3]){0.0, 1.0, 0.0});
        scan_set_quad(&f.mesh, 2, (double[3]){5.0, 5.0, 5.0}, (double[3]){1.0, 0.0, 0.0},
                      (double[3]){0.0, 1.0, 0.0});
        f.mesh.positions[5][0] = f.mesh.positions[6][0] = -0.0f;
        double normal[3];
        expected_normal(&f.mesh, f.weights, f.mesh.positions[5], normal);
        assert_true(normal[0] < -0.05 && normal[0] > -0.15);
        begin(&f, chunk_triangles);
        check(&f);
        end(&f);
    }
}

RUN_TESTS(NULL, NULL)
