/* tris_load.c - loads single chunks.
 *
 * Loading a chunk checks its checksum, and what that does not prove: indices, bounds, finite
 * numbers. So callers use a chunk without checks of their own. */
#include "formats/chunks/tris_internal.h"

#include <inttypes.h>
#include <string.h>
#include <xxhash.h>

int fmt_tris_read_unchanged(const struct fmt_tris_file *file, void *to, uint64_t bytes,
                            uint64_t offset)
{
    int status = bsq_file_read(file->ctx, &file->file, to, bytes, offset);
    return status == 0 ? bsq_file_check(file->ctx, &file->file) : status;
}

uint64_t fmt_tris_load_size(const struct fmt_tris_file *file, uint64_t index)
{
    return file->parts ? fmt_tris_part_load_size(file, index)
                       : tris_load_size(file->header.attributes, &file->chunks[index]);
}

uint64_t fmt_tris_load_size_max(const struct fmt_tris_file *file)
{
    return file->load_size_max;
}

/* Indices that are widened in one step. */
enum { WIDEN_STEP = 8 };

typedef uint16_t short_indices __attribute__((vector_size(2 * WIDEN_STEP)));
typedef uint32_t wide_indices __attribute__((vector_size(4 * WIDEN_STEP)));

/* Widens `count` indices from `first` on, at most WIDEN_STEP. Returns the larger ones of these and
 * of `max`. */
static inline short_indices widen_step(uint8_t *stored, uint64_t first, uint64_t count,
                                       short_indices max)
{
    short_indices from = {0};
    memcpy(&from, stored + first * sizeof from[0], count * sizeof from[0]);
    const wide_indices to = __builtin_convertvector(from, wide_indices);
    memcpy(stored + first * sizeof to[0], &to, count * sizeof to[0]);
    const short_indices larger = (short_indices)(from > max);
    return (from & larger) | (max & ~larger);
}

/* Widens indices from 16 to 32 bits in place, from the last to the first: the scratch memory has
 * space after them. Returns the largest index. */
static uint32_t widen_indices(uint8_t *stored, uint32_t count)
{
    uint64_t first = count - count % WIDEN_STEP;
    uint32_t largest = 0;
    short_indices max = widen_step(stored, first, count - first, (short_indices){0});
    while (first > 0) {
        first -= WIDEN_STEP;
        max = widen_step(stored, first, WIDEN_STEP, max);
    }
    for (int i = 0; i < WIDEN_STEP; i++)
        largest = max[i] > largest ? max[i] : largest;
    return largest;
}

static uint32_t largest_index(const uint32_t *indices, uint32_t count)
{
    uint32_t max = 0;
    for (uint32_t i = 0; i < count; i++)
        max = indices[i] > max ? indices[i] : max;
    return max;
}

static bool positions_inside(const struct fmt_tris_chunk *chunk,
                             const struct fmt_tris_chunk_info *info)
{
    int outside = 0;
    for (uint32_t v = 0; v < chunk->vertex_count; v++)
        for (int axis = 0; axis < 3; axis++) {
            float p = chunk->positions[v][axis];
            /* NaN fails both comparisons. */
            outside |= !(p >= info->bounds_min[axis]) | !(p <= info->bounds_max[axis]);
        }
    return !outside;
}

static bool texcoords_finite(const struct fmt_tris_chunk *chunk)
{
    float poison = 0.0f;
    for (uint32_t v = 0; v < chunk->vertex_count; v++)
        poison += chunk->texcoords[v][0] * 0.0f + chunk->texcoords[v][1] * 0.0f;
    return poison == 0.0f;
}

static bool materials_known(const struct fmt_tris_chunk *chunk, uint32_t material_count)
{
    int unknown = 0;
    for (uint32_t t = 0; t < chunk->triangle_count; t++)
        unknown |= (chunk->materials[t] >= material_count) & (chunk->materials[t] != UINT32_MAX);
    return !unknown;
}

int fmt_tris_damaged_chunk(const struct fmt_tris_file *file, uint64_t index, const char *what)
{
    return bsq_fail(file->ctx, BSQ_EDATA, "%s: damaged chunk file: chunk %" PRIu64 ": %s",
                    file->file.path, index, what);
}

/* Points the chunk at its parts in the bytes that were read. */
static void place_chunk(struct fmt_tris_chunk *out, const uint8_t *bytes,
                        const struct tris_layout *l, uint32_t attributes)
{
    out->positions = (const float(*)[3])(const void *)(bytes + l->positions);
    if (attributes & FMT_TRIS_NORMALS)
        out->normals = (const uint32_t *)(const void *)(bytes + l->normals);
    if (attributes & FMT_TRIS_TEXCOORDS)
        out->texcoords = (const float(*)[2])(const void *)(bytes + l->texcoords);
    if (attributes & FMT_TRIS_COLORS)
        out->colors = (const uint32_t *)(const void *)(bytes + l->colors);
    if (attributes & FMT_TRIS_MATERIALS)
        out->materials = (const uint32_t *)(const void *)(bytes + l->materials);
    out->triangles = (const uint32_t(*)[3])(const void *)(bytes + l->triangles);
}

static bool all_zero(const uint8_t *bytes, uint64_t count)
{
    uint8_t any = 0;
    for (uint64_t i = 0; i < count; i++)
        any |= bytes[i];
    return any == 0;
}

int fmt_tris_load(const struct fmt_tris_file *file, uint64_t index, void *scratch,
                  struct fmt_tris_chunk *out)
{
    if (file->parts)
        return fmt_tris_load_part(file, index, scratch, out);
    const struct fmt_tris_chunk_info *info = &file->chunks[index];
    const uint32_t attributes = file->header.attributes;
    struct tris_layout l = tris_chunk_layout(attributes, info->triangle_count, info->vertex_count);
    uint8_t *bytes = scratch;
    memset(out, 0, sizeof *out);
    int status = fmt_tris_read_unchanged(file, bytes, l.bytes, info->offset);
    if (status < 0)
        return status;
    struct tris_chunk_header header;
    memcpy(&header, bytes, sizeof header);
    if (XXH3_64bits(bytes + 8, l.bytes - 8) != header.checksum)
        return fmt_tris_damaged_chunk(file, index, "the checksum does not match");
    if (header.triangle_count != info->triangle_count || header.vertex_count != info->vertex_count)
        return fmt_tris_damaged_chunk(file, index, "its counts are not those of the table");
    if (!all_zero(bytes + l.end, l.bytes - l.end))
        return fmt_tris_damaged_chunk(file, index, "its padding is not zero");
    out->triangle_count = info->triangle_count;
    out->vertex_count = info->vertex_count;
    place_chunk(out, bytes, &l, attributes);
    uint32_t max = l.short_indices ? widen_indices(bytes + l.triangles, 3 * info->triangle_count)
                                   : largest_index(out->triangles[0], 3 * info->triangle_count);
    if (max >= info->vertex_count)
        return fmt_tris_damaged_chunk(file, index, "an index is out of range");
    if (!positions_inside(out, info))
        return fmt_tris_damaged_chunk(file, index, "a vertex is outside of the bounds");
    if (out->texcoords && !texcoords_finite(out))
        return fmt_tris_damaged_chunk(file, index, "a texture coordinate is not finite");
    if (out->materials && !materials_known(out, file->header.material_count))
        return fmt_tris_damaged_chunk(file, index, "a material number is out of range");
    return 0;
}
