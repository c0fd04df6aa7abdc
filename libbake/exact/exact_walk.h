/* exact_walk.h - the walk of a ray through a tree of boxes; private to this folder. */
#ifndef BAKE_EXACT_EXACT_WALK_H
#define BAKE_EXACT_EXACT_WALK_H

#include "libbake/exact/exact_line.h"

/* Where a hit of a ray would win. */
struct exact_range {
    struct exact_span span;
    float reach;    /* from where distances to boxes count */
    float farthest; /* distance up to which a hit could win */
};

/* A ray on its way. Whoever finds a hit shrinks the range. */
struct exact_walk {
    struct exact_line line;
    struct exact_range range;
    bool done; /* no better hit is needed */
};

/* Returns the range between two parameters. */
static inline struct exact_range exact_range_of(double begin, double end, float reach)
{
    struct exact_range range = {.span = exact_span_of(begin, end), .reach = reach};
    /* With more than the differences here and of the distances are rounded by. */
    const float in = reach - range.span.begin, out = range.span.end - reach;
    range.farthest = (in > out ? in : out) * (1.0f + 4.8e-7f);
    return range;
}

struct exact_entry {
    float distance;
    uint32_t level, node;
};

/* Pushes the children that the ray crosses, the nearest one last. Returns the new depth. */
static inline uint32_t exact_push_children(struct exact_entry *stack, uint32_t depth,
                                           uint32_t level, uint32_t node, unsigned bits,
                                           const float distances[8])
{
    const uint32_t base = depth;
    if ((bits & (bits - 1)) == 0 && bits != 0) {
        const unsigned c = (unsigned)__builtin_ctz(bits);
        stack[depth] = (struct exact_entry){distances[c], level - 1, 8 * node + c};
        return depth + 1;
    }
    for (; bits; bits &= bits - 1) {
        const unsigned c = (unsigned)__builtin_ctz(bits);
        uint32_t at = depth++;
        for (; at > base && stack[at - 1].distance < distances[c]; at--)
            stack[at] = stack[at - 1];
        stack[at] = (struct exact_entry){distances[c], level - 1, 8 * node + c};
    }
    return depth;
}

/* Calls `visit` for the boxes of a tree that the ray crosses where a hit would win, near ones
 * first, until `visit` sets walk->done. */
LANES_INLINE void exact_walk_tree(struct exact_walk *walk, const struct exact_tree *tree,
                                  void (*visit)(void *arg, uint32_t box), void *arg)
{
    struct exact_entry stack[EXACT_TREE_STACK];
    eights crossed;
    float distances[8];
    uint32_t depth = 1;
    if (tree->levels == 0)
        return;
    stack[0] = (struct exact_entry){0, tree->levels - 1, 0};
    while (depth > 0 && !walk->done) {
        const struct exact_entry top = stack[--depth];
        if (top.distance > walk->range.farthest)
            continue;
        const struct exact_box8 *boxes = &tree->nodes[tree->first[top.level] + top.node];
        unsigned bits =
            exact_line_crosses(&walk->line, boxes, walk->range.span, walk->range.reach, &crossed);
        memcpy(distances, &crossed, sizeof distances);
        if (top.level > 0) {
            const struct exact_box8 *below =
                &tree->nodes[tree->first[top.level - 1] + 8 * top.node];
            for (unsigned b = bits; b; b &= b - 1) {
                const char *node = (const char *)&below[__builtin_ctz(b)];
                __builtin_prefetch(node);
                __builtin_prefetch(node + 64);
                __builtin_prefetch(node + 128);
            }
            depth = exact_push_children(stack, depth, top.level, top.node, bits, distances);
            continue;
        }
        for (; bits && !walk->done; bits &= bits - 1) {
            const unsigned c = (unsigned)__builtin_ctz(bits);
            if (distances[c] <= walk->range.farthest)
                visit(arg, 8 * top.node + c);
        }
    }
}

#endif
