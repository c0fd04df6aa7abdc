/* measure.c - see steps.h.
 *
 * One pass over the chunks bounds the distance of the scan from the mesh, and that of most of the
 * mesh's triangles from the scan (cover.h). Points of the mesh look for the scan in a second pass
 * (samples.c), and what is left open is bounded by the scan around it (resolve.c). Sums are added
 * up in the order of chunks, so results do not depend on threads. */
#include "libvoxel/simplify/measure.h"

#include <float.h>
#include <string.h>

#include "base/parallel.h"
#include "libvoxel/simplify/steps.h"

enum {
    GUESS_CHUNKS = 16,     /* for the guess, one chunk of 16 is loaded, */
    GUESS_CHUNKS_MAX = 64, /* and about 64 of them at most; */
    GUESS_RUNS = 16,       /* of its runs of vertices, one of 16 is measured */
    FINE_SHARE = 64,       /* triangles below this share of the mesh's own need no inner points */
    POINTS_SHARE = 8,      /* others have one in each of these shares, */
    POINTS_MAX = 1 << 16,
    VERTEX_BYTES =
        28, /* of a chunk's vertices, beside the chunk; and of its triangles, in a tree */
    TRIANGLE_BYTES = 40
};
/* How much higher than the guess triangles of the scan may be above the mesh's; at most this part
 * of a triangle's size, because more of them see each other then. */
static const double cover_factor = 2, cover_most = 0.5;

struct measure_slot {
    struct vox_sums sums;
    struct vox_bound bound;
    struct vox_box_sums *boxes; /* that the chunk touches */
    uint32_t box_count;
};

/* ---- sums ---- */

void vox_sums_add(struct vox_sums *sums, const struct vox_sums *other)
{
    sums->weight += other->weight;
    sums->distance += other->distance;
    sums->square += other->square;
    for (int i = 0; i < VOX_BINS; i++)
        sums->bins[i] += other->bins[i];
}

/* Turns sums into figures. The 99th percentile is the upper end of its bin. */
void vox_summarize(const struct vox_measuring *m, const struct vox_sums *sums,
                   const struct vox_bound *bound, struct vox_distances *out)
{
    const double *origin = fmt_tris_get_header(m->file)->origin;
    double below = 0;
    uint64_t bin = 0;
    *out = (struct vox_distances){.max = fmax(bound->low, bound->high)};
    for (int k = 0; k < 3; k++)
        out->where[k] = origin[k] + bound->where[k];
    if (!(sums->weight > 0))
        return;
    out->mean = sums->distance / sums->weight;
    out->rms = sqrt(sums->square / sums->weight);
    while (bin < VOX_BINS - 1 && (below += sums->bins[bin]) < 0.99 * sums->weight)
        bin++;
    bin = (uint64_t)(m->first_bin + (int64_t)bin + 1) << 48;
    memcpy(&out->p99, &bin, sizeof bin);
    out->p99 = fmin(sqrt(out->p99), out->max);
}

/* ---- the vertices of a chunk ---- */

int vox_load_chunk(const struct vox_measuring *m, uint64_t index, void **scratch,
                   struct fmt_tris_chunk *chunk)
{
    BSQ_PASS(bsq_alloc(m->ctx, "a chunk", fmt_tris_load_size(m->file, index), 1, scratch));
    return fmt_tris_load(m->file, index, *scratch, chunk);
}

int vox_visit_chunks(const struct vox_measuring *m,
                     int (*fn)(void *arg, uint64_t index, unsigned worker), void *arg)
{
    return bsq_parallel_on(m->ctx, bsq_workers_within(m->ctx, bsq_threads(m->ctx), m->chunk_bytes),
                           fmt_tris_get_header(m->file)->chunk_count, fn, arg);
}

/* Returns how many points from the first on, at most a batch, are within reach of it. */
static unsigned count_near(const float (*points)[3], uint32_t count, double reach)
{
    unsigned near = 1;
    while (near < count && near < VOX_CLOSEST_BATCH &&
           vox_square_between(points[near], points[0]) < reach * reach)
        near++;
    return near;
}

/* Measures vertices from number *v on that lie close together, and adds their count to *v. *last:
 * a vertex that was measured, UINT32_MAX if none was; it bounds the distances of these. */
static void measure_run(const struct vox_measuring *m, const struct fmt_tris_chunk *chunk,
                        double *squares, uint32_t *closest, uint32_t *v, uint32_t *last)
{
    const float(*points)[3] = &chunk->positions[*v];
    const unsigned count = count_near(points, chunk->vertex_count - *v, m->reach);
    for (unsigned i = 0; i < count; i++) {
        squares[*v + i] = INFINITY;
        if (*last == UINT32_MAX)
            continue;
        const double most =
            sqrt(squares[*last]) + sqrt(vox_square_between(points[i], chunk->positions[*last]));
        squares[*v + i] = most * most * 1.000001 + DBL_MIN;
    }
    vox_closest_squares(&m->tree, points, count, &squares[*v], closest ? &closest[*v] : NULL);
    *v += count;
    *last = *v - 1;
}

/* Raises the guess by some vertices of a chunk. */
static int guess_chunk(struct vox_measuring *m, uint64_t index)
{
    struct fmt_tris_chunk chunk;
    void *scratch = NULL;
    double *squares = NULL;
    uint32_t last = UINT32_MAX;
    int status = 0;
    BSQ_TRY(vox_load_chunk(m, index, &scratch, &chunk));
    BSQ_TRY(vox_keep_own(m, index, &chunk));
    BSQ_TRY(BSQ_ALLOC(m->ctx, "distances", chunk.vertex_count, &squares));
    for (uint32_t v = 0; v < chunk.vertex_count; v += (GUESS_RUNS - 1) * VOX_CLOSEST_BATCH) {
        const uint32_t begin = v;
        measure_run(m, &chunk, squares, NULL, &v, &last);
        for (uint32_t i = begin; i < v; i++)
            m->guess = fmax(m->guess, sqrt(squares[i]));
        BSQ_TRY(bsq_check(m->ctx));
    }
done:
    BSQ_FREE(m->ctx, squares, scratch);
    return status;
}

/* ---- the triangles of a chunk ---- */

/* Measures points spread over a triangle. A sequence of low discrepancy (Roberts, "The Unreasonable
 * Effectiveness of Quasirandom Sequences", 2018). near: a triangle of the mesh. Returns the part of
 * the area that corners still stand for. */
static double measure_inside(const struct vox_measuring *m, const float *const corners[3],
                             uint32_t near, double area, struct measure_slot *slot)
{
    const double wanted = POINTS_SHARE * area / (m->reach * m->reach);
    const unsigned count = wanted < POINTS_MAX ? (unsigned)wanted + 1 : POINTS_MAX;
    const double inner = count == 1 ? 0.75 : 1; /* exact up to the second degree, if it is one */
    const float *other[3];
    vox_closest_corners(&m->tree, near, other);
    for (unsigned i = 0; i < count; i++) {
        double u = fmod(1.0 / 3 + 0.7548776662466927 * i, 1.0),
               v = fmod(1.0 / 3 + 0.5698402909980532 * i, 1.0), point[3], square = INFINITY;
        if (u + v > 1) {
            u = 1 - u;
            v = 1 - v;
        }
        for (int k = 0; k < 3; k++)
            point[k] = (1 - u - v) * (double)corners[0][k] + u * (double)corners[1][k] +
                       v * (double)corners[2][k];
        square = vox_triangle_square_at(other, point, square);
        vox_closest_point(&m->tree, point, &square);
        vox_add_distance(m, &slot->sums, square, inner * area / count);
        vox_boxes_add_point(m, point, square, inner * area / count, slot->boxes, slot->box_count);
        vox_bound_note(&slot->bound, point, sqrt(square));
    }
    return 1 - inner;
}

/* No point is farther from the next corner than the longest edge over the square root of 3. */
double vox_bound_by_corners(const struct vox_measuring *m, const float *const corners[3],
                            const uint32_t *triangle, const struct vox_chunk_vertices *of,
                            double allowed)
{
    double squares[3], most = 0, bound;
    for (int k = 0; k < 3; k++) {
        squares[k] = of->squares[triangle[k]];
        most = squares[k] > most ? squares[k] : most;
    }
    bound = sqrt(most) + vox_longest_edge(corners) / sqrt(3);
    for (int k = 0; k < 3 && bound > allowed; k++) {
        const float *other[3];
        double own = squares[k];
        vox_closest_corners(&m->tree, of->closest[triangle[k]], other);
        for (int i = 0; i < 3; i++)
            if (of->closest[triangle[i]] != of->closest[triangle[k]])
                own = fmax(own, vox_triangle_square_at(other,
                                                       (const double[3]){(double)corners[i][0],
                                                                         (double)corners[i][1],
                                                                         (double)corners[i][2]},
                                                       INFINITY));
            else
                own = fmax(own, squares[i]);
        bound = fmin(bound, sqrt(own));
    }
    return bound;
}

/* Marks the triangle of the mesh that is closest to where a triangle of the scan may be farther
 * than the limit. */
static void mark_closest(const struct vox_measuring *m, const float *const corners[3])
{
    struct vox_bound bound = vox_limit_bound(m);
    double square = INFINITY;
    for (int k = 0; k < 3; k++)
        bound.where[k] = (double)corners[0][k];
    vox_bound_triangle(&m->tree, corners, &bound);
    if (fmax(bound.high, bound.low) > m->limit)
        m->marks[vox_closest_point(&m->tree, bound.where, &square)] = 1;
}

static int measure_triangles(const struct vox_measuring *m, const struct fmt_tris_chunk *chunk,
                             const struct vox_chunk_vertices *of, struct measure_slot *slot)
{
    const float(*positions)[3] = chunk->positions;
    const double fine = m->reach * m->reach / FINE_SHARE;
    struct vox_bound *b = &slot->bound;
    double allowed = vox_bound_allowed(b);
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        const uint32_t *v = chunk->triangles[t];
        const float *const corners[3] = {positions[v[0]], positions[v[1]], positions[v[2]]};
        const double area = vox_triangle_area(positions, v);
        double share = 1;
        if (area > fine)
            share = measure_inside(m, corners, of->closest[v[0]], area, slot);
        for (int k = 0; k < 3; k++)
            of->weights[v[k]] += share * area / 3;
        const double bound = vox_bound_by_corners(m, corners, v, of, allowed);
        if (bound <= allowed) {
            b->high = bound > b->high ? bound : b->high;
            continue;
        }
        if (m->marks) {
            mark_closest(m, corners);
        } else {
            vox_bound_triangle(&m->tree, corners, b);
            allowed = vox_bound_allowed(b);
        }
        BSQ_PASS(bsq_check(m->ctx));
    }
    return 0;
}

static int measure_vertices(const struct vox_measuring *m, const struct fmt_tris_chunk *chunk,
                            const struct vox_chunk_vertices *of, struct vox_bound *bound)
{
    uint32_t last = UINT32_MAX, farthest = 0;
    for (uint32_t v = 0; v < chunk->vertex_count;) {
        measure_run(m, chunk, of->squares, of->closest, &v, &last);
        if (bsq_check(m->ctx) < 0)
            return BSQ_EINTR;
    }
    for (uint32_t v = 0; v < chunk->vertex_count; v++)
        farthest = of->squares[v] > of->squares[farthest] ? v : farthest;
    const float *p = chunk->positions[farthest];
    vox_bound_note(bound, (const double[3]){(double)p[0], (double)p[1], (double)p[2]},
                   sqrt(of->squares[farthest]));
    return 0;
}

/* ---- the pass ---- */

static int produce_chunk(void *arg, void *slot_, uint64_t sequence)
{
    const struct vox_measuring *m = arg;
    struct measure_slot *slot = slot_;
    memset(slot, 0, sizeof *slot);
    /* A little less than the guess, so that the vertex that it is from is noted. */
    slot->bound = (struct vox_bound){.low = m->guess * (1 - 1e-12), .slack = m->scan.slack};
    if (m->marks)
        slot->bound = vox_limit_bound(m);
    return sequence < fmt_tris_get_header(m->file)->chunk_count;
}

static int measure_chunk(void *arg, void *slot_, uint64_t sequence, unsigned worker)
{
    const struct vox_measuring *m = arg;
    struct measure_slot *slot = slot_;
    struct vox_chunk_vertices of = {0};
    struct fmt_tris_chunk chunk;
    void *scratch = NULL;
    int status = 0;
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[sequence];
    (void)worker;
    if (vox_box_square(info->bounds_min, info->bounds_max, m->near_low, m->near_high) > 0)
        return 0;
    BSQ_TRY(vox_load_chunk(m, sequence, &scratch, &chunk));
    BSQ_TRY(BSQ_ALLOC(m->ctx, "numbers of blocks", chunk.vertex_count, &of.blocks));
    BSQ_TRY(vox_cover_add(m->ctx, &m->cover, &chunk, of.blocks));
    BSQ_TRY(vox_keep_own(m, sequence, &chunk));
    const uint32_t count = chunk.vertex_count;
    if (count == 0)
        goto done;
    BSQ_TRY(BSQ_ALLOC(m->ctx, "distances", count, &of.squares));
    BSQ_TRY(BSQ_CALLOC(m->ctx, "areas", count, &of.weights));
    BSQ_TRY(BSQ_ALLOC(m->ctx, "closest triangles", count, &of.closest));
    BSQ_TRY(vox_boxes_touched(m, sequence, &slot->boxes, &slot->box_count));
    BSQ_TRY(measure_vertices(m, &chunk, &of, &slot->bound));
    BSQ_TRY(measure_triangles(m, &chunk, &of, slot));
    BSQ_TRY(vox_boxes_add_triangles(m, &chunk, &of, slot->boxes, slot->box_count));
    for (uint32_t v = 0; v < count; v++) {
        const float *p = chunk.positions[v];
        vox_add_distance(m, &slot->sums, of.squares[v], of.weights[v]);
        vox_boxes_add_point(m, (const double[3]){(double)p[0], (double)p[1], (double)p[2]},
                            of.squares[v], of.weights[v], slot->boxes, slot->box_count);
    }
done:
    BSQ_FREE(m->ctx, of.blocks, of.closest, of.weights, of.squares, scratch);
    return status;
}

static int add_chunk(void *arg, void *slot_, uint64_t sequence)
{
    struct vox_measuring *m = arg;
    struct measure_slot *slot = slot_;
    vox_sums_add(m->from_scan, &slot->sums);
    vox_bound_add(&m->scan, &slot->bound);
    vox_boxes_add(m, slot->boxes, slot->box_count);
    bsq_free(m->ctx, slot->boxes);
    slot->boxes = NULL;
    if (vox_has_chunk(m, sequence))
        bsq_progress_add(m->ctx, fmt_tris_chunks(m->file)[sequence].triangle_count);
    return 0;
}

static int measure_scan(struct vox_measuring *m)
{
    const uint64_t chunks = fmt_tris_get_header(m->file)->chunk_count;
    struct measure_slot *slots = NULL;
    uint64_t own = 0;
    unsigned slot_count = 0;
    int status = 0;
    for (uint64_t i = 0; i < chunks; i++)
        if (vox_has_chunk(m, i) && own++ % (GUESS_CHUNKS + chunks / GUESS_CHUNKS_MAX) == 0)
            BSQ_TRY(guess_chunk(m, i));
    m->cover = (struct vox_cover){.tree = &m->tree,
                                  .height = fmin(cover_factor * m->guess, cover_most * m->reach) +
                                            m->scan.slack,
                                  .margin = m->scan.slack / 8,
                                  .reach = m->reach};
    BSQ_TRY(vox_cover_begin(m->ctx, m->mesh->triangle_count, &m->cover));
    slot_count =
        bsq_workers_within(m->ctx, 2 * bsq_threads(m->ctx), m->chunk_bytes + sizeof *slots);
    BSQ_TRY(BSQ_CALLOC(m->ctx, "distances", slot_count, &slots));
    const struct bsq_pipeline pipeline = {.produce = produce_chunk,
                                          .work = measure_chunk,
                                          .emit = add_chunk,
                                          .arg = m,
                                          .slots = slots,
                                          .slot_size = sizeof *slots,
                                          .slot_count = slot_count};
    bsq_progress_begin(m->ctx, "measuring", "triangles", m->region->triangles);
    status = bsq_pipeline_run(m->ctx, &pipeline);
    bsq_progress_end(m->ctx);
done:
    for (unsigned i = 0; slots && i < slot_count; i++)
        bsq_free(m->ctx, slots[i].boxes);
    bsq_free(m->ctx, slots);
    return status;
}

/* ---- both ways ---- */

double vox_mean_reach(const struct vox_mesh *mesh)
{
    double area = 0;
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        area += vox_triangle_area((const float(*)[3])mesh->positions, mesh->triangles[t]);
    return sqrt(area / mesh->triangle_count);
}

/* Sets sizes: of chunks in memory, how far the scan and the mesh reach, and how far coordinates are
 * rounded. No distance is larger than the last octaves of the histogram have. */
static void measure_sizes(struct vox_measuring *m)
{
    const struct fmt_tris_header *header = fmt_tris_get_header(m->file);
    const float(*positions)[3] = (const float(*)[3])m->mesh->positions;
    const struct fmt_tris_chunk_info *chunks = fmt_tris_chunks(m->file);
    double most = 0, square;
    uint64_t bits;
    for (uint64_t i = 0; i < header->chunk_count; i++) {
        const uint64_t bytes = fmt_tris_load_size(m->file, i) +
                               VERTEX_BYTES * (uint64_t)chunks[i].vertex_count +
                               TRIANGLE_BYTES * ((uint64_t)chunks[i].triangle_count + 64);
        m->chunk_bytes = bytes > m->chunk_bytes ? bytes : m->chunk_bytes;
    }
    for (uint32_t v = 0; v < m->mesh->vertex_count; v++)
        for (int k = 0; k < 3; k++)
            most = fmax(most, fabs((double)positions[v][k]));
    for (int k = 0; k < 3; k++) {
        const double side = (double)header->bounds_max[k] - (double)header->bounds_min[k];
        m->diagonal += side * side;
        most = fmax(most,
                    fmax(fabs((double)header->bounds_min[k]), fabs((double)header->bounds_max[k])));
    }
    m->diagonal = sqrt(m->diagonal);
    m->reach = vox_mean_reach(m->mesh);
    m->area = m->reach * m->reach * m->mesh->triangle_count;
    m->scan.slack = m->low.slack = 0x1p-21 * most;
    square = 16 * most * most;
    memcpy(&bits, &square, sizeof bits);
    m->first_bin = (int64_t)(bits >> 48) - VOX_BINS;
}

int vox_measure_region(struct vox_measuring *m, const bool *owned)
{
    const struct vox_mesh *mesh = m->mesh;
    const uint32_t count = mesh->triangle_count;
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(m->ctx, "bounds", count, &m->bounds));
    BSQ_TRY(vox_closest_build(m->ctx, (const float(*)[3])mesh->positions,
                              (const uint32_t(*)[3])mesh->triangles, count, false, &m->tree));
    BSQ_TRY(measure_scan(m));
    for (uint32_t t = 0; t < count; t++)
        m->bounds[t] = !owned || owned[t] ? vox_cover_bound(&m->cover, t) : 0;
    if (m->marks)
        m->scan = m->low = vox_limit_bound(m);
    BSQ_TRY(vox_measure_samples(m));
    BSQ_TRY(vox_resolve_bounds(m));
    status = vox_boxes_add_mesh(m);
done:
    vox_cover_free(m->ctx, &m->cover);
    vox_closest_free(m->ctx, &m->tree);
    bsq_free(m->ctx, m->bounds);
    m->bounds = NULL;
    return status;
}

int vox_measure(struct bsq_ctx *ctx, const struct fmt_tris_file *file, const struct vox_mesh *mesh,
                struct vox_marks *marks, struct vox_measured_box *boxes, uint32_t box_count,
                uint32_t at_once, struct vox_distances *scan_to_mesh,
                struct vox_distances *mesh_to_scan)
{
    const struct vox_region all = {{-INFINITY, -INFINITY, -INFINITY},
                                   {INFINITY, INFINITY, INFINITY},
                                   fmt_tris_get_header(file)->triangle_count};
    struct vox_measuring m = {.ctx = ctx, .file = file, .mesh = mesh, .region = &all};
    int status = 0;
    measure_sizes(&m);
    BSQ_TRY(vox_surround_region(&m, VOX_NEAR_REACHES * m.reach));
    if (marks) {
        m.limit = marks->limit;
        m.marks = marks->triangles;
    }
    BSQ_TRY(vox_boxes_begin(&m, boxes, box_count));
    BSQ_TRY(BSQ_CALLOC(ctx, "distances", 1, &m.from_scan));
    BSQ_TRY(BSQ_CALLOC(ctx, "distances", 1, &m.from_mesh));
    BSQ_TRY(marks || mesh->triangle_count / 2 <= at_once ? vox_measure_region(&m, NULL)
                                                         : vox_measure_parts(&m, at_once));
    vox_summarize(&m, m.from_scan, &m.scan, scan_to_mesh);
    vox_summarize(&m, m.from_mesh, &m.low, mesh_to_scan);
    vox_boxes_end(&m);
done:
    BSQ_FREE(ctx, m.boxes.from_mesh, m.boxes.from_scan, m.from_mesh, m.from_scan);
    return status;
}
