/* triangulate.c - see triangulate.h.
 *
 * The buckets of a batch's triangles are found first; the triangles are then sorted by bucket and
 * each bucket's are coded together, so they share runs even if the faces of the file have no order.
 * There is a fast path for most scans, whose batches have triangles with positions alone and one
 * material: these are coded while their buckets are found, so each change of the bucket ends a run.
 * That pays as long as neighbours in the file are neighbours in space. */
#include "base/geometry/polygon.h"
#include "libvoxel/partition/corner_delta_code.h"
#include "libvoxel/partition/triangulate.h"

/* Corners are prefetched this far ahead: files without order wait for memory otherwise. */
#define CORNERS_AHEAD   48
#define TRIANGLES_AHEAD 32
#define SORTED_AHEAD    8

/* Positions of a scan's file that were read last. Page n of the file is at n % PAGES. */
enum { PAGES = 256, PAGE_VERTICES = 64 };
struct position_pages {
    uint64_t ends[PAGES]; /* the number of the page after it; 0: there is none */
    float positions[PAGES][PAGE_VERTICES][3];
};

/* A batch of faces. */
struct faces {
    const struct fmt_mesh_batch *batch;
    const uint32_t *sizes;                        /* NULL if all faces are triangles */
    const uint64_t *indices[FMT_MESH_KIND_COUNT]; /* of corners; NULL: none has any */
    bool has_materials;                           /* triangles may have different ones */
};

/* Returns the most bytes that a coded triangle of this scan takes: differences of indices take four
 * bytes if there are fewer than 2^31. */
static inline uint32_t coded_triangle_bytes(const struct triangulation *rules, uint32_t kinds)
{
    const struct scan *scan = rules->scan;
    uint64_t most = scan_count(scan, SCAN_POSITIONS) | scan_count(scan, SCAN_TEXCOORDS) |
                    scan_count(scan, SCAN_NORMALS);
    return kinds * (most >> 31 ? CORNER_CODE_MAX : 13);
}

/* ---- memory ---- */

int vox_triangulator_init(struct triangulator *t, struct bsq_ctx *ctx,
                          const struct triangulation *rules)
{
    uint64_t buckets = (uint64_t)1 << 3 * rules->levels;
    *t = (struct triangulator){.ctx = ctx, .rules = rules};
    return BSQ_CALLOC(ctx, "faces", buckets, &t->counts);
}

void vox_triangulator_free(struct triangulator *t)
{
    BSQ_FREE(t->ctx, t->runs, t->bytes, t->corners, t->buckets, t->materials, t->order, t->counts,
             t->polygon, t->polygon_triangles, t->polygon_scratch, t->pages);
    memset(t, 0, sizeof *t);
}

static int reserve_polygon(struct triangulator *t, uint32_t max_size)
{
    const char *what = "faces";
    if (max_size <= 3)
        return 0;
    if (t->rules->vertex_buckets && !t->pages)
        BSQ_PASS(BSQ_CALLOC(t->ctx, what, 1, &t->pages));
    BSQ_PASS(BSQ_GROW(t->ctx, what, max_size, &t->polygon, &t->polygon_capacity[0]));
    BSQ_PASS(bsq_grow(t->ctx, what, max_size, 12, &t->polygon_triangles, &t->polygon_capacity[1]));
    return bsq_grow(t->ctx, what, bsq_triangulate_scratch(max_size), 1, &t->polygon_scratch,
                    &t->polygon_capacity[2]);
}

/* ---- triangles ---- */

static inline const float *corner_position(const struct triangulator *t, const struct faces *faces,
                                           uint32_t corner)
{
    return stream_at(&t->rules->scan->streams[SCAN_POSITIONS],
                     faces->indices[FMT_MESH_VERTEX][corner], 12);
}

/* Returns the bucket of triangles with this first corner. */
static inline uint32_t bucket_of(const struct triangulator *t, const struct faces *faces,
                                 uint32_t corner)
{
    if (t->rules->vertex_buckets)
        return vertex_bucket(t->rules->vertex_buckets, faces->indices[FMT_MESH_VERTEX][corner]);
    return morton_cell(&t->rules->cube, t->rules->levels, corner_position(t, faces, corner));
}

/* Returns the address that bucket_of() reads. */
static inline const void *bucket_source(const struct triangulator *t, const struct faces *faces,
                                        uint32_t corner)
{
    if (t->rules->vertex_buckets)
        return vertex_bucket_place(t->rules->vertex_buckets,
                                   faces->indices[FMT_MESH_VERTEX][corner]);
    return corner_position(t, faces, corner);
}

/* Returns a corner of a triangle: its number in the batch. */
static inline uint32_t faces_corner_of(const struct triangulator *t, const struct faces *faces,
                                       uint32_t triangle, uint32_t k)
{
    return faces->sizes ? t->corners[triangle][k] : 3 * triangle + k;
}

/* ---- polygons ---- */

/* Finds the position of a corner, if positions are in a file. *out: until the next call. Neighbours
 * in the mesh are mostly neighbours in the file, so pages of it are kept. */
static int read_position(struct triangulator *t, const struct faces *faces, uint32_t corner,
                         const float **out)
{
    const struct attribute_stream *stream = &t->rules->scan->streams[SCAN_POSITIONS];
    const uint64_t vertex = faces->indices[FMT_MESH_VERTEX][corner], page = vertex / PAGE_VERTICES;
    const uint64_t first = page * PAGE_VERTICES, left = stream->count - first;
    float(*positions)[3] = t->pages->positions[page % PAGES];
    uint64_t *end = &t->pages->ends[page % PAGES];
    if (*end != page + 1) {
        *end = 0;
        BSQ_PASS(
            stream_read(stream, first, left < PAGE_VERTICES ? left : PAGE_VERTICES, positions));
        *end = page + 1;
    }
    *out = positions[vertex % PAGE_VERTICES];
    return 0;
}

/* Adds the triangle of corners first + v[0], first + v[1] and first + v[2]. */
static inline void faces_add_triangle(struct triangulator *t, uint32_t first, const uint32_t v[3])
{
    uint32_t *corners = t->corners[t->triangles++];
    for (uint32_t k = 0; k < 3; k++)
        corners[k] = first + v[k];
}

static int add_polygon(struct triangulator *t, const struct faces *faces, uint32_t first,
                       uint32_t size)
{
    for (uint32_t k = 0; k < size; k++) {
        const float *p;
        if (t->pages)
            BSQ_PASS(read_position(t, faces, first + k, &p));
        else
            p = corner_position(t, faces, first + k);
        for (int axis = 0; axis < 3; axis++)
            t->polygon[k][axis] = p[axis];
        BSQ_PASS(bsq_check_corner(t->ctx, k));
    }
    BSQ_PASS(bsq_triangulate(t->ctx, (const double(*)[3])t->polygon, size, t->polygon_triangles,
                             t->polygon_scratch));
    for (uint32_t i = 0; i < size - 2; i++) {
        faces_add_triangle(t, first, t->polygon_triangles + 3 * i);
        BSQ_PASS(bsq_check_corner(t->ctx, i));
    }
    return 0;
}

static int add_faces(struct triangulator *t, const struct faces *faces)
{
    static const uint32_t triangle[3] = {0, 1, 2};
    const uint32_t corner_count = (uint32_t)faces->batch->corner_count;
    uint32_t corner = 0;
    t->triangles = 0;
    for (uint64_t f = 0; f < faces->batch->face_count; f++) {
        const uint32_t size = faces->sizes[f];
        for (uint32_t k = corner + CORNERS_AHEAD;
             !t->pages && k < corner + CORNERS_AHEAD + size && k < corner_count; k++)
            __builtin_prefetch(corner_position(t, faces, k));
        if (size > 3)
            BSQ_PASS(add_polygon(t, faces, corner, size));
        else
            faces_add_triangle(t, corner, triangle);
        corner += size;
    }
    return 0;
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
static inline void run_writer_end(struct run_writer *w)
{
    if (!w->header)
        return;
    w->run.bytes = (uint32_t)(w->to - w->header) - run_header_bytes(&w->run);
    run_header_put(&w->run, w->header);
    w->header = NULL;
    w->run.triangles = 0;
}

/* Ends the current run, if any, and begins another. */
static inline void run_writer_begin(struct run_writer *w, unsigned form, uint32_t material)
{
    run_writer_end(w);
    w->run = (struct run_header){.form = (uint16_t)form, .material = material};
    w->header = w->to;
    w->to += run_header_bytes(&w->run);
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        if (form >> kind & 1)
            w->codes[kind] = (struct corner_code){0};
}

/* ---- sorting by bucket ---- */

/* Finds the buckets of all triangles. A position may be in two cache lines. */
static void find_buckets(struct triangulator *t, const struct faces *faces)
{
    const uint32_t triangles = (uint32_t)t->triangles;
    for (uint32_t i = 0; i < triangles; i++) {
        if (i + TRIANGLES_AHEAD < triangles) {
            const char *source =
                bucket_source(t, faces, faces_corner_of(t, faces, i + TRIANGLES_AHEAD, 0));
            __builtin_prefetch(source);
            __builtin_prefetch(source + 8);
        }
        t->buckets[i] = (uint16_t)bucket_of(t, faces, faces_corner_of(t, faces, i, 0));
    }
}

/* Counts the triangles of each bucket. `runs` gets the buckets in the order of their first
 * triangles. */
static void faces_count_triangles(struct triangulator *t)
{
    uint32_t run_count = 0;
    for (uint64_t i = 0; i < t->triangles; i++) {
        const uint32_t bucket = t->buckets[i];
        t->runs[run_count].bucket = bucket;
        run_count += t->counts[bucket]++ == 0;
    }
    t->run_count = run_count;
}

/* Lists the triangles of each bucket in `order`, in the order of the file. */
static void sort_by_bucket(struct triangulator *t)
{
    uint32_t *places = t->counts, end = 0;
    for (uint32_t r = 0; r < t->run_count; r++) {
        t->runs[r].triangles = places[t->runs[r].bucket];
        places[t->runs[r].bucket] = end;
        end += t->runs[r].triangles;
    }
    for (uint32_t i = 0; i < end; i++)
        t->order[places[t->buckets[i]]++] = i;
    memset(t->order + end, 0, SORTED_AHEAD * sizeof *t->order);
    for (uint32_t r = 0; r < t->run_count; r++)
        t->counts[t->runs[r].bucket] = 0;
}

/* ---- materials ---- */

static inline bool lacks_texcoord(const struct triangulator *t, const struct faces *faces,
                                  uint32_t triangle)
{
    const uint64_t *texcoords = faces->indices[FMT_MESH_TEXCOORD];
    bool lacks = !texcoords;
    for (uint32_t k = 0; k < 3 && !lacks; k++)
        lacks = texcoords[faces_corner_of(t, faces, triangle, k)] == FMT_MESH_NONE;
    return lacks;
}

/* Finds the materials of triangles that may have different ones. */
static void faces_find_materials(struct triangulator *t, const struct faces *faces)
{
    const struct fmt_mesh_batch *batch = faces->batch;
    uint32_t usemtl = batch->material_at_start, triangle = 0;
    uint64_t change = 0;
    for (uint64_t f = 0; f < batch->face_count; f++) {
        while (change < batch->material_change_count && batch->material_changes[change].face <= f)
            usemtl = batch->material_changes[change++].material;
        for (uint32_t end = triangle + (faces->sizes ? faces->sizes[f] : 3) - 2; triangle < end;
             triangle++)
            t->materials[triangle] = run_material(usemtl, lacks_texcoord(t, faces, triangle));
    }
}

/* ---- coding ---- */

static inline void put_triangle(const struct triangulator *t, const struct faces *faces,
                                unsigned form, uint32_t triangle, struct run_writer *w)
{
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        const uint64_t *from = faces->indices[kind];
        if (!(form >> kind & 1))
            continue;
        const uint64_t index[3] = {from[faces_corner_of(t, faces, triangle, 0)],
                                   from[faces_corner_of(t, faces, triangle, 1)],
                                   from[faces_corner_of(t, faces, triangle, 2)]};
        w->to = corner_code_put(&w->codes[kind], index, w->to);
    }
}

static inline __attribute__((always_inline)) void prefetch_triangle(const struct triangulator *t,
                                                                    const struct faces *faces,
                                                                    unsigned form,
                                                                    uint32_t triangle)
{
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        if (form >> kind & 1)
            __builtin_prefetch(&faces->indices[kind][faces_corner_of(t, faces, triangle, 0)]);
}

/* Writes the triangles of a bucket as runs and returns their end. Inlined, so that a constant form
 * is one. `faces` is a copy, so that the compiler knows that nothing written here changes it. */
static inline __attribute__((always_inline)) uint8_t *
put_bucket(const struct triangulator *t, const struct faces faces, unsigned form,
           const uint32_t *order, uint32_t count, uint8_t *to)
{
    struct run_writer w = {.to = to};
    uint32_t material = run_material(faces.batch->material_at_start, true);
    for (uint32_t i = 0; i < count; i++) {
        if (faces.has_materials)
            material = t->materials[order[i]];
        if (w.run.triangles % RUN_TRIANGLES == 0 || w.run.material != material)
            run_writer_begin(&w, form, material);
        prefetch_triangle(t, &faces, form, order[i + SORTED_AHEAD]);
        put_triangle(t, &faces, form, order[i], &w);
        w.run.triangles++;
    }
    run_writer_end(&w);
    return w.to;
}

static unsigned form_of(const struct faces *faces)
{
    unsigned form = 0;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        form |= (unsigned)(faces->indices[kind] != NULL) << kind;
    return form;
}

/* Codes the sorted triangles as runs. */
static void code_sorted(struct triangulator *t, const struct faces *faces)
{
    const unsigned form = form_of(faces);
    const uint32_t *order = t->order;
    uint8_t *to = t->bytes;
    for (uint32_t r = 0; r < t->run_count; r++) {
        struct bucket_runs *runs = &t->runs[r];
        runs->offset = (uint64_t)(to - t->bytes);
        if (form == 1u << FMT_MESH_VERTEX)
            to = put_bucket(t, *faces, 1u << FMT_MESH_VERTEX, order, runs->triangles, to);
        else
            to = put_bucket(t, *faces, form, order, runs->triangles, to);
        runs->bytes = (uint64_t)(to - t->bytes) - runs->offset;
        order += runs->triangles;
    }
}

/* ---- plain batches ---- */

/* After a batch without order the next ones are likely to have none. A trial that fails takes a
 * sixteenth of a batch's time. */
#define BLOCKS_WITHOUT_TRIAL 16

static bool faces_is_plain(const struct faces *faces)
{
    return !faces->sizes && !faces->has_materials && !faces->indices[FMT_MESH_NORMAL];
}

/* Returns how many changes of the bucket are tolerated. */
static uint32_t most_runs(uint64_t triangles)
{
    return 64 + (uint32_t)triangles / 16;
}

static int reserve_plain(struct triangulator *t, uint64_t triangles)
{
    uint64_t runs = most_runs(triangles), headers = runs + triangles / RUN_TRIANGLES + 1;
    uint64_t bytes = triangles * coded_triangle_bytes(t->rules, 1) + headers * RUN_HEADER_MAX +
                     CORNER_CODE_SLACK;
    BSQ_PASS(bsq_grow(t->ctx, "faces", bytes, 1, &t->bytes, &t->bytes_capacity));
    return BSQ_GROW(t->ctx, "faces", runs, &t->runs, &t->run_capacity);
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
    const struct attribute_stream positions = t->rules->scan->streams[SCAN_POSITIONS];
    const struct morton_cube cube = t->rules->cube;
    const uint32_t levels = t->rules->levels;
    const bool known = t->rules->vertex_buckets != NULL;
    const struct vertex_buckets buckets =
        known ? *t->rules->vertex_buckets : (struct vertex_buckets){0};
    const uint32_t material = run_material(faces->batch->material_at_start, true);
    const uint64_t *v = faces->indices[FMT_MESH_VERTEX];
    const uint64_t triangles = faces->batch->face_count;
    const uint32_t most = most_runs(triangles);
    struct run_writer w = {.to = t->bytes};
    uint32_t bucket = UINT32_MAX;
    t->triangles = 0;
    t->run_count = 0;
    for (uint64_t i = 0; i < triangles; i++, v += 3) {
        if (!known && i + TRIANGLES_AHEAD < triangles)
            __builtin_prefetch(stream_at(&positions, v[3 * TRIANGLES_AHEAD], 12));
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
    else if (faces_is_plain(faces)) {
        BSQ_PASS(reserve_plain(t, faces->batch->face_count));
        *done = code_triangles(t, faces);
        t->skipped_plain = *done ? 0 : BLOCKS_WITHOUT_TRIAL;
    }
    return 0;
}

/* ---- batches ---- */

static int faces_reserve(struct triangulator *t, const struct faces *faces, uint64_t triangles)
{
    const char *what = "faces";
    uint32_t kinds = 0;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        kinds += faces->indices[kind] != NULL;
    /* At most a header for each triangle. */
    const uint64_t bytes =
        triangles * (coded_triangle_bytes(t->rules, kinds) + RUN_HEADER_MAX) + CORNER_CODE_SLACK;
    const uint64_t buckets = (uint64_t)1 << 3 * t->rules->levels;
    const uint64_t runs = (buckets < triangles ? buckets : triangles) + 1;
    BSQ_PASS(bsq_grow(t->ctx, what, bytes, 1, &t->bytes, &t->bytes_capacity));
    BSQ_PASS(BSQ_GROW(t->ctx, what, runs, &t->runs, &t->run_capacity));
    BSQ_PASS(BSQ_GROW(t->ctx, what, triangles, &t->buckets, &t->bucket_capacity));
    BSQ_PASS(BSQ_GROW(t->ctx, what, triangles + SORTED_AHEAD, &t->order, &t->order_capacity));
    if (faces->sizes)
        BSQ_PASS(BSQ_GROW(t->ctx, what, triangles, &t->corners, &t->corner_capacity));
    if (faces->has_materials)
        BSQ_PASS(BSQ_GROW(t->ctx, what, triangles, &t->materials, &t->material_capacity));
    return 0;
}

int vox_triangulate_batch(struct triangulator *t, const struct fmt_mesh_batch *batch,
                          uint32_t max_size)
{
    const struct faces faces = {
        .batch = batch,
        .sizes = max_size > 3 ? batch->face_sizes : NULL,
        .indices = {batch->corner_vertices, batch->corner_texcoords, batch->corner_normals},
        .has_materials = batch->material_change_count > 0 || batch->corner_texcoords};
    const uint64_t triangles = batch->corner_count - 2 * batch->face_count;
    bool plain;
    BSQ_PASS(triangulate_plain(t, &faces, &plain));
    if (plain)
        return 0;
    BSQ_PASS(faces_reserve(t, &faces, triangles));
    BSQ_PASS(reserve_polygon(t, max_size));
    t->triangles = triangles;
    BSQ_PASS(faces.sizes ? add_faces(t, &faces) : 0);
    find_buckets(t, &faces);
    faces_count_triangles(t);
    sort_by_bucket(t);
    if (faces.has_materials)
        faces_find_materials(t, &faces);
    code_sorted(t, &faces);
    return 0;
}
