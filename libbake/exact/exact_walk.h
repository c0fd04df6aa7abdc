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
    bk_line line;
    struct exact_range range;
    bool ahead;           /* the range is between 0 and something, and its reach 0 */
    bool done;            /* no better hit is needed */
    const char *contents; /* of the tree's boxes, content_bytes each; NULL: not to be fetched */
    uint32_t content_bytes;
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

/* Fetches those of eight objects, of `bytes` each, whose bits are set. */
LANES_INLINE void exact_prefetch(const void *objects, uint32_t bytes, unsigned bits)
{
    for (; bits; bits &= bits - 1)
        for (uint32_t at = 0; at < bytes; at += 64)
            __builtin_prefetch((const char *)objects + (uint32_t)__builtin_ctz(bits) * bytes + at);
}

LANES_INLINE unsigned exact_walk_crosses(const struct exact_walk *walk,
                                         const struct exact_box8 *boxes, eights *distances)
{
    return walk->ahead
               ? exact_line_crosses_ahead(&walk->line, boxes, walk->range.span.end, distances)
               : exact_line_crosses(&walk->line, boxes, walk->range.span, walk->range.reach,
                                    distances);
}

/* Calls `visit` for the boxes below a node that the ray crosses where a hit would win, near ones
 * first, until `visit` sets walk->done. bits, crossed: of the node's children, as
 * exact_line_crosses() returns them. */
LANES_INLINE void exact_walk_below(struct exact_walk *walk, const struct exact_tree *tree,
                                   uint32_t level, uint32_t node, unsigned bits, eights crossed,
                                   void (*visit)(void *arg, uint32_t box), void *arg)
{
    struct exact_entry stack[EXACT_TREE_STACK];
    float distances[8];
    uint32_t depth = 0;
    for (;;) {
        memcpy(distances, &crossed, sizeof distances);
        if (level > 0) {
            exact_prefetch(&tree->nodes[tree->first[level - 1] + 8 * node],
                           sizeof(struct exact_box8), bits);
            depth = exact_push_children(stack, depth, level, node, bits, distances);
        } else if (walk->contents) {
            exact_prefetch(walk->contents + (uint64_t)8 * node * walk->content_bytes,
                           walk->content_bytes, bits);
        }
        for (; level == 0 && bits && !walk->done; bits &= bits - 1) {
            const unsigned c = (unsigned)__builtin_ctz(bits);
            if (distances[c] <= walk->range.farthest)
                visit(arg, 8 * node + c);
        }
        while (depth > 0 && stack[depth - 1].distance > walk->range.farthest)
            depth--;
        if (depth == 0 || walk->done)
            return;
        level = stack[--depth].level;
        node = stack[depth].node;
        bits = exact_walk_crosses(walk, &tree->nodes[tree->first[level] + node], &crossed);
    }
}

/* Likewise for all boxes of a tree. */
LANES_INLINE void exact_walk_tree(struct exact_walk *walk, const struct exact_tree *tree,
                                  void (*visit)(void *arg, uint32_t box), void *arg)
{
    eights crossed;
    if (tree->levels == 0)
        return;
    const uint32_t root = tree->levels - 1;
    const unsigned bits = exact_walk_crosses(walk, &tree->nodes[tree->first[root]], &crossed);
    exact_walk_below(walk, tree, root, 0, bits, crossed, visit, arg);
}

#endif
