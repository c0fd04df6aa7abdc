/* tris_load.c - loads single chunks, and verifies whole files.
 *
 * Loading a chunk checks its checksum, and what that does not prove: indices, bounds, finite
 * numbers. So callers use a chunk without checks of their own. Verifying adds what only a faulty
 * writer gets wrong: bounds larger than their content, unused vertices, invalid normals and
 * colours. */
#include "formats/chunks/tris_internal.h"

#include <assert.h>
#include <inttypes.h>
#include <xxhash.h>

#include "base/geometry/vertex_normal.h"
#include "base/parallel.h"

int fmt_tris_read_unchanged(const struct fmt_tris_file *file, void *to, uint64_t bytes,
                            uint64_t offset)
{
    int status = bsq_file_read(file->ctx, &file->file, to, bytes, offset);
    return status == 0 ? bsq_file_check(file->ctx, &file->file) : status;
}

uint64_t fmt_tris_load_size(const struct fmt_tris_file *file, uint64_t index)
{
    return tris_load_size(file->header.attributes, &file->chunks[index]);
}

uint64_t fmt_tris_load_size_max(const struct fmt_tris_file *file)
{
    return file->load_size_max;
}

void fmt_tris_read_ahead(const struct fmt_tris_file *file, uint64_t index)
{
    bsq_file_read_ahead(&file->file, file->chunks[index].size_bytes, file->chunks[index].offset);
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
    out->positions = (const float(*)[3])(const void *)bytes;
    for (int i = 0; i < TRIS_ATTRIBUTE_COUNT; i++) {
        const void *values = bytes + l->values[i];
        if (attributes & fmt_tris_attributes[i].flag)
            memcpy((char *)out + fmt_tris_attributes[i].member, &values, sizeof values);
    }
    out->triangles = (const uint32_t(*)[3])(const void *)(bytes + l->triangles);
}

static bool tris_all_zero(const uint8_t *bytes, uint64_t count)
{
    uint8_t any = 0;
    for (uint64_t i = 0; i < count; i++)
        any |= bytes[i];
    return any == 0;
}

int fmt_tris_load(const struct fmt_tris_file *file, uint64_t index, void *scratch,
                  struct fmt_tris_chunk *out)
{
    const struct fmt_tris_chunk_info *info = &file->chunks[index];
    const uint32_t attributes = file->header.attributes;
    struct tris_layout l = tris_chunk_layout(attributes, info->triangle_count, info->vertex_count);
    uint8_t *bytes = scratch;
    memset(out, 0, sizeof *out);
    BSQ_PASS(fmt_tris_read_unchanged(file, bytes, l.bytes, info->offset));
    if (!file->own && XXH3_64bits(bytes, l.bytes) != info->checksum)
        return fmt_tris_damaged_chunk(file, index, "the checksum does not match");
    if (!tris_all_zero(bytes + l.end, l.bytes - l.end))
        return fmt_tris_damaged_chunk(file, index, "its padding is not zero");
    out->triangle_count = info->triangle_count;
    out->vertex_count = info->vertex_count;
    place_chunk(out, bytes, &l, attributes);
    uint32_t max = l.short_indices ? widen_indices(bytes + l.triangles, 3 * info->triangle_count)
                                   : largest_index(out->triangles[0], 3 * info->triangle_count);
    if (max >= info->vertex_count)
        return fmt_tris_damaged_chunk(file, index, "an index is out of range");
    if (file->own)
        return 0;
    if (!positions_inside(out, info))
        return fmt_tris_damaged_chunk(file, index, "a vertex is outside of the bounds");
    if (out->texcoords && !texcoords_finite(out))
        return fmt_tris_damaged_chunk(file, index, "a texture coordinate is not finite");
    if (out->materials && !materials_known(out, file->header.material_count))
        return fmt_tris_damaged_chunk(file, index, "a material number is out of range");
    return 0;
}

/* ---- verifying ---- */

struct verify {
    const struct fmt_tris_file *file;
    struct bsq_ctx *ctx;
    uint8_t *scratch; /* for each worker: a chunk, then a byte for each of its vertices */
    uint64_t chunk_bytes, worker_bytes;
};

static bool bounds_exact(const struct fmt_tris_chunk *chunk, const struct fmt_tris_chunk_info *info)
{
    for (int axis = 0; axis < 3; axis++) {
        float min = chunk->positions[0][axis], max = min;
        for (uint32_t v = 1; v < chunk->vertex_count; v++) {
            float p = chunk->positions[v][axis];
            min = p < min ? p : min;
            max = p > max ? p : max;
        }
        if (min != info->bounds_min[axis] || max != info->bounds_max[axis])
            return false;
    }
    return true;
}

static bool all_used(const struct fmt_tris_chunk *chunk, uint8_t *used)
{
    uint32_t count = 0;
    memset(used, 0, chunk->vertex_count);
    for (uint32_t t = 0; t < chunk->triangle_count; t++)
        for (int corner = 0; corner < 3; corner++)
            used[chunk->triangles[t][corner]] = 1;
    for (uint32_t v = 0; v < chunk->vertex_count; v++)
        count += used[v];
    return count == chunk->vertex_count;
}

static bool normals_valid(const struct fmt_tris_chunk *chunk)
{
    int wrong = 0;
    for (uint32_t v = 0; chunk->normals && v < chunk->vertex_count; v++)
        wrong |= ((chunk->normals[v] & 0xffff) == 0x8000) | (chunk->normals[v] >> 16 == 0x8000);
    return !wrong;
}

/* Returns whether the bits of colours that mean nothing are as they must be. */
static bool colors_opaque(const struct fmt_tris_chunk *chunk)
{
    uint32_t all = UINT32_MAX;
    for (uint32_t v = 0; chunk->colors && v < chunk->vertex_count; v++)
        all &= chunk->colors[v] & (chunk->fine_colors ? ~(chunk->fine_colors[v] >> 6) : UINT32_MAX);
    return all >> 24 == 255;
}

/* Returns what is wrong with a chunk, or NULL. */
static const char *tris_fault_of(const struct fmt_tris_chunk *chunk,
                                 const struct fmt_tris_chunk_info *info, uint8_t *used)
{
    const uint64_t sample_bytes = tris_sample_bytes(chunk->triangle_count);
    if (!bounds_exact(chunk, info))
        return "its bounds are not those of its vertices";
    if (!all_used(chunk, used))
        return "a vertex is not used";
    if (chunk->samples && XXH3_64bits(chunk->samples, sample_bytes) != info->sample_checksum)
        return "its sample's checksum does not match";
    if (chunk->samples && !fmt_tris_sample_valid(chunk->samples, chunk->triangle_count))
        return "a record of its sample is not valid";
    if (!normals_valid(chunk))
        return "a normal is not valid";
    return colors_opaque(chunk) ? NULL : "a colour is not opaque";
}

/* Verifies the made normals of a chunk. */
static int verify_made_normals(const struct verify *v, uint64_t index, uint8_t *bytes)
{
    struct fmt_tris_normals normals;
    bool valid = true;
    BSQ_PASS(fmt_tris_load_normals(v->file, index, bytes, &normals));
    for (uint32_t i = 0; i < v->file->chunks[index].vertex_count; i++)
        valid &= bsq_vertex_normal_valid(normals.vertices[i]);
    for (uint32_t i = 0; i < normals.crease_count; i++)
        valid &= bsq_vertex_normal_valid(normals.creases[i].second);
    return valid ? 0 : fmt_tris_damaged_chunk(v->file, index, "a made normal is not valid");
}

static int verify_chunk(void *arg, uint64_t index, unsigned worker)
{
    const struct verify *v = arg;
    const struct fmt_tris_chunk_info *info = &v->file->chunks[index];
    uint8_t *bytes = v->scratch + worker * v->worker_bytes;
    struct fmt_tris_chunk chunk = {0};
    BSQ_PASS(bsq_check(v->ctx));
    BSQ_PASS(fmt_tris_load(v->file, index, bytes, &chunk));
    assert(chunk.positions && chunk.triangles);
    const char *fault = tris_fault_of(&chunk, info, bytes + v->chunk_bytes);
    bsq_progress_add(v->ctx, info->size_bytes);
    if (fault)
        return fmt_tris_damaged_chunk(v->file, index, fault);
    return v->file->header.made_normals != 0 ? verify_made_normals(v, index, bytes) : 0;
}

/* Checks that the header's bounds are exactly those of all chunks. */
static int verify_bounds(const struct verify *v)
{
    const struct fmt_tris_header *h = &v->file->header;
    const struct fmt_tris_chunk_info *infos = v->file->chunks;
    for (int axis = 0; axis < 3; axis++) {
        float min = h->chunk_count ? infos[0].bounds_min[axis] : 0.0f;
        float max = h->chunk_count ? infos[0].bounds_max[axis] : 0.0f;
        for (uint64_t i = 1; i < h->chunk_count; i++) {
            min = infos[i].bounds_min[axis] < min ? infos[i].bounds_min[axis] : min;
            max = infos[i].bounds_max[axis] > max ? infos[i].bounds_max[axis] : max;
        }
        if (min != h->bounds_min[axis] || max != h->bounds_max[axis])
            return fmt_tris_damaged(v->file, "the header's bounds are not those of the chunks");
    }
    return 0;
}

static int verify_images(const struct verify *v)
{
    const uint64_t end = v->file->chunks_offset;
    uint8_t buffer[16384];
    int status = 0;
    XXH3_state_t *hash = XXH3_createState();
    if (!hash || XXH3_64bits_reset(hash) != XXH_OK)
        BSQ_TRY(bsq_fail(v->ctx, BSQ_ENOMEM, "no memory for the checksum of images"));
    for (uint64_t at = sizeof(struct tris_file_header), size; at < end; at += size) {
        size = end - at < sizeof buffer ? end - at : sizeof buffer;
        BSQ_TRY(bsq_check(v->ctx));
        BSQ_TRY(fmt_tris_read_unchanged(v->file, buffer, size, at));
        XXH3_64bits_update(hash, buffer, size);
    }
    if (XXH3_64bits_digest(hash) != v->file->images_checksum)
        status = fmt_tris_damaged(v->file, "the images' checksum does not match");
done:
    XXH3_freeState(hash);
    return status;
}

static int verify_chunks(struct verify *v, uint64_t count)
{
    const unsigned workers = bsq_workers_within(v->ctx, bsq_threads(v->ctx), v->worker_bytes);
    int status = bsq_alloc(v->ctx, "chunks", workers, v->worker_bytes, &v->scratch);
    if (status == 0)
        status = bsq_parallel_on(v->ctx, workers, count, verify_chunk, v);
    bsq_free(v->ctx, v->scratch);
    return status;
}

int fmt_tris_verify(const struct fmt_tris_file *file, uint64_t *vertices)
{
    const struct fmt_tris_header *header = &file->header;
    const struct fmt_tris_chunk_info *infos = file->chunks;
    uint64_t sum = 0, most = 0;
    for (uint64_t i = 0; i < header->chunk_count; i++) {
        sum += infos[i].vertex_count;
        most = infos[i].vertex_count > most ? infos[i].vertex_count : most;
    }
    struct verify v = {.file = file, .ctx = file->ctx};
    v.chunk_bytes = bsq_align_up(fmt_tris_load_size_max(file), 8);
    if (v.chunk_bytes < file->normals_size_max)
        v.chunk_bytes = file->normals_size_max;
    v.worker_bytes = v.chunk_bytes + bsq_align_up(most, 8);
    int status = verify_bounds(&v);
    if (status == 0)
        status = verify_images(&v);
    if (status == 0 && header->chunk_count > 0)
        status = verify_chunks(&v, header->chunk_count);
    if (vertices)
        *vertices = sum;
    return status;
}
