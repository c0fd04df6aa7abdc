/* arrays.c - gives arrays of a Python process as the bytes of a binary PLY file, piece by piece, so
 * that a scan in memory needs no copy and no file; and looks up points of an image. Part of the
 * extension, see ffi_build.py. */
#include <stdint.h>
#include <string.h>

#include "formats/texture/texture.h"

/* The rows of an array follow each other at `step` bytes. */
struct rows {
    const char *first;
    ptrdiff_t step;
};

struct arrays {
    const char *header;
    uint64_t header_bytes, vertex_count, face_count;
    struct rows positions, normals, colors, faces; /* normals, colors: first may be NULL */
    unsigned position_bytes;                       /* of a coordinate: 4 or 8 */
    unsigned index_bytes;                          /* of an index: 4 or 8 */
};

enum { NORMAL_BYTES = 12, COLOR_BYTES = 3, FACE_BYTES = 13, MOST_BYTES = 64 };

static unsigned vertex_bytes(const struct arrays *a)
{
    return 3 * a->position_bytes + (a->normals.first ? NORMAL_BYTES : 0) +
           (a->colors.first ? COLOR_BYTES : 0);
}

static uint64_t arrays_size(const struct arrays *a)
{
    return a->header_bytes + a->vertex_count * vertex_bytes(a) + a->face_count * FACE_BYTES;
}

static char *put(char *to, const struct rows *rows, uint64_t row, size_t bytes)
{
    if (rows->first)
        memcpy(to, rows->first + (ptrdiff_t)row * rows->step, bytes);
    return rows->first ? to + bytes : to;
}

static void put_vertex(const struct arrays *a, uint64_t v, char *to)
{
    to = put(to, &a->positions, v, 3 * a->position_bytes);
    to = put(to, &a->normals, v, NORMAL_BYTES);
    put(to, &a->colors, v, COLOR_BYTES);
}

static void put_face(const struct arrays *a, uint64_t face, char *to)
{
    const char *from = a->faces.first + (ptrdiff_t)face * a->faces.step;
    uint64_t wide[3];
    uint32_t indices[3];
    *to = 3;
    if (a->index_bytes == 4) {
        memcpy(to + 1, from, sizeof indices);
        return;
    }
    memcpy(wide, from, sizeof wide);
    for (int k = 0; k < 3; k++) /* the reader refuses what does not fit */
        indices[k] = wide[k] < UINT32_MAX ? (uint32_t)wide[k] : UINT32_MAX;
    memcpy(to + 1, indices, sizeof indices);
}

/* Copies bytes of elements of `size` bytes, of which `offset` counts from the first. Returns how
 * many there were to copy. */
static uint64_t give(const struct arrays *a, void (*one)(const struct arrays *, uint64_t, char *),
                     uint64_t elements, unsigned size, char *to, uint64_t count, uint64_t offset)
{
    char element[MOST_BYTES];
    uint64_t given = 0;
    for (uint64_t i = offset / size; i < elements && given < count; i++) {
        const uint64_t skip = given == 0 ? offset % size : 0;
        const uint64_t bytes = size - skip < count - given ? size - skip : count - given;
        if (bytes == size) {
            one(a, i, to + given);
        } else {
            one(a, i, element);
            memcpy(to + given, element + skip, bytes);
        }
        given += bytes;
    }
    return given;
}

/* Implements the callback of struct bsq_source. */
static int arrays_read(void *user, void *to, uint64_t count, uint64_t offset)
{
    const struct arrays *a = user;
    const uint64_t vertices = a->vertex_count * vertex_bytes(a);
    char *at = to;
    if (offset < a->header_bytes) {
        const uint64_t left = a->header_bytes - offset, bytes = left < count ? left : count;
        memcpy(at, a->header + offset, bytes);
        at += bytes, count -= bytes, offset += bytes;
    }
    offset -= a->header_bytes;
    if (count > 0 && offset < vertices) {
        const uint64_t given =
            give(a, put_vertex, a->vertex_count, vertex_bytes(a), at, count, offset);
        at += given, count -= given, offset += given;
    }
    if (count > 0)
        give(a, put_face, a->face_count, FACE_BYTES, at, count, offset - vertices);
    return 0;
}

/* Filters an image bilinearly at `count` points, from its lower left corner; beyond its border,
 * texels at the border count. cache_bytes, data, alpha, errors: as in formats/texture/texture.h. */
static int arrays_sample(struct bsq_ctx *ctx, const char *path, bool data, bool alpha,
                         uint64_t cache_bytes, uint64_t count, const float (*uv)[2],
                         float (*out)[3])
{
    static const uint8_t clamp[2] = {FMT_WRAP_CLAMP, FMT_WRAP_CLAMP};
    const struct fmt_texture_source source = {
        .path = path, .data = data, .srgb = !data, .alpha = alpha};
    struct fmt_textures *textures = NULL;
    int status = fmt_textures_open(ctx, 1, fmt_texture_source_at, &source, cache_bytes, &textures);
    for (uint64_t i = 0; status == 0 && i < count; i++)
        status = fmt_texture_sample(textures, 0, clamp, uv[i][0], uv[i][1], 0, 0, out[i]);
    fmt_textures_close(textures);
    return status;
}
