/* triangulate.c - see triangulate.h.
 *
 * Neighbours in the file are mostly neighbours in space, so consecutive triangles in one bucket are
 * noted as one span. Then all spans of a bucket are coded together, so a bucket's triangles share
 * runs even if the faces of the file have no order. There is a fast path for most scans, whose
 * batches have triangles with positions alone and one material: these are coded while their buckets
 * are found, so each change of the bucket ends a run. That pays as long as neighbours in the file
 * are neighbours in space. */
#include "base/polygon.h"
#include "libvoxel/partition/corner_delta_code.h"
#include "libvoxel/partition/triangulate.h"

/* Corners are prefetched this far ahead: files without order wait for memory otherwise. */
#define CORNERS_AHEAD 48

/* Positions of a scan's file that were read last. Page n of the file is at n % PAGES. */
enum { PAGES = 256, PAGE_VERTICES = 64 };
struct position_pages {
    uint64_t ends[PAGES]; /* the number of the page after it; 0: there is none */
    float positions[PAGES][PAGE_VERTICES][3];
};

/* Consecutive triangles of a batch that are in one bucket and have one material. */
struct triangle_span {
    uint32_t bucket, first, count, material;
};

/* A batch of faces. */
struct faces {
    const struct fmt_mesh_batch *batch;
    const uint32_t *sizes;                        /* NULL if all faces are triangles */
    const uint64_t *indices[FMT_MESH_KIND_COUNT]; /* of corners; NULL: none has any */
    uint32_t material[2]; /* of triangles with texture coordinates, others */
};

/* Returns the most bytes that a coded triangle of this scan takes: differences of indices take four
 * bytes if there are fewer than 2^31. */
static inline uint32_t coded_triangle_bytes(const struct triangulation_plan *plan, uint32_t kinds)
{
    const struct scan *scan = plan->scan;
    uint64_t most = scan_count(scan, SCAN_POSITIONS) | scan_count(scan, SCAN_TEXCOORDS) |
                    scan_count(scan, SCAN_NORMALS);
    return kinds * (most >> 31 ? CORNER_CODE_MAX : 13);
}

/* ---- memory ---- */

int vox_triangulator_init(struct triangulator *t, struct bsq_ctx *ctx,
                          const struct triangulation_plan *plan)
{
    uint64_t buckets = (uint64_t)1 << 3 * plan->levels;
    *t = (struct triangulator){.ctx = ctx, .plan = plan};
    int status = bsq_alloc(ctx, "faces", buckets, sizeof *t->runs_of_bucket, &t->runs_of_bucket);
    if (status == 0)
        memset(t->runs_of_bucket, 0xff, buckets * sizeof *t->runs_of_bucket);
    return status;
}

void vox_triangulator_free(struct triangulator *t)
{
    void *parts[] = {
        t->runs,           t->bytes,   t->corners,           t->spans,           t->sorted,
        t->runs_of_bucket, t->polygon, t->polygon_triangles, t->polygon_scratch, t->pages};
    for (size_t i = 0; t->ctx && i < sizeof parts / sizeof *parts; i++)
        bsq_free(t->ctx, parts[i]);
    memset(t, 0, sizeof *t);
}

static int reserve_triangles(struct triangulator *t, uint64_t triangles, uint64_t spans)
{
    int status =
        bsq_grow(t->ctx, "faces", triangles, sizeof *t->corners, &t->corners, &t->corner_capacity);
    if (status == 0)
        status = bsq_grow(t->ctx, "faces", spans, sizeof *t->spans, &t->spans, &t->span_capacity);
    return status;
}

static int reserve_polygon(struct triangulator *t, uint32_t max_size)
{
    const char *what = "faces";
    int status = 0;
    if (max_size <= 3)
        return 0;
    if (t->plan->vertex_buckets && !t->pages)
        BSQ_TRY(bsq_calloc(t->ctx, what, 1, sizeof *t->pages, &t->pages));
    BSQ_TRY(
        bsq_grow(t->ctx, what, max_size, sizeof *t->polygon, &t->polygon, &t->polygon_capacity[0]));
    BSQ_TRY(bsq_grow(t->ctx, what, max_size, 12, &t->polygon_triangles, &t->polygon_capacity[1]));
    status = bsq_grow(t->ctx, what, bsq_triangulate_scratch(max_size), 1, &t->polygon_scratch,
                      &t->polygon_capacity[2]);
done:
    return status;
}

/* ---- triangles ---- */

static inline const float *corner_position(const struct triangulator *t, const struct faces *faces,
                                           uint32_t corner)
{
    return stream_at(&t->plan->scan->streams[SCAN_POSITIONS],
                     faces->indices[FMT_MESH_VERTEX][corner], 12);
}

/* Returns the bucket of triangles with this first corner. */
static inline uint32_t bucket_of(const struct triangulator *t, const struct faces *faces,
                                 uint32_t corner)
{
    if (t->plan->vertex_buckets)
        return vertex_bucket(t->plan->vertex_buckets, faces->indices[FMT_MESH_VERTEX][corner]);
    return morton_cell(&t->plan->cube, t->plan->levels, corner_position(t, faces, corner));
}

/* Returns the address that bucket_of() reads. */
static inline const void *bucket_source(const struct triangulator *t, const struct faces *faces,
                                        uint32_t corner)
{
    if (t->plan->vertex_buckets)
        return vertex_bucket_place(t->plan->vertex_buckets,
                                   faces->indices[FMT_MESH_VERTEX][corner]);
    return corner_position(t, faces, corner);
}

static inline bool lacks_texcoord(const struct faces *faces, uint32_t a, uint32_t b, uint32_t c)
{
    const uint64_t *t = faces->indices[FMT_MESH_TEXCOORD];
    return !t || t[a] == FMT_MESH_NONE || t[b] == FMT_MESH_NONE || t[c] == FMT_MESH_NONE;
}

/* Notes that the next `count` triangles are in this bucket. */
static inline void extend_spans(struct triangulator *t, uint32_t bucket, uint32_t material,
                                uint32_t count)
{
    if (t->span_count == 0 || t->spans[t->span_count - 1].bucket != bucket ||
        t->spans[t->span_count - 1].material != material)
        t->spans[t->span_count++] = (struct triangle_span){
            .bucket = bucket, .first = (uint32_t)t->triangles, .material = material};
    t->spans[t->span_count - 1].count += count;
}

static inline void add_triangle(struct triangulator *t, const struct faces *faces, uint32_t a,
                                uint32_t b, uint32_t c)
{
    extend_spans(t, bucket_of(t, faces, a), faces->material[lacks_texcoord(faces, a, b, c)], 1);
    uint32_t *corners = t->corners[t->triangles++];
    corners[0] = a;
    corners[1] = b;
    corners[2] = c;
}

/* ---- polygons ---- */

/* Finds the position of a corner, if positions are in a file. *out: until the next call. Neighbours
 * in the mesh are mostly neighbours in the file, so pages of it are kept. */
static int read_position(struct triangulator *t, const struct faces *faces, uint32_t corner,
                         const float **out)
{
    const struct attribute_stream *stream = &t->plan->scan->streams[SCAN_POSITIONS];
    const uint64_t vertex = faces->indices[FMT_MESH_VERTEX][corner], page = vertex / PAGE_VERTICES;
    const uint64_t first = page * PAGE_VERTICES, left = stream_count(stream) - first;
    float(*positions)[3] = t->pages->positions[page % PAGES];
    uint64_t *end = &t->pages->ends[page % PAGES];
    int status = 0;
    if (*end != page + 1) {
        *end = 0;
        BSQ_TRY(vox_spill_read(&stream->spill, first * sizeof *positions,
                               (left < PAGE_VERTICES ? left : PAGE_VERTICES) * sizeof *positions,
                               positions));
        *end = page + 1;
    }
    *out = positions[vertex % PAGE_VERTICES];
done:
    return status;
}

static int add_polygon(struct triangulator *t, const struct faces *faces, uint32_t first,
                       uint32_t size)
{
    int status = 0;
    for (uint32_t k = 0; k < size; k++) {
        const float *p;
        if (t->pages)
            BSQ_TRY(read_position(t, faces, first + k, &p));
        else
            p = corner_position(t, faces, first + k);
        for (int axis = 0; axis < 3; axis++)
            t->polygon[k][axis] = p[axis];
        BSQ_TRY(bsq_check_corner(t->ctx, k));
    }
    const uint32_t *v = t->polygon_triangles;
    BSQ_TRY(bsq_triangulate(t->ctx, (const double(*)[3])t->polygon, size, t->polygon_triangles,
                            t->polygon_scratch));
    for (uint32_t i = 0; i < size - 2; i++, v += 3) {
        add_triangle(t, faces, first + v[0], first + v[1], first + v[2]);
        BSQ_TRY(bsq_check_corner(t->ctx, i));
    }
done:
    return status;
}

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

/* Sorts the triangulator's spans by bucket and codes them as runs. */
static int code_spans(struct triangulator *t, const struct faces *faces)
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

/* ---- plain batches ---- */

/* After a batch without order the next ones are likely to have none. A trial that fails takes a
 * sixteenth of a batch's time. */
#define BLOCKS_WITHOUT_TRIAL 16

static bool is_plain(const struct faces *faces)
{
    return !faces->sizes && faces->batch->material_change_count == 0 &&
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
    const uint32_t material = run_material(faces->batch->material_at_start, true);
    const uint64_t *v = faces->indices[FMT_MESH_VERTEX];
    const uint64_t triangles = faces->batch->face_count;
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

/* Triangulates a batch of triangles that have positions alone and one material. *done: false if the
 * batch has no such faces or its triangles have no order; then the result is undefined. */
static int triangulate_plain(struct triangulator *t, const struct faces *faces, bool *done)
{
    *done = false;
    if (t->skipped_plain > 0)
        t->skipped_plain--;
    else if (is_plain(faces)) {
        int status = reserve_plain(t, faces->batch->face_count);
        if (status < 0)
            return status;
        *done = code_triangles(t, faces);
        t->skipped_plain = *done ? 0 : BLOCKS_WITHOUT_TRIAL;
    }
    return 0;
}

/* ---- batches ---- */

static int add_face(struct triangulator *t, const struct faces *faces, uint32_t first,
                    uint32_t size)
{
    if (size > 3)
        return add_polygon(t, faces, first, size);
    add_triangle(t, faces, first, first + 1, first + 2);
    return 0;
}

static void set_material(struct faces *faces, uint32_t usemtl)
{
    faces->material[0] = run_material(usemtl, false);
    faces->material[1] = run_material(usemtl, true);
}

static int add_faces(struct triangulator *t, struct faces *faces)
{
    const struct fmt_mesh_batch *batch = faces->batch;
    const uint32_t corner_count = (uint32_t)batch->corner_count;
    uint32_t corner = 0;
    uint64_t change = 0;
    t->triangles = 0;
    t->span_count = 0;
    set_material(faces, batch->material_at_start);
    for (uint64_t f = 0; f < batch->face_count; f++) {
        uint32_t size = faces->sizes ? faces->sizes[f] : 3;
        while (change < batch->material_change_count && batch->material_changes[change].face <= f)
            set_material(faces, batch->material_changes[change++].material);
        for (uint32_t k = corner + CORNERS_AHEAD;
             k < corner + CORNERS_AHEAD + size && k < corner_count; k += faces->sizes ? 1 : 3)
            __builtin_prefetch(bucket_source(t, faces, k));
        int status = add_face(t, faces, corner, size);
        if (status < 0)
            return status;
        corner += size;
    }
    return 0;
}

int vox_triangulate_batch(struct triangulator *t, const struct fmt_mesh_batch *batch,
                          uint32_t max_size)
{
    struct faces faces = {
        .batch = batch,
        .sizes = max_size > 3 ? batch->face_sizes : NULL,
        .indices = {batch->corner_vertices, batch->corner_texcoords, batch->corner_normals}};
    const uint64_t triangles = batch->corner_count - 2 * batch->face_count;
    bool plain;
    int status = triangulate_plain(t, &faces, &plain);
    if (status < 0 || plain)
        return status;
    BSQ_TRY(reserve_triangles(t, triangles, triangles));
    BSQ_TRY(reserve_polygon(t, max_size));
    BSQ_TRY(add_faces(t, &faces));
    status = code_spans(t, &faces);
done:
    return status;
}
