#include "scan_fixture.h"
#include "libvoxel/normals/normals.h"
#include "tests/unit/fixture.h"

static void *must_alloc(uint64_t count, uint64_t size)
{
    void *memory = calloc(count ? count : 1, size);
    assert_non_null(memory);
    return memory;
}

struct scan_mesh scan_mesh_new(uint32_t vertices, uint32_t triangles)
{
    struct scan_mesh mesh = {.vertex_count = vertices, .triangle_count = triangles};
    mesh.positions = must_alloc(vertices, sizeof *mesh.positions);
    mesh.triangles = must_alloc(triangles, sizeof *mesh.triangles);
    return mesh;
}

void scan_mesh_free(struct scan_mesh *mesh)
{
    free(mesh->positions);
    free(mesh->triangles);
    free(mesh->normals);
    free(mesh->colors);
    free(mesh->materials);
    free(mesh->texcoords);
    memset(mesh, 0, sizeof *mesh);
}

void scan_set_vertex(struct scan_mesh *mesh, uint32_t v, double x, double y, double z)
{
    mesh->positions[v][0] = (float)x;
    mesh->positions[v][1] = (float)y;
    mesh->positions[v][2] = (float)z;
}

void scan_set_triangle(struct scan_mesh *mesh, uint32_t t, uint32_t a, uint32_t b, uint32_t c)
{
    mesh->triangles[t][0] = a;
    mesh->triangles[t][1] = b;
    mesh->triangles[t][2] = c;
}

void scan_set_quad(struct scan_mesh *mesh, uint32_t q, const double at[3], const double u[3],
                   const double v[3])
{
    for (uint32_t i = 0; i < 4; i++) {
        double p[3];
        for (int a = 0; a < 3; a++)
            p[a] = at[a] + (i == 1 || i == 2 ? u[a] : 0.0) + (i >= 2 ? v[a] : 0.0);
        scan_set_vertex(mesh, 4 * q + i, p[0], p[1], p[2]);
    }
    scan_set_triangle(mesh, 2 * q, 4 * q, 4 * q + 1, 4 * q + 2);
    scan_set_triangle(mesh, 2 * q + 1, 4 * q, 4 * q + 2, 4 * q + 3);
}

double scan_random(uint64_t *seed)
{
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    return (double)(*seed >> 11) / 9007199254740992.0;
}

/* ---- sphere ---- */

/* Returns the number of vertex (i, j) of a triangular grid, i + j <= n. */
static uint32_t grid_vertex(uint32_t n, uint32_t i, uint32_t j)
{
    return i * (n + 1) + j - (i > 0 ? i * (i - 1) / 2 : 0);
}

static void sphere_face(struct scan_mesh *mesh, int face, uint32_t n, double radius,
                        uint32_t first_vertex, uint32_t first_triangle)
{
    double sign[3];
    for (int a = 0; a < 3; a++)
        sign[a] = face >> a & 1 ? -1.0 : 1.0;
    bool flip = sign[0] * sign[1] * sign[2] < 0;
    for (uint32_t i = 0; i <= n; i++)
        for (uint32_t j = 0; i + j <= n; j++) {
            double p[3] = {i, j, n - i - j};
            double length = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
            for (int a = 0; a < 3; a++)
                mesh->positions[first_vertex + grid_vertex(n, i, j)][a] =
                    (float)(sign[a] * radius * p[a] / length);
        }
    uint32_t t = first_triangle;
    for (uint32_t i = 0; i < n; i++)
        for (uint32_t j = 0; i + j < n; j++)
            for (int half = 0; half < 2 && i + j + (uint32_t)half < n; half++, t++) {
                uint32_t v[3] = {half ? grid_vertex(n, i + 1, j + 1) : grid_vertex(n, i, j),
                                 half ? grid_vertex(n, i, j + 1) : grid_vertex(n, i + 1, j),
                                 half ? grid_vertex(n, i + 1, j) : grid_vertex(n, i, j + 1)};
                for (int k = 0; k < 3; k++)
                    mesh->triangles[t][k] = first_vertex + v[flip ? 2 - k : k];
            }
}

struct scan_mesh scan_sphere(double radius, double max_edge)
{
    /* Projection stretches an edge of a face, sqrt(2) R / n, by at most sqrt(3). */
    uint32_t n = (uint32_t)ceil(sqrt(6.0) * radius / max_edge);
    uint32_t vertices = (n + 1) * (n + 2) / 2;
    struct scan_mesh mesh = scan_mesh_new(8 * vertices, 8 * n * n);
    for (int face = 0; face < 8; face++)
        sphere_face(&mesh, face, n, radius, (uint32_t)face * vertices, (uint32_t)face * n * n);
    return mesh;
}

/* ---- order ---- */

struct keyed {
    uint64_t key;
    uint32_t triangle;
};

static int compare_keys(const void *a, const void *b)
{
    const struct keyed *x = a, *y = b;
    if (x->key != y->key)
        return x->key < y->key ? -1 : 1;
    return x->triangle < y->triangle ? -1 : x->triangle > y->triangle;
}

static uint64_t morton(const struct scan_mesh *mesh, const uint32_t v[3], const float min[3],
                       float size)
{
    uint64_t key = 0;
    for (int a = 0; a < 3; a++) {
        float sum = 0.0f;
        for (int k = 0; k < 3; k++)
            sum += mesh->positions[v[k]][a] - min[a];
        uint32_t cell = (uint32_t)(sum / (3.0f * size) * 1048575.0f);
        for (int bit = 0; bit < 20; bit++)
            key |= (uint64_t)(cell >> bit & 1) << (3 * bit + 2 - a);
    }
    return key;
}

void scan_sort(struct scan_mesh *mesh)
{
    float min[3], size = 0.0f;
    for (int a = 0; a < 3; a++) {
        float max = min[a] = mesh->positions[0][a];
        for (uint32_t i = 1; i < mesh->vertex_count; i++) {
            min[a] = fminf(min[a], mesh->positions[i][a]);
            max = fmaxf(max, mesh->positions[i][a]);
        }
        size = fmaxf(size, max - min[a]);
    }
    struct keyed *keys = must_alloc(mesh->triangle_count, sizeof *keys);
    uint32_t(*sorted)[3] = must_alloc(mesh->triangle_count, sizeof *sorted);
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        keys[t] = (struct keyed){morton(mesh, mesh->triangles[t], min, size), t};
    qsort(keys, mesh->triangle_count, sizeof *keys, compare_keys);
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        memcpy(sorted[t], mesh->triangles[keys[t].triangle], sizeof *sorted);
    free(keys);
    free(mesh->triangles);
    mesh->triangles = sorted;
}

/* ---- chunk files ---- */

/* Writes a chunk of triangles [first, first + count). local: has UINT32_MAX for each vertex, before
 * and after. */
static struct scan_mesh extract(const struct scan_mesh *mesh, uint32_t first, uint32_t count,
                                uint32_t *local)
{
    struct scan_mesh part = scan_mesh_new(3 * count, count);
    uint32_t n = 0;
    part.normals = mesh->normals ? must_alloc(3 * count, 4) : NULL;
    part.colors = mesh->colors ? must_alloc(3 * count, 4) : NULL;
    part.texcoords = mesh->texcoords ? must_alloc(3 * count, sizeof *part.texcoords) : NULL;
    part.materials = mesh->materials ? must_alloc(count, 4) : NULL;
    for (uint32_t t = 0; t < count; t++) {
        for (int k = 0; k < 3; k++) {
            uint32_t v = mesh->triangles[first + t][k];
            if (local[v] == UINT32_MAX) {
                memcpy(part.positions[n], mesh->positions[v], sizeof *part.positions);
                if (part.normals)
                    part.normals[n] = mesh->normals[v];
                if (part.colors)
                    part.colors[n] = mesh->colors[v];
                if (part.texcoords)
                    memcpy(part.texcoords[n], mesh->texcoords[v], sizeof *part.texcoords);
                local[v] = n++;
            }
            part.triangles[t][k] = local[v];
        }
        if (part.materials)
            part.materials[t] = mesh->materials[first + t];
    }
    for (uint32_t t = 0; t < count; t++)
        for (int k = 0; k < 3; k++)
            local[mesh->triangles[first + t][k]] = UINT32_MAX;
    part.vertex_count = n;
    return part;
}

static void write_chunk(struct bsq_ctx *ctx, struct fmt_tris_writer *writer, uint32_t attributes,
                        const struct scan_mesh *part)
{
    struct fmt_tris_chunk chunk = {
        .triangle_count = part->triangle_count,
        .vertex_count = part->vertex_count,
        .positions = (const float(*)[3])part->positions,
        .normals = part->normals,
        .texcoords = (const float(*)[2])part->texcoords,
        .colors = part->colors,
        .triangles = (const uint32_t(*)[3])part->triangles,
        .materials = part->materials,
    };
    struct fmt_tris_chunk_info info;
    uint64_t size = 0;
    void *bytes =
        must_alloc(fmt_tris_encoded_bound(attributes, chunk.triangle_count, chunk.vertex_count), 1);
    assert_int_equal(fmt_tris_encode(ctx, attributes, &chunk, bytes, &size, &info), 0);
    assert_int_equal(fmt_tris_append(writer, bytes, size, &info), 0);
    free(bytes);
}

void scan_write(struct bsq_ctx *ctx, const char *path, const struct scan_mesh *mesh,
                const double origin[3], const struct fmt_tris_material *materials,
                uint32_t material_count, uint32_t chunk_triangles)
{
    struct fmt_tris_writer *writer;
    struct fmt_tris_header header = {
        .attributes =
            (mesh->normals ? FMT_TRIS_NORMALS : 0u) | (mesh->texcoords ? FMT_TRIS_TEXCOORDS : 0u) |
            (mesh->colors ? FMT_TRIS_COLORS : 0u) | (mesh->materials ? FMT_TRIS_MATERIALS : 0u),
        .source_faces = mesh->triangle_count,
        .material_count = material_count,
        .materials = must_alloc(material_count, sizeof *materials),
    };
    if (material_count)
        memcpy(header.materials, materials, material_count * sizeof *materials);
    if (origin)
        memcpy(header.origin, origin, sizeof header.origin);
    bsq_forget_files(ctx); /* which may have read an older file of this name */
    assert_int_equal(fmt_tris_create(ctx, path, &header, &writer), 0);
    uint32_t *local = must_alloc(mesh->vertex_count, sizeof *local);
    memset(local, 0xff, mesh->vertex_count * sizeof *local);
    for (uint32_t first = 0; first < mesh->triangle_count; first += chunk_triangles) {
        uint32_t left = mesh->triangle_count - first;
        struct scan_mesh part =
            extract(mesh, first, left < chunk_triangles ? left : chunk_triangles, local);
        write_chunk(ctx, writer, header.attributes, &part);
        scan_mesh_free(&part);
    }
    if (!mesh->normals)
        assert_int_equal(vox_write_normals(ctx, writer, BSQ_SCAN_NORMALS_SMOOTH, path), 0);
    assert_int_equal(fmt_tris_commit(writer, NULL), 0);
    free(local);
    free(header.materials);
}
