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
    NEAR_REACHES = 16, /* how far triangles of other regions matter */
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

/* Returns whether the middle of a triangle is in the region. */
static bool has_triangle(const struct vox_measuring *m, const float (*positions)[3],
                         const uint32_t corners[3])
{
    float middle[3];
    for (int k = 0; k < 3; k++)
        middle[k] =
            (positions[corners[0]][k] + positions[corners[1]][k] + positions[corners[2]][k]) / 3;
    return vox_region_has(m->region, middle);
}

/* Returns whether all of a chunk is in the region. */
static bool has_whole_chunk(const struct vox_measuring *m, uint64_t index)
{
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    return vox_region_has(m->region, info->bounds_min) &&
           vox_region_has(m->region, info->bounds_max);
}

/* Leaves of a chunk, in its scratch, the triangles that the region has, and their vertices. */
static int keep_own(const struct vox_measuring *m, uint64_t index, struct fmt_tris_chunk *chunk)
{
    float(*positions)[3] = (float(*)[3])chunk->positions;
    uint32_t(*triangles)[3] = (uint32_t(*)[3])chunk->triangles;
    uint32_t *numbers = NULL, vertices = 0, count = 0;
    if (has_whole_chunk(m, index))
        return 0;
    BSQ_PASS(BSQ_CALLOC(m->ctx, "numbers of vertices", chunk->vertex_count, &numbers));
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        if (!has_triangle(m, chunk->positions, triangles[t]))
            continue;
        memmove(triangles[count], triangles[t], sizeof *triangles);
        for (int i = 0; i < 3; i++)
            numbers[triangles[count][i]] = 1;
        count++;
    }
    for (uint32_t v = 0; v < chunk->vertex_count; v++)
        if (numbers[v] > 0) {
            memmove(positions[vertices], positions[v], sizeof *positions);
            numbers[v] = vertices++;
        }
    for (uint32_t t = 0; t < count; t++)
        for (int i = 0; i < 3; i++)
            triangles[t][i] = numbers[triangles[t][i]];
    chunk->triangle_count = count;
    chunk->vertex_count = vertices;
    bsq_free(m->ctx, numbers);
    return 0;
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
    BSQ_TRY(keep_own(m, index, &chunk));
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
        if (t % 256 == 0)
            if (bsq_check(m->ctx) < 0)
                return BSQ_EINTR;
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
    vox_cover_add(&m->cover, &chunk, of.blocks);
    BSQ_TRY(keep_own(m, sequence, &chunk));
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

/* Returns the square root of a triangle's area, in the mean. */
static double mean_reach(const struct vox_mesh *mesh)
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
    m->reach = mean_reach(m->mesh);
    m->area = m->reach * m->reach * m->mesh->triangle_count;
    m->scan.slack = m->low.slack = 0x1p-21 * most;
    square = 16 * most * most;
    memcpy(&bits, &square, sizeof bits);
    m->first_bin = (int64_t)(bits >> 48) - VOX_BINS;
}

/* Measures the chunks of a region, and the triangles of the mesh that it has: owned, of each; NULL:
 * all. */
static int measure_region(struct vox_measuring *m, const bool *owned)
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

struct box {
    float low[3], high[3];
};

static const struct box no_box = {{INFINITY, INFINITY, INFINITY},
                                  {-INFINITY, -INFINITY, -INFINITY}};

static void grow_box(struct box *box, const float low[3], const float high[3])
{
    for (int k = 0; k < 3; k++) {
        box->low[k] = fminf(box->low[k], low[k]);
        box->high[k] = fmaxf(box->high[k], high[k]);
    }
}

static void grow_by_corners(struct box *box, const float (*positions)[3], const uint32_t corners[3])
{
    for (int i = 0; i < 3; i++)
        grow_box(box, positions[corners[i]], positions[corners[i]]);
}

struct surroundings {
    const struct vox_measuring *m;
    struct box *boxes; /* of the region's triangles, one a worker */
};

static int surround_chunk(void *arg, uint64_t index, unsigned worker)
{
    const struct surroundings *s = arg;
    const struct vox_measuring *m = s->m;
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    struct fmt_tris_chunk chunk;
    void *scratch = NULL;
    int status = 0;
    bool touches = true;
    for (int k = 0; k < 3; k++)
        touches = touches && info->bounds_max[k] >= m->region->low[k] &&
                  info->bounds_min[k] < m->region->high[k];
    if (has_whole_chunk(m, index)) {
        grow_box(&s->boxes[worker], info->bounds_min, info->bounds_max);
    } else if (touches) {
        BSQ_TRY(vox_load_chunk(m, index, &scratch, &chunk));
        for (uint32_t t = 0; t < chunk.triangle_count; t++)
            if (has_triangle(m, chunk.positions, chunk.triangles[t]))
                grow_by_corners(&s->boxes[worker], chunk.positions, chunk.triangles[t]);
    }
done:
    bsq_free(m->ctx, scratch);
    return status;
}

/* Bounds the triangles that a region has, of the scan and of the mesh. Chunks may have triangles
 * far apart, so their own boxes are no measure. */
static int bound_region(struct vox_measuring *m, struct box *out)
{
    const float(*positions)[3] = (const float(*)[3])m->mesh->positions;
    struct surroundings s = {.m = m};
    int status = 0;
    *out = no_box;
    BSQ_TRY(BSQ_ALLOC(m->ctx, "boxes", bsq_threads(m->ctx), &s.boxes));
    for (unsigned i = 0; i < bsq_threads(m->ctx); i++)
        s.boxes[i] = no_box;
    BSQ_TRY(vox_visit_chunks(m, surround_chunk, &s));
    for (unsigned i = 0; i < bsq_threads(m->ctx); i++)
        grow_box(out, s.boxes[i].low, s.boxes[i].high);
    for (uint32_t t = 0; t < m->mesh->triangle_count; t++)
        if (has_triangle(m, positions, m->mesh->triangles[t]))
            grow_by_corners(out, positions, m->mesh->triangles[t]);
done:
    bsq_free(m->ctx, s.boxes);
    return status;
}

/* Sets the box of what matters to a region: what is in its box and this much farther. */
static void surround_region(struct vox_measuring *m, const struct box *box, double farther)
{
    for (int k = 0; k < 3; k++) {
        m->near_low[k] = box->low[k] - (float)farther;
        m->near_high[k] = box->high[k] + (float)farther;
    }
}

/* Returns whether a triangle of the mesh is the region's. *near: whether it matters there. */
static bool is_owned(const struct vox_measuring *m, const uint32_t corners[3], bool *near)
{
    const float(*positions)[3] = (const float(*)[3])m->mesh->positions;
    const bool own = has_triangle(m, positions, corners);
    struct box box = no_box;
    grow_by_corners(&box, positions, corners);
    *near = own || !(vox_box_square(box.low, box.high, m->near_low, m->near_high) > 0);
    return own;
}

/* Measures a region with the triangles of the mesh near it. numbers: space, of all vertices. */
static int measure_part(struct vox_measuring *m, uint32_t *numbers)
{
    const struct vox_mesh *whole = m->mesh;
    struct vox_mesh part = {0};
    struct box box;
    bool *owned = NULL, near;
    uint32_t count = 0;
    int status = 0;
    m->reach = sqrt(m->area / whole->triangle_count);
    BSQ_PASS(bound_region(m, &box));
    if (box.low[0] > box.high[0])
        return 0; /* the region is empty */
    for (double farther = fmax(NEAR_REACHES * m->reach, m->scan.slack); count == 0; farther *= 2) {
        surround_region(m, &box, farther);
        for (uint32_t t = 0; t < whole->triangle_count; t++) {
            is_owned(m, whole->triangles[t], &near);
            count += near;
        }
        BSQ_PASS(bsq_check(m->ctx));
    }
    BSQ_TRY(BSQ_ALLOC(m->ctx, "a region", count, &owned));
    BSQ_TRY(vox_mesh_allocate(m->ctx, 3 * count, count, false, false, &part));
    part.vertex_count = part.triangle_count = 0;
    memset(numbers, 0, whole->vertex_count * sizeof *numbers);
    for (uint32_t t = 0; t < whole->triangle_count; t++) {
        const uint32_t *corners = whole->triangles[t];
        const bool own = is_owned(m, corners, &near);
        if (!near)
            continue;
        owned[part.triangle_count] = own;
        for (int k = 0; k < 3; k++) {
            uint32_t *number = &numbers[corners[k]];
            if (*number == 0) {
                memcpy(part.positions[part.vertex_count], whole->positions[corners[k]],
                       sizeof *part.positions);
                *number = ++part.vertex_count;
            }
            part.triangles[part.triangle_count][k] = *number - 1;
        }
        part.triangle_count++;
    }
    m->mesh = &part;
    m->reach = mean_reach(&part);
    status = measure_region(m, owned);
    m->mesh = whole;
done:
    bsq_free(m->ctx, owned);
    vox_mesh_free(m->ctx, &part);
    return status;
}

/* Measures region by region, as what is known of a mesh while it is measured takes much memory. */
static int measure_parts(struct vox_measuring *m, uint32_t at_once)
{
    const struct vox_mesh *whole = m->mesh;
    const double share = (double)at_once / whole->triangle_count;
    struct vox_level level = {.ctx = m->ctx};
    struct vox_region *regions = NULL;
    uint32_t *numbers = NULL;
    uint64_t count;
    int status = 0;
    BSQ_TRY(vox_reduce_chunks(m->ctx, m->file, UINT64_MAX, NULL, false, &level));
    BSQ_TRY(vox_divide_level(&level, (uint64_t)(share * (double)level.triangles), 0.5, &regions,
                             &count));
    BSQ_TRY(BSQ_ALLOC(m->ctx, "a region", whole->vertex_count, &numbers));
    for (uint64_t i = 0; i < count; i++) {
        m->region = &regions[i];
        BSQ_TRY(measure_part(m, numbers));
    }
done:
    BSQ_FREE(m->ctx, numbers, regions);
    vox_level_free(&level, NULL);
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
    struct box box;
    int status = 0;
    measure_sizes(&m);
    BSQ_TRY(bound_region(&m, &box));
    surround_region(&m, &box, NEAR_REACHES * m.reach);
    if (marks) {
        m.limit = marks->limit;
        m.marks = marks->triangles;
    }
    BSQ_TRY(vox_boxes_begin(&m, boxes, box_count));
    BSQ_TRY(BSQ_CALLOC(ctx, "distances", 1, &m.from_scan));
    BSQ_TRY(BSQ_CALLOC(ctx, "distances", 1, &m.from_mesh));
    BSQ_TRY(marks || mesh->triangle_count / 2 <= at_once ? measure_region(&m, NULL)
                                                         : measure_parts(&m, at_once));
    vox_summarize(&m, m.from_scan, &m.scan, scan_to_mesh);
    vox_summarize(&m, m.from_mesh, &m.low, mesh_to_scan);
    vox_boxes_end(&m);
done:
    BSQ_FREE(ctx, m.boxes.from_mesh, m.boxes.from_scan, m.from_mesh, m.from_scan);
    return status;
}
