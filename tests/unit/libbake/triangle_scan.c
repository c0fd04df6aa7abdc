/* triangle_scan.c - allocates and writes meshes of tests. */
#include "tests/unit/fixture.h"
#include "tests/unit/libbake/triangle_scan.h"
#include "tests/unit/vertex_normals.h"

struct triangle_scan triangle_scan_new(uint32_t vertices, uint32_t triangles)
{
    return (struct triangle_scan){.vertex_count = vertices,
                                  .triangle_count = triangles,
                                  .positions = calloc(vertices, 12),
                                  .normals = calloc(vertices, 4),
                                  .colors = calloc(vertices, 4),
                                  .texcoords = calloc(vertices, 8),
                                  .materials = calloc(triangles, 4),
                                  .triangles = calloc(triangles, 12)};
}

void triangle_scan_free(struct triangle_scan *scan)
{
    free(scan->positions);
    free(scan->normals);
    free(scan->colors);
    free(scan->texcoords);
    free(scan->materials);
    free(scan->triangles);
}

/* Writes a chunk of the triangles [first, first + count), with vertices renumbered. */
static void append_chunk(struct bsq_ctx *ctx, struct fmt_tris_writer *writer,
                         const struct triangle_scan *scan, uint32_t first, uint32_t count)
{
    struct triangle_scan part = triangle_scan_new(3 * count, count);
    uint32_t *number = malloc(4 * scan->vertex_count);
    memset(number, 0xff, 4 * scan->vertex_count);
    part.vertex_count = 0;
    for (uint32_t t = 0; t < count; t++) {
        part.materials[t] = scan->materials[first + t];
        for (int i = 0; i < 3; i++) {
            uint32_t v = scan->triangles[first + t][i];
            if (number[v] == UINT32_MAX) {
                uint32_t n = number[v] = part.vertex_count++;
                memcpy(part.positions[n], scan->positions[v], 12);
                memcpy(part.texcoords[n], scan->texcoords[v], 8);
                part.normals[n] = scan->normals[v];
                part.colors[n] = scan->colors[v];
            }
            part.triangles[t][i] = number[v];
        }
    }
    const uint32_t has = scan->attributes;
    struct fmt_tris_chunk chunk = {
        .triangle_count = count,
        .vertex_count = part.vertex_count,
        .positions = (const float(*)[3])part.positions,
        .normals = has & FMT_TRIS_NORMALS ? part.normals : NULL,
        .texcoords = has & FMT_TRIS_TEXCOORDS ? (const float(*)[2])part.texcoords : NULL,
        .colors = has & FMT_TRIS_COLORS ? part.colors : NULL,
        .triangles = (const uint32_t(*)[3])part.triangles,
        .materials = has & FMT_TRIS_MATERIALS ? part.materials : NULL};
    uint64_t size, bound = fmt_tris_encoded_bound(has, count, part.vertex_count);
    struct fmt_tris_chunk_info info;
    void *buffer = aligned_alloc(64, (bound + 63) / 64 * 64);
    assert_int_equal(fmt_tris_encode(ctx, has, &chunk, buffer, &size, &info), 0);
    assert_int_equal(fmt_tris_append(writer, buffer, size, &info), 0);
    free(buffer);
    free(number);
    triangle_scan_free(&part);
}

/* ---- vertex normals ---- */

/* A corner at a position: the unit normal of its triangle, and twice its area. */
struct facet {
    double normal[3], area;
};

static double facet_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* A corner of a mesh. */
struct corner {
    float at[3];
    uint32_t triangle, number;
};

static int compare_corners(const void *a, const void *b)
{
    const float *p = ((const struct corner *)a)->at, *q = ((const struct corner *)b)->at;
    for (int k = 0; k < 3; k++)
        if (p[k] != q[k])
            return p[k] < q[k] ? -1 : 1;
    return 0;
}

/* Lists all triangles of the mesh at a position, and returns how many. corners: sorted. */
static uint32_t list_facets(const struct triangle_scan *scan, const struct corner *corners,
                            const float at[3], struct facet *facets)
{
    const struct corner key = {.at = {at[0], at[1], at[2]}},
                        *end = corners + 3 * (size_t)scan->triangle_count;
    const struct corner *c =
        bsearch(&key, corners, 3 * (size_t)scan->triangle_count, sizeof *corners, compare_corners);
    uint32_t count = 0;
    while (c > corners && compare_corners(c - 1, &key) == 0)
        c--;
    for (; c < end && compare_corners(c, &key) == 0; c++) {
        const uint32_t *v = scan->triangles[c->triangle];
        const float *p = scan->positions[v[c->number]],
                    *q = scan->positions[v[(c->number + 1) % 3]],
                    *r = scan->positions[v[(c->number + 2) % 3]];
        struct facet *f = &facets[count++];
        for (int k = 0; k < 3; k++) {
            const int l = (k + 1) % 3, m = (k + 2) % 3;
            f->normal[k] = ((double)q[l] - (double)p[l]) * ((double)r[m] - (double)p[m]) -
                           ((double)q[m] - (double)p[m]) * ((double)r[l] - (double)p[l]);
        }
        f->area = sqrt(facet_dot(f->normal, f->normal));
        for (int k = 0; k < 3 && f->area > 0; k++)
            f->normal[k] /= f->area;
    }
    return count;
}

/* Finds the normals at a position: the mean by area; if facets turn by more than 45 degrees from
 * it, those of the first facet and of the one farthest from that. Returns whether there are two. */
static bool find_normals(const struct triangle_scan *scan, const struct corner *corners,
                         const float at[3], struct facet *facets, uint64_t normals[2])
{
    const uint32_t count = list_facets(scan, corners, at, facets);
    double sum[3] = {0}, least = 1;
    uint32_t farthest = 0;
    bool two = false;
    for (uint32_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++)
            sum[k] += facets[i].area * facets[i].normal[k];
    for (uint32_t i = 0; i < count; i++) {
        two |= facet_dot(sum, facets[i].normal) < sqrt(0.5 * facet_dot(sum, sum));
        if (facet_dot(facets[0].normal, facets[i].normal) < least) {
            least = facet_dot(facets[0].normal, facets[i].normal);
            farthest = i;
        }
    }
    normals[0] = test_pack_normal(two ? facets[0].normal : sum, 0);
    normals[1] = test_pack_normal(facets[farthest].normal, 0);
    return two;
}

/* Writes the section of normals, of the whole mesh. */
static void write_normals(const struct triangle_scan *scan, struct fmt_tris_writer *writer)
{
    struct fmt_tris_file *file;
    assert_int_equal(fmt_tris_normals_begin(writer, BSQ_SCAN_NORMALS_AREA, &file), 0);
    assert_true(scan->triangle_count > 0);
    struct facet *facets = calloc(3 * (size_t)scan->triangle_count, sizeof *facets);
    struct corner *corners = calloc(3 * (size_t)scan->triangle_count, sizeof *corners);
    for (uint32_t i = 0; i < 3 * scan->triangle_count; i++) {
        const float *at = scan->positions[scan->triangles[i / 3][i % 3]];
        corners[i] = (struct corner){{at[0], at[1], at[2]}, i / 3, i % 3};
    }
    qsort(corners, 3 * (size_t)scan->triangle_count, sizeof *corners, compare_corners);
    for (uint64_t c = 0; c < fmt_tris_get_header(file)->chunk_count; c++) {
        struct fmt_tris_chunk chunk;
        void *scratch = malloc(fmt_tris_load_size(file, c));
        assert_int_equal(fmt_tris_load(file, c, scratch, &chunk), 0);
        uint64_t *normals = calloc(3 * (size_t)chunk.vertex_count, sizeof *normals);
        struct fmt_tris_crease *creases =
            (struct fmt_tris_crease *)(void *)(normals + chunk.vertex_count);
        uint32_t count = 0;
        for (uint32_t v = 0; v < chunk.vertex_count; v++) {
            uint64_t both[2];
            if (find_normals(scan, corners, chunk.positions[v], facets, both))
                creases[count++] = (struct fmt_tris_crease){.vertex = v, .second = both[1]};
            normals[v] = both[0];
        }
        assert_int_equal(fmt_tris_normals_put(writer, c, normals), 0);
        assert_int_equal(
            fmt_tris_normals_finish(writer, c, creases, count,
                                    fmt_tris_normals_checksum(normals, chunk.vertex_count, count)),
            0);
        free(normals);
        free(scratch);
    }
    fmt_tris_close(file);
    free(facets);
    free(corners);
}

void triangle_scan_write(const struct triangle_scan *scan, const double origin[3],
                         uint32_t chunk_triangles, const char *path)
{
    struct bsq_ctx *ctx = test_context(0, 0);
    struct fmt_tris_header header = {.attributes = scan->attributes,
                                     .source_faces = scan->triangle_count,
                                     .origin = {origin[0], origin[1], origin[2]},
                                     .material_count = scan->material_count,
                                     .materials =
                                         (struct fmt_tris_material *)(uintptr_t)scan->material};
    struct fmt_tris_writer *writer;
    assert_int_equal(fmt_tris_create(ctx, path, &header, &writer), 0);
    for (uint32_t t = 0; t < scan->triangle_count; t += chunk_triangles) {
        uint32_t left = scan->triangle_count - t;
        append_chunk(ctx, writer, scan, t, left < chunk_triangles ? left : chunk_triangles);
    }
    if (scan->smooth)
        write_normals(scan, writer);
    assert_int_equal(fmt_tris_commit(writer, NULL), 0);
    bsq_ctx_destroy(ctx);
}
