/* tris_encode.c - turns the arrays of a chunk into the bytes of the file.
 *
 * Attributes are stored as successive arrays, so that a reader can use them in place. Only indices
 * change: they are stored in 16 bits if the vertex count allows it. Encoding needs no state, so
 * workers encode chunks while one thread appends them. */
#include "formats/chunks/tris_internal.h"

#include <math.h>
#include <string.h>
#include <xxhash.h>

uint64_t fmt_tris_encoded_bound(uint32_t attributes, uint32_t triangle_count, uint32_t vertex_count)
{
    return tris_chunk_layout(attributes, triangle_count, vertex_count).bytes;
}

static int chunk_bounds(struct bsq_ctx *ctx, const struct fmt_tris_chunk *chunk,
                        struct fmt_tris_chunk_info *info)
{
    for (int axis = 0; axis < 3; axis++) {
        info->bounds_min[axis] = INFINITY;
        info->bounds_max[axis] = -INFINITY;
    }
    float poison = 0.0f; /* becomes NaN with the first value that is not finite */
    for (uint32_t v = 0; v < chunk->vertex_count; v++)
        for (int axis = 0; axis < 3; axis++) {
            float p = chunk->positions[v][axis];
            poison += p * 0.0f;
            info->bounds_min[axis] = p < info->bounds_min[axis] ? p : info->bounds_min[axis];
            info->bounds_max[axis] = p > info->bounds_max[axis] ? p : info->bounds_max[axis];
        }
    if (poison != 0.0f)
        return bsq_fail(ctx, BSQ_EBUG, "a chunk has a vertex position that is not finite");
    return 0;
}

static int store_indices(struct bsq_ctx *ctx, const struct fmt_tris_chunk *chunk,
                         const struct tris_layout *layout, uint8_t *to)
{
    const uint32_t *from = &chunk->triangles[0][0];
    uint32_t count = 3 * chunk->triangle_count, max = 0;
    for (uint32_t i = 0; i < count; i++)
        max = from[i] > max ? from[i] : max;
    if (max >= chunk->vertex_count)
        return bsq_fail(ctx, BSQ_EBUG, "a chunk refers to vertex %u, it has %u", max,
                        chunk->vertex_count);
    if (layout->short_indices) {
        uint16_t *indices = (uint16_t *)(void *)to;
        for (uint32_t i = 0; i < count; i++)
            indices[i] = (uint16_t)from[i];
    } else {
        memcpy(to, from, (size_t)count * 4);
    }
    return 0;
}

int fmt_tris_encode(struct bsq_ctx *ctx, uint32_t attributes, const struct fmt_tris_chunk *chunk,
                    void *buffer, uint64_t *size, struct fmt_tris_chunk_info *info)
{
    uint32_t nt = chunk->triangle_count, nv = chunk->vertex_count;
    if (nt == 0 || nt > FMT_TRIS_CHUNK_TRIANGLES || nv == 0 || nv > 3 * nt)
        return bsq_fail(ctx, BSQ_EBUG, "a chunk of %u triangles and %u vertices", nt, nv);
    struct tris_layout l = tris_chunk_layout(attributes, nt, nv);
    uint8_t *bytes = buffer;
    int status;
    memset(info, 0, sizeof *info);
    if ((status = chunk_bounds(ctx, chunk, info)) < 0)
        return status;
    memcpy(bytes + l.positions, chunk->positions, (size_t)12 * nv);
    if (attributes & FMT_TRIS_NORMALS)
        memcpy(bytes + l.normals, chunk->normals, (size_t)4 * nv);
    if (attributes & FMT_TRIS_TEXCOORDS)
        memcpy(bytes + l.texcoords, chunk->texcoords, (size_t)8 * nv);
    if (attributes & FMT_TRIS_COLORS)
        memcpy(bytes + l.colors, chunk->colors, (size_t)4 * nv);
    if (attributes & FMT_TRIS_MATERIALS)
        memcpy(bytes + l.materials, chunk->materials, (size_t)4 * nt);
    if ((status = store_indices(ctx, chunk, &l, bytes + l.triangles)) < 0)
        return status;
    memset(bytes + l.end, 0, l.bytes - l.end);
    struct tris_chunk_header header = {0, nt, nv};
    memcpy(bytes, &header, sizeof header);
    header.checksum = XXH3_64bits(bytes + 8, l.bytes - 8);
    memcpy(bytes, &header, sizeof header);
    info->size_bytes = *size = l.bytes;
    info->triangle_count = nt;
    info->vertex_count = nv;
    return 0;
}
