/* Tests edge collapse on closed, open and broken meshes: topology, volume, borders, and what must
 * not move; and the welding before it. */
#include "libvoxel/simplify/steps.h"
#include "tests/unit/libvoxel/simplify/torus.h"
#include "tests/unit/test.h"

SHARED_CONTEXT(ctx, 1)

static struct vox_removed removed; /* by the collapses of a test */

/* Makes a mesh of n x n squares, two triangles each, whose rows and columns close if `closed`. */
static struct vox_mesh make_grid(uint32_t n, bool closed, void (*place)(double, double, float *))
{
    const uint32_t side = closed ? n : n + 1;
    struct vox_mesh mesh;
    assert_int_equal(vox_mesh_allocate(ctx, side * side, 2 * n * n, true, &mesh), 0);
    for (uint32_t y = 0; y < side; y++)
        for (uint32_t x = 0; x < side; x++)
            place((double)x / n, (double)y / n, mesh.positions[y * side + x]);
    uint32_t(*out)[3] = mesh.triangles;
    for (uint32_t y = 0; y < n; y++)
        for (uint32_t x = 0; x < n; x++) {
            const uint32_t right = (x + 1) % side, up = (y + 1) % side;
            const uint32_t a = y * side + x, b = y * side + right, c = up * side + x,
                           d = up * side + right;
            memcpy(out++, (uint32_t[3]){a, b, d}, sizeof *out);
            memcpy(out++, (uint32_t[3]){a, d, c}, sizeof *out);
        }
    return mesh;
}

static void on_plane(double x, double y, float *p)
{
    p[0] = (float)(4 * x);
    p[1] = (float)(4 * y);
    p[2] = 0.5f;
}
/* Waves with a thin spike of height 1. */
static void with_spike(double x, double y, float *p)
{
    const double r = 8 * hypot(4 * x - 2, 4 * y - 2);
    on_plane(x, y, p);
    p[2] = (float)(0.1 * sin(4 * PI * x) * sin(4 * PI * y) + (r < 1 ? 1 - r : 0));
}

/* Collapses with locked borders and carried quadrics, or else as in the last phase. */
static void collapse(struct vox_mesh *mesh, bool thin, uint32_t target)
{
    vox_mesh_set_quadrics(mesh);
    assert_int_equal(thin ? vox_thin(ctx, target, mesh)
                          : vox_collapse(ctx, target, NULL, NULL, mesh, &removed),
                     0);
}

static void cluster(struct vox_mesh *mesh, double share)
{
    vox_mesh_set_quadrics(mesh);
    assert_int_equal(vox_cluster(ctx, share, mesh), 0);
}

struct figures {
    unsigned edges, borders, crowded; /* with one triangle; with more than two */
    double volume, area;
};

static int compare_edges(const void *a, const void *b)
{
    return memcmp(a, b, 2 * sizeof(uint32_t));
}

static struct figures describe(const struct vox_mesh *mesh)
{
    struct figures f = {0};
    const unsigned count = 3 * mesh->triangle_count;
    uint32_t(*edges)[2] = malloc(count * sizeof *edges);
    assert_non_null(edges);
    for (unsigned i = 0; i < count; i++) {
        const uint32_t *t = mesh->triangles[i / 3], a = t[i % 3], b = t[(i + 1) % 3];
        assert_true(a != b && a < mesh->vertex_count && b < mesh->vertex_count);
        edges[i][0] = a < b ? a : b;
        edges[i][1] = a < b ? b : a;
    }
    qsort(edges, count, sizeof *edges, compare_edges);
    for (unsigned i = 0, same; i < count; i += same) {
        for (same = 1; i + same < count && compare_edges(edges[i], edges[i + same]) == 0; same++)
            ;
        f.edges++;
        f.borders += same == 1;
        f.crowded += same > 2;
    }
    free(edges);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const float *a = mesh->positions[mesh->triangles[t][0]],
                    *b = mesh->positions[mesh->triangles[t][1]],
                    *c = mesh->positions[mesh->triangles[t][2]];
        double n[3];
        for (int k = 0; k < 3; k++) {
            const int i = (k + 1) % 3, j = (k + 2) % 3;
            n[k] = ((double)b[i] - a[i]) * ((double)c[j] - a[j]) -
                   ((double)b[j] - a[j]) * ((double)c[i] - a[i]);
        }
        f.volume += (a[0] * n[0] + a[1] * n[1] + a[2] * n[2]) / 6;
        f.area += sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / 2;
    }
    return f;
}

/* A torus stays one. In groups, down to the fewest triangles that a torus can have (7 vertices, 14
 * triangles, Csaszar), or nearly so; in the last phase, its handle is cut for fewer. */
TEST(tori_stay_tori)
{
    static const uint32_t targets[] = {2000, 300, 4};
    for (int thin = 0; thin < 2; thin++) {
        struct vox_mesh mesh = make_grid(60, true, on_torus);
        const double volume = describe(&mesh).volume;
        removed = (struct vox_removed){0};
        for (int i = 0; i < 3; i++) {
            collapse(&mesh, thin, targets[i]);
            const struct figures f = describe(&mesh);
            const bool cut = !thin && i == 2;
            assert_int_equal(mesh.vertex_count + mesh.triangle_count, f.edges + (cut ? 2 : 0));
            assert_int_equal(f.borders + f.crowded, 0);
            assert_int_equal(removed.handles > 0, cut);
            if (i < 2 || cut)
                assert_in_range(mesh.triangle_count, targets[i] - 1, targets[i]);
            else
                assert_in_range(mesh.triangle_count, 14, 60);
            if (i < 2)
                assert_true(fabs(f.volume / volume - 1) < (thin ? 0.05 : 0.005));
        }
        vox_mesh_free(ctx, &mesh);
    }
}

/* Adds a tetrahedron of side 0.02 to a mesh that has space for it. */
static void add_tetrahedron(struct vox_mesh *mesh, float x, float y, float z)
{
    static const uint32_t faces[4][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
    const uint32_t first = mesh->vertex_count;
    for (uint32_t i = 0; i < 4; i++) {
        float *p = mesh->positions[first + i];
        p[0] = x + 0.02f * (i == 1);
        p[1] = y + 0.02f * (i == 2);
        p[2] = z + 0.02f * (i == 3);
        for (int k = 0; k < 3; k++)
            mesh->triangles[mesh->triangle_count + i][k] = first + faces[i][k];
    }
    mesh->vertex_count += 4;
    mesh->triangle_count += 4;
}

/* Small pieces close to a surface go when its own error grows; one that is far from all stays as
 * long as the target allows. */
TEST(pieces_go_by_their_distance)
{
    enum { SIDE = 12, COUNT = SIDE * SIDE };
    struct vox_mesh sheet = make_grid(80, false, with_spike), mesh;
    assert_int_equal(vox_mesh_allocate(ctx, sheet.vertex_count + 4 * (COUNT + 1),
                                       sheet.triangle_count + 4 * (COUNT + 1), true, &mesh),
                     0);
    memcpy(mesh.positions, sheet.positions, sheet.vertex_count * sizeof *mesh.positions);
    memcpy(mesh.triangles, sheet.triangles, sheet.triangle_count * sizeof *mesh.triangles);
    mesh.vertex_count = sheet.vertex_count;
    mesh.triangle_count = sheet.triangle_count;
    for (int i = 0; i < COUNT; i++)
        add_tetrahedron(&mesh, 0.3f * (float)(i % SIDE), 0.3f * (float)(i / SIDE), 0.15f);
    add_tetrahedron(&mesh, 2, 2, 9);
    removed = (struct vox_removed){0};
    collapse(&mesh, false, 120);
    assert_in_range(mesh.triangle_count, 117, 120); /* a piece takes four at once */
    assert_in_range(removed.pieces, COUNT * 4 / 5, COUNT);
    assert_int_equal(removed.triangles, 4 * removed.pieces);
    unsigned above = 0;
    for (uint32_t v = 0; v < mesh.vertex_count; v++)
        above += mesh.positions[v][2] > 8;
    assert_int_equal(above, 4);
    collapse(&mesh, false, 4);
    assert_in_range(mesh.triangle_count, 1, 4);
    vox_mesh_free(ctx, &mesh);
    vox_mesh_free(ctx, &sheet);
}

/* A torus of noise, some of whose triangles turn. */
static void on_noise(double x, double y, float *p)
{
    on_torus(x, y, p);
    for (int k = 0; k < 3; k++) {
        const double at = sin(12.9898 * x + 78.233 * y + 37.719 * k) * 43758.5453;
        p[k] += (float)(0.25 * (at - floor(at) - 0.5));
    }
}

static unsigned count_back_to_back(const struct vox_mesh *mesh)
{
    unsigned count = 0;
    for (uint32_t s = 0; s < mesh->triangle_count; s++)
        for (uint32_t t = 0; t < s; t++) {
            const uint32_t *a = mesh->triangles[s], *b = mesh->triangles[t];
            unsigned same = 0;
            double n[3], m[3];
            for (int i = 0; i < 9; i++)
                same += a[i / 3] == b[i % 3];
            if (same != 2)
                continue;
            vox_triangle_normal((const float(*)[3])mesh->positions, a, n);
            vox_triangle_normal((const float(*)[3])mesh->positions, b, m);
            const double nm = n[0] * m[0] + n[1] * m[1] + n[2] * m[2],
                         nn = n[0] * n[0] + n[1] * n[1] + n[2] * n[2],
                         mm = m[0] * m[0] + m[1] * m[1] + m[2] * m[2];
            count += nm < -0.9 * sqrt(nn * mm);
        }
    return count;
}

/* Noise does not keep a mesh from its target, nor leave triangles back to back. */
TEST(noise_goes)
{
    static const uint32_t targets[] = {600, 200, 100};
    struct vox_mesh mesh = make_grid(100, true, on_noise);
    const double volume = describe(&mesh).volume;
    for (int i = 0; i < 3; i++) {
        collapse(&mesh, false, targets[i]);
        const struct figures f = describe(&mesh);
        assert_in_range(mesh.triangle_count, targets[i] - 1, targets[i]);
        assert_in_range(count_back_to_back(&mesh), 0, 10);
        assert_int_equal(f.borders + f.crowded, 0);
        assert_true(fabs(f.volume / volume - 1) < 0.06);
    }
    vox_mesh_free(ctx, &mesh);
}

/* Vertices of a coarse mesh lie outside of what is round, but the mesh that fits it encloses as
 * much. */
TEST(fitting_keeps_volume)
{
    const uint32_t n = 24, all = 2 * n * n;
    for (uint32_t part = 2; part < 6; part++) {
        struct vox_mesh mesh = make_grid(n, true, on_torus);
        const double volume = describe(&mesh).volume;
        collapse(&mesh, false, all / part);
        assert_true(fabs(describe(&mesh).volume / volume - 1) < 0.002);
        vox_mesh_free(ctx, &mesh);
    }
}

/* A spike has little volume, but its tip is far from all else. */
TEST(tips_stay)
{
    struct vox_mesh mesh = make_grid(80, false, with_spike);
    float top = 0;
    collapse(&mesh, false, 60);
    for (uint32_t v = 0; v < mesh.vertex_count; v++)
        top = fmaxf(top, mesh.positions[v][2]);
    assert_true(top > 0.93f && top < 1.07f);
    vox_mesh_free(ctx, &mesh);
}

/* Most folds of the scan do not stay. */
/* Costs grow with the sixth power of a length, and floats hold them. */
TEST(scale_does_not_matter)
{
    static const int exponents[] = {-60, 60};
    struct vox_mesh plain = make_grid(40, false, with_spike);
    collapse(&plain, false, 300);
    for (int i = 0; i < 2; i++) {
        struct vox_mesh scaled = make_grid(40, false, with_spike);
        for (uint32_t v = 0; v < scaled.vertex_count; v++)
            for (int k = 0; k < 3; k++)
                scaled.positions[v][k] = ldexpf(scaled.positions[v][k], exponents[i]);
        assert_int_equal(vox_collapse(ctx, 300, NULL, NULL, &scaled, &removed), 0);
        assert_int_equal(scaled.triangle_count, plain.triangle_count);
        assert_memory_equal(scaled.triangles, plain.triangles,
                            plain.triangle_count * sizeof *plain.triangles);
        for (uint32_t v = 0; v < plain.vertex_count; v++)
            for (int k = 0; k < 3; k++)
                assert_true(scaled.positions[v][k] == ldexpf(plain.positions[v][k], exponents[i]));
        vox_mesh_free(ctx, &scaled);
    }
    vox_mesh_free(ctx, &plain);
}

TEST(folds_go)
{
    enum { N = 48 };
    struct vox_mesh mesh = make_grid(N, false, on_plane);
    unsigned turned = 0;
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        float *p = mesh.positions[v];
        p[2] = 0.1f * sinf(2 * p[0]) * sinf(2 * p[1]);
        if (v % (N + 1) % 7 == 3 && v / (N + 1) % 7 == 3) /* beyond the next one */
            p[0] += 1.3f * 4 / N;
    }
    for (int i = 0; i < 2; i++) {
        turned = 0;
        for (uint32_t t = 0; t < mesh.triangle_count; t++) {
            double normal[3];
            vox_triangle_normal((const float(*)[3])mesh.positions, mesh.triangles[t], normal);
            turned += normal[2] <= 0;
        }
        if (i == 0)
            assert_true(turned > 90);
        collapse(&mesh, false, 400);
    }
    assert_true(turned < 30); /* 56 if collapses may not turn any */
    assert_int_equal(describe(&mesh).crowded, 0);
    vox_mesh_free(ctx, &mesh);
}

/* A flat square with a border becomes two triangles with the same corners. */
TEST(flat_squares_keep_their_outline)
{
    struct vox_mesh mesh = make_grid(24, false, on_plane);
    collapse(&mesh, false, 2);
    assert_in_range(mesh.triangle_count, 2, 8);
    assert_true(fabs(describe(&mesh).area - 16) < 1e-3);
    for (uint32_t v = 0; v < mesh.vertex_count; v++)
        assert_true(fabsf(mesh.positions[v][2] - 0.5f) < 1e-6f);
    vox_mesh_free(ctx, &mesh);
}

TEST(locked_borders_stay)
{
    enum { N = 20 };
    struct vox_mesh mesh = make_grid(N, false, on_plane);
    collapse(&mesh, true, 2);
    unsigned on_border = 0;
    for (uint32_t v = 0; v < mesh.vertex_count; v++)
        for (int k = 0; k < 4 * N; k++) { /* the places of the border */
            const float at = (float)(4.0 * (k % N) / N), back = (float)(4.0 * (N - k % N) / N);
            const float x = k < N ? at : k < 2 * N ? 4 : k < 3 * N ? back : 0;
            const float y = k < N ? 0 : k < 2 * N ? at : k < 3 * N ? 4 : back;
            on_border += mesh.positions[v][0] == x && mesh.positions[v][1] == y;
        }
    assert_int_equal(on_border, 4 * N);
    assert_int_equal(describe(&mesh).borders, 4 * N);
    assert_true(mesh.triangle_count < 2 * 4 * N);
    vox_mesh_free(ctx, &mesh);
}

/* Three sheets that meet at an edge keep that edge as it is. */
TEST(crowded_edges_stay)
{
    enum { N = 8 };
    struct vox_mesh sheet = make_grid(N, false, on_plane), mesh;
    assert_int_equal(
        vox_mesh_allocate(ctx, 3 * sheet.vertex_count, 3 * sheet.triangle_count, true, &mesh), 0);
    for (uint32_t s = 0; s < 3; s++) {
        for (uint32_t v = 0; v < sheet.vertex_count; v++) { /* turned around the line y = 0 */
            const float y = sheet.positions[v][1];
            float *p = mesh.positions[s * sheet.vertex_count + v];
            p[0] = sheet.positions[v][0];
            p[1] = s == 0 ? y : s == 1 ? 0 : -y;
            p[2] = s == 1 ? y : 0;
        }
        for (uint32_t t = 0; t < sheet.triangle_count; t++)
            for (int k = 0; k < 3; k++)
                mesh.triangles[s * sheet.triangle_count + t][k] =
                    s * sheet.vertex_count + sheet.triangles[t][k];
    }
    vox_mesh_set_quadrics(&mesh);
    assert_int_equal(vox_mesh_weld(ctx, &mesh), 0);
    assert_int_equal(mesh.vertex_count, 3 * sheet.vertex_count - 2 * (N + 1));
    assert_int_equal(describe(&mesh).crowded, N);
    cluster(&mesh, 0.01);
    assert_int_equal(describe(&mesh).crowded, N);
    collapse(&mesh, false, 60);
    assert_int_equal(describe(&mesh).crowded, N);
    unsigned kept = 0;
    for (uint32_t v = 0; v < mesh.vertex_count; v++)
        kept += mesh.positions[v][1] == 0.0f && mesh.positions[v][2] == 0.0f;
    assert_int_equal(kept, N + 1);
    vox_mesh_free(ctx, &mesh);
    vox_mesh_free(ctx, &sheet);
}

/* Closed bodies that cannot lose an edge stay whole. */
TEST(tetrahedra_stay)
{
    static const float corners[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    static const uint32_t faces[4][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
    struct vox_mesh mesh;
    assert_int_equal(vox_mesh_allocate(ctx, 4, 4, true, &mesh), 0);
    memcpy(mesh.positions, corners, sizeof corners);
    memcpy(mesh.triangles, faces, sizeof faces);
    collapse(&mesh, false, 1);
    assert_int_equal(mesh.triangle_count, 4);
    assert_memory_equal(mesh.positions, corners, sizeof corners);
    vox_mesh_free(ctx, &mesh);
}

/* Clusters keep a torus, also where cells are as wide as its tube or hold all of it. */
TEST(clusters_keep_tori)
{
    static const double shares[] = {0.5, 0.1, 0.04, 0.001};
    for (int i = 0; i < 4; i++)
        for (uint32_t n = 20; n <= 120; n += 50) {
            struct vox_mesh mesh = make_grid(n, true, on_torus);
            const double volume = describe(&mesh).volume;
            const uint32_t vertices = mesh.vertex_count;
            cluster(&mesh, shares[i]);
            const struct figures f = describe(&mesh);
            assert_int_equal(mesh.vertex_count + mesh.triangle_count, f.edges);
            assert_int_equal(f.borders + f.crowded, 0);
            assert_true(fabs(f.volume / volume - 1) < 0.1);
            if (n == 120 && i < 3)
                assert_true(mesh.vertex_count < 1.5 * shares[i] * vertices);
            vox_mesh_free(ctx, &mesh);
        }
}

/* The border of a square stays, and few vertices inside. */
TEST(clusters_keep_borders)
{
    enum { N = 60 };
    struct vox_mesh mesh = make_grid(N, false, on_plane);
    cluster(&mesh, 0.01);
    const struct figures f = describe(&mesh);
    unsigned on_border = 0;
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        const float *p = mesh.positions[v];
        on_border += p[0] == 0 || p[1] == 0 || p[0] == 4 || p[1] == 4;
        assert_true(fabsf(p[2] - 0.5f) < 1e-6f);
    }
    assert_int_equal(on_border, 4 * N);
    assert_int_equal(f.borders, 4 * N);
    assert_int_equal(f.crowded, 0);
    assert_true(fabs(f.area - 16) < 1e-3);
    assert_true(mesh.vertex_count < 4 * N + N * N / 8);
    vox_mesh_free(ctx, &mesh);
}

/* Two squares that share a cell everywhere stay apart, and a small piece stays there. */
TEST(clusters_keep_pieces)
{
    enum { N = 40 };
    static const uint32_t faces[4][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
    struct vox_mesh sheet = make_grid(N, false, on_plane), mesh;
    const uint32_t vertices = sheet.vertex_count, triangles = sheet.triangle_count;
    assert_int_equal(vox_mesh_allocate(ctx, 2 * vertices + 4, 2 * triangles + 4, true, &mesh), 0);
    for (uint32_t s = 0; s < 2; s++) {
        for (uint32_t v = 0; v < vertices; v++) {
            memcpy(mesh.positions[s * vertices + v], sheet.positions[v], sizeof *mesh.positions);
            mesh.positions[s * vertices + v][2] += 0.001f * (float)s;
        }
        for (uint32_t t = 0; t < triangles; t++)
            for (int k = 0; k < 3; k++)
                mesh.triangles[s * triangles + t][k] = s * vertices + sheet.triangles[t][k];
    }
    for (uint32_t v = 0; v < 4; v++) {
        const float place[3] = {2 + 0.01f * (v == 1), 2 + 0.01f * (v == 2), 3 + 0.01f * (v == 3)};
        memcpy(mesh.positions[2 * vertices + v], place, sizeof place);
        for (int k = 0; k < 3; k++)
            mesh.triangles[2 * triangles + v][k] = 2 * vertices + faces[v][k];
    }
    cluster(&mesh, 0.01);
    const struct figures f = describe(&mesh);
    assert_int_equal(f.borders, 2 * 4 * N);
    assert_int_equal(f.crowded, 0);
    assert_true(fabs(f.area - 32) < 1e-2);
    assert_true(mesh.triangle_count < triangles);
    unsigned above = 0;
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        const float z = mesh.positions[v][2];
        above += z >= 3;
        assert_true(z >= 3 || fabsf(z - 0.5f) < 1e-6f || fabsf(z - 0.501f) < 1e-6f);
    }
    assert_int_equal(above, 4);
    vox_mesh_free(ctx, &mesh);
    vox_mesh_free(ctx, &sheet);
}

/* Equal positions become one vertex, both zeros too; triangles without three corners and repeated
 * ones go. */
TEST(welding)
{
    static const float positions[7][3] = {{0, 0, 0},     {1, 0, 0}, {0, 1, 0}, {-0.0f, 0, 0},
                                          {1, -0.0f, 0}, {0, 1, 0}, {0, 0, 2}};
    static const uint32_t triangles[5][3] = {{0, 1, 2}, {3, 5, 4}, {0, 3, 6}, {3, 1, 6}, {5, 3, 4}};
    struct vox_mesh mesh;
    assert_int_equal(vox_mesh_allocate(ctx, 7, 5, true, &mesh), 0);
    memcpy(mesh.positions, positions, sizeof positions);
    memcpy(mesh.triangles, triangles, sizeof triangles);
    vox_mesh_set_quadrics(&mesh);
    const double before = mesh.quadrics[0].a[5] + mesh.quadrics[3].a[5];
    assert_int_equal(vox_mesh_weld(ctx, &mesh), 0);
    assert_int_equal(mesh.vertex_count, 4);
    assert_int_equal(mesh.triangle_count, 2);
    assert_memory_equal(mesh.triangles[1], ((uint32_t[3]){0, 1, 3}), sizeof(uint32_t[3]));
    assert_true(mesh.quadrics[0].a[5] == before);
    vox_mesh_free(ctx, &mesh);
}

/* A triangle without area is missing at a slit; a hole stays. */
TEST(slits_are_closed)
{
    static const float positions[6][3] = {{0, 0, 0}, {2, 0, 0},  {1, 0, 0},
                                          {1, 2, 0}, {1, -2, 0}, {4, 0, 0}};
    static const uint32_t triangles[4][3] = {{0, 2, 3}, {2, 1, 3}, {0, 4, 1}, {4, 5, 1}};
    struct vox_mesh mesh;
    assert_int_equal(vox_mesh_allocate(ctx, 6, 4, false, &mesh), 0);
    memcpy(mesh.positions, positions, sizeof positions);
    memcpy(mesh.triangles, triangles, sizeof triangles);
    const unsigned borders = describe(&mesh).borders;
    assert_int_equal(vox_mesh_close_slits(ctx, &mesh), 0);
    assert_int_equal(mesh.triangle_count, 5);
    assert_int_equal(describe(&mesh).borders, borders - 3);
    assert_int_equal(describe(&mesh).crowded, 0);
    assert_int_equal(vox_mesh_close_slits(ctx, &mesh), 0);
    assert_int_equal(mesh.triangle_count, 5);
    mesh.positions[2][1] = 0.1f; /* now it encloses something */
    mesh.triangle_count = 4;
    assert_int_equal(vox_mesh_close_slits(ctx, &mesh), 0);
    assert_int_equal(mesh.triangle_count, 4);
    vox_mesh_free(ctx, &mesh);
}

/* Every allocation may fail: then there is one error, and nothing leaks. */
TEST(memory_runs_out)
{
    for (uint64_t budget = 4096;; budget += 40000) {
        struct bsq_ctx *small = test_context(1, budget), *large = ctx;
        struct vox_mesh mesh = make_grid(30, true, on_torus);
        vox_mesh_set_quadrics(&mesh);
        ctx = small;
        const int clustered = vox_cluster(ctx, 0.9, &mesh);
        const int status = vox_collapse(ctx, 1000, NULL, NULL, &mesh, &removed);
        const int thinned = vox_thin(ctx, 100, &mesh);
        const int welded = vox_mesh_weld(ctx, &mesh);
        ctx = large;
        assert_true(status == 0 || status == BSQ_ENOMEM);
        assert_true(clustered == 0 || clustered == BSQ_ENOMEM);
        assert_true(thinned == 0 || thinned == BSQ_ENOMEM);
        assert_true(welded == 0 || welded == BSQ_ENOMEM);
        vox_mesh_free(ctx, &mesh);
        test_context_end(small);
        if (clustered == 0 && status == 0 && thinned == 0 && welded == 0)
            return;
    }
}

RUN_TESTS(open_ctx, close_ctx)
