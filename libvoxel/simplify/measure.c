/* measure.c - see steps.h.
 *
 * Each chunk's vertices look for the mesh. Then samples of the mesh look for the triangles of
 * chunks that they may be closest to. Squared distances of samples only shrink, as bits of floats,
 * so workers need no lock for them and the result does not depend on their order. Sums are added up
 * in the order of chunks. */
#include "libvoxel/simplify/steps.h"

#include <float.h>
#include <math.h>
#include <stdatomic.h>
#include <string.h>

#include "base/parallel.h"
#include "base/geometry/vec.h"
#include "libvoxel/simplify/closest.h"

enum {
    /* For each triangle of the scan and of the mesh: more would find nothing new. */
    SAMPLES_PER_TRIANGLE = 16,
    AREA_SAMPLES_MAX = 131072,
    /* Of the histogram: a sixteenth of an octave each, from 2^-40 of the scan's diagonal on. */
    BINS_PER_OCTAVE = 16,
    OCTAVES = 42,
    BINS = BINS_PER_OCTAVE * OCTAVES,
    SAMPLE_BLOCK = 1024,
    BUNDLE = 32
};

/* Pending samples that follow each other: a box around them, and the largest of their squared
 * distances when they began to be looked for. */
struct bundle {
    float low[3], high[3];
    double most;
};

struct sums {
    double weight, distance, square; /* weighted sums */
    double max_square;
    float where[3];
    double bins[BINS]; /* weights by distance */
};

struct measuring {
    struct bsq_ctx *ctx;
    const struct fmt_tris_file *file;
    const struct vox_mesh *mesh;
    double enough_square, diagonal, reach; /* reach: of a batch of points */
    struct vox_closest tree;               /* of the mesh */
    float (*samples)[3];                   /* points on the mesh, then its vertices */
    _Atomic uint32_t *found;               /* bits of their squared distances */
    uint32_t area_samples, sample_count;   /* points on the mesh; with its vertices */
    uint32_t *pending;                     /* numbers of samples that are looked for */
    uint32_t pending_count;
    struct bundle *bundles;
    struct sums *total;
    atomic_bool enough;
};

struct slot {
    struct sums sums;
};

/* ---- sums ---- */

static void add_distance(struct sums *sums, double square, double weight, const float at[3],
                         double diagonal)
{
    const double distance = sqrt(square);
    const double octave = distance > 0 ? log2(distance / diagonal) + OCTAVES - 2 : 0;
    const int bin = (int)(octave * BINS_PER_OCTAVE);
    sums->weight += weight;
    sums->distance += weight * distance;
    sums->square += weight * square;
    sums->bins[bin < 0 ? 0 : bin >= BINS ? BINS - 1 : bin] += weight;
    if (square > sums->max_square) {
        sums->max_square = square;
        memcpy(sums->where, at, sizeof sums->where);
    }
}

static void add_sums(struct sums *sums, const struct sums *other)
{
    sums->weight += other->weight;
    sums->distance += other->distance;
    sums->square += other->square;
    for (int i = 0; i < BINS; i++)
        sums->bins[i] += other->bins[i];
    if (other->max_square > sums->max_square) {
        sums->max_square = other->max_square;
        memcpy(sums->where, other->where, sizeof sums->where);
    }
}

/* Turns sums into figures. The 99th percentile is the upper end of its bin. */
static void summarize(const struct measuring *m, const struct sums *sums, struct vox_distances *out)
{
    const double *origin = fmt_tris_get_header(m->file)->origin;
    double below = 0;
    int bin = 0;
    *out = (struct vox_distances){.max = sqrt(sums->max_square)};
    for (int k = 0; k < 3; k++)
        out->where[k] = origin[k] + (double)sums->where[k];
    if (!(sums->weight > 0))
        return;
    out->mean = sums->distance / sums->weight;
    out->rms = sqrt(sums->square / sums->weight);
    while (bin < BINS - 1 && (below += sums->bins[bin]) < 0.99 * sums->weight)
        bin++;
    out->p99 = m->diagonal * exp2((double)(bin + 1) / BINS_PER_OCTAVE - (OCTAVES - 2));
    out->p99 = out->p99 < out->max ? out->p99 : out->max;
}

/* ---- samples of the mesh ---- */

static double square_between(const float p[3], const float q[3])
{
    double square = 0;
    for (int k = 0; k < 3; k++)
        square += ((double)p[k] - (double)q[k]) * ((double)p[k] - (double)q[k]);
    return square;
}

static double triangle_area(const float (*positions)[3], const uint32_t triangle[3])
{
    double normal[3];
    vox_triangle_normal(positions, triangle, normal);
    return 0.5 * sqrt(bsq_dotd(normal, normal));
}

/* Spreads samples over the triangles in steps of equal area; inside a triangle by a sequence of low
 * discrepancy (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018). */
static void spread_samples(struct measuring *m)
{
    const struct vox_mesh *mesh = m->mesh;
    const float(*positions)[3] = (const float(*)[3])mesh->positions;
    double area = 0, reached = 0;
    uint32_t done = 0;
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        area += triangle_area(positions, mesh->triangles[t]);
    m->reach = sqrt(area / mesh->triangle_count);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *corners = mesh->triangles[t];
        reached += triangle_area(positions, corners);
        const bool last = t + 1 == mesh->triangle_count;
        for (; done < m->area_samples && (last || (done + 0.5) * area < reached * m->area_samples);
             done++) {
            double u = fmod(0.5 + 0.7548776662466927 * done, 1.0),
                   v = fmod(0.5 + 0.5698402909980532 * done, 1.0);
            if (u + v > 1) {
                u = 1 - u;
                v = 1 - v;
            }
            for (int k = 0; k < 3; k++)
                m->samples[done][k] = (float)((1 - u - v) * (double)positions[corners[0]][k] +
                                              u * (double)positions[corners[1]][k] +
                                              v * (double)positions[corners[2]][k]);
        }
    }
    memcpy(m->samples + m->area_samples, mesh->positions,
           mesh->vertex_count * sizeof *mesh->positions);
}

static float from_bits(uint32_t bits)
{
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Lowers the distance of a sample. Bits of floats above 0 are in the order of the floats. */
static void lower(_Atomic uint32_t *found, double square)
{
    const float value = (float)square;
    uint32_t bits, old = atomic_load_explicit(found, memory_order_relaxed);
    memcpy(&bits, &value, sizeof bits);
    while (bits < old && !atomic_compare_exchange_weak_explicit(
                             found, &old, bits, memory_order_relaxed, memory_order_relaxed))
        ;
}

/* ---- from the scan ---- */

static int produce_chunk(void *arg, void *slot, uint64_t sequence)
{
    const struct measuring *m = arg;
    memset(slot, 0, sizeof(struct slot));
    return !m->enough && sequence < fmt_tris_get_header(m->file)->chunk_count;
}

/* Loads a chunk. The caller frees *scratch, on failure too. */
static int load_chunk(const struct measuring *m, uint64_t index, void **scratch,
                      struct fmt_tris_chunk *chunk)
{
    int status = bsq_alloc(m->ctx, "a chunk", fmt_tris_load_size(m->file, index), 1, scratch);
    return status < 0 ? status : fmt_tris_load(m->file, index, *scratch, chunk);
}

/* Returns how many points from the first on, at most a batch, are within reach of it. */
static unsigned count_near(const float (*points)[3], uint32_t count, double reach)
{
    unsigned near = 1;
    while (near < count && near < VOX_CLOSEST_BATCH &&
           square_between(points[near], points[0]) < reach * reach)
        near++;
    return near;
}

/* Adds the distances of a chunk's vertices from the mesh, by a third of the area of the triangles
 * around each. areas: of vertices. Distances are bounded by that of a vertex before. */
static int measure_vertices(const struct measuring *m, const struct fmt_tris_chunk *chunk,
                            double *areas, struct sums *sums)
{
    double squares[VOX_CLOSEST_BATCH], last_square = INFINITY;
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        const double third = triangle_area(chunk->positions, chunk->triangles[t]) / 3;
        for (int k = 0; k < 3; k++)
            areas[chunk->triangles[t][k]] += third;
    }
    for (uint32_t v = 0, count; v < chunk->vertex_count; v += count) {
        const float(*points)[3] = &chunk->positions[v], *last = chunk->positions[v > 0 ? v - 1 : 0];
        count = count_near(points, chunk->vertex_count - v, m->reach);
        for (unsigned i = 0; i < count; i++) {
            const double most = sqrt(last_square) + sqrt(square_between(points[i], last));
            squares[i] = most * most * 1.000001 + DBL_MIN;
        }
        vox_closest_squares(&m->tree, points, count, squares);
        for (unsigned i = 0; i < count; i++)
            add_distance(sums, squares[i], areas[v + i], points[i], m->diagonal);
        last_square = squares[count - 1];
        if (bsq_check(m->ctx) < 0)
            return BSQ_EINTR;
    }
    return 0;
}

static int measure_chunk(void *arg, void *slot_, uint64_t sequence, unsigned worker)
{
    const struct measuring *m = arg;
    struct slot *slot = slot_;
    struct fmt_tris_chunk chunk;
    void *scratch = NULL;
    double *areas = NULL;
    int status = 0;
    (void)worker;
    BSQ_TRY(load_chunk(m, sequence, &scratch, &chunk));
    BSQ_TRY(bsq_calloc(m->ctx, "areas", chunk.vertex_count, sizeof *areas, &areas));
    status = measure_vertices(m, &chunk, areas, &slot->sums);
done:
    bsq_free(m->ctx, areas);
    bsq_free(m->ctx, scratch);
    return status;
}

static int add_chunk(void *arg, void *slot_, uint64_t sequence)
{
    struct measuring *m = arg;
    const struct slot *slot = slot_;
    add_sums(m->total, &slot->sums);
    if (m->total->max_square > m->enough_square)
        m->enough = true;
    bsq_progress_add(m->ctx, fmt_tris_chunks(m->file)[sequence].triangle_count);
    return 0;
}

static int measure_scan(struct measuring *m)
{
    const unsigned slot_count = 2 * bsq_threads(m->ctx);
    struct slot *slots = NULL;
    int status = 0;
    BSQ_TRY(bsq_calloc(m->ctx, "distances", slot_count, sizeof *slots, &slots));
    const struct bsq_pipeline pipeline = {.produce = produce_chunk,
                                          .work = measure_chunk,
                                          .emit = add_chunk,
                                          .arg = m,
                                          .slots = slots,
                                          .slot_size = sizeof *slots,
                                          .slot_count = slot_count};
    bsq_progress_begin(m->ctx, "measuring", "triangles",
                       fmt_tris_get_header(m->file)->triangle_count);
    status = bsq_pipeline_run(m->ctx, &pipeline);
    bsq_progress_end(m->ctx);
done:
    bsq_free(m->ctx, slots);
    return status;
}

/* ---- from the mesh ---- */

/* Bounds the distances of a block of samples: no chunk is farther than the far corner of its box.
 */
static int bound_samples(void *arg, uint64_t block, unsigned worker)
{
    const struct measuring *m = arg;
    const struct fmt_tris_chunk_info *chunks = fmt_tris_chunks(m->file);
    const uint64_t count = fmt_tris_get_header(m->file)->chunk_count;
    const uint32_t begin = (uint32_t)(block * SAMPLE_BLOCK);
    (void)worker;
    for (uint32_t j = begin; j < begin + SAMPLE_BLOCK && j < m->pending_count; j++) {
        const float *p = m->samples[m->pending[j]];
        double least = INFINITY;
        for (uint64_t i = 0; i < count; i++) {
            double square = 0;
            for (int k = 0; k < 3; k++) {
                const double to_low = fabs((double)p[k] - (double)chunks[i].bounds_min[k]),
                             to_high = fabs((double)p[k] - (double)chunks[i].bounds_max[k]);
                const double far = to_low > to_high ? to_low : to_high;
                square += far * far;
            }
            least = square < least ? square : least;
        }
        lower(&m->found[m->pending[j]], least * 1.000001);
    }
    return bsq_check(m->ctx);
}

static double get_found(const struct measuring *m, uint32_t sample)
{
    return (double)from_bits(atomic_load_explicit(&m->found[sample], memory_order_relaxed));
}

/* A chunk, and a tree over it once there is a sample that it may be closest to. */
struct searched {
    struct fmt_tris_chunk chunk;
    struct vox_closest tree;
    void *scratch;
};

/* Lowers the distance of a sample. */
static int measure_sample(const struct measuring *m, uint64_t index, uint32_t sample,
                          struct searched *in)
{
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    const float(*p)[3] = (const float(*)[3])m->samples[sample];
    const double most = get_found(m, sample);
    double square = most;
    int status = 0;
    if (vox_box_square(info->bounds_min, info->bounds_max, *p, *p) >= most)
        return 0;
    if (!in->tree.nodes) {
        BSQ_TRY(load_chunk(m, index, &in->scratch, &in->chunk));
        BSQ_TRY(vox_closest_build(m->ctx, in->chunk.positions, in->chunk.triangles,
                                  in->chunk.triangle_count, true, &in->tree));
    }
    vox_closest_squares(&in->tree, p, 1, &square);
    if (square < most)
        lower(&m->found[sample], square);
done:
    return status;
}

/* Lowers the distances of pending samples that a chunk may be closest to. */
static int measure_samples(void *arg, uint64_t index, unsigned worker)
{
    const struct measuring *m = arg;
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    struct searched in = {0};
    int status = 0;
    (void)worker;
    for (uint32_t begin = 0; begin < m->pending_count; begin += BUNDLE) {
        const struct bundle *bundle = &m->bundles[begin / BUNDLE];
        if (vox_box_square(info->bounds_min, info->bounds_max, bundle->low, bundle->high) >=
            bundle->most)
            continue;
        /* Far away from the scan, samples visit much of each tree. */
        BSQ_TRY(bsq_check(m->ctx));
        for (uint32_t j = begin; j < begin + BUNDLE && j < m->pending_count; j++)
            BSQ_TRY(measure_sample(m, index, m->pending[j], &in));
    }
    bsq_progress_add(m->ctx, info->triangle_count);
done:
    vox_closest_free(m->ctx, &in.tree);
    bsq_free(m->ctx, in.scratch);
    return status;
}

static void set_bundle(const struct measuring *m, uint32_t begin, struct bundle *out)
{
    *out = (struct bundle){{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}, 0};
    for (uint32_t j = begin; j < begin + BUNDLE && j < m->pending_count; j++) {
        const float *p = m->samples[m->pending[j]];
        for (int k = 0; k < 3; k++) {
            out->low[k] = fminf(out->low[k], p[k]);
            out->high[k] = fmaxf(out->high[k], p[k]);
        }
        out->most = fmax(out->most, get_found(m, m->pending[j]));
    }
}

static int measure_pending(struct measuring *m)
{
    const struct fmt_tris_header *header = fmt_tris_get_header(m->file);
    for (uint32_t begin = 0; begin < m->pending_count; begin += BUNDLE)
        set_bundle(m, begin, &m->bundles[begin / BUNDLE]);
    bsq_progress_begin(m->ctx, "measuring", "triangles", header->triangle_count);
    int status = bsq_parallel_for(m->ctx, header->chunk_count, measure_samples, m);
    bsq_progress_end(m->ctx);
    return status;
}

/* Most samples are as close to the scan as its vertices are to the mesh, so they are looked for
 * within twice that distance first. Only what is not found there is looked for farther away. */
static int measure_mesh(struct measuring *m)
{
    const float guess =
        (float)fmin(4 * m->total->max_square + 1e-14 * m->diagonal * m->diagonal, FLT_MAX);
    uint32_t bits;
    int status = 0;
    memcpy(&bits, &guess, sizeof bits);
    for (uint32_t s = 0; s < m->sample_count; s++) {
        m->found[s] = bits;
        m->pending[s] = s;
    }
    m->pending_count = m->sample_count;
    BSQ_TRY(measure_pending(m));
    m->pending_count = 0;
    for (uint32_t s = 0; s < m->sample_count; s++) {
        if (m->found[s] < bits)
            continue;
        memset((void *)&m->found[s], 0x7f, sizeof m->found[s]); /* about 3e38 */
        m->pending[m->pending_count++] = s;
    }
    if (m->pending_count == 0)
        return 0;
    BSQ_TRY(bsq_parallel_for(m->ctx, m->pending_count / SAMPLE_BLOCK + 1, bound_samples, m));
    status = measure_pending(m);
done:
    return status;
}

int vox_measure(struct bsq_ctx *ctx, const struct fmt_tris_file *file, const struct vox_mesh *mesh,
                double enough, struct vox_distances *scan_to_mesh,
                struct vox_distances *mesh_to_scan)
{
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    struct measuring m = {.ctx = ctx, .file = file, .mesh = mesh, .enough_square = enough * enough};
    struct sums *samples = NULL;
    int status = 0;
    for (int k = 0; k < 3; k++) {
        const double side = (double)header->bounds_max[k] - (double)header->bounds_min[k];
        m.diagonal += side * side;
    }
    m.diagonal = sqrt(m.diagonal);
    m.area_samples = AREA_SAMPLES_MAX;
    if (header->triangle_count + mesh->triangle_count < AREA_SAMPLES_MAX / SAMPLES_PER_TRIANGLE)
        m.area_samples =
            SAMPLES_PER_TRIANGLE * (uint32_t)(header->triangle_count + mesh->triangle_count);
    m.sample_count = m.area_samples + mesh->vertex_count;
    BSQ_TRY(bsq_calloc(ctx, "distances", 1, sizeof *m.total, &m.total));
    BSQ_TRY(bsq_calloc(ctx, "distances", 1, sizeof *samples, &samples));
    BSQ_TRY(bsq_alloc(ctx, "samples", m.sample_count, sizeof *m.samples, &m.samples));
    BSQ_TRY(bsq_alloc(ctx, "samples", m.sample_count, sizeof *m.found, &m.found));
    BSQ_TRY(bsq_alloc(ctx, "samples", m.sample_count, sizeof *m.pending, &m.pending));
    BSQ_TRY(bsq_alloc(ctx, "samples", m.sample_count / BUNDLE + 1, sizeof *m.bundles, &m.bundles));
    BSQ_TRY(vox_closest_build(ctx, (const float(*)[3])mesh->positions,
                              (const uint32_t(*)[3])mesh->triangles, mesh->triangle_count, false,
                              &m.tree));
    spread_samples(&m);
    BSQ_TRY(measure_scan(&m));
    if (!m.enough)
        BSQ_TRY(measure_mesh(&m));
    for (uint32_t s = 0; s < m.sample_count && !m.enough; s++)
        add_distance(samples, (double)from_bits(m.found[s]), s < m.area_samples ? 1.0 : 0.0,
                     (const float *)m.samples[s], m.diagonal);
    summarize(&m, m.total, scan_to_mesh);
    summarize(&m, samples, mesh_to_scan);
done:
    vox_closest_free(ctx, &m.tree);
    bsq_free(ctx, m.bundles);
    bsq_free(ctx, m.pending);
    bsq_free(ctx, (void *)m.found);
    bsq_free(ctx, m.samples);
    bsq_free(ctx, samples);
    bsq_free(ctx, m.total);
    return status;
}
