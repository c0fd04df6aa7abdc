/* samples.c - see measure.h.
 *
 * Points of the mesh look for the triangles of chunks that they may be closest to. Squared
 * distances of points only shrink, as bits of doubles, so workers need no lock for them and the
 * result does not depend on their order. */
#include <float.h>
#include <string.h>

#include "base/parallel.h"
#include "libvoxel/simplify/measure.h"

enum {
    /* For each triangle of the scan and of the mesh: more would find nothing new. */
    SAMPLES_PER_TRIANGLE = 16,
    AREA_SAMPLES_MAX = 32768,
    /* An open triangle has this many points along an edge, at most; all together have about as many
     * as the others, and a few for each of the mesh's. */
    PARTS_MOST = 12,
    OPEN_SAMPLES = 8,
    SAMPLE_BLOCK = 1024,
    BUNDLE = 32
};

/* Pending samples that follow each other: a box around them, and the largest of their squared
 * distances when they began to be looked for. */
struct bundle {
    float low[3], high[3];
    double most;
};

struct sampling {
    const struct vox_measuring *m;
    float (*points)[3];      /* on the mesh, then its vertices, then grids of open triangles */
    _Atomic uint64_t *found; /* bits of their squared distances */
    uint32_t area_samples, sample_count; /* points on the mesh; all */
    uint8_t *parts;                      /* of each edge of an open triangle; 0: it is not open */
    uint32_t *pending;                   /* numbers of samples that are looked for */
    uint32_t pending_count;
    struct bundle *bundles;
};

static double get_found(const struct sampling *s, uint32_t sample)
{
    const uint64_t bits = atomic_load_explicit(&s->found[sample], memory_order_relaxed);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void set_found(struct sampling *s, uint32_t sample, double square)
{
    uint64_t bits;
    memcpy(&bits, &square, sizeof bits);
    s->found[sample] = bits;
}

/* Lowers the distance of a sample. Bits of doubles above 0 are in the order of the doubles. */
static void lower_found(const struct sampling *s, uint32_t sample, double square)
{
    uint64_t bits, old = atomic_load_explicit(&s->found[sample], memory_order_relaxed);
    memcpy(&bits, &square, sizeof bits);
    while (bits < old &&
           !atomic_compare_exchange_weak_explicit(&s->found[sample], &old, bits,
                                                  memory_order_relaxed, memory_order_relaxed))
        ;
}

/* Spreads samples over the triangles in steps of equal area; inside a triangle by a sequence of low
 * discrepancy (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018). They look
 * within the bounds of their triangles, and others within `most`. */
static void spread_samples(struct sampling *s, double most)
{
    const struct vox_mesh *mesh = s->m->mesh;
    const double area = s->m->reach * s->m->reach * mesh->triangle_count;
    double reached = 0;
    uint32_t done = 0;
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *corners = mesh->triangles[t];
        const float(*positions)[3] = (const float(*)[3])mesh->positions;
        const bool last = t + 1 == mesh->triangle_count;
        const double bound = s->m->bounds[t] > 0 ? s->m->bounds[t] : INFINITY; /* 0: not its own */
        reached += vox_triangle_area(positions, corners);
        for (; done < s->area_samples && (last || (done + 0.5) * area < reached * s->area_samples);
             done++) {
            double u = fmod(0.5 + 0.7548776662466927 * done, 1.0),
                   v = fmod(0.5 + 0.5698402909980532 * done, 1.0);
            if (u + v > 1) {
                u = 1 - u;
                v = 1 - v;
            }
            for (int k = 0; k < 3; k++)
                s->points[done][k] = (float)((1 - u - v) * (double)positions[corners[0]][k] +
                                             u * (double)positions[corners[1]][k] +
                                             v * (double)positions[corners[2]][k]);
            const double within = bound + s->m->low.slack;
            set_found(s, done, fmin(within * within, most));
        }
    }
    memcpy(s->points + s->area_samples, mesh->positions,
           mesh->vertex_count * sizeof *mesh->positions);
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        set_found(s, s->area_samples + v, most);
}

static uint32_t count_grid(unsigned parts)
{
    return parts > 0 ? (parts + 1) * (parts + 2) / 2 : 0;
}

/* Chooses how finely triangles are sampled whose bounds may be higher than the scan's distance, so
 * that points of most are close enough to each other to bound them. Returns the points. */
static uint32_t choose_grids(const struct sampling *s)
{
    const struct vox_measuring *m = s->m;
    const double most = AREA_SAMPLES_MAX + OPEN_SAMPLES * (double)m->mesh->triangle_count;
    double wanted = 0;
    uint32_t count = 0;
    for (int round = 0; round < 2; round++)
        for (uint32_t t = 0; t < m->mesh->triangle_count; t++) {
            const float *corners[3];
            if (!(m->bounds[t] > vox_bound_allowed(&m->scan)))
                continue;
            vox_closest_corners(&m->tree, t, corners);
            double parts = fmin(vox_longest_edge(corners) / m->scan.low, PARTS_MOST);
            if (round == 0)
                wanted += 0.5 * (parts + 1) * (parts + 2);
            if (round == 1 && wanted > most)
                parts *= sqrt(most / wanted);
            s->parts[t] = parts > 1 ? (uint8_t)parts : 1;
            count += round == 1 ? count_grid(s->parts[t]) : 0;
        }
    return count;
}

/* Sets the points of open triangles, row by row. */
static void spread_grids(struct sampling *s, double most)
{
    uint32_t at = s->area_samples + s->m->mesh->vertex_count;
    for (uint32_t t = 0; t < s->m->mesh->triangle_count; t++) {
        const double within = s->m->bounds[t] + s->m->low.slack;
        const unsigned n = s->parts[t];
        const float *c[3];
        vox_closest_corners(&s->m->tree, t, c);
        for (unsigned i = 0; i <= n && n > 0; i++)
            for (unsigned j = 0; j <= n - i; j++, at++) {
                for (int k = 0; k < 3; k++)
                    s->points[at][k] = (float)(((n - i - j) * (double)c[0][k] +
                                                j * (double)c[1][k] + i * (double)c[2][k]) /
                                               n);
                set_found(s, at, fmin(within * within, most));
            }
    }
}

/* Returns a bound for a triangle, by its own points, which begin at number `at`: no point is
 * farther from one of them than the edge of a part over the square root of 3. */
static double bound_by_grid(const struct sampling *s, uint32_t t, uint32_t at)
{
    const uint32_t end = at + count_grid(s->parts[t]);
    const float *corners[3];
    double most = 0;
    for (; at < end; at++)
        most = fmax(most, get_found(s, at));
    vox_closest_corners(&s->m->tree, t, corners);
    return sqrt(most) + vox_longest_edge(corners) / sqrt(3) / s->parts[t] + s->m->low.slack;
}

/* Bounds the distances of a block of samples: no chunk is farther than the far corner of its box.
 */
static int bound_samples(void *arg, uint64_t block, unsigned worker)
{
    const struct sampling *s = arg;
    const struct fmt_tris_chunk_info *chunks = fmt_tris_chunks(s->m->file);
    const uint64_t count = fmt_tris_get_header(s->m->file)->chunk_count;
    const uint32_t begin = (uint32_t)(block * SAMPLE_BLOCK);
    (void)worker;
    for (uint32_t j = begin; j < begin + SAMPLE_BLOCK && j < s->pending_count; j++) {
        const float *p = s->points[s->pending[j]];
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
        lower_found(s, s->pending[j], least * 1.000001);
    }
    return bsq_check(s->m->ctx);
}

/* A chunk, and a tree over it once there is a sample that it may be closest to. */
struct searched {
    struct fmt_tris_chunk chunk;
    struct vox_closest tree;
    uint32_t near; /* a triangle that was closest to a sample before */
    void *scratch;
};

/* Lowers the distance of a sample. */
static int measure_sample(const struct sampling *s, uint64_t index, uint32_t sample,
                          struct searched *in)
{
    const struct vox_measuring *m = s->m;
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    const float(*p)[3] = (const float(*)[3])s->points[sample];
    const double most = get_found(s, sample);
    const float *corners[3];
    double square = most;
    if (vox_box_square(info->bounds_min, info->bounds_max, *p, *p) >= most)
        return 0;
    if (!in->tree.nodes) {
        BSQ_PASS(vox_load_chunk(m, index, &in->scratch, &in->chunk));
        BSQ_PASS(vox_closest_build(m->ctx, in->chunk.positions, in->chunk.triangles,
                                   in->chunk.triangle_count, true, &in->tree));
    }
    vox_closest_corners(&in->tree, in->near, corners);
    square = vox_triangle_square(corners, *p, square);
    vox_closest_squares(&in->tree, p, 1, &square, &in->near);
    if (square < most)
        lower_found(s, sample, square);
    return 0;
}

/* Lowers the distances of pending samples that a chunk may be closest to. */
static int measure_samples(void *arg, uint64_t index, unsigned worker)
{
    const struct sampling *s = arg;
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(s->m->file)[index];
    struct searched in = {0};
    int status = 0;
    (void)worker;
    for (uint32_t begin = 0; begin < s->pending_count; begin += BUNDLE) {
        const struct bundle *bundle = &s->bundles[begin / BUNDLE];
        if (vox_box_square(info->bounds_min, info->bounds_max, bundle->low, bundle->high) >=
            bundle->most)
            continue;
        /* Far away from the scan, samples visit much of each tree. */
        BSQ_TRY(bsq_check(s->m->ctx));
        for (uint32_t j = begin; j < begin + BUNDLE && j < s->pending_count; j++)
            BSQ_TRY(measure_sample(s, index, s->pending[j], &in));
    }
    bsq_progress_add(s->m->ctx, info->triangle_count);
done:
    vox_closest_free(s->m->ctx, &in.tree);
    bsq_free(s->m->ctx, in.scratch);
    return status;
}

static void set_bundle(const struct sampling *s, uint32_t begin, struct bundle *out)
{
    *out = (struct bundle){{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}, 0};
    for (uint32_t j = begin; j < begin + BUNDLE && j < s->pending_count; j++) {
        const float *p = s->points[s->pending[j]];
        for (int k = 0; k < 3; k++) {
            out->low[k] = fminf(out->low[k], p[k]);
            out->high[k] = fmaxf(out->high[k], p[k]);
        }
        out->most = fmax(out->most, get_found(s, s->pending[j]));
    }
}

static int measure_pending(struct sampling *s)
{
    const struct fmt_tris_header *header = fmt_tris_get_header(s->m->file);
    for (uint32_t begin = 0; begin < s->pending_count; begin += BUNDLE)
        set_bundle(s, begin, &s->bundles[begin / BUNDLE]);
    bsq_progress_begin(s->m->ctx, "measuring", "triangles", header->triangle_count);
    int status = vox_visit_chunks(s->m, measure_samples, s);
    bsq_progress_end(s->m->ctx);
    return status;
}

/* Most samples are as close to the scan as its vertices are to the mesh, so they are looked for
 * within twice that distance first. Only what is not found there is looked for farther away. */
static int measure_all(struct sampling *s, double most)
{
    for (uint32_t i = 0; i < s->sample_count; i++)
        s->pending[i] = i;
    s->pending_count = s->sample_count;
    BSQ_PASS(measure_pending(s));
    s->pending_count = 0;
    for (uint32_t i = 0; i < s->sample_count; i++) {
        if (get_found(s, i) < most)
            continue;
        set_found(s, i, DBL_MAX);
        s->pending[s->pending_count++] = i;
    }
    if (s->pending_count == 0)
        return 0;
    BSQ_PASS(bsq_parallel_for(s->m->ctx, s->pending_count / SAMPLE_BLOCK + 1, bound_samples, s));
    return measure_pending(s);
}

/* Adds up the distances, and lowers the bounds of open triangles. */
static void use_samples(struct vox_measuring *m, const struct sampling *s)
{
    /* What a sample stands for, as all regions have as many. */
    const double weight = m->reach * m->reach * m->mesh->triangle_count / m->area;
    for (uint32_t i = 0; i < s->sample_count && !m->marks; i++) {
        const double square = get_found(s, i);
        const float *p = s->points[i];
        const double point[3] = {(double)p[0], (double)p[1], (double)p[2]};
        if (i < s->area_samples && vox_region_has(m->region, p)) {
            vox_add_distance(m, m->from_mesh, square, weight);
            vox_boxes_add_point(m, point, square, weight, m->boxes.from_mesh, m->boxes.count);
        }
        vox_bound_note(&m->low, point, sqrt(square));
    }
    uint32_t at = s->area_samples + m->mesh->vertex_count;
    for (uint32_t t = 0; t < m->mesh->triangle_count; t++) {
        const uint32_t end = at + count_grid(s->parts[t]);
        if (at < end)
            m->bounds[t] = fmin(m->bounds[t], bound_by_grid(s, t, at));
        for (; at < end; at++)
            if (m->marks && get_found(s, at) > m->limit * m->limit) {
                m->marks[t] = 1;
                m->bounds[t] = 0; /* nothing more to find out */
            }
    }
}

int vox_measure_samples(struct vox_measuring *m)
{
    const uint64_t triangles = fmt_tris_get_header(m->file)->triangle_count;
    const double far = 2 * m->scan.low + 1e-7 * m->diagonal, most = far * far;
    struct sampling s = {.m = m, .area_samples = AREA_SAMPLES_MAX};
    int status = 0;
    if (triangles + m->mesh->triangle_count < AREA_SAMPLES_MAX / SAMPLES_PER_TRIANGLE)
        s.area_samples = SAMPLES_PER_TRIANGLE * (uint32_t)(triangles + m->mesh->triangle_count);
    BSQ_TRY(BSQ_CALLOC(m->ctx, "samples", m->mesh->triangle_count, &s.parts));
    s.sample_count = s.area_samples + m->mesh->vertex_count + choose_grids(&s);
    BSQ_TRY(BSQ_ALLOC(m->ctx, "samples", s.sample_count, &s.points));
    BSQ_TRY(BSQ_ALLOC(m->ctx, "samples", s.sample_count, &s.found));
    BSQ_TRY(BSQ_ALLOC(m->ctx, "samples", s.sample_count, &s.pending));
    BSQ_TRY(BSQ_ALLOC(m->ctx, "samples", s.sample_count / BUNDLE + 1, &s.bundles));
    spread_samples(&s, most);
    spread_grids(&s, most);
    BSQ_TRY(measure_all(&s, most));
    use_samples(m, &s);
done:
    BSQ_FREE(m->ctx, s.bundles, s.pending, (void *)s.found, s.points, s.parts);
    return status;
}
