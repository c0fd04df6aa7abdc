/* exact_walk_lanes.c - finds the nearest hits of rays among the triangles of chunks.
 *
 * The leaves of the tree are runs of EXACT_RUN triangles. So that most triangles that are tested in
 * double are hit, these have boxes, too. They are made for the runs that a bundle enters: that
 * takes no longer than to bring them from memory. */
#include <string.h>

#include "libbake/exact/exact_scene.h"
#include "libbake/exact/exact_walk.h"

struct trace {
    const struct exact_slot *slot;
    uint64_t first;
    const bk_limits *limits;
    const struct bake_ray *ray;
    struct exact_walk walk;
    double t_max;   /* of hits that count */
    bk_shear shear; /* set for the first triangle: many rays meet none */
    bool sheared;
    struct exact_best *best;
    bool improved;
};

/* Returns where hits would win over the best one. */
static struct exact_range range_of(double t_max, const struct exact_best *best,
                                   const bk_limits *limits)
{
    double begin = limits->t_min, end = t_max;
    if (best->triangle != BAKE_NO_HIT)
        bk_narrow(best->t, best->reach, &begin, &end);
    return exact_range_of(begin, end, (float)best->reach);
}

/* Tests a triangle, and takes its hit if that wins. */
static void walk_try_triangle(struct trace *trace, uint32_t triangle)
{
    const struct fmt_tris_chunk *chunk = &trace->slot->chunk;
    const bk_limits *limits = trace->limits;
    struct exact_best *best = trace->best;
    const uint32_t *v = chunk->triangles[triangle];
    const uint64_t number = trace->first + triangle;
    bk_line_hit crossing;
    if (!trace->sheared)
        bk_shear_set(&trace->shear, trace->ray->origin, trace->ray->direction);
    trace->sheared = true;
    if (!exact_cross_triangle(&trace->shear, chunk->positions[v[0]], chunk->positions[v[1]],
                              chunk->positions[v[2]], &crossing) ||
        !(crossing.t >= limits->t_min && crossing.t <= trace->t_max) ||
        fabs(crossing.t) < limits->gap)
        return;
    if (best->triangle != BAKE_NO_HIT &&
        !bk_wins(crossing.t, number, best->t, best->triangle, best->reach))
        return;
    if (limits->sides &&
        limits->sides != (crossing.along != bake_exact_wound_backwards(chunk, triangle)
                              ? (bk_uint)BK_ALONG
                              : (bk_uint)BK_AGAINST))
        return;
    *best = (struct exact_best){crossing.t, number, crossing.w1, crossing.w2, best->reach};
    trace->improved = true;
}

/* Tests the triangles with these numbers and boxes. */
LANES_INLINE void try_boxes(struct trace *trace, const uint32_t *numbers,
                            const struct exact_box8 *boxes)
{
    eights distances;
    unsigned bits = exact_line_crosses(&trace->walk.line, boxes, trace->walk.range.span,
                                       trace->walk.range.reach, &distances);
    for (; bits; bits &= bits - 1)
        walk_try_triangle(trace, numbers[__builtin_ctz(bits)]);
}

static void try_run(void *arg, uint32_t run)
{
    struct trace *trace = arg;
    struct exact_box8 boxes;
    uint32_t numbers[EXACT_RUN];
    for (uint32_t i = 0; i < EXACT_RUN; i++)
        numbers[i] = EXACT_RUN * run + i;
    exact_run_set(&trace->slot->chunk, run, &boxes);
    try_boxes(trace, numbers, &boxes);
    trace->walk.range = range_of(trace->t_max, trace->best, trace->limits);
}

/* ---- bundles ----
 *
 * Walking a tree waits for one node after the other. So neighbouring rays look together for the
 * triangles that any of them may cross. The boxes of these are gathered by eights, and each ray
 * goes through this list. */

enum { MOST_RUNS = 64, MOST_TRIANGLES = 256 };

/* Triangles of a chunk. */
struct list {
    uint32_t count;
    uint32_t numbers[MOST_TRIANGLES];
    struct exact_box8 boxes[MOST_TRIANGLES / 8];
};

/* A convex part of space that holds where hits of all rays of a bundle count. Between two planes
 * across the axis kz, its sides are linear: each starts at the first plane at first[] and changes
 * by change[] up to the second. */
struct beam {
    int axes[2], kz;
    float begin, end, scale;         /* the planes; 1 / their distance */
    float first[2][2], change[2][2]; /* low and high sides, by axis */
};

/* Sets the planes of a beam so that they enclose the parts of all rays that have a direction.
 * Returns false if one is too flat between them, or if there is none. */
static bool set_planes(struct beam *beam, const struct bake_ray *rays, uint32_t count, double t_min,
                       double t_max)
{
    const float flattest = 0.25f, *d = rays->direction;
    double low = INFINITY, high = -INFINITY;
    beam->kz = fabsf(d[1]) > fabsf(d[0]);
    beam->kz = fabsf(d[2]) > fabsf(d[beam->kz]) ? 2 : beam->kz;
    for (uint32_t i = 0; i < count; i++) {
        const double o = (double)rays[i].origin[beam->kz],
                     slope = (double)rays[i].direction[beam->kz];
        d = rays[i].direction;
        if (d[0] == 0.0f && d[1] == 0.0f && d[2] == 0.0f)
            continue;
        if (!(fabs(slope) >= (double)flattest))
            return false;
        const double a = o + slope * t_min, b = o + slope * t_max;
        low = a < low ? a : low;
        low = b < low ? b : low;
        high = a > high ? a : high;
        high = b > high ? b : high;
    }
    const struct exact_span span = exact_span_of(low, high);
    beam->begin = span.begin;
    beam->end = span.end;
    beam->scale = span.end > span.begin ? 1 / (span.end - span.begin) : 0;
    return isfinite(span.begin) && isfinite(span.end) && isfinite(beam->scale);
}

/* Sets the sides along an axis, farther out than all roundings can move them: these are fewer than
 * ten, each of 2^-24 of a coordinate. */
static bool set_sides(struct beam *beam, const struct bake_ray *rays, uint32_t count, int axis)
{
    const double begin = (double)beam->begin, end = (double)beam->end;
    const int k = beam->axes[axis], kz = beam->kz;
    /* Low and high sides at both planes. */
    double sides[2][2] = {{INFINITY, INFINITY}, {-INFINITY, -INFINITY}};
    for (uint32_t i = 0; i < count; i++) {
        /* Without a direction, not a number, which is neither below nor above a side. */
        const double slope =
            (double)bk_component(rays[i].direction[k]) / (double)rays[i].direction[kz];
        const double o = (double)rays[i].origin[k], oz = (double)rays[i].origin[kz];
        const double at[2] = {o + (begin - oz) * slope, o + (end - oz) * slope};
        for (int p = 0; p < 2; p++) {
            sides[0][p] = at[p] < sides[0][p] ? at[p] : sides[0][p];
            sides[1][p] = at[p] > sides[1][p] ? at[p] : sides[1][p];
        }
    }
    const double slack =
        1e-6 * (fabs(sides[0][0]) + fabs(sides[1][0]) + fabs(sides[0][1]) + fabs(sides[1][1]));
    for (int s = 0; s < 2; s++) {
        beam->first[s][axis] = (float)(sides[s][0] + (s == 0 ? -slack : slack));
        beam->change[s][axis] = (float)(sides[s][1] - sides[s][0]);
    }
    return isfinite(slack);
}

static bool set_beam(struct beam *beam, const struct bake_ray *rays, uint32_t count, double t_min,
                     double t_max)
{
    if (!set_planes(beam, rays, count, t_min, t_max))
        return false;
    beam->axes[0] = (beam->kz + 1) % 3;
    beam->axes[1] = (beam->kz + 2) % 3;
    return set_sides(beam, rays, count, 0) && set_sides(beam, rays, count, 1);
}

/* Returns a bit mask of the boxes that overlap the beam. */
static inline unsigned beam_crosses(const struct beam *beam, const struct exact_box8 *boxes)
{
    const eights *low = (const eights *)(const void *)boxes->planes[0],
                 *high = (const eights *)(const void *)boxes->planes[1];
    const eights begin = eights_splat(beam->begin), scale = eights_splat(beam->scale);
    const eights from = eights_max(low[beam->kz], begin),
                 to = eights_min(high[beam->kz], eights_splat(beam->end));
    const eights a = (from - begin) * scale, b = (to - begin) * scale;
    unsigned bits = eights_not_above(from, to);
    for (int i = 0; i < 2; i++) {
        const int k = beam->axes[i];
        const eights low_change = eights_splat(beam->change[0][i]),
                     high_change = eights_splat(beam->change[1][i]);
        const eights least = eights_splat(beam->first[0][i]) +
                             eights_min(a * low_change, b * low_change),
                     most = eights_splat(beam->first[1][i]) +
                            eights_max(a * high_change, b * high_change);
        bits &= eights_not_above(least, high[k]) & eights_not_above(low[k], most);
    }
    return bits;
}

/* Adds the triangles of a run that overlap the beam. */
static void list_run(const struct fmt_tris_chunk *chunk, uint32_t run, const struct beam *beam,
                     struct list *list)
{
    struct exact_box8 boxes;
    exact_run_set(chunk, run, &boxes);
    unsigned bits = beam_crosses(beam, &boxes);
    for (; bits; bits &= bits - 1, list->count++) {
        const unsigned c = (unsigned)__builtin_ctz(bits), to = list->count % 8;
        struct exact_box8 *out = &list->boxes[list->count / 8];
        list->numbers[list->count] = EXACT_RUN * run + c;
        for (int k = 0; k < 3; k++) {
            out->planes[0][k][to] = boxes.planes[0][k][c];
            out->planes[1][k][to] = boxes.planes[1][k][c];
        }
    }
}

/* Lists the triangles of the slot's chunk that overlap the beam. Returns false if there may be more
 * than fit. */
static bool find_triangles(const struct exact_slot *slot, const struct beam *beam,
                           struct list *list)
{
    const struct exact_tree *tree = &slot->tree;
    struct exact_entry stack[EXACT_TREE_STACK];
    uint32_t depth = 1, count = 0, runs[MOST_RUNS];
    stack[0] = (struct exact_entry){0, tree->levels - 1, 0};
    while (depth > 0) {
        const struct exact_entry top = stack[--depth];
        unsigned bits = beam_crosses(beam, &tree->nodes[tree->first[top.level] + top.node]);
        for (; bits; bits &= bits - 1) {
            const uint32_t child = 8 * top.node + (uint32_t)__builtin_ctz(bits);
            if (top.level > 0) {
                stack[depth++] = (struct exact_entry){0, top.level - 1, child};
                continue;
            }
            if (count == MOST_RUNS)
                return false;
            exact_prefetch(slot->chunk.triangles[(uint64_t)EXACT_RUN * child],
                           EXACT_RUN * sizeof *slot->chunk.triangles, 1);
            runs[count++] = child;
        }
    }
    for (uint32_t r = 0; r < count; r++) {
        if (list->count + EXACT_RUN > MOST_TRIANGLES)
            return false;
        list_run(&slot->chunk, runs[r], beam, list);
    }
    exact_box8_end(list->boxes, list->count);
    return true;
}

unsigned BSQ_SIMD_NAME(bake_exact_slot_trace)(const struct exact_slot *slot, uint64_t first,
                                              const struct bake_ray *rays, uint32_t count,
                                              const bk_limits *limits, struct exact_best *best)
{
    struct list list;
    unsigned improved = 0;
    struct beam beam;
    list.count = 0;
    const bool listed = slot->tree.levels > 0 &&
                        set_beam(&beam, rays, count, limits->t_min, limits->t_max) &&
                        find_triangles(slot, &beam, &list);
    if (listed && list.count == 0)
        return 0;
    struct exact_range fresh = {0}; /* of rays without a hit, and with this reach */
    double reach = NAN;
    for (uint32_t i = 0; i < count; i++) {
        struct trace trace = {
            .slot = slot, .first = first, .limits = limits, .ray = &rays[i], .best = &best[i]};
        if (!bk_line_set(&trace.walk.line, rays[i].origin, rays[i].direction))
            continue;
        trace.t_max =
            limits->from_reach && best[i].reach < limits->t_max ? best[i].reach : limits->t_max;
        if (best[i].triangle != BAKE_NO_HIT) {
            trace.walk.range = range_of(trace.t_max, &best[i], limits);
        } else {
            if (best[i].reach != reach)
                fresh = range_of(trace.t_max, &best[i], limits);
            reach = best[i].reach;
            trace.walk.range = fresh;
        }
        if (listed)
            for (uint32_t b = 0; b < list.count; b += 8)
                try_boxes(&trace, &list.numbers[b], &list.boxes[b / 8]);
        else
            exact_walk_tree(&trace.walk, &slot->tree, try_run, &trace);
        improved |= (unsigned)trace.improved << i;
    }
    return improved;
}

/* Returns a bit mask of eight boxes that any of the rays crosses. */
static unsigned rays_cross(const struct bake_ray *rays, uint32_t count, double t_min, double t_max,
                           const struct exact_box8 *boxes)
{
    const struct exact_span span = exact_span_of(t_min, t_max);
    bk_line line;
    eights distances;
    unsigned bits = 0;
    for (uint32_t i = 0; i < count; i++)
        if (bk_line_set(&line, rays[i].origin, rays[i].direction))
            bits |= exact_line_crosses(&line, boxes, span, 0, &distances);
    return bits;
}

uint32_t BSQ_SIMD_NAME(bake_exact_crossed)(const struct bake_ray *rays, uint32_t ray_count,
                                           double t_min, double t_max,
                                           const struct exact_box8 *boxes, uint32_t count,
                                           uint32_t *out)
{
    struct beam beam;
    /* Near many boxes, rays point anywhere or are far apart: few of them cross each box. */
    const bool narrow = count <= 16 && set_beam(&beam, rays, ray_count, t_min, t_max);
    uint32_t found = 0;
    for (uint32_t i = 0; i < count; i += 8) {
        const unsigned bits = narrow ? beam_crosses(&beam, &boxes[i / 8])
                                     : rays_cross(rays, ray_count, t_min, t_max, &boxes[i / 8]);
        eights_store_set(bits, i, out + found);
        found += (uint32_t)__builtin_popcount(bits);
    }
    return found;
}
