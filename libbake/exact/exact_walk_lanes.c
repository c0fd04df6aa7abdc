/* exact_walk_lanes.c - finds the nearest hit of a ray among the triangles of chunks.
 *
 * The leaves of the tree are boxes of single triangles, so that most triangles that are tested in
 * double are hit. */
#include <string.h>

#include "libbake/exact/exact_line.h"
#include "libbake/exact/exact_scene.h"

struct trace {
    const struct exact_slot *slot;
    uint64_t first;
    const struct exact_limits *limits;
    const struct bake_exact_ray *ray;
    struct exact_line line;
    struct exact_shear shear; /* set for the first triangle: many rays meet none */
    bool sheared;
    struct exact_span span; /* where a hit would win; shrinks with each hit */
    float reach;            /* best->reach, from which distances to boxes count */
    float farthest;         /* distance up to which a hit could win */
    double t_max;           /* of hits that count */
    struct exact_best *best;
    bool improved, done;             /* done: no better hit is needed */
    const struct exact_group *group; /* whose slots are walked one after another */
};

static void set_span(struct trace *trace)
{
    const struct exact_best *best = trace->best;
    const double reach = best->reach, t = best->t;
    double begin = trace->limits->t_min, end = trace->t_max;
    if (best->triangle != BAKE_EXACT_NONE) {
        const double least = t <= reach ? t : -t, most = t > reach || -t > reach ? fabs(t) : reach;
        begin = begin > least ? begin : least;
        end = end < most ? end : most;
    }
    trace->span = exact_span_of(begin, end);
    /* With more than the differences here and of the distances are rounded by. */
    const float in = trace->reach - trace->span.begin, out = trace->span.end - trace->reach;
    trace->farthest = (in > out ? in : out) * (1.0f + 4.8e-7f);
}

/* Prepares a ray. Returns false if it hits nothing. */
static bool begin_trace(struct trace *trace)
{
    const struct exact_limits *limits = trace->limits;
    trace->reach = (float)trace->best->reach;
    trace->t_max = limits->t_max;
    if (limits->from_reach && trace->best->reach < limits->t_max)
        trace->t_max = trace->best->reach;
    set_span(trace);
    return exact_line_set(&trace->line, trace->ray->origin, trace->ray->direction);
}

/* Tests a triangle, and takes its hit if that wins. */
static void try_triangle(struct trace *trace, uint32_t triangle)
{
    const struct fmt_tris_chunk *chunk = &trace->slot->chunk;
    const struct exact_limits *limits = trace->limits;
    struct exact_best *best = trace->best;
    const uint32_t *v = chunk->triangles[triangle];
    const uint64_t number = trace->first + triangle;
    struct exact_crossing crossing;
    if (!trace->sheared)
        exact_shear_set(&trace->shear, trace->ray->origin, trace->ray->direction);
    trace->sheared = true;
    if (!exact_cross_triangle(&trace->shear, chunk->positions[v[0]], chunk->positions[v[1]],
                              chunk->positions[v[2]], &crossing) ||
        !(crossing.t >= limits->t_min && crossing.t <= trace->t_max) ||
        fabs(crossing.t) < limits->gap)
        return;
    if (best->triangle != BAKE_EXACT_NONE &&
        !exact_wins(crossing.t, number, best->t, best->triangle, best->reach))
        return;
    if (!limits->two_sided) {
        const bool along = crossing.along != bake_exact_wound_backwards(chunk, triangle);
        if (along == limits->facing_origin)
            return;
    }
    *best = (struct exact_best){crossing.t, number, crossing.w1, crossing.w2, best->reach};
    trace->improved = true;
    trace->done = limits->any;
    set_span(trace);
}

struct entry {
    float distance;
    uint32_t level, node;
};

/* Pushes the children that the ray crosses, the nearest one last. Returns the new depth. */
static uint32_t push_children(struct entry *stack, uint32_t depth, uint32_t level, uint32_t node,
                              unsigned bits, const float distances[8])
{
    const uint32_t base = depth;
    if ((bits & (bits - 1)) == 0 && bits != 0) {
        const unsigned c = (unsigned)__builtin_ctz(bits);
        stack[depth] = (struct entry){distances[c], level - 1, 8 * node + c};
        return depth + 1;
    }
    for (; bits; bits &= bits - 1) {
        const unsigned c = (unsigned)__builtin_ctz(bits);
        uint32_t at = depth++;
        for (; at > base && stack[at - 1].distance < distances[c]; at--)
            stack[at] = stack[at - 1];
        stack[at] = (struct entry){distances[c], level - 1, 8 * node + c};
    }
    return depth;
}

/* Calls `visit` for the boxes of a tree that the ray crosses where a hit would win, near ones
 * first.
 */
static inline void walk_tree(struct trace *trace, const struct exact_tree *tree,
                             void (*visit)(struct trace *trace, uint32_t box))
{
    struct entry stack[EXACT_TREE_STACK];
    eights crossed;
    float distances[8];
    uint32_t depth = 1;
    if (tree->levels == 0)
        return;
    stack[0] = (struct entry){0, tree->levels - 1, 0};
    while (depth > 0 && !trace->done) {
        const struct entry top = stack[--depth];
        if (top.distance > trace->farthest)
            continue;
        const struct exact_box8 *boxes = &tree->nodes[tree->first[top.level] + top.node];
        unsigned bits =
            exact_line_crosses(&trace->line, boxes, trace->span, trace->reach, &crossed);
        memcpy(distances, &crossed, sizeof distances);
        if (top.level > 0) {
            depth = push_children(stack, depth, top.level, top.node, bits, distances);
            continue;
        }
        for (; bits && !trace->done; bits &= bits - 1) {
            const unsigned c = (unsigned)__builtin_ctz(bits);
            if (distances[c] <= trace->farthest)
                visit(trace, 8 * top.node + c);
        }
    }
}

static void walk_slot(struct trace *trace, const struct exact_slot *slot, uint64_t first)
{
    trace->slot = slot;
    trace->first = first;
    walk_tree(trace, &slot->tree, try_triangle);
}

static void visit_slot(struct trace *trace, uint32_t number)
{
    const struct exact_slot *slot = &trace->group->slots[number];
    walk_slot(trace, slot, trace->group->exact->chunks[slot->number].first_triangle);
}

bool BSQ_SIMD_NAME(bake_exact_slot_trace)(const struct exact_slot *slot, uint64_t first,
                                          const struct bake_exact_ray *ray,
                                          const struct exact_limits *limits,
                                          struct exact_best *best)
{
    struct trace trace = {.limits = limits, .ray = ray, .best = best};
    if (!begin_trace(&trace))
        return false;
    walk_slot(&trace, slot, first);
    return trace.improved;
}

bool BSQ_SIMD_NAME(bake_exact_group_trace)(const struct exact_group *group,
                                           const struct bake_exact_ray *ray,
                                           const struct exact_limits *limits,
                                           struct exact_best *best)
{
    struct trace trace = {.limits = limits, .ray = ray, .best = best, .group = group};
    if (!begin_trace(&trace))
        return false;
    walk_tree(&trace, &group->tree, visit_slot);
    return trace.improved;
}

uint32_t BSQ_SIMD_NAME(bake_exact_crossed)(const struct bake_exact_ray *ray, double t_min,
                                           double t_max, const struct exact_box8 *boxes,
                                           uint32_t count, uint32_t *out)
{
    const struct exact_span span = exact_span_of(t_min, t_max);
    struct exact_line line;
    eights distances;
    uint32_t found = 0;
    if (!exact_line_set(&line, ray->origin, ray->direction))
        return 0;
    for (uint32_t i = 0; i < count; i += 8) {
        const unsigned bits = exact_line_crosses(&line, &boxes[i / 8], span, 0, &distances);
        eights_store_set(bits, i, out + found);
        found += (uint32_t)__builtin_popcount(bits);
    }
    return found;
}
