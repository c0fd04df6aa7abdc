/* Tests that the vertex normals of a chunk file do not depend on chunks, threads and memory. */
#include "libvoxel/voxel.h"
#include "formats/chunks/tris.h"
#include "base/geometry/positions.h"
#include "base/geometry/smooth_normals.h"
#include "base/geometry/vertex_normal.h"
#include "tests/unit/libvoxel/scan_fixture.h"
#include "tests/unit/test.h"

enum { CHUNK_TRIANGLES = 200, CHUNKS_MAX = 64 };

/* A chunk and its normals. */
struct decoded {
    struct fmt_tris_chunk chunk;
    struct fmt_tris_normals normals;
    void *memory, *normals_memory;
};

struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_tris_file *file;
    struct scan_mesh mesh;
    uint32_t chunk_count;
    enum bsq_scan_normals weights; /* AUTO: by area */
    struct decoded chunks[CHUNKS_MAX];
};

static enum bsq_scan_normals weights_of(const struct fixture *f)
{
    return f->weights == BSQ_SCAN_NORMALS_AUTO ? BSQ_SCAN_NORMALS_AREA : f->weights;
}

/* ---- chunks ---- */

/* Writes scan.tris again with normals by these weights, and opens that. */
static void make_normals(struct bsq_ctx *ctx, enum bsq_scan_normals weights,
                         struct fmt_tris_file **file)
{
    static const char *const path = "scan.tris";
    struct vox_sort_report report = {.size = sizeof report};
    const struct vox_join_options options = {.size = sizeof options,
                                             .tris_paths = &path,
                                             .tris_count = 1,
                                             .output_path = "made.tris",
                                             .scan_normals = weights};
    int status = vox_join(ctx, &options, &report);
    if (status == 0)
        status = fmt_tris_open(ctx, "made.tris", file);
    if (status < 0)
        print_message("%s\n", bsq_error(ctx));
    assert_int_equal(status, 0);
    unlink("made.tris");
}

static void decode(struct fixture *f, uint32_t index)
{
    struct decoded *d = &f->chunks[index];
    d->memory = malloc(fmt_tris_load_size(f->file, index));
    d->normals_memory = malloc(fmt_tris_normals_size_max(f->file));
    assert_int_equal(fmt_tris_load(f->file, index, d->memory, &d->chunk), 0);
    assert_int_equal(fmt_tris_load_normals(f->file, index, d->normals_memory, &d->normals), 0);
}

/* Writes the fixture's mesh in chunks of up to chunk_triangles, and reads all of them. */
static void begin(struct fixture *f, uint32_t chunk_triangles)
{
    f->ctx = test_context(1, 64 << 20);
    scan_write(f->ctx, "scan.tris", &f->mesh, (double[3]){0, 0, 0}, NULL, 0, chunk_triangles);
    make_normals(f->ctx, weights_of(f), &f->file);
    f->chunk_count = (uint32_t)fmt_tris_get_header(f->file)->chunk_count;
    assert_true(f->chunk_count > 1 && f->chunk_count <= CHUNKS_MAX);
    for (uint32_t i = 0; i < f->chunk_count; i++)
        decode(f, i);
}

static void end(struct fixture *f)
{
    for (uint32_t i = 0; i < f->chunk_count; i++) {
        free(f->chunks[i].memory);
        free(f->chunks[i].normals_memory);
    }
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

/* A triangle around a vertex. */
struct facet {
    double normal[3], weight, angle;
};

enum { FACETS_MAX = 4096 };

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Returns the unit normal's length: 0 without an area. */
static double unit_normal(const float *const p[3], double n[3])
{
    for (int a = 0; a < 3; a++) {
        int b = (a + 1) % 3, c = (a + 2) % 3;
        n[a] = ((double)p[1][b] - p[0][b]) * ((double)p[2][c] - p[0][c]) -
               ((double)p[1][c] - p[0][c]) * ((double)p[2][b] - p[0][b]);
    }
    const double area = sqrt(dot(n, n));
    for (int a = 0; a < 3 && area > 0.0; a++)
        n[a] /= area;
    return area;
}

/* Lists all triangles of the mesh with a corner at this position. Returns how many. */
static uint32_t facets_at(const struct scan_mesh *mesh, enum bsq_scan_normals weights,
                          const float at[3], struct facet *facets)
{
    uint32_t count = 0;
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        for (int i = 0; i < 3; i++) {
            const float *p[3];
            struct facet *f = &facets[count];
            for (int k = 0; k < 3; k++)
                p[k] = mesh->positions[mesh->triangles[t][k]];
            if (!same_place(p[i], at))
                continue;
            const double area = unit_normal(p, f->normal);
            f->weight = expected_weight(p, i, area, weights);
            f->angle = expected_weight(p, i, area, BSQ_SCAN_NORMALS_ANGLE);
            assert_true(++count < FACETS_MAX);
        }
    return count;
}

/* Sums the facets of a side, weighted by angle. towards: facets with a positive product are on it.
 * Returns whether the side has a normal. */
static bool expected_side(const struct facet *facets, uint32_t count, const double towards[3],
                          double side[3])
{
    double total = 0.0;
    side[0] = side[1] = side[2] = 0.0;
    for (uint32_t i = 0; i < count; i++)
        for (int k = 0; k < 3 && dot(facets[i].normal, towards) > 0.0; k++) {
            side[k] += facets[i].angle * facets[i].normal[k];
            total += k == 0 ? facets[i].angle : 0.0;
        }
    const double length = sqrt(dot(side, side));
    for (int k = 0; k < 3; k++)
        side[k] = length > 0.0 ? side[k] / length : 0.0;
    return length > 0.0 && length >= BSQ_CREASE_SHARE * total;
}

/* Returns whether the normals of each side of a fold are close to each other, or all are close to a
 * plane, as base/geometry/smooth_normals.h defines it. */
static bool expected_crease(const struct facet *facets, uint32_t count, const double second[3])
{
    double sum[3][3] = {{0}}, total = 0.0, c[3][3] = {{0}}, lengths[3];
    for (uint32_t i = 0; i < count; i++) {
        const int side = dot(facets[i].normal, second) > 0.0;
        total += facets[i].angle;
        for (int k = 0; k < 3; k++) {
            sum[side][k] += facets[i].angle * facets[i].normal[k];
            sum[2][k] += facets[i].angle * facets[i].normal[k];
        }
    }
    for (int s = 0; s < 3; s++)
        lengths[s] = sqrt(dot(sum[s], sum[s]));
    if (total - lengths[0] - lengths[1] < BSQ_SIDES_SHARE * (total - lengths[2]))
        return true;
    for (uint32_t i = 0; i < count; i++)
        for (int k = 0; k < 9; k++)
            c[k / 3][k % 3] += facets[i].angle / total *
                               (facets[i].normal[k / 3] - sum[2][k / 3] / total) *
                               (facets[i].normal[k % 3] - sum[2][k % 3] / total);
    double determinant = 0.0, minors = 0.0;
    for (int k = 0; k < 3; k++) {
        const int l = (k + 1) % 3, m = (k + 2) % 3;
        determinant += c[0][k] * (c[1][l] * c[2][m] - c[1][m] * c[2][l]);
        minors += c[l][l] * c[m][m] - c[l][m] * c[l][m];
    }
    return determinant <= BSQ_SIDES_FLATNESS * minors;
}

/* Computes the one or two normals at a position as base/geometry/smooth_normals.h defines them;
 * zero: none. Returns whether it is a crease. */
static bool expected_sides(const struct scan_mesh *mesh, enum bsq_scan_normals weights,
                           const float at[3], double sides[2][3])
{
    static struct facet facets[FACETS_MAX];
    const uint32_t count = facets_at(mesh, weights, at, facets);
    double sum[3] = {0}, total = 0.0, least = 2.0, first[3], across[3], second[3];
    const double *farthest = NULL;
    memset(sides, 0, 2 * sizeof *sides);
    for (uint32_t i = 0; i < count; i++) {
        for (int k = 0; k < 3; k++)
            sum[k] += facets[i].weight * facets[i].normal[k];
        total += facets[i].weight;
    }
    const double length = sqrt(dot(sum, sum));
    for (int k = 0; k < 3; k++)
        sum[k] = length > 0.0 ? sum[k] / length : 0.0;
    for (uint32_t i = 0; i < count; i++)
        if (dot(facets[i].normal, facets[i].normal) > 0.0 && dot(facets[i].normal, sum) < least) {
            farthest = facets[i].normal;
            least = dot(farthest, sum);
        }
    memcpy(sides[0], sum, sizeof sum);
    if (!farthest || weights == BSQ_SCAN_NORMALS_ANGLE ||
        (length >= BSQ_CREASE_SHARE * total && least >= sqrt(0.5)))
        return false;
    for (int k = 0; k < 3; k++)
        across[k] = sum[k] - least * farthest[k];
    const double size = sqrt(dot(across, across));
    for (int k = 0; k < 3; k++) {
        second[k] = farthest[k] - (size * length > 1e-6 * total ? across[k] / size : 0.0);
        first[k] = -second[k];
    }
    if (!expected_crease(facets, count, second))
        return false;
    for (int side = 0; side < 2; side++)
        if (!expected_side(facets, count, side ? second : first, sides[side]))
            memset(sides[side], 0, sizeof *sides);
    return true;
}

/* Chooses the normal of a triangle's corner: of two sides the closer one, if it is close enough. */
static void choose_normal(const double sides[2][3], bool crease, const double facet[3],
                          double normal[3])
{
    const double *side = sides[crease && dot(sides[1], facet) > dot(sides[0], facet)];
    const bool none = crease ? dot(side, facet) < sqrt(0.5) : dot(side, side) == 0.0;
    memcpy(normal, none ? facet : side, 3 * sizeof *normal);
}

/* Returns the cosine between a corner's normal and what is expected of it; 1 without an area. */
typedef double check_corner(const struct fixture *f, const float at[3], const double facet[3],
                            const double normal[3]);

static double agrees(const struct fixture *f, const float at[3], const double facet[3],
                     const double normal[3])
{
    double sides[2][3], expected[3];
    const bool crease = expected_sides(&f->mesh, weights_of(f), at, sides);
    choose_normal((const double(*)[3])sides, crease, facet, expected);
    return dot(expected, normal);
}

/* Computes the normal of all triangles of the mesh with a corner at this position. */
static void expected_normal(const struct scan_mesh *mesh, enum bsq_scan_normals weights,
                            const float at[3], double normal[3])
{
    double sides[2][3];
    expected_sides(mesh, weights, at, sides);
    memcpy(normal, sides[0], sizeof *sides);
}

/* Sets the normals of both sides of a vertex of a chunk; zeros: none. Returns whether it is a
 * crease.
 */
static bool get_sides(const struct decoded *d, uint32_t vertex, double sides[2][3])
{
    uint64_t packed[2] = {d->normals.vertices[vertex], BSQ_VERTEX_NORMAL_NONE};
    bool crease = false;
    for (uint32_t i = 0; i < d->normals.crease_count; i++)
        if (d->normals.creases[i].vertex == vertex) {
            packed[1] = d->normals.creases[i].second;
            crease = true;
        }
    for (int side = 0; side < 2; side++) {
        float n[3];
        bsq_vertex_normal_unpack(packed[side], n);
        for (int k = 0; k < 3; k++)
            sides[side][k] = (double)n[k];
    }
    return crease;
}

/* Returns the least cosine of all corners of a chunk's triangles. */
static double least_cosine(const struct fixture *f, const struct decoded *d,
                           check_corner *check_one)
{
    double least = 1.0;
    for (uint32_t t = 0; t < d->chunk.triangle_count; t++) {
        const float *p[3];
        double facet[3], normal[3];
        for (int i = 0; i < 3; i++)
            p[i] = d->chunk.positions[d->chunk.triangles[t][i]];
        if (unit_normal(p, facet) == 0.0)
            continue;
        for (int i = 0; i < 3; i++) {
            double sides[2][3];
            const bool crease = get_sides(d, d->chunk.triangles[t][i], sides);
            choose_normal((const double(*)[3])sides, crease, facet, normal);
            least = fmin(least, check_one(f, p[i], facet, normal));
        }
    }
    return least;
}

/* Returns the least cosine of all corners. */
static double check_with(struct fixture *f, check_corner *check_one)
{
    double least = 1.0;
    for (uint32_t i = 0; i < f->chunk_count; i++)
        least = fmin(least, least_cosine(f, &f->chunks[i], check_one));
    return least;
}

static void check(struct fixture *f)
{
    assert_true(check_with(f, agrees) > 1.0 - 1e-6);
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

/* Each triangle is there twice in a row, so that an even number of a chunk's triangles has each
 * edge also where the chunk ends. */
TEST(test_scan_that_is_there_twice)
{
    struct fixture f = {.mesh = scan_sphere(1.0, 0.1)};
    scan_sort(&f.mesh);
    const uint32_t count = f.mesh.triangle_count;
    uint32_t(*twice)[3] = malloc(2 * count * sizeof *twice);
    for (uint32_t t = 0; t < 2 * count; t++)
        memcpy(twice[t], f.mesh.triangles[t / 2], sizeof *twice);
    free(f.mesh.triangles);
    f.mesh.triangles = twice;
    f.mesh.triangle_count = 2 * count;
    begin(&f, CHUNK_TRIANGLES);
    check(&f);
    end(&f);
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

/* Each fan is closed and in its own chunk, so it keeps its own normal. In one chunk, both have a
 * common one: chunks without attributes have each position once. One fan is tilted. */
TEST(test_two_closed_fans_with_one_apex)
{
    enum { CORNERS = 100 };
    const double at[3] = {2.0, 3.0, 0.5};
    double alone[3], both[3], sides[2][3];
    struct fixture f = {.mesh = scan_mesh_new(2 * (CORNERS + 1), CORNERS)};
    put_fan(&f.mesh, 0, 0, CORNERS, at, -0.3);
    expected_normal(&f.mesh, BSQ_SCAN_NORMALS_AREA, f.mesh.positions[0], alone);
    f.mesh.triangles = realloc(f.mesh.triangles, 2 * CORNERS * sizeof *f.mesh.triangles);
    f.mesh.triangle_count = 2 * CORNERS;
    put_fan(&f.mesh, CORNERS + 1, CORNERS, CORNERS, at, -0.1);
    for (uint32_t i = CORNERS + 2; i < 2 * (CORNERS + 1); i++)
        f.mesh.positions[i][2] += 0.3f * (f.mesh.positions[i][0] - (float)at[0]);
    for (uint32_t t = CORNERS; t < 2 * CORNERS; t++)
        f.mesh.triangles[t][0] = 0;
    expected_normal(&f.mesh, BSQ_SCAN_NORMALS_AREA, f.mesh.positions[0], both);
    assert_true(fabs(alone[0] - both[0]) > 0.01);
    for (uint32_t chunk = CORNERS; chunk < 2 * CORNERS; chunk += CORNERS - 1) {
        struct fixture of = f;
        of.mesh = scan_mesh_new(f.mesh.vertex_count, f.mesh.triangle_count);
        memcpy(of.mesh.positions, f.mesh.positions, f.mesh.vertex_count * sizeof *f.mesh.positions);
        memcpy(of.mesh.triangles, f.mesh.triangles,
               f.mesh.triangle_count * sizeof *f.mesh.triangles);
        begin(&of, chunk);
        get_sides(&of.chunks[0], 0, sides);
        assert_true(dot(sides[0], chunk == CORNERS ? alone : both) > 1.0 - 1e-6);
        end(&of);
    }
    scan_mesh_free(&f.mesh);
}

/* Returns the rise that is expected at a vertex of a convex mesh by area: 9/8 of the height of the
 * area around it. */
static double expected_rise(const struct scan_mesh *mesh, const float at[3], const double n[3])
{
    double area = 0.0, moment = 0.0;
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        for (int i = 0; i < 3; i++) {
            const float *p[3];
            double facet[3];
            for (int k = 0; k < 3; k++)
                p[k] = mesh->positions[mesh->triangles[t][k]];
            if (!same_place(p[i], at))
                continue;
            const double twice = unit_normal(p, facet);
            area += twice;
            for (int k = 0; k < 3; k++)
                moment += twice * n[k] * (((double)p[0][k] + p[1][k] + p[2][k]) / 3.0 - at[k]);
        }
    return 9.0 / 8.0 * moment / area;
}

TEST(test_rises)
{
    struct fixture f = {.mesh = scan_sphere(1.0, 0.3)};
    scan_sort(&f.mesh);
    begin(&f, CHUNK_TRIANGLES / 4);
    for (uint32_t i = 0; i < f.chunk_count; i++)
        for (uint32_t v = 0; v < f.chunks[i].chunk.vertex_count; v++) {
            double sides[2][3];
            const float *at = f.chunks[i].chunk.positions[v];
            get_sides(&f.chunks[i], v, sides);
            const double expected = expected_rise(&f.mesh, at, sides[0]),
                         rise = (double)bsq_vertex_rise(f.chunks[i].normals.vertices[v]);
            assert_true(expected < -1e-3 && fabs(rise - expected) < 2e-4 * -expected);
        }
    end(&f);
}

/* Returns the checksum of all normals of a scan of triangles that touch nothing or in vertices. */
static uint64_t normals_of_soup(unsigned threads, uint64_t memory, uint32_t triangles)
{
    uint64_t seed = 5, sum = 0;
    struct bsq_ctx *ctx = test_context(threads, memory);
    struct scan_mesh mesh = scan_mesh_new(3 * triangles, triangles);
    for (uint32_t v = 0; v < 3 * triangles; v++)
        scan_set_vertex(&mesh, v, scan_random(&seed), scan_random(&seed), scan_random(&seed));
    for (uint32_t v = 9; v < 3 * triangles; v += 9)
        memcpy(mesh.positions[v], mesh.positions[v - 8], sizeof *mesh.positions);
    for (uint32_t t = 0; t < triangles; t++)
        scan_set_triangle(&mesh, t, 3 * t, 3 * t + 1, 3 * t + 2);
    scan_write(ctx, "scan.tris", &mesh, NULL, NULL, 0, 1000);
    struct fmt_tris_file *file;
    make_normals(ctx, BSQ_SCAN_NORMALS_AREA, &file);
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    for (uint64_t i = 0; i < header->chunk_count; i++)
        sum = sum * 31 + fmt_tris_chunks(file)[i].normals_checksum;
    fmt_tris_close(file);
    if (memory > 0)
        assert_true(bsq_memory_high(ctx) <= memory);
    bsq_ctx_destroy(ctx);
    unlink("scan.tris");
    scan_mesh_free(&mesh);
    return sum;
}

/* With little memory, the positions of a bucket do not fit, and it is done in parts. */
TEST(test_same_bytes_for_any_threads_and_memory)
{
    enum { TRIANGLES = 20000 };
    const uint64_t expected = normals_of_soup(1, 0, TRIANGLES);
    assert_true(normals_of_soup(3, 0, TRIANGLES) == expected);
    assert_true(normals_of_soup(3, 12 << 20, TRIANGLES) == expected);
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
        expected_normal(&f.mesh, BSQ_SCAN_NORMALS_AREA, f.mesh.positions[5], normal);
        assert_true(normal[0] < -0.05 && normal[0] > -0.15);
        begin(&f, chunk_triangles);
        check(&f);
        end(&f);
    }
}

/* ---- shapes ---- */

/* Adds a quad, or a triangle if the last two corners are equal. */
static void add_quad(struct scan_mesh *mesh, uint32_t *count, const uint32_t v[4])
{
    scan_set_triangle(mesh, (*count)++, v[0], v[1], v[2]);
    if (v[2] != v[3])
        scan_set_triangle(mesh, (*count)++, v[0], v[2], v[3]);
}

enum { SEGMENTS = 64 };

/* Makes a solid of revolution with flat ends: fans around the middle, or ears, whose triangles are
 * small beside those of the wall. radius, z: of rows + 1 rings. */
static struct scan_mesh revolve(const double *radius, const double *z, uint32_t rows, bool ears)
{
    struct scan_mesh mesh = scan_mesh_new((rows + 1) * SEGMENTS + 2, 2 * (rows + 1) * SEGMENTS);
    const uint32_t middle = (rows + 1) * SEGMENTS;
    uint32_t count = 0;
    for (uint32_t r = 0; r <= rows; r++)
        for (uint32_t i = 0; i < SEGMENTS; i++)
            scan_set_vertex(&mesh, r * SEGMENTS + i, radius[r] * cos(2 * BSQ_PI * i / SEGMENTS),
                            radius[r] * sin(2 * BSQ_PI * i / SEGMENTS), z[r]);
    for (uint32_t r = 0; r < rows; r++)
        for (uint32_t i = 0; i < SEGMENTS; i++) {
            const uint32_t a = r * SEGMENTS + i, b = r * SEGMENTS + (i + 1) % SEGMENTS;
            add_quad(&mesh, &count, (const uint32_t[4]){a, b, b + SEGMENTS, a + SEGMENTS});
        }
    for (uint32_t end = 0; end < 2; end++) {
        const uint32_t ring = end * rows * SEGMENTS;
        scan_set_vertex(&mesh, middle + end, 0.0, 0.0, z[end * rows]);
        for (uint32_t step = 1; ears && step < SEGMENTS / 2; step *= 2)
            for (uint32_t i = 0; i < SEGMENTS; i += 2 * step) {
                const uint32_t v[2] = {ring + i + step, ring + (i + 2 * step) % SEGMENTS};
                scan_set_triangle(&mesh, count++, ring + i, v[!end], v[end]);
            }
        for (uint32_t i = 0; !ears && i < SEGMENTS; i++) {
            const uint32_t v[2] = {ring + i, ring + (i + 1) % SEGMENTS};
            scan_set_triangle(&mesh, count++, middle + end, v[!end], v[end]);
        }
    }
    mesh.triangle_count = count;
    return mesh;
}

/* Returns the cosine to the ends of a solid, or to an ellipsoid with this height around z = 0. */
static double to_solid(const float at[3], const double facet[3], const double normal[3],
                       double height)
{
    const double z = (double)at[2] / height / height;
    double n[3] = {(double)at[0], (double)at[1], isinf(height) ? 0.0 : z};
    if (fabs(facet[2]) > 0.999)
        return normal[2] * facet[2];
    return dot(n, normal) / sqrt(dot(n, n));
}

static double to_cylinder(const struct fixture *f, const float at[3], const double facet[3],
                          const double normal[3])
{
    (void)f;
    return to_solid(at, facet, normal, INFINITY);
}

/* The upper end is no crease. */
static double to_bust(const struct fixture *f, const float at[3], const double facet[3],
                      const double normal[3])
{
    (void)f;
    return at[2] > 1.4f ? 1.0 : to_solid(at, facet, normal, 1.5);
}

static double degrees(double cosine)
{
    return acos(fmin(cosine, 1.0)) * 180.0 / BSQ_PI;
}

/* Returns the largest error of a solid's corners, in degrees. */
static double largest_error(struct scan_mesh mesh, unsigned weights, check_corner *to)
{
    struct fixture f = {.mesh = mesh, .weights = (enum bsq_scan_normals)weights};
    begin(&f, CHUNK_TRIANGLES);
    check(&f);
    const double least = check_with(&f, to);
    end(&f);
    return degrees(least);
}

/* Ends of a cylinder are flat and its wall is smooth up to the rim, whatever the sizes of the
 * triangles on both sides; by angle, its edges are smooth, as in Blender. */
TEST(test_capped_cylinder)
{
    enum { ROWS = 16 };
    for (unsigned w = BSQ_SCAN_NORMALS_AREA; w < BSQ_SCAN_NORMALS_FLAT; w++)
        for (int shape = 0; shape < 4; shape++) {
            const uint32_t rows = shape < 2 ? ROWS : 1;
            double radius[ROWS + 1], z[ROWS + 1];
            for (uint32_t r = 0; r <= rows; r++) {
                radius[r] = 1.0;
                z[r] = 2.0 * r / rows - 1.0;
            }
            const double error = largest_error(revolve(radius, z, rows, shape % 2), w, to_cylinder);
            print_message("weights %u, shape %d: %.3f degrees\n", w, shape, error);
            assert_true(w == BSQ_SCAN_NORMALS_ANGLE ? error > 30.0 : error < 0.3);
        }
}

/* A round body of small triangles stands on a base of large ones. */
TEST(test_bust_with_flat_base)
{
    enum { ROWS = 40 };
    for (unsigned w = BSQ_SCAN_NORMALS_AREA; w < BSQ_SCAN_NORMALS_FLAT; w += 2) {
        double radius[ROWS + 1], z[ROWS + 1];
        for (uint32_t r = 0; r <= ROWS; r++) {
            const double turn = BSQ_PI * (0.62 - 0.57 * r / ROWS);
            radius[r] = sin(turn);
            z[r] = 1.5 * cos(turn);
        }
        const double error = largest_error(revolve(radius, z, ROWS, false), w, to_bust);
        print_message("weights %u: %.3f degrees\n", w, error);
        assert_true(error < 3.0);
    }
}

/* Sums of the angles of corners to a sphere, as they are and as their weights alone make them. */
static double noise_errors[2];

static double add_noise_errors(const struct fixture *f, const float at[3], const double facet[3],
                               const double normal[3])
{
    static struct facet facets[FACETS_MAX];
    const uint32_t count = facets_at(&f->mesh, weights_of(f), at, facets);
    const double n[3] = {(double)at[0], (double)at[1], (double)at[2]};
    double sum[3] = {0};
    (void)facet;
    for (uint32_t i = 0; i < 3 * count; i++)
        sum[i % 3] += facets[i / 3].weight * facets[i / 3].normal[i % 3];
    noise_errors[0] += degrees(dot(n, normal) / sqrt(dot(n, n) * dot(normal, normal)));
    noise_errors[1] += degrees(dot(n, sum) / sqrt(dot(n, n) * dot(sum, sum)));
    return 1.0;
}

/* Noise of two tenths of an edge folds many one-rings, but makes hardly any creases. */
TEST(test_noise_is_no_crease)
{
    struct fixture f = {.mesh = scan_sphere(1.0, 0.15)};
    scan_sort(&f.mesh);
    for (uint32_t v = 0; v < f.mesh.vertex_count; v++) {
        uint64_t seed = bsq_position_hash(f.mesh.positions[v]);
        for (int k = -4; k < 3; k++) { /* the first numbers are alike */
            const double noise = 0.075 * (scan_random(&seed) - 0.5);
            f.mesh.positions[v][k < 0 ? 0 : k] += k < 0 ? 0.0f : (float)noise;
        }
    }
    begin(&f, CHUNK_TRIANGLES);
    check(&f);
    check_with(&f, add_noise_errors);
    print_message("%.4f beside %.4f\n", noise_errors[0], noise_errors[1]);
    assert_true(noise_errors[0] < 1.1 * noise_errors[1]);
    end(&f);
}

RUN_TESTS(NULL, NULL)
