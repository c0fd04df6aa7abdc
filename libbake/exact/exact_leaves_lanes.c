/* exact_leaves_lanes.c - finds the nearest hit, or any, of a secondary ray. */
#include <assert.h>
#include <float.h>

#include "libbake/exact/exact_leaves.h"
#include "libbake/exact/exact_walk.h"

struct look {
    const struct exact_group *group;
    const struct exact_leaves *chunk;
    const struct exact_look_limits *limits;
    struct exact_walk walk;
    bk_shear shear;
    const float *origin;
    float from[3], slopes[3]; /* origin and s of the shear */
    float far; /* largest coordinate of the chunk's corners, relative to the ray's origin */
    double nearest;
    bool found;
};

/* Returns a bit mask of the triangles of a leaf that the line may hit within the walk's span: those
 * for which bk_cross_triangle() cannot say no. What it computes in double is computed in float
 * here, so that with unit = 2^-24, sheared corners are off by less than 7 units of look->far, which
 * is doubled here, and edge functions by what follows from that and their own roundings. Where
 * squares overflow, the slack is NaN, and comparisons with that leave a triangle in. */
LANES_INLINE unsigned leaf_candidates(const struct look *look, const struct exact_leaf *leaf)
{
    const bk_uint *axes = look->shear.k;
    const eights sx = eights_splat(look->slopes[0]), sy = eights_splat(look->slopes[1]),
                 sz = eights_splat(look->slopes[2]), unit = eights_splat(0x1p-24f),
                 least = eights_splat(FLT_MIN), off = eights_splat(14 * 0x1p-24f * look->far);
    eights x[3], y[3], t[3], side = eights_splat(0.0f);
    for (int c = 0; c < 3; c++) {
        eights from[3];
        for (int k = 0; k < 3; k++)
            from[k] = *(const eights *)(const void *)leaf->corners[c][axes[k]] -
                      eights_splat(look->from[k]);
        x[c] = from[0] - sx * from[2];
        y[c] = from[1] - sy * from[2];
        t[c] = sz * from[2];
        side = eights_max(side, eights_max(x[c], -x[c]));
        side = eights_max(side, eights_max(y[c], -y[c]));
    }
    const eights square = 4.0f * side * side;
    const eights slack =
        off * (5.0f * side + 8.0f * off) + 4.0f * unit * square + least + 0.0f * square;
    unsigned below = 0, above = 0;
    for (int c = 0; c < 3; c++) {
        const int b = (c + 1) % 3, d = (c + 2) % 3;
        const eights edge = x[b] * y[d] - y[b] * x[d];
        below |= eights_not_above(edge, -slack);
        above |= eights_not_above(slack, edge);
    }
    const eights first = eights_min(eights_min(t[0], t[1]), t[2]) - (off + least),
                 last = eights_max(eights_max(t[0], t[1]), t[2]) + (off + least);
    const unsigned outside = eights_not_above(eights_splat(look->walk.range.span.end), first) |
                             eights_not_above(last, eights_splat(look->walk.range.span.begin));
    return 0xffu & ~((below & above) | outside);
}

/* Tests a triangle, and takes its hit if it is nearer. */
static void try_lane(struct look *look, const struct exact_leaf *leaf, unsigned lane)
{
    const struct exact_look_limits *limits = look->limits;
    const bk_uint *k = look->shear.k;
    bk_line_hit crossing;
    bk_vec3 at[3];
    for (int c = 0; c < 3; c++)
        at[c] = bk_v3(leaf->corners[c][k[0]][lane], leaf->corners[c][k[1]][lane],
                      leaf->corners[c][k[2]][lane]);
    if (!bk_cross_triangle(&look->shear, at[0], at[1], at[2], &crossing) ||
        !(crossing.t >= 0 && crossing.t <= look->nearest))
        return;
    if (!limits->two_sided) {
        const bool along = crossing.along != (bool)(leaf->backwards >> lane & 1);
        if (along == limits->facing_origin)
            return;
    }
    look->nearest = crossing.t;
    look->found = true;
    look->walk.done = limits->any;
    look->walk.range = exact_range_of(0, crossing.t, 0);
}

static void visit_leaf(void *arg, uint32_t box)
{
    struct look *look = arg;
    const struct exact_leaf *leaf = &look->chunk->leaves[box];
    unsigned bits = leaf_candidates(look, leaf);
    for (; bits && !look->walk.done; bits &= bits - 1)
        try_lane(look, leaf, (unsigned)__builtin_ctz(bits));
}

/* Returns the largest coordinate in a box of a node, relative to a point. */
static float farthest_in(const struct exact_box8 *boxes, uint32_t box, const float origin[3])
{
    float far = 0;
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 2; i++)
            far = fmaxf(far, fabsf(boxes->planes[i][k][box] - origin[k]));
    return far;
}

static void visit_chunk(void *arg, uint32_t box)
{
    struct look *look = arg;
    look->chunk = &look->group->chunks[box];
    look->far = farthest_in(&look->group->tree.nodes[box / 8], box % 8, look->origin);
    look->walk.contents = (const char *)look->chunk->leaves;
    exact_walk_tree(&look->walk, &look->chunk->tree, visit_leaf, look);
    look->walk.contents = NULL;
}

/* ---- paths ---- */

static const struct exact_tree *tree_of(const struct exact_group *group,
                                        const struct exact_step *step)
{
    return step->chunk ? &step->chunk->tree : &group->tree;
}

/* Adds a node of a tree as a step. Returns whether there was space, and such a node. */
static bool add_step(const struct exact_group *group, struct exact_path *path,
                     struct exact_step step)
{
    const struct exact_tree *tree = tree_of(group, &step);
    if (path->count == EXACT_STEPS || tree->levels == 0)
        return false;
    step.boxes = &tree->nodes[tree->first[step.level] + step.node];
    path->steps[path->count++] = step;
    return true;
}

void BSQ_SIMD_NAME(bake_exact_path_find)(const struct exact_group *group, const float origin[3],
                                         struct exact_path *out)
{
    out->count = 0;
    memcpy(out->origin, origin, sizeof out->origin);
    add_step(group, out, (struct exact_step){.level = group->tree.levels - 1});
    for (uint32_t s = 0; s < out->count; s++) {
        struct exact_step *step = &out->steps[s];
        unsigned bits = 0xff;
        for (int k = 0; k < 3; k++) {
            const eights at = eights_splat(origin[k]);
            bits &= eights_not_above(*(const eights *)(const void *)step->boxes->planes[0][k], at) &
                    eights_not_above(at, *(const eights *)(const void *)step->boxes->planes[1][k]);
        }
        for (; bits; bits &= bits - 1) {
            const uint32_t c = (uint32_t)__builtin_ctz(bits), child = 8 * step->node + c;
            struct exact_step next = {.chunk = step->chunk, .far = step->far, .node = child};
            if (step->level > 0)
                next.level = step->level - 1;
            else if (step->chunk)
                continue; /* a leaf */
            else
                next = (struct exact_step){.chunk = &group->chunks[child],
                                           .level = group->chunks[child].tree.levels - 1,
                                           .far = farthest_in(step->boxes, c, origin)};
            if (add_step(group, out, next))
                step->inside |= 1u << c;
        }
    }
}

/* Goes on from a step. bits, crossed: of its children. */
static void walk_step(struct look *look, const struct exact_step *step, unsigned bits,
                      eights crossed)
{
    look->chunk = step->chunk;
    look->far = step->far;
    look->walk.contents = step->chunk ? (const char *)step->chunk->leaves : NULL;
    assert(!step->chunk || look->walk.contents);
    exact_walk_below(&look->walk, tree_of(look->group, step), step->level, step->node, bits,
                     crossed, step->chunk ? visit_leaf : visit_chunk, look);
}

bool BSQ_SIMD_NAME(bake_exact_group_trace)(const struct exact_group *group,
                                           const struct exact_path *path, const float direction[3],
                                           const struct exact_look_limits *limits, double *t)
{
    struct look look = {.group = group,
                        .limits = limits,
                        .walk = {.ahead = true, .content_bytes = sizeof(struct exact_leaf)},
                        .nearest = limits->t_max};
    eights crossed[EXACT_STEPS];
    unsigned bits[EXACT_STEPS];
    if (!bk_line_set(&look.walk.line, path->origin, direction))
        return false;
    bk_shear_set(&look.shear, path->origin, direction);
    look.origin = path->origin;
    for (int k = 0; k < 3; k++) {
        look.from[k] = path->origin[look.shear.k[k]];
        look.slopes[k] = (float)look.shear.s[k];
    }
    look.walk.range = exact_range_of(0, limits->t_max, 0);
    for (uint32_t s = 0; s < path->count; s++)
        bits[s] = exact_walk_crosses(&look.walk, path->steps[s].boxes, &crossed[s]) &
                  ~path->steps[s].inside;
    for (uint32_t s = path->count; s-- > 0 && !look.walk.done;)
        if (bits[s])
            walk_step(&look, &path->steps[s], bits[s], crossed[s]);
    *t = look.nearest;
    return look.found;
}
