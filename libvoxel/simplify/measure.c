/* measure.c - see measure.h.
 *
 * The pass over the chunks serves both directions: each chunk's vertices look for the mesh, and
 * samples of the mesh that the chunk may be closest to look for its triangles. Squared distances of
 * samples only shrink, as bits of floats, so workers need no lock for them and the result does not
 * depend on their order. Sums are added up in the order of chunks. */
#include "libvoxel/simplify/measure.h"

#include <float.h>
#include <math.h>
#include <stdatomic.h>
#include <string.h>

#include "base/parallel.h"
#include "base/vec.h"
#include "libvoxel/simplify/closest.h"

enum {
    /* For each triangle of the scan and of the mesh: more would find nothing new. */
    SAMPLES_PER_TRIANGLE = 16,
    AREA_SAMPLES_MAX = 131072,
    /* Of the histogram: a sixteenth of an octave each, from 2^-40 of the scan's diagonal on. */
    BINS_PER_OCTAVE = 16,
    OCTAVES = 42,
    BINS = BINS_PER_OCTAVE * OCTAVES,
    SAMPLE_BLOCK = 1024
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
    double enough_square, diagonal;
    struct vox_closest tree;             /* of the mesh */
    float (*samples)[3];                 /* points on the mesh, then its vertices */
    _Atomic uint32_t *found;             /* bits of their squared distances */
    uint32_t area_samples, sample_count; /* points on the mesh; with its vertices */
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

static double triangle_area(const float (*positions)[3], const uint32_t triangle[3])
{
    double e[2][3], normal[3];
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 2; i++)
            e[i][k] = (double)positions[triangle[i + 1]][k] - (double)positions[triangle[0]][k];
    bsq_crossd(e[0], e[1], normal);
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

/* Bounds the distances of a block of samples: no chunk is farther than the far corner of its box.
 */
static int bound_samples(void *arg, uint64_t block, unsigned worker)
{
    struct measuring *m = arg;
    const struct fmt_tris_chunk_info *chunks = fmt_tris_chunks(m->file);
    const uint64_t count = fmt_tris_get_header(m->file)->chunk_count;
    const uint32_t begin = (uint32_t)(block * SAMPLE_BLOCK);
    (void)worker;
    for (uint32_t s = begin; s < begin + SAMPLE_BLOCK && s < m->sample_count; s++) {
        double least = INFINITY;
        for (uint64_t i = 0; i < count; i++) {
            double square = 0;
            for (int k = 0; k < 3; k++) {
                const double x = (double)m->samples[s][k];
                const double to_low = fabs(x - (double)chunks[i].bounds_min[k]),
                             to_high = fabs(x - (double)chunks[i].bounds_max[k]);
                const double far = to_low > to_high ? to_low : to_high;
                square += far * far;
            }
            least = square < least ? square : least;
        }
        lower(&m->found[s], least * 1.000001);
    }
    return bsq_check(m->ctx);
}

/* ---- chunks ---- */

static int produce_chunk(void *arg, void *slot, uint64_t sequence)
{
    const struct measuring *m = arg;
    memset(slot, 0, sizeof(struct slot));
    return !m->enough && sequence < fmt_tris_get_header(m->file)->chunk_count;
}

/* Adds the distances of a chunk's vertices from the mesh, by a third of the area of the triangles
 * around each. areas: of vertices. The distance of a vertex is bounded by that of the one before.
 */
static int measure_vertices(const struct measuring *m, const struct fmt_tris_chunk *chunk,
                            double *areas, struct sums *sums)
{
    double square = INFINITY, last[3] = {0, 0, 0};
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        const double third = triangle_area(chunk->positions, chunk->triangles[t]) / 3;
        for (int k = 0; k < 3; k++)
            areas[chunk->triangles[t][k]] += third;
    }
    for (uint32_t v = 0; v < chunk->vertex_count; v++) {
        double p[3], moved = 0;
        if (v % 4096 == 0 && bsq_check(m->ctx) < 0)
            return BSQ_EINTR;
        for (int k = 0; k < 3; k++) {
            p[k] = (double)chunk->positions[v][k];
            moved += (p[k] - last[k]) * (p[k] - last[k]);
            last[k] = p[k];
        }
        const double most = sqrt(square) + sqrt(moved);
        square = vox_closest_square(&m->tree, p, most * most * 1.000001 + DBL_MIN);
        add_distance(sums, square, areas[v], chunk->positions[v], m->diagonal);
    }
    return 0;
}

/* Lowers the distances of the samples that this chunk may be closest to. */
static int measure_samples(const struct measuring *m, uint64_t index,
                           const struct fmt_tris_chunk *chunk)
{
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    struct vox_closest tree = {0};
    int status = 0;
    for (uint32_t s = 0; s < m->sample_count; s++) {
        const double p[3] = {(double)m->samples[s][0], (double)m->samples[s][1],
                             (double)m->samples[s][2]};
        const double most =
            (double)from_bits(atomic_load_explicit(&m->found[s], memory_order_relaxed));
        if (s % 4096 == 0)
            BSQ_TRY(bsq_check(m->ctx));
        if (vox_box_square(info->bounds_min, info->bounds_max, p) >= most)
            continue;
        if (!tree.nodes)
            BSQ_TRY(vox_closest_build(m->ctx, chunk->positions, chunk->triangles,
                                      chunk->triangle_count, true, &tree));
        const double square = vox_closest_square(&tree, p, most);
        if (square < most)
            lower(&m->found[s], square);
    }
done:
    vox_closest_free(m->ctx, &tree);
    return status;
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
    BSQ_TRY(bsq_alloc(m->ctx, "a chunk", fmt_tris_load_size(m->file, sequence), 1, &scratch));
    BSQ_TRY(fmt_tris_load(m->file, sequence, scratch, &chunk));
    BSQ_TRY(bsq_calloc(m->ctx, "areas", chunk.vertex_count, sizeof *areas, &areas));
    BSQ_TRY(measure_vertices(m, &chunk, areas, &slot->sums));
    if (slot->sums.max_square <= m->enough_square)
        status = measure_samples(m, sequence, &chunk);
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

static int measure_chunks(struct measuring *m)
{
    const unsigned slot_count = 2 * bsq_threads(m->ctx);
    struct slot *slots = NULL;
    int status = 0;
    BSQ_TRY(bsq_calloc(m->ctx, "distances", slot_count, sizeof *slots, &slots));
    BSQ_TRY(bsq_parallel_for(m->ctx, m->sample_count / SAMPLE_BLOCK + 1, bound_samples, m));
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
    BSQ_TRY(vox_closest_build(ctx, (const float(*)[3])mesh->positions,
                              (const uint32_t(*)[3])mesh->triangles, mesh->triangle_count, false,
                              &m.tree));
    spread_samples(&m);
    memset(m.found, 0x7f, m.sample_count * sizeof *m.found); /* about 3e38 */
    BSQ_TRY(measure_chunks(&m));
    for (uint32_t s = 0; s < m.sample_count; s++)
        add_distance(samples, (double)from_bits(m.found[s]), s < m.area_samples ? 1.0 : 0.0,
                     (const float *)m.samples[s], m.diagonal);
    summarize(&m, m.total, scan_to_mesh);
    summarize(&m, samples, mesh_to_scan);
done:
    vox_closest_free(ctx, &m.tree);
    bsq_free(ctx, (void *)m.found);
    bsq_free(ctx, m.samples);
    bsq_free(ctx, samples);
    bsq_free(ctx, m.total);
    return status;
}
