/* normals.c - makes the vertex normals of a chunk file, in three steps.
 *
 * All chunks are gone through once (normals_chunk.c). Most vertices are inside their chunk, and get
 * their normals there. The triangles of the others go to buckets by position, where they are summed
 * (normals_open.c). At last the answers go to their chunks, with all creases. */
#include "libvoxel/normals/normals_run.h"

#include <string.h>

#include "base/parallel.h"
#include "base/sort_array.h"

enum {
    VERTICES_A_BUCKET = 65536,
    MOST_BUCKETS = 1024,
    MOST_ANSWER_BUCKETS = 4096,
    PAGE_BYTES = 4096,
    ANSWERS = 1024, /* that are read at a time */
    SLOTS = 2       /* a thread */
};

int vox_normals_answer(struct normals_run *run, const struct normals_answer *answer)
{
    return bsq_spill_add(&run->answers, answer->chunk / run->answer_chunks, answer, sizeof *answer);
}

/* ---- the answers of a chunk ---- */

/* A chunk whose normals are completed: that of the slot's sequence number. */
struct answer_slot {
    struct normals_answer *answers; /* ANSWERS */
    /* Vertices, then creases. */
    uint64_t *normals;
    uint64_t normals_capacity;
    uint32_t crease_count;
    uint64_t checksum;
};

int vox_normals_produce(void *arg, void *slot, uint64_t chunk)
{
    (void)slot;
    return chunk < ((const struct normals_run *)arg)->chunk_count;
}

static int compare_creases(const void *a, const void *b)
{
    const uint32_t x = ((const struct fmt_tris_crease *)a)->vertex,
                   y = ((const struct fmt_tris_crease *)b)->vertex;
    return (x > y) - (x < y);
}

/* Takes an answer that is for the slot's chunk. */
static int take_answer(struct normals_run *run, struct answer_slot *s,
                       const struct normals_answer *answer)
{
    const uint32_t vertex = answer->vertex & ~ANSWER_CREASE;
    const uint64_t vertices = run->infos[answer->chunk].vertex_count;
    const struct fmt_tris_crease crease = {.vertex = vertex, .second = answer->second};
    const uint64_t words = sizeof crease / sizeof *s->normals;
    int status = 0;
    s->normals[vertex] = answer->first;
    if (!(answer->vertex & ANSWER_CREASE))
        return 0;
    status = BSQ_GROW(run->ctx, "creases", vertices + words * (s->crease_count + UINT64_C(1)),
                      &s->normals, &s->normals_capacity);
    if (status == 0)
        memcpy(&s->normals[vertices + words * s->crease_count++], &crease, sizeof crease);
    return status;
}

/* Takes all answers for a chunk. */
static int take_answers(struct normals_run *run, uint64_t chunk, struct answer_slot *s,
                        bool *changed)
{
    const uint32_t bucket = (uint32_t)(chunk / run->answer_chunks);
    const uint64_t count = run->answers.list[bucket].bytes / sizeof *s->answers;
    struct bsq_spill_cursor cursor = {0};
    for (uint64_t first = 0; first < count; first += ANSWERS) {
        const uint64_t some = count - first < ANSWERS ? count - first : ANSWERS;
        BSQ_PASS(bsq_spill_read(&run->answers, bucket, first * sizeof *s->answers,
                                some * sizeof *s->answers, s->answers, &cursor));
        for (uint64_t i = 0; i < some; i++)
            if (s->answers[i].chunk == chunk) {
                BSQ_PASS(take_answer(run, s, &s->answers[i]));
                *changed = true;
            }
    }
    return 0;
}

static int answer_work(void *arg, void *slot, uint64_t chunk, unsigned worker)
{
    struct normals_run *run = arg;
    struct answer_slot *s = slot;
    const uint32_t vertices = run->infos[chunk].vertex_count;
    bool changed = false;
    (void)worker;
    s->crease_count = 0;
    BSQ_PASS(BSQ_GROW(run->ctx, "normals", vertices, &s->normals, &s->normals_capacity));
    BSQ_PASS(fmt_tris_normals_get(run->file, chunk, s->normals));
    BSQ_PASS(take_answers(run, chunk, s, &changed));
    bsq_sort(s->normals + vertices, s->crease_count, sizeof(struct fmt_tris_crease),
             compare_creases);
    s->checksum = fmt_tris_normals_checksum(s->normals, vertices, s->crease_count);
    if (changed)
        return fmt_tris_normals_put(run->writer, chunk, s->normals);
    return 0;
}

static int answer_emit(void *arg, void *slot, uint64_t chunk)
{
    const struct normals_run *run = arg;
    const struct answer_slot *s = slot;
    const void *creases = s->normals + run->infos[chunk].vertex_count;
    bsq_progress_add(run->ctx, 1);
    return fmt_tris_normals_finish(run->writer, chunk, creases, s->crease_count, s->checksum);
}

/* Completes the normals of all chunks. */
static int complete_chunks(struct normals_run *run)
{
    struct answer_slot *slots = NULL;
    const uint64_t count = (uint64_t)SLOTS * bsq_threads(run->ctx);
    int status;
    BSQ_TRY(BSQ_CALLOC(run->ctx, "normals", count, &slots));
    for (uint64_t i = 0; i < count; i++)
        BSQ_TRY(BSQ_ALLOC(run->ctx, "normals", ANSWERS, &slots[i].answers));
    const struct bsq_pipeline pipeline = {.produce = vox_normals_produce,
                                          .work = answer_work,
                                          .emit = answer_emit,
                                          .arg = run,
                                          .slots = slots,
                                          .slot_size = sizeof *slots,
                                          .slot_count = (unsigned)count};
    status = bsq_pipeline_run(run->ctx, &pipeline);
done:
    for (uint64_t i = 0; slots && i < count; i++) {
        BSQ_FREE(run->ctx, slots[i].answers, slots[i].normals);
    }
    bsq_free(run->ctx, slots);
    return status;
}

/* ---- the whole ---- */

/* Makes the buckets: their number depends on the scan only. */
static int normals_make_buckets(struct normals_run *run, const char *beside)
{
    const uint64_t pages = bsq_memory_left(run->ctx) / 4;
    uint64_t vertices = 0;
    for (uint64_t i = 0; i < run->chunk_count; i++) {
        const struct fmt_tris_chunk_info *info = &run->infos[i];
        vertices += info->vertex_count;
        run->vertices = info->vertex_count > run->vertices ? info->vertex_count : run->vertices;
        run->triangles =
            info->triangle_count > run->triangles ? info->triangle_count : run->triangles;
    }
    const uint64_t count = vertices / VERTICES_A_BUCKET + 1;
    const uint32_t corners = count < MOST_BUCKETS ? (uint32_t)count : MOST_BUCKETS;
    run->answer_chunks =
        (uint32_t)((run->chunk_count + MOST_ANSWER_BUCKETS - 1) / MOST_ANSWER_BUCKETS);
    const uint32_t answers =
        (uint32_t)((run->chunk_count + run->answer_chunks - 1) / run->answer_chunks);
    BSQ_PASS(bsq_spill_init(&run->corners, run->ctx, "corners between chunks", beside, corners,
                            corners, PAGE_BYTES, pages / 4 * 3));
    return bsq_spill_init(&run->answers, run->ctx, "normals", beside, answers, answers, PAGE_BYTES,
                          pages / 4);
}

/* Returns a random number (the finishing steps of MurmurHash3, Appleby 2011). */
static uint64_t ring_number(uint64_t ring)
{
    ring *= UINT64_C(0x9e3779b97f4a7c15);
    ring = (ring ^ ring >> 33) * UINT64_C(0xff51afd7ed558ccd);
    return ring ^ ring >> 33;
}

static int number_rings(struct normals_run *run)
{
    const uint32_t rings = (run->vertices > NORMALS_RINGS ? run->vertices : NORMALS_RINGS) + 1;
    BSQ_PASS(BSQ_ALLOC(run->ctx, "normals", rings, &run->own_rings));
    BSQ_PASS(BSQ_ALLOC(run->ctx, "normals", rings, &run->numbers));
    for (uint32_t i = 0; i < rings; i++) {
        run->own_rings[i] = i;
        run->numbers[i] = ring_number(i);
    }
    return 0;
}

/* Fills a section with the normals of the chunks of its file. */
static int fill_section(struct normals_run *run, const char *beside)
{
    int status;
    run->infos = fmt_tris_chunks(run->file);
    run->chunk_count = fmt_tris_get_header(run->file)->chunk_count;
    if (run->chunk_count == 0)
        return 0;
    bsq_progress_begin(run->ctx, "normals", "chunks", 2 * run->chunk_count);
    BSQ_TRY(normals_make_buckets(run, beside));
    BSQ_TRY(number_rings(run));
    BSQ_TRY(vox_normals_visit_chunks(run));
    BSQ_TRY(vox_normals_join_corners(run));
    status = complete_chunks(run);
done:
    BSQ_FREE(run->ctx, run->own_rings, run->numbers);
    bsq_spill_free(&run->corners);
    bsq_spill_free(&run->answers);
    bsq_progress_end(run->ctx);
    return status;
}

int vox_write_normals(struct bsq_ctx *ctx, struct fmt_tris_writer *writer,
                      enum bsq_scan_normals weights, const char *beside)
{
    struct normals_run run = {
        .ctx = ctx, .writer = writer, .weights = weights, .lock = PTHREAD_MUTEX_INITIALIZER};
    struct fmt_tris_file *file;
    int status = fmt_tris_normals_begin(writer, weights, &file);
    run.file = file;
    if (status == 0)
        status = fill_section(&run, beside);
    fmt_tris_close(file);
    return status;
}
