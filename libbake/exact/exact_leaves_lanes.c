/* exact_leaves_lanes.c - finds the nearest hit, or any, of a secondary ray. */
#include <float.h>

#include "libbake/exact/exact_leaves.h"
#include "libbake/exact/exact_walk.h"

struct look {
    const struct exact_group *group;
    const struct exact_leaves *chunk;
    const struct exact_look_limits *limits;
    struct exact_walk walk;
    struct exact_shear shear;
    double nearest;
    bool found;
};

/* Returns a bit mask of the triangles of a leaf that the line may hit within the walk's span: those
 * for which exact_cross_triangle() cannot say no. What it computes in double is computed in float
 * here, so that with unit = 2^-24 and the largest coordinate `far` from the ray's origin, sheared
 * corners are off by less than 7 units of `far`, which is doubled here, and edge functions by what
 * follows from that and their own roundings. Where squares overflow, the slack is NaN, and
 * comparisons with that leave a triangle in. */
LANES_INLINE unsigned leaf_candidates(const struct look *look, const struct exact_leaf *leaf)
{
    const struct exact_shear *shear = &look->shear;
    const int axes[3] = {shear->kx, shear->ky, shear->kz};
    const eights sx = eights_splat((float)shear->sx), sy = eights_splat((float)shear->sy),
                 sz = eights_splat((float)shear->sz), zero = eights_splat(0.0f),
                 unit = eights_splat(0x1p-24f), least = eights_splat(FLT_MIN);
    eights x[3], y[3], t[3], far = zero, side = zero;
    for (int c = 0; c < 3; c++) {
        eights from[3];
        for (int k = 0; k < 3; k++) {
            from[k] = *(const eights *)(const void *)leaf->corners[c][axes[k]] -
                      eights_splat((float)shear->origin[axes[k]]);
            far = eights_max(far, eights_max(from[k], -from[k]));
        }
        x[c] = from[0] - sx * from[2];
        y[c] = from[1] - sy * from[2];
        t[c] = sz * from[2];
        side = eights_max(side, eights_max(x[c], -x[c]));
        side = eights_max(side, eights_max(y[c], -y[c]));
    }
    const eights off = 14.0f * unit * far;
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
    struct exact_crossing crossing;
    float corners[3][3];
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 3; k++)
            corners[c][k] = leaf->corners[c][k][lane];
    if (!exact_cross_triangle(&look->shear, corners[0], corners[1], corners[2], &crossing) ||
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

static void visit_chunk(void *arg, uint32_t box)
{
    struct look *look = arg;
    look->chunk = &look->group->chunks[box];
    exact_walk_tree(&look->walk, &look->chunk->tree, visit_leaf, look);
}

bool BSQ_SIMD_NAME(bake_exact_group_trace)(const struct exact_group *group,
                                           const struct bake_ray *ray,
                                           const struct exact_look_limits *limits, double *t)
{
    struct look look = {.group = group, .limits = limits, .nearest = limits->t_max};
    if (!exact_line_set(&look.walk.line, ray->origin, ray->direction))
        return false;
    exact_shear_set(&look.shear, ray->origin, ray->direction);
    look.walk.range = exact_range_of(0, limits->t_max, 0);
    exact_walk_tree(&look.walk, &group->tree, visit_chunk, &look);
    *t = look.nearest;
    return look.found;
}
