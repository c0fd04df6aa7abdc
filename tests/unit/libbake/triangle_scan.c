/* triangle_scan.c - allocates and writes meshes of tests. */
#include "tests/unit/fixture.h"
#include "tests/unit/libbake/triangle_scan.h"

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
    assert_int_equal(fmt_tris_commit(writer, NULL), 0);
    bsq_ctx_destroy(ctx);
}
