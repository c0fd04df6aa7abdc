/* bk_meet.h - rays through triangles, on devices.
 *
 * In: a group of chunks, in an area of the device's memory: an array of struct bk_chunk, the first
 * of which has the tree over the chunks' bounds, then the chunks; and the nodes and leaves that
 * they point at. Out: of a secondary ray, whether it hits any triangle, or the distance of its
 * nearest hit; of a first ray through one chunk, the hit that wins by bk_wins().
 *
 * Nodes are 2 x 3 x 8 floats: lower and upper bounds, by axis, of eight children; those of missing
 * ones are empty. Leaves have eight triangles: 3 x 3 x 8 floats by corner and axis, then a word
 * whose bit i is set if triangle i is wound backwards. libbake/exact makes them, and traces them on
 * the processor, where eight boxes or triangles are tested at once. What a line that close cannot
 * hit is left out in float; the others are decided in double by bk_line.h. */
#ifndef BAKE_KERNEL_BK_MEET_H
#define BAKE_KERNEL_BK_MEET_H

#include "bk_line.h"
#include "bk_secondary.h"

/* Levels of a tree, at most. */
#define BK_CHUNK_LEVELS 11

/* A tree, and what its lowest nodes point at: the children of node n have numbers 8 n to 8 n + 7,
 * and are leaves or, of the group's tree, chunks. */
typedef struct bk_chunk {
    bk_uint nodes, leaves;          /* where they begin in the area: in units of 64 bytes */
    bk_uint levels;                 /* of nodes, at least 1 */
    bk_uint first[BK_CHUNK_LEVELS]; /* number of each level's first node; level 0 is the lowest */
    bk_uint padding[2];
} bk_chunk;

#ifdef BK_DOUBLE

#define BK_CHUNK_UNIT 4 /* in struct bk_float4 */
#define BK_NODE_SIZE  12
#define BK_LEAF_SIZE  20

/* Which hits of first rays count. */
typedef struct bk_limits {
    double t_min, t_max, gap; /* between the first two; not nearer than the gap */
    bk_uint sides;            /* as below */
    bk_uint from_reach;       /* not 0: up to the ray's reach at most */
} bk_limits;

/* A first ray, and its hit so far in other chunks. */
typedef struct bk_first_ray {
    float origin[3], direction[3], reach;
    bk_uint met; /* not 0: there is such a hit, at t */
    double t;
} bk_first_ray;

/* The hit of a first ray. */
typedef struct bk_first_hit {
    double t;
    float w1, w2;     /* barycentric weights of the second and third corner */
    bk_uint triangle; /* number in the chunk, whose leaves have its order; BK_NO_TRIANGLE: none */
    bk_uint padding;
} bk_first_hit;

/* A ray on its way. */
typedef struct bk_meeting {
    bk_line line;
    bk_shear shear;
    float origin[3], slopes[3]; /* of the shear, in float */
    double nearest;             /* of a secondary ray: hits beyond this do not count */
    float begin, end; /* hits count between these at most: 0 and that, or those of a first ray */
    float far;        /* largest coordinate of the chunk's corners, relative to the ray's origin */
    bk_uint any;      /* the first hit that is found will do */
    bk_uint sides; /* 0: both sides of triangles count; BK_ALONG, BK_AGAINST: those that face so */
    bk_uint found;
    bk_uint first; /* not 0: it is a first ray, and has the rest, too */
    bk_limits limits;
    double reach;
    bk_uint met;      /* not 0: there is a hit so far */
    bk_first_hit hit; /* that one */
} bk_meeting;

enum { BK_ALONG = 1, BK_AGAINST };

BK_FN void bk_set_nearest(bk_meeting *m, double t)
{
    m->nearest = t;
    m->end = (float)(t + t * BK_LINE_ROUNDING);
}

/* Sets where hits of a first ray may win, rounded outwards. */
BK_FN void bk_set_range(bk_meeting *m)
{
    double begin = m->limits.t_min, end = m->limits.t_max;

    if (m->met)
        bk_narrow(m->hit.t, m->reach, &begin, &end);
    m->begin = (float)(begin - bk_size(begin) * BK_LINE_ROUNDING);
    m->end = (float)(end + bk_size(end) * BK_LINE_ROUNDING);
}

/* ---- nodes ---- */

/* Adds a child of a node to `bits` if the line crosses it, and keeps the nearest one. */
BK_FN void bk_meet_box(const bk_meeting *m, float in, float out, bk_uint child, bk_uint *bits,
                       bk_uint *nearest, float *least)
{
    float distance = in * BK_LINE_LESS, last = out * BK_LINE_MORE;

    if (m->first) { /* parameters may be negative */
        const float reach = (float)m->reach;
        in = bk_upper(bk_lower(distance, in * BK_LINE_MORE), m->begin);
        last = bk_lower(bk_upper(last, out * BK_LINE_LESS), m->end);
        if (!(in <= last))
            return;
        distance = bk_upper(in - reach, reach - last);
    } else if (!(distance <= bk_lower(last, m->end))) {
        return;
    }
    if (*bits == 0u || distance < *least) {
        *nearest = child;
        *least = distance;
    }
    *bits |= 1u << child;
}

/* Returns a bit mask of the children that the line crosses, and sets *nearest to one of them. */
BK_FN bk_uint bk_meet_node(const bk_meeting *m, const BK_GLOBAL bk_float4 *node, bk_uint *nearest)
{
    const bk_line *l = &m->line;
    const float most = 3.402823466e38f, from = m->first ? -most : 0.0f,
                to = m->first ? most : m->end;
    float least = 0.0f;
    bk_uint bits = 0, part, k;

    for (part = 0; part < 2u; part++) {
        bk_float4 in, out;
        in.x = in.y = in.z = in.w = from;
        out.x = out.y = out.z = out.w = to;
        for (k = 0; k < 3u; k++) {
            const bk_float4 a = node[(l->near[k] * 3u + k) * 2u + part];
            const bk_float4 b = node[(l->far[k] * 3u + k) * 2u + part];
            const float near = l->near_origin[k], far = l->far_origin[k], by = l->inverse[k];
            in.x = bk_upper(in.x, (a.x - near) * by);
            in.y = bk_upper(in.y, (a.y - near) * by);
            in.z = bk_upper(in.z, (a.z - near) * by);
            in.w = bk_upper(in.w, (a.w - near) * by);
            out.x = bk_lower(out.x, (b.x - far) * by);
            out.y = bk_lower(out.y, (b.y - far) * by);
            out.z = bk_lower(out.z, (b.z - far) * by);
            out.w = bk_lower(out.w, (b.w - far) * by);
        }
        bk_meet_box(m, in.x, out.x, 4u * part, &bits, nearest, &least);
        bk_meet_box(m, in.y, out.y, 4u * part + 1u, &bits, nearest, &least);
        bk_meet_box(m, in.z, out.z, 4u * part + 2u, &bits, nearest, &least);
        bk_meet_box(m, in.w, out.w, 4u * part + 3u, &bits, nearest, &least);
    }
    return bits;
}

/* Returns the largest coordinate in a child's box, relative to the ray's origin. */
BK_FN float bk_farthest_in(const bk_meeting *m, const BK_GLOBAL float *node, bk_uint child)
{
    float far = 0.0f;
    bk_uint i, k;

    for (k = 0; k < 3u; k++)
        for (i = 0; i < 2u; i++)
            far = bk_upper(far, bk_abs(node[(i * 3u + m->shear.k[k]) * 8u + child] - m->origin[k]));
    return far;
}

/* ---- leaves ---- */

/* Returns whether a line may hit a triangle, whose corners are given along the axes of the shear:
 * whether bk_cross_triangle() may say so. That computes in double what is computed in float here,
 * so that with unit = 2^-24, sheared corners are off by less than 7 units of m->far, which is
 * doubled here, and edge functions by what follows from that and their own roundings. Where squares
 * overflow, the slack is NaN, and comparisons with that leave a triangle in. */
BK_FN bk_uint bk_may_meet(const bk_meeting *m, bk_vec3 a, bk_vec3 b, bk_vec3 c)
{
    const float unit = 1.0f / 16777216.0f, least = 1.17549435e-38f, off = 14.0f * unit * m->far;
    const float az = a.z - m->origin[2], bz = b.z - m->origin[2], cz = c.z - m->origin[2];
    const float ax = (a.x - m->origin[0]) - m->slopes[0] * az,
                ay = (a.y - m->origin[1]) - m->slopes[1] * az,
                bx = (b.x - m->origin[0]) - m->slopes[0] * bz,
                by = (b.y - m->origin[1]) - m->slopes[1] * bz,
                cx = (c.x - m->origin[0]) - m->slopes[0] * cz,
                cy = (c.y - m->origin[1]) - m->slopes[1] * cz;
    const float sx = bk_upper(bk_upper(bk_abs(ax), bk_abs(bx)), bk_abs(cx)),
                sy = bk_upper(bk_upper(bk_abs(ay), bk_abs(by)), bk_abs(cy)),
                side = bk_upper(sx, sy), square = 4.0f * side * side;
    const float slack =
        off * (5.0f * side + 8.0f * off) + 4.0f * unit * square + least + 0.0f * square;
    const float u = bx * cy - by * cx, v = cx * ay - cy * ax, w = ax * by - ay * bx;
    const float ta = m->slopes[2] * az, tb = m->slopes[2] * bz, tc = m->slopes[2] * cz;
    const bk_uint below = u <= -slack || v <= -slack || w <= -slack,
                  above = u >= slack || v >= slack || w >= slack;

    return !((below && above) || m->end <= bk_lower(bk_lower(ta, tb), tc) - (off + least) ||
             bk_upper(bk_upper(ta, tb), tc) + (off + least) <= m->begin);
}

/* Returns a bit mask of the triangles of a leaf that the line may hit. */
BK_FN bk_uint bk_leaf_candidates(const bk_meeting *m, const BK_GLOBAL bk_float4 *leaf)
{
    const bk_uint *k = m->shear.k;
    bk_uint bits = 0, part;

    BK_ROLLED
    for (part = 0; part < 2u; part++) {
        const BK_GLOBAL bk_float4 *x = leaf + 2u * k[0] + part, *y = leaf + 2u * k[1] + part,
                                  *z = leaf + 2u * k[2] + part;
        const bk_float4 ax = x[0], ay = y[0], az = z[0], bx = x[6], by = y[6], bz = z[6],
                        cx = x[12], cy = y[12], cz = z[12];
        bits |= (bk_may_meet(m, bk_v3(ax.x, ay.x, az.x), bk_v3(bx.x, by.x, bz.x),
                             bk_v3(cx.x, cy.x, cz.x)) |
                 bk_may_meet(m, bk_v3(ax.y, ay.y, az.y), bk_v3(bx.y, by.y, bz.y),
                             bk_v3(cx.y, cy.y, cz.y))
                     << 1 |
                 bk_may_meet(m, bk_v3(ax.z, ay.z, az.z), bk_v3(bx.z, by.z, bz.z),
                             bk_v3(cx.z, cy.z, cz.z))
                     << 2 |
                 bk_may_meet(m, bk_v3(ax.w, ay.w, az.w), bk_v3(bx.w, by.w, bz.w),
                             bk_v3(cx.w, cy.w, cz.w))
                     << 3)
                << 4u * part;
    }
    return bits;
}

/* Returns the number of the lowest bit. */
BK_FN bk_uint bk_lowest(bk_uint bits)
{
    return bk_popcount32((bits & (0u - bits)) - 1u);
}

/* Returns a corner of a leaf's triangle along the axes of the shear. */
BK_FN bk_vec3 bk_leaf_corner(const bk_meeting *m, const BK_GLOBAL float *leaf, bk_uint corner,
                             bk_uint lane)
{
    const BK_GLOBAL float *at = leaf + 24u * corner + lane;

    return bk_v3(at[8u * m->shear.k[0]], at[8u * m->shear.k[1]], at[8u * m->shear.k[2]]);
}

/* Returns whether a hit of a triangle with this number counts, if it is on the right side. */
BK_FN bk_uint bk_counts(const bk_meeting *m, double t, bk_uint triangle)
{
    if (!m->first)
        return t >= 0.0 && t <= m->nearest;
    return t >= m->limits.t_min && t <= m->limits.t_max && !(bk_size(t) < m->limits.gap) &&
           (!m->met || bk_wins(t, triangle, m->hit.t, m->hit.triangle, m->reach));
}

BK_FN void bk_take_hit(bk_meeting *m, const bk_line_hit *hit, bk_uint triangle)
{
    m->found = 1u;
    if (!m->first) {
        bk_set_nearest(m, hit->t);
        return;
    }
    m->met = 1u;
    m->hit.t = hit->t;
    m->hit.w1 = hit->w1;
    m->hit.w2 = hit->w2;
    m->hit.triangle = triangle;
    bk_set_range(m);
}

/* Tests the triangles of the leaf with a number, and takes the hit that wins. */
BK_FN void bk_meet_leaf(bk_meeting *m, const BK_GLOBAL bk_float4 *leaves, bk_uint number)
{
    const BK_GLOBAL bk_float4 *leaf = leaves + (bk_ulong)number * BK_LEAF_SIZE;
    const BK_GLOBAL float *corners = (const BK_GLOBAL float *)leaf;
    bk_uint bits = bk_leaf_candidates(m, leaf);

    BK_ROLLED
    for (; bits && !(m->any && m->found); bits &= bits - 1u) {
        const bk_uint lane = bk_lowest(bits);
        bk_line_hit hit;
        if (!bk_cross_triangle(&m->shear, bk_leaf_corner(m, corners, 0, lane),
                               bk_leaf_corner(m, corners, 1, lane),
                               bk_leaf_corner(m, corners, 2, lane), &hit) ||
            !bk_counts(m, hit.t, 8u * number + lane))
            continue;
        if (m->sides) {
            const bk_uint backwards = ((const BK_GLOBAL bk_uint *)leaf)[72] >> lane & 1u;
            if ((hit.along != backwards ? BK_ALONG : BK_AGAINST) != m->sides)
                continue;
        }
        bk_take_hit(m, &hit, 8u * number + lane);
    }
}

/* ---- groups ---- */

/* Nodes on the way up to the root: what is left of their children, and in the higher bits the level
 * and BK_IN_CHUNK. */
#define BK_IN_CHUNK 0x10000u
typedef struct bk_meet_stack {
    bk_uint node[2 * BK_CHUNK_LEVELS], rest[2 * BK_CHUNK_LEVELS], depth;
} bk_meet_stack;

/* Finds the hit of a ray that wins, or any, in the group of an area. */
BK_FN void bk_meet_group(bk_meeting *m, const BK_GLOBAL bk_float4 *area)
{
    const BK_GLOBAL bk_chunk *group = (const BK_GLOBAL bk_chunk *)area, *tree = group;
    bk_uint level = group->levels - 1u, node = 0, child = 0;
    bk_meet_stack stack;

    stack.depth = 0;
    for (;;) {
        const BK_GLOBAL bk_float4 *at = area + (bk_ulong)tree->nodes * BK_CHUNK_UNIT +
                                        (bk_ulong)(tree->first[level] + node) * BK_NODE_SIZE;
        bk_uint bits = bk_meet_node(m, at, &child);
        if (tree != group && level == 0u) {
            const BK_GLOBAL bk_float4 *leaves = area + (bk_ulong)tree->leaves * BK_CHUNK_UNIT;
            for (; bits; bits &= bits - 1u)
                bk_meet_leaf(m, leaves, 8u * node + bk_lowest(bits));
            if (m->any && m->found)
                return;
        }
        if (bits == 0u) {
            if (stack.depth-- == 0u)
                return;
            node = stack.node[stack.depth];
            bits = stack.rest[stack.depth];
            tree = bits & BK_IN_CHUNK ? tree : group;
            level = bits >> 8 & 0xffu;
            bits &= 0xffu;
            child = bk_lowest(bits);
        }
        bits &= ~(1u << child);
        if (bits) {
            stack.node[stack.depth] = node;
            stack.rest[stack.depth++] = bits | level << 8 | (tree != group ? BK_IN_CHUNK : 0u);
        }
        node = 8u * node + child;
        if (level > 0u) {
            level--;
            continue;
        }
        at = area + (bk_ulong)group->nodes * BK_CHUNK_UNIT + (bk_ulong)(node / 8u) * BK_NODE_SIZE;
        m->far = bk_farthest_in(m, (const BK_GLOBAL float *)at, child);
        tree = group + 1 + node;
        level = tree->levels - 1u;
        node = 0;
    }
}

/* Prepares a ray. Returns 0 if it has no direction or is not finite. */
BK_FN bk_uint bk_meeting_set(bk_meeting *m, const float from[3], const float direction[3])
{
    bk_uint k;

    if (!bk_line_set(&m->line, from, direction))
        return 0u;
    bk_shear_set(&m->shear, from, direction);
    for (k = 0; k < 3u; k++) {
        m->origin[k] = (float)m->shear.origin[k];
        m->slopes[k] = (float)m->shear.s[k];
    }
    m->begin = m->far = 0.0f;
    m->found = 0;
    return 1u;
}

/* Traces ray number `ray` of a viewpoint through the group of an area, and notes in the viewpoint's
 * state what it met: a bit, or the distance of its nearest hit so far. hidden, distances: of struct
 * bake_ray_states. */
BK_FN void bk_meet_from(const BK_GLOBAL bk_float4 *area, const bk_params *params,
                        const BK_GLOBAL bk_viewpoint *stored, bk_uint ray,
                        BK_GLOBAL bk_uint *hidden, BK_GLOBAL float *distances)
{
    const bk_viewpoint from = *stored;
    const bk_uint opens = bk_open_rays(params), open = ray < opens;
    const bk_uint number = open ? ray : ray - opens;
    const bk_rays rays = bk_rays_of(params, open);
    const bk_vec3 start = bk_ray_start(&rays, &from);
    float at[3], direction[3];
    bk_vec3w d;
    bk_meeting m;

    m.any = open && bk_state_words(params) > 0u;
    m.sides = open ? 0u : from.side < 0.0f ? BK_AGAINST : BK_ALONG;
    if (from.side == 0.0f || (m.any && hidden[number / 32u] >> number % 32u & 1u))
        return;
    distances += bk_state_words(params) > 0u ? number : ray;
    d = bk_ray_directions(&rays, &from, number);
    at[0] = start.x;
    at[1] = start.y;
    at[2] = start.z;
    direction[0] = bk_lane(d.x, 0);
    direction[1] = bk_lane(d.y, 0);
    direction[2] = bk_lane(d.z, 0);
    if (!bk_meeting_set(&m, at, direction))
        return;
    m.first = 0;
    bk_set_nearest(&m, (double)(m.any ? rays.limit : bk_min(*distances, rays.limit)));
    bk_meet_group(&m, area);
    if (m.found && m.any)
        bk_or(&hidden[number / 32u], 1u << number % 32u);
    else if (m.found)
        *distances = (float)m.nearest;
}

/* ---- first rays ---- */

/* Finds the hit of a first ray that wins in the chunk of an area's group, and over the ray's hit so
 * far, unless only its number could tell: that of a hit in another chunk is not known here. */
BK_FN void bk_meet_first(const BK_GLOBAL bk_float4 *area, const bk_limits *limits,
                         const BK_GLOBAL bk_first_ray *stored, BK_GLOBAL bk_first_hit *out)
{
    const bk_first_ray ray = *stored;
    bk_meeting m;

    m.first = 1u;
    m.any = 0;
    m.sides = limits->sides;
    m.limits = *limits;
    m.reach = (double)ray.reach;
    m.met = ray.met;
    m.hit.t = ray.t;
    m.hit.w1 = m.hit.w2 = 0.0f;
    m.hit.triangle = BK_NO_TRIANGLE;
    if (limits->from_reach && m.reach < m.limits.t_max)
        m.limits.t_max = m.reach;
    if (bk_meeting_set(&m, ray.origin, ray.direction)) {
        bk_set_range(&m);
        bk_meet_group(&m, area);
    }
    out->t = m.hit.t;
    out->w1 = m.hit.w1;
    out->w2 = m.hit.w2;
    out->triangle = m.hit.triangle;
}

#endif

#endif
