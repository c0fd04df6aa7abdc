/* tris_verify.c - checks a whole chunk file.
 *
 * fmt_tris_load() checks what a reader needs to be safe. This adds what only a faulty writer gets
 * wrong: bounds larger than their content, unused vertices, invalid normals and colours. */
#include "base/parallel.h"
#include "formats/chunks/tris_internal.h"

#include <assert.h>
#include <inttypes.h>
#include <string.h>

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

static bool colors_opaque(const struct fmt_tris_chunk *chunk)
{
    uint32_t all = UINT32_MAX;
    for (uint32_t v = 0; chunk->colors && v < chunk->vertex_count; v++)
        all &= chunk->colors[v];
    return all >> 24 == 255;
}

/* Returns what is wrong with a chunk, or NULL. */
static const char *fault_of(const struct fmt_tris_chunk *chunk,
                            const struct fmt_tris_chunk_info *info, uint8_t *used)
{
    if (!bounds_exact(chunk, info))
        return "its bounds are not those of its vertices";
    if (!all_used(chunk, used))
        return "a vertex is not used";
    if (!normals_valid(chunk))
        return "a normal is not valid";
    return colors_opaque(chunk) ? NULL : "a colour is not opaque";
}

static int verify_chunk(void *arg, uint64_t index, unsigned worker)
{
    const struct verify *v = arg;
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(v->file)[index];
    uint8_t *bytes = v->scratch + worker * v->worker_bytes;
    struct fmt_tris_chunk chunk = {0};
    int status = bsq_check(v->ctx);
    if (status == 0)
        status = fmt_tris_load(v->file, index, bytes, &chunk);
    if (status < 0)
        return status;
    assert(chunk.positions && chunk.triangles);
    const char *fault = fault_of(&chunk, info, bytes + v->chunk_bytes);
    bsq_progress_add(v->ctx, info->size_bytes);
    return fault ? fmt_tris_damaged_chunk(v->file, index, fault) : 0;
}

/* Checks that the header's bounds are exactly those of all chunks. */
static int verify_bounds(const struct verify *v)
{
    const struct fmt_tris_header *h = fmt_tris_get_header(v->file);
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(v->file);
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

static int verify_chunks(struct verify *v, uint64_t count)
{
    bool parallel = bsq_memory_left(v->ctx) / bsq_threads(v->ctx) >= v->worker_bytes;
    int status = bsq_alloc(v->ctx, "chunks", parallel ? bsq_threads(v->ctx) : 1, v->worker_bytes,
                           &v->scratch);
    if (status == 0 && parallel)
        status = bsq_parallel_for(v->ctx, count, verify_chunk, v);
    for (uint64_t i = 0; i < count && !parallel && status == 0; i++)
        status = verify_chunk(v, i, 0);
    bsq_free(v->ctx, v->scratch);
    return status;
}

int fmt_tris_verify(const struct fmt_tris_file *file, uint64_t *vertices)
{
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(file);
    uint64_t sum = 0, most = 0;
    for (uint64_t i = 0; i < header->chunk_count; i++) {
        sum += infos[i].vertex_count;
        most = infos[i].vertex_count > most ? infos[i].vertex_count : most;
    }
    struct verify v = {.file = file, .ctx = fmt_tris_context(file)};
    v.chunk_bytes = bsq_align_up(fmt_tris_load_size_max(file), 8);
    v.worker_bytes = v.chunk_bytes + bsq_align_up(most, 8);
    int status = verify_bounds(&v);
    if (status == 0 && header->chunk_count > 0)
        status = verify_chunks(&v, header->chunk_count);
    if (vertices)
        *vertices = sum;
    return status;
}
