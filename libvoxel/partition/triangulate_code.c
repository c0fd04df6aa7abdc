/* triangulate_code.c - codes the triangles of a block as runs, one bucket after the other.
 *
 * All spans of a bucket are coded together, so a bucket's triangles share runs even if the faces of
 * the file have no order. There is a fast path for most scans, whose blocks have triangles with
 * positions alone and one material: these are coded while their buckets are found, so each change
 * of the bucket ends a run. That pays as long as neighbours in the file are neighbours in space. */
#include "libvoxel/partition/triangulate.h"

/* ---- runs ---- */

/* Writes runs of delta-coded triangles. */
struct run_writer {
    uint8_t *header; /* of the current run, NULL between runs */
    uint8_t *to;
    struct run_header run;
    struct corner_code codes[FMT_MESH_KIND_COUNT];
};

/* Completes the current run's header, if there is a run. */
static void run_writer_end(struct run_writer *w)
{
    if (!w->header)
        return;
    w->run.bytes = (uint32_t)(w->to - w->header - (ptrdiff_t)sizeof w->run);
    memcpy(w->header, &w->run, sizeof w->run);
    w->header = NULL;
    w->run.triangles = 0;
}

/* Ends the current run, if any, and begins another. */
static void run_writer_begin(struct run_writer *w, unsigned form, uint32_t material)
{
    run_writer_end(w);
    *w = (struct run_writer){.header = w->to,
                             .to = w->to + sizeof w->run,
                             .run = {.form = (uint16_t)form, .material = material}};
}

/* ---- spans ---- */

#define NO_RUNS UINT32_MAX
/* Spans are prefetched this far ahead: files without order wait for memory otherwise. */
#define SPANS_AHEAD 16

static void put_triangle(const struct faces *faces, struct run_writer *w, const uint32_t corners[3])
{
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        const uint64_t *from = faces->indices[kind];
        if (!from)
            continue;
        const uint64_t index[3] = {from[corners[0]], from[corners[1]], from[corners[2]]};
        w->to = corner_code_put(&w->codes[kind], index, w->to);
    }
}

static unsigned form_of(const struct faces *faces)
{
    unsigned form = 0;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        form |= (unsigned)(faces->indices[kind] != NULL) << kind;
    return form;
}

/* Writes a span's triangles, into the current run while it has space. */
static void put_span(const struct triangulator *t, const struct faces *faces, unsigned form,
                     const struct triangle_span *span, struct run_writer *w)
{
    const uint32_t end = span->first + span->count;
    for (uint32_t i = span->first; i < end; i++) {
        if (w->run.triangles == 0 || w->run.material != span->material ||
            w->run.triangles == RUN_TRIANGLES)
            run_writer_begin(w, form, span->material);
        put_triangle(faces, w, t->corners[i]);
        w->run.triangles++;
    }
}

/* Sorts spans by bucket, stably, and makes an entry of `runs` for each bucket. */
static void sort_spans(struct triangulator *t)
{
    uint32_t end = 0;
    t->run_count = 0;
    for (uint32_t i = 0; i < t->span_count; i++) {
        uint32_t *number = &t->runs_of_bucket[t->spans[i].bucket];
        if (*number == NO_RUNS) {
            *number = t->run_count++;
            t->runs[*number] = (struct bucket_runs){.bucket = t->spans[i].bucket};
        }
        t->runs[*number].span_count++;
    }
    for (uint32_t i = 0; i < t->run_count; i++)
        t->runs[i].first_span = end += t->runs[i].span_count;
    for (uint32_t i = t->span_count; i-- > 0;)
        t->sorted[--t->runs[t->runs_of_bucket[t->spans[i].bucket]].first_span] = t->spans[i];
    for (uint32_t i = 0; i < t->run_count; i++)
        t->runs_of_bucket[t->runs[i].bucket] = NO_RUNS;
}

/* Prefetches indices of spans to come. Always inlined: GCC drops calls to functions that only
 * prefetch. */
static inline __attribute__((always_inline)) void
prefetch_spans(const struct triangulator *t, const struct faces *faces, unsigned form, uint32_t at)
{
    if (at + 2 * SPANS_AHEAD >= t->span_count)
        return;
    __builtin_prefetch(t->corners[t->sorted[at + 2 * SPANS_AHEAD].first]);
    const uint32_t corner = t->corners[t->sorted[at + SPANS_AHEAD].first][0];
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        if (form >> kind & 1)
            __builtin_prefetch(&faces->indices[kind][corner]);
}

/* Writes all spans of a bucket as runs. */
static void put_bucket(struct triangulator *t, const struct faces *faces, struct bucket_runs *runs,
                       struct run_writer *w)
{
    const unsigned form = form_of(faces);
    runs->offset = (uint64_t)(w->to - t->bytes);
    for (uint32_t i = runs->first_span; i < runs->first_span + runs->span_count; i++) {
        prefetch_spans(t, faces, form, i);
        put_span(t, faces, form, &t->sorted[i], w);
        runs->triangles += t->sorted[i].count;
    }
    run_writer_end(w);
    runs->bytes = (uint64_t)(w->to - t->bytes) - runs->offset;
}

static int reserve(struct triangulator *t, const struct faces *faces)
{
    const char *what = "faces";
    uint32_t kinds = 0;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        kinds += faces->indices[kind] != NULL;
    const uint64_t headers = t->span_count + t->triangles / RUN_TRIANGLES;
    const uint64_t bytes = t->triangles * coded_triangle_bytes(t->plan, kinds) +
                           headers * sizeof(struct run_header) + CORNER_CODE_SLACK;
    const uint64_t buckets = (uint64_t)1 << 3 * t->plan->levels;
    const uint64_t runs = buckets < t->span_count ? buckets : t->span_count;
    int status;
    BSQ_TRY(bsq_grow(t->ctx, what, bytes, 1, &t->bytes, &t->bytes_capacity));
    BSQ_TRY(
        bsq_grow(t->ctx, what, t->span_count, sizeof *t->sorted, &t->sorted, &t->sorted_capacity));
    status = bsq_grow(t->ctx, what, runs, sizeof *t->runs, &t->runs, &t->run_capacity);
done:
    return status;
}

int vox_triangulate_code_spans(struct triangulator *t, const struct faces *faces)
{
    int status = reserve(t, faces);
    if (status < 0)
        return status;
    sort_spans(t);
    struct run_writer w = {.to = t->bytes};
    for (uint32_t i = 0; i < t->run_count; i++)
        put_bucket(t, faces, &t->runs[i], &w);
    return 0;
}

/* ---- plain blocks ---- */

/* After a block without order the next ones are likely to have none. A trial that fails takes a
 * sixteenth of a block's time. */
#define BLOCKS_WITHOUT_TRIAL 16

static bool is_plain(const struct faces *faces)
{
    return !faces->sizes && faces->block->material_change_count == 0 &&
           !faces->indices[FMT_MESH_TEXCOORD] && !faces->indices[FMT_MESH_NORMAL];
}

/* Returns how many changes of the bucket are tolerated. */
static uint32_t most_runs(uint64_t triangles)
{
    return 64 + (uint32_t)triangles / 16;
}

static int reserve_plain(struct triangulator *t, uint64_t triangles)
{
    uint64_t runs = most_runs(triangles), headers = runs + triangles / RUN_TRIANGLES + 1;
    uint64_t bytes = triangles * coded_triangle_bytes(t->plan, 1) +
                     headers * sizeof(struct run_header) + CORNER_CODE_SLACK;
    int status = bsq_grow(t->ctx, "faces", bytes, 1, &t->bytes, &t->bytes_capacity);
    if (status == 0)
        status = bsq_grow(t->ctx, "faces", runs, sizeof *t->runs, &t->runs, &t->run_capacity);
    return status;
}

/* Ends the runs of the current bucket. */
static void end_bucket(struct triangulator *t, struct run_writer *w)
{
    run_writer_end(w);
    if (t->run_count == 0)
        return;
    struct bucket_runs *runs = &t->runs[t->run_count - 1];
    runs->bytes = (uint64_t)(w->to - t->bytes) - runs->offset;
    t->triangles += runs->triangles;
}

/* Returns false if the bucket changes too often. */
static bool code_triangles(struct triangulator *t, const struct faces *faces)
{
    /* Copies tell the compiler that nothing written here changes them. */
    const struct attribute_stream positions = t->plan->scan->streams[SCAN_POSITIONS];
    const struct morton_cube cube = t->plan->cube;
    const uint32_t levels = t->plan->levels;
    const bool known = t->plan->vertex_buckets != NULL;
    const struct vertex_buckets buckets =
        known ? *t->plan->vertex_buckets : (struct vertex_buckets){0};
    const uint32_t material = run_material(faces->block->material_at_start, true);
    const uint64_t *v = faces->indices[FMT_MESH_VERTEX];
    const uint64_t triangles = faces->block->face_count;
    const uint32_t most = most_runs(triangles);
    struct run_writer w = {.to = t->bytes};
    uint32_t bucket = UINT32_MAX;
    t->triangles = 0;
    t->run_count = 0;
    for (uint64_t i = 0; i < triangles; i++, v += 3) {
        uint32_t number = known ? vertex_bucket(&buckets, v[0])
                                : morton_cell(&cube, levels, stream_at(&positions, v[0], 12));
        bool first = number != bucket || w.run.triangles == RUN_TRIANGLES;
        if (number != bucket) {
            end_bucket(t, &w);
            if (t->run_count == most)
                return false;
            t->runs[t->run_count++] =
                (struct bucket_runs){.bucket = number, .offset = (uint64_t)(w.to - t->bytes)};
            bucket = number;
        }
        if (first)
            run_writer_begin(&w, 1u << FMT_MESH_VERTEX, material);
        w.to = corner_code_put(&w.codes[FMT_MESH_VERTEX], v, w.to);
        w.run.triangles++;
        t->runs[t->run_count - 1].triangles++;
    }
    end_bucket(t, &w);
    return true;
}

int vox_triangulate_plain(struct triangulator *t, const struct faces *faces, bool *done)
{
    *done = false;
    if (t->skipped_plain > 0)
        t->skipped_plain--;
    else if (is_plain(faces)) {
        int status = reserve_plain(t, faces->block->face_count);
        if (status < 0)
            return status;
        *done = code_triangles(t, faces);
        t->skipped_plain = *done ? 0 : BLOCKS_WITHOUT_TRIAL;
    }
    return 0;
}
