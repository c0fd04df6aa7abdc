/* bk_tree.h - sends secondary rays through a tree of boxes around the voxels of a grid, one ray at
 * a time. For GPUs; tree_rays_lanes.c sends many at once.
 *
 * leaf_tree.h describes the nodes. A ray descends into the children of a node whose boxes it meets,
 * those first that lie towards its start. Boxes are tested with a margin for rounding. In a block
 * of 4^3 voxels, the ray goes from voxel to voxel (Amanatides & Woo, "A Fast Voxel Traversal
 * Algorithm for Ray Tracing", 1987). bk_visit.h tests the records of voxels. */
#ifndef BAKE_KERNEL_BK_TREE_H
#define BAKE_KERNEL_BK_TREE_H

#include "bk_visit.h"

/* Returns by how many voxels borders of boxes on an axis may be off by rounding, for rays that
 * start at `from`. low, high: the first and the last voxel of the tree on the axis. */
BK_FN float bk_tree_margin(bk_int low, bk_int high, float from)
{
    const float a = (float)low, b = (float)(high + 1);
    const float distance = bk_max(bk_abs(a - from), bk_abs(b - from));

    /* Borders are at most `distance` away, and computed from a node's corner, which adds two sizes
     * of the tree. The cap keeps margins below half of the 255 steps between the borders of a
     * missing child, so no ray meets it. */
    return bk_min(distance + 2.0f * (b - a) + 16.0f, 33554432.0f) * (1.0f / 2097152.0f);
}

#if BK_WIDTH == 1

/* A node in pairs of words of eight bytes: the corner and the first child, then the borders of each
 * axis. */
#define BK_NODE_PAIRS 4u
#define BK_TREE_WIDTH 8u
/* Most levels of a tree, see BAKE_TREE_DEPTH. */
#define BK_TREE_DEPTH 58

/* With BK_COUNT, the value of a ray is not what it found, but how many nodes and blocks it visited:
 * nodes, and BK_COUNT times the blocks. For tests/bench/tree_visits.c. */
#ifdef BK_COUNT
#define BK_VISIT(walk, n) ((walk)->visited += (n))
#define BK_VALUE(walk)    ((float)(walk)->visited)
#else
#define BK_VISIT(walk, n) ((void)0)
#define BK_VALUE(walk)    ((walk)->result)
#endif

/* A ray on its way through the tree. */
typedef struct bk_tree_walk {
#ifdef BK_COUNT
    bk_int visited;
#endif
    bk_visits visits;
    float rise;     /* of bk_ray_rise() */
    bk_vec3 margin; /* of the t of a box's borders */
    float t_before; /* voxels are entered before it; far below 0 if only the first one is */
    /* How the voxel of the nearest hit is entered: at t_stop, across a border of stop_axis. Voxels
     * that are entered later, by t and then by axis, do not count. */
    float t_stop;
    bk_int stop_axis;
    float result; /* see bk_add_up() */
    bk_uint octant;
    /* What is still to visit: children of a node, or blocks of a leaf, one bit each. */
    bk_uint node; /* the first child; of blocks their leaf's node */
    bk_uint children, is_leaf;
    bk_uint depth;                 /* of the stack */
    bk_ulong stack[BK_TREE_DEPTH]; /* of nodes: `node` << 8 | `children` */
} bk_tree_walk;

/* Starts a ray from a point. Without a way through the grid, or at a wall, it is over at once. */
BK_FN void bk_tree_begin(const bk_grid *grid, const bk_params *params, const bk_rays *rays,
                         const bk_viewpoint *from, bk_vec3w direction, bk_tree_walk *walk)
{
    const bk_vec3 point = bk_ray_start(rays, from);
    const bk_vec3w start = bk_splat3(point);
    const bk_int *low = params->index_min, *high = params->index_max;
    bk_visits *visits = &walk->visits;
    float t_near, t_far;
    bk_walk steps;
    float t;

    visits->ray = bk_ray_along(start, direction, bk_scalew(direction, from->side), 1);
    bk_bounds(&visits->ray, params, &t_near, &t_far);
    walk->rise = bk_ray_rise(rays, from, direction);
    bk_set_walk(rays, walk->rise, &steps);
    visits->t_end = bk_min(rays->limit, t_far);
    walk->node = walk->is_leaf = walk->depth = 0;
    walk->children = bk_begin_walk(params, &visits->ray, &steps, t_near, visits->t_end,
                                   &visits->t_begin, &visits->cursor);
    walk->result = !rays->open && !(t_far < rays->limit) ? rays->limit : -1.0f;
    if (rays->open && from->crowded == BK_CROWDED_BY_WALL) {
        bk_cache cache = bk_cache_empty();
        const bk_wall wall = bk_find_wall(grid, &cache, from->solid_from, from->normal);
        if (bk_bits(bk_cross_wall(&wall, direction, walk->rise, &t)) && t <= rays->limit) {
            walk->result = t;
            walk->children = 0;
        }
    }
    visits->first_x = visits->cursor.x;
    visits->first_y = visits->cursor.y;
    visits->first_z = visits->cursor.z;
    walk->t_before = visits->t_begin < visits->t_end ? visits->t_end : -0.5f * BK_FAR;
    walk->t_stop = visits->t_end;
    walk->stop_axis = 3;
    walk->margin.x = bk_abs(visits->ray.inverse.x) * bk_tree_margin(low[0], high[0], point.x);
    walk->margin.y = bk_abs(visits->ray.inverse.y) * bk_tree_margin(low[1], high[1], point.y);
    walk->margin.z = bk_abs(visits->ray.inverse.z) * bk_tree_margin(low[2], high[2], point.z);
    walk->octant = (bk_uint)(~bk_upwards(visits->ray.inverse.x) & 4) |
                   (bk_uint)(~bk_upwards(visits->ray.inverse.y) & 2) |
                   (bk_uint)(~bk_upwards(visits->ray.inverse.z) & 1);
}

/* ---- voxels ---- */

/* Returns how many of the borders of a block on an axis rays cross no later than the border of
 * `axis` at t, by which they enter the block: 0 to 4. 4: they have left it by then. own: of the
 * borders. first: the layer in which the walk begins. */
BK_FN bk_int bk_tree_layer(bk_int corner, bk_int first, bk_int base, float start, float inverse,
                           float t, bk_int axis, bk_int own)
{
    const bk_int up = bk_upwards(inverse);
    const bk_int from = up ? first - corner : corner + 3 - first;
    bk_int crossed = bk_maxi(from, 0), i;

    for (i = crossed; i < 4; i++) {
        const float border = bk_border(up ? corner + i + 1 : corner + 3 - i, base, start, inverse);
        if (border < t || (border == t && own <= axis))
            crossed = i + 1;
    }
    return crossed;
}

/* Returns the t at which rays enter a block on an axis; -BK_FAR: their walks begin in its layers;
 * BK_FAR: they begin past the block. */
BK_FN float bk_tree_entered(bk_int corner, bk_int first, bk_int base, float start, float inverse)
{
    const bk_int up = bk_upwards(inverse);
    const float t = bk_border(up ? corner : corner + 4, base, start, inverse);

    if ((first ^ corner) >= 0 && (first ^ corner) < 4)
        return -BK_FAR;
    return (up ? corner < first : first < corner) ? BK_FAR : t;
}

/* Returns whether the ray of visits hits the surface in the occupied voxel that it enters at t, and
 * sets its t. */
BK_FN bk_uint bk_tree_hit(const bk_grid *grid, const bk_params *params, const bk_rays *rays,
                          float rise, bk_visits *visits, float *t)
{
    bk_cache cache = bk_cache_empty();
    bk_walk walk;

    if (!(*t < params->coarse)) {
        *t += rays->open ? 0.0f : BK_FAR_DEPTH;
        return 1;
    }
    bk_rank_voxels(grid, 1, &visits->cursor, visits->values);
    bk_set_walk(rays, rise, &walk);
    if ((!rays->open || *t < walk.t_near) &&
        !bk_find_met(grid, &walk, &visits->ray, 1, visits->values, &visits->cursor, *t))
        return 0;
    bk_clear_walk(&walk);
    bk_meet_visits(grid, params, &cache, visits, 1, *t, &walk);
    *t = walk.hit.t;
    return bk_bits(walk.hit.found);
}

/* Ends the ray in the voxel of its visits, or lets only voxels before that one count. */
BK_FN void bk_tree_stop(const bk_params *params, const bk_rays *rays, float t, bk_tree_walk *walk)
{
    walk->result = bk_min(t, rays->limit);
    if (rays->open && !(params->flags & BK_OPEN_FALLOFF)) {
        walk->result = 0.0f;
        walk->depth = walk->children = 0;
    }
    walk->t_stop = walk->visits.t_event;
    walk->stop_axis = walk->visits.axis;
}

/* Finds how a ray enters a block. Returns 0 if it does not, or too late. */
BK_FN bk_uint bk_tree_enter(bk_int x, bk_int y, bk_int z, bk_tree_walk *walk)
{
    bk_visits *visits = &walk->visits;
    const bk_ray *ray = &visits->ray;
    const float tx = bk_tree_entered(x, visits->first_x, ray->bx, ray->start.x, ray->inverse.x);
    const float ty = bk_tree_entered(y, visits->first_y, ray->by, ray->start.y, ray->inverse.y);
    const float tz = bk_tree_entered(z, visits->first_z, ray->bz, ray->start.z, ray->inverse.z);
    const float t = bk_max(bk_max(tx, ty), tz);
    const bk_int axis = bk_entry_axis(tx, ty, tz, t);
    bk_int nx, ny, nz;

    if (!(t < walk->t_before) || !bk_comes_before(t, axis, walk->t_stop, walk->stop_axis))
        return 0;
    nx = bk_tree_layer(x, visits->first_x, ray->bx, ray->start.x, ray->inverse.x, t, axis, 0);
    ny = bk_tree_layer(y, visits->first_y, ray->by, ray->start.y, ray->inverse.y, t, axis, 1);
    nz = bk_tree_layer(z, visits->first_z, ray->bz, ray->start.z, ray->inverse.z, t, axis, 2);
    visits->t_event = t;
    visits->axis = axis;
    visits->cursor.x = x + (bk_upwards(ray->inverse.x) ? nx : 3 - nx);
    visits->cursor.y = y + (bk_upwards(ray->inverse.y) ? ny : 3 - ny);
    visits->cursor.z = z + (bk_upwards(ray->inverse.z) ? nz : 3 - nz);
    return (nx | ny | nz) < 4;
}

/* Goes on to the next voxel of the block with this corner. Returns 0 if the ray has left the block,
 * or if that voxel does not count. */
BK_FN bk_uint bk_tree_leave(bk_int x, bk_int y, bk_int z, bk_tree_walk *walk)
{
    bk_visits *visits = &walk->visits;

    visits->cursor = bk_beside(&visits->ray, &visits->cursor, visits->exit_axis, 0);
    visits->t_event = visits->t_exit;
    visits->axis = visits->exit_axis;
    return (((visits->cursor.x ^ x) | (visits->cursor.y ^ y) | (visits->cursor.z ^ z)) & ~3) == 0 &&
           visits->t_event < walk->t_before &&
           bk_comes_before(visits->t_event, visits->axis, walk->t_stop, walk->stop_axis);
}

/* Goes through the voxels of a block, as far as they count. */
BK_FN void bk_tree_block(const bk_grid *grid, const bk_params *params, const bk_rays *rays,
                         bk_uint block, bk_tree_walk *walk)
{
    const bk_ulong2 head = grid->nodes[(bk_ulong)walk->node * BK_NODE_PAIRS];
    const bk_uint leaf = (bk_uint)(head.y >> 32);
    const bk_ulong occupied = grid->blocks[(bk_ulong)leaf * BK_TREE_WIDTH + block];
    const bk_int x = ((bk_int)(bk_uint)head.x & ~7) | (bk_int)(block & 4u);
    const bk_int y = ((bk_int)(bk_uint)(head.x >> 32) & ~7) | (bk_int)(block << 1 & 4u);
    const bk_int z = ((bk_int)(bk_uint)head.y & ~7) | (bk_int)(block << 2 & 4u);
    bk_visits *visits = &walk->visits;
    bk_uint inside = bk_tree_enter(x, y, z, walk);
    float t = 0.0f;

    BK_VISIT(walk, BK_COUNT);
    visits->cursor.mask = 0;
    visits->cursor.leaf = (bk_int)leaf;
    while (inside) {
        bk_uint met = 0;
        /* To the next occupied voxel, so that rays of a warp test theirs together. */
        BK_ROLLED
        do {
            const bk_cursor at = visits->cursor;
            const bk_uint bit = (bk_uint)((at.x & 3) << 4 | (at.y & 3) << 2 | (at.z & 3));
            visits->t_exit = bk_find_exit(&visits->ray, &at, &visits->exit_axis);
            met = (bk_uint)(occupied >> bit) & 1u;
            if (!met)
                inside = bk_tree_leave(x, y, z, walk);
        } while (inside && !met);
        t = bk_max(visits->t_begin, visits->t_event);
        if (met && bk_tree_hit(grid, params, rays, walk->rise, visits, &t)) {
            bk_tree_stop(params, rays, t, walk);
            return;
        }
        if (met)
            inside = bk_tree_leave(x, y, z, walk);
    }
}

/* ---- nodes ---- */

/* Narrows [*t_in, *t_out] by the borders of child i of four on an axis. near, far: t of the node's
 * corner, less and more by a margin. */
BK_FN void bk_tree_narrow(bk_uint nears, bk_uint fars, bk_uint i, float scale, float near,
                          float far, float *t_in, float *t_out)
{
    const float a = (float)(bk_int)(nears >> 8u * i & 255u);
    const float b = (float)(bk_int)(fars >> 8u * i & 255u);

    *t_in = bk_upper(*t_in, a * scale + near);
    *t_out = bk_lower(*t_out, b * scale + far);
}

/* Returns the children of a node whose boxes a ray may meet, one bit each. */
BK_FN bk_uint bk_tree_children(const BK_GLOBAL bk_ulong2 *words, const bk_tree_walk *walk)
{
    const bk_visits *visits = &walk->visits;
    const bk_ray *ray = &visits->ray;
    const bk_ulong2 head = words[0], bx = words[1], by = words[2], bz = words[3];
    const bk_int low = (bk_int)(bk_uint)head.x;
    const float step = (float)(bk_int)(1u << 2 * (low & 7));
    const bk_int cx = low & ~7, cy = (bk_int)(bk_uint)(head.x >> 32) & ~7;
    const bk_int cz = (bk_int)(bk_uint)head.y & ~7;
    const float sx = ray->inverse.x * step, sy = ray->inverse.y * step, sz = ray->inverse.z * step;
    const float zx = bk_border(cx, ray->bx, ray->start.x, ray->inverse.x);
    const float zy = bk_border(cy, ray->by, ray->start.y, ray->inverse.y);
    const float zz = bk_border(cz, ray->bz, ray->start.z, ray->inverse.z);
    const float near_x = zx - walk->margin.x, far_x = zx + walk->margin.x;
    const float near_y = zy - walk->margin.y, far_y = zy + walk->margin.y;
    const float near_z = zz - walk->margin.z, far_z = zz + walk->margin.z;
    const bk_ulong nx = walk->octant & 4u ? bx.y : bx.x, fx = walk->octant & 4u ? bx.x : bx.y;
    const bk_ulong ny = walk->octant & 2u ? by.y : by.x, fy = walk->octant & 2u ? by.x : by.y;
    const bk_ulong nz = walk->octant & 1u ? bz.y : bz.x, fz = walk->octant & 1u ? bz.x : bz.y;
    const float t_last = bk_upper(walk->t_stop, visits->t_begin);
    bk_uint i, low_bit, met = 0;

    for (low_bit = 0; low_bit < 64; low_bit += 32)
        for (i = 0; i < 4; i++) {
            float t_in = visits->t_begin, t_out = t_last;
            bk_tree_narrow((bk_uint)(nx >> low_bit), (bk_uint)(fx >> low_bit), i, sx, near_x, far_x,
                           &t_in, &t_out);
            bk_tree_narrow((bk_uint)(ny >> low_bit), (bk_uint)(fy >> low_bit), i, sy, near_y, far_y,
                           &t_in, &t_out);
            bk_tree_narrow((bk_uint)(nz >> low_bit), (bk_uint)(fz >> low_bit), i, sz, near_z, far_z,
                           &t_in, &t_out);
            met |= (t_in <= t_out ? 1u : 0u) << (low_bit / 8 + i);
        }
    return met;
}

/* Returns the number of the child, of those whose bits are set, that lies first along rays of an
 * octant. */
BK_FN bk_uint bk_tree_first(bk_uint children, bk_uint octant)
{
    bk_uint bits = children;

    bits = octant & 4u ? (bits >> 4 | bits << 4) & 0xffu : bits;
    bits = octant & 2u ? (bits >> 2 & 0x33u) | (bits & 0x33u) << 2 : bits;
    bits = octant & 1u ? (bits >> 1 & 0x55u) | (bits & 0x55u) << 1 : bits;
    return bk_popcount32((bits & (0u - bits)) - 1u) ^ octant;
}

/* Takes a child, of those that are still to visit. */
BK_FN bk_uint bk_tree_take(bk_tree_walk *walk)
{
    const bk_uint child = bk_tree_first(walk->children, walk->octant);

    walk->children &= ~(1u << child);
    return child;
}

/* Descends into the next child whose own children the ray may meet, or takes what waits in the
 * stack. */
BK_FN void bk_tree_descend(const bk_grid *grid, bk_tree_walk *walk)
{
    const bk_uint number = walk->node + bk_tree_take(walk);
    const BK_GLOBAL bk_ulong2 *words = grid->nodes + (bk_ulong)number * BK_NODE_PAIRS;
    const bk_uint children = bk_tree_children(words, walk), next = (bk_uint)(words->y >> 32);

    BK_VISIT(walk, 1);
    if (!children)
        return;
    if (walk->children)
        walk->stack[walk->depth++] = (bk_ulong)walk->node << 8 | walk->children;
    walk->is_leaf = (bk_uint)words->y & 1u;
    walk->node = walk->is_leaf ? number : next;
    walk->children = children;
}

/* Takes what was left aside last. Returns 0 if nothing was. */
BK_FN bk_uint bk_tree_resume(bk_tree_walk *walk)
{
    bk_ulong entry;

    if (walk->depth == 0)
        return 0;
    entry = walk->stack[--walk->depth];
    walk->node = (bk_uint)(entry >> 8);
    walk->children = (bk_uint)entry & 0xffu;
    walk->is_leaf = 0;
    return 1;
}

/* Traces a ray of a point. Returns what it found, see bk_add_up(). */
BK_FN float bk_tree_look(const bk_grid *grid, const bk_params *params, const bk_rays *rays,
                         const bk_viewpoint *from, bk_vec3w direction)
{
    bk_tree_walk walk;

#ifdef BK_COUNT
    walk.visited = 0;
#endif
    bk_tree_begin(grid, params, rays, from, direction, &walk);
    if (!walk.children)
        return BK_VALUE(&walk);
    BK_ROLLED
    do {
        BK_ROLLED
        while (walk.children && !walk.is_leaf) {
            bk_tree_descend(grid, &walk);
            if (!walk.children)
                bk_tree_resume(&walk);
        }
        BK_ROLLED
        while (walk.children)
            bk_tree_block(grid, params, rays, bk_tree_take(&walk), &walk);
    } while (bk_tree_resume(&walk));
    return BK_VALUE(&walk);
}

/* Traces ray number `ray` of a stored viewpoint, open ones first. found: see bk_add_up(). */
BK_FN void bk_look_from(const bk_grid *grid, const bk_params *params,
                        const BK_GLOBAL bk_viewpoint *stored, bk_uint ray, BK_GLOBAL float *found)
{
    const bk_uint opens = bk_open_rays(params);
    const bk_viewpoint from = *stored;
    const bk_rays rays = bk_rays_of(params, ray < opens);

    if (from.side != 0.0f)
        *found = bk_tree_look(grid, params, &rays, &from,
                              bk_ray_directions(&rays, &from, rays.open ? ray : ray - opens));
}

#endif

#endif
