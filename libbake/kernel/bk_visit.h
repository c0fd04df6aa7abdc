/* bk_visit.h - meets the surface in voxels along a ray, in any order.
 *
 *  - A ray visits the voxels that it enters before it leaves them. Of borders at the same t, that
 *    of the lower axis is crossed first.
 *  - The records of a voxel are tested with the state that a walk has after the previous voxel on
 *    the ray. That state follows from the records of the previous voxel alone. A surface may also
 *    be crossed after a voxel, if the next one is empty.
 *  - Near voxels whose surface a ray cannot hit, see bk_meets(), only end runs, which the voxels
 *    before them see. So they need not be tested.
 *
 * So voxels can be found through a tree, in any order, and rays hit what they would hit if they
 * went from voxel to voxel. */
#ifndef BAKE_KERNEL_BK_VISIT_H
#define BAKE_KERNEL_BK_VISIT_H

#include "bk_secondary.h"

/* Rays and the voxels they visit, in lanes. */
typedef struct bk_visits {
    bk_ray ray;
    bk_iw first_x, first_y, first_z; /* voxels in which walks begin */
    bk_fw t_begin, t_end;
    bk_cursor cursor; /* the voxels */
    bk_ulong values[BK_WIDTH];
    /* How rays enter their voxels: t, and the axis of the border; -1: walks begin here. */
    bk_fw t_event;
    bk_iw axis;
    bk_fw t_exit; /* how they leave them */
    bk_iw exit_axis;
} bk_visits;

/* Returns the t at which rays enter layer v of an axis; -BK_FAR: their walks begin in it. */
BK_FN bk_fw bk_entered(bk_iw v, bk_iw first, bk_iw base, bk_fw start, bk_fw inverse)
{
    const bk_fw t = bk_border(v + (1 & ~bk_upwards(inverse)), base, start, inverse);

    return bk_select(v != first, t, bk_splat(-BK_FAR));
}

/* Returns the axis of the last of three borders at `t` or before, the highest one of several; -1 if
 * t says that walks begin here. */
BK_FN bk_iw bk_entry_axis(bk_fw tx, bk_fw ty, bk_fw tz, bk_fw t)
{
    const bk_iw last = bk_selecti(bk_less(ty, tx), bk_splati(0), bk_splati(1));
    const bk_iw axis = bk_selecti(bk_less(tz, bk_maxw(tx, ty)), last, bk_splati(2));

    return bk_selecti(bk_less(bk_splat(-BK_FAR), t), axis, bk_splati(-1));
}

/* Finds how rays enter voxels: across the last of the borders of the three axes. */
BK_FN bk_fw bk_find_entry(const bk_visits *visits, const bk_cursor *cursor, bk_iw *axis)
{
    const bk_ray *ray = &visits->ray;
    const bk_fw tx = bk_entered(cursor->x, visits->first_x, ray->bx, ray->start.x, ray->inverse.x);
    const bk_fw ty = bk_entered(cursor->y, visits->first_y, ray->by, ray->start.y, ray->inverse.y);
    const bk_fw tz = bk_entered(cursor->z, visits->first_z, ray->bz, ray->start.z, ray->inverse.z);
    const bk_fw t = bk_maxw(bk_maxw(tx, ty), tz);

    *axis = bk_entry_axis(tx, ty, tz, t);
    return t;
}

/* Finds how rays leave voxels: across the first border. */
BK_FN bk_fw bk_find_exit(const bk_ray *ray, const bk_cursor *cursor, bk_iw *axis)
{
    const bk_iw x = bk_exit_layer(cursor->x, cursor->mask, bk_upwards(ray->inverse.x));
    const bk_iw y = bk_exit_layer(cursor->y, cursor->mask, bk_upwards(ray->inverse.y));
    const bk_iw z = bk_exit_layer(cursor->z, cursor->mask, bk_upwards(ray->inverse.z));
    const bk_fw tx = bk_border(x, ray->bx, ray->start.x, ray->inverse.x);
    const bk_fw ty = bk_border(y, ray->by, ray->start.y, ray->inverse.y);
    const bk_fw tz = bk_border(z, ray->bz, ray->start.z, ray->inverse.z);
    const bk_fw xy = bk_minw(tx, ty);
    const bk_iw first = bk_selecti(bk_less(ty, tx), bk_splati(1), bk_splati(0));

    *axis = bk_selecti(bk_less(tz, xy), bk_splati(2), first);
    return bk_minw(xy, tz);
}

/* Returns whether a border is crossed before another one. */
BK_FN bk_mask bk_comes_before(bk_fw t, bk_iw axis, bk_fw t_other, bk_iw other)
{
    return bk_less(t, t_other) | ((t == t_other) & (axis < other));
}

/* Returns the neighbours of voxels along an axis, in the direction of rays or, if `back` is not 0,
 * against it. */
BK_FN bk_cursor bk_beside(const bk_ray *ray, const bk_cursor *cursor, bk_iw axis, bk_uint back)
{
    const bk_iw sign = bk_splati(back ? 1 : -1), none = bk_splati(0);
    bk_cursor next = *cursor;

    next.x = cursor->x + bk_selecti(axis == 0, sign * (bk_upwards(ray->inverse.x) | 1), none);
    next.y = cursor->y + bk_selecti(axis == 1, sign * (bk_upwards(ray->inverse.y) | 1), none);
    next.z = cursor->z + bk_selecti(axis == 2, sign * (bk_upwards(ray->inverse.z) | 1), none);
    return next;
}

/* Finds voxels beside those of visits. Returns the lanes whose voxel is occupied, and sets their
 * leaves. */
BK_FN bk_uint bk_find_voxels(const bk_grid *grid, bk_cache *cache, const bk_visits *visits,
                             bk_uint lanes, bk_cursor *cursor)
{
    const bk_iw apart = (cursor->x ^ visits->cursor.x) | (cursor->y ^ visits->cursor.y) |
                        (cursor->z ^ visits->cursor.z);
    const bk_uint inside = lanes & bk_bits((apart & ~7) == 0);
    bk_uint found = inside ? bk_find_occupied(grid, inside, cursor) : 0;
    bk_int leaves[BK_WIDTH];

    lanes &= ~inside;
    if (lanes == 0)
        return found;
    bk_store_lanes(leaves, cursor->leaf);
    for (; lanes; lanes &= lanes - 1u) {
        const bk_uint lane = bk_first(lanes);
        const bk_int x = bk_lane(cursor->x, lane), y = bk_lane(cursor->y, lane);
        const bk_int z = bk_lane(cursor->z, lane);
        if (bk_locate(grid, cache, x, y, z) == 0 &&
            bk_leaf_value(grid, cache->leaf, x, y, z) != 0) {
            leaves[lane] = (bk_int)cache->leaf;
            found |= 1u << lane;
        }
    }
    cursor->leaf = bk_load_lanes(leaves);
    return found;
}

/* Returns the lanes whose rays may hit one of the records of voxels that they enter at t. */
BK_FN bk_uint bk_find_met(const bk_grid *grid, const bk_walk *walk, const bk_ray *ray,
                          bk_uint lanes, const bk_ulong values[BK_WIDTH], const bk_cursor *cursor,
                          bk_fw t)
{
    bk_uint first, seconds, none;
    bk_record record;
    bk_fw distance;

    bk_load_records(grid, lanes, values, 0, &record, &seconds);
    distance = bk_plane_distance(ray, &record, cursor);
    first = lanes & bk_bits(bk_meets(walk, ray, &record, distance, t));
    seconds &= ~first;
    if (seconds == 0)
        return first;
    seconds = bk_load_records(grid, seconds, values, 1, &record, &none);
    distance = bk_plane_distance(ray, &record, cursor);
    return first | (seconds & bk_bits(bk_meets(walk, ray, &record, distance, t)));
}

/* Sets the state of walks to the one after the previous voxels on the rays. */
BK_FN void bk_recall(const bk_grid *grid, bk_cache *cache, const bk_visits *visits, bk_uint lanes,
                     bk_walk *walk)
{
    bk_cursor before = bk_beside(&visits->ray, &visits->cursor, visits->axis, 1);
    bk_ulong values[BK_WIDTH];
    bk_iw axis;
    bk_fw t;

    lanes = bk_find_voxels(grid, cache, visits, lanes & bk_bits(visits->axis >= 0), &before);
    if (lanes == 0)
        return;
    t = bk_maxw(visits->t_begin, bk_find_entry(visits, &before, &axis));
    bk_rank_voxels(grid, lanes, &before, values);
    bk_cross_voxels(grid, walk, &visits->ray, lanes, values, &before, t,
                    bk_minw(bk_maxw(t, visits->t_event), walk->t_limit));
    walk->hit = bk_no_crossing();
}

/* Tests the records of visited voxels, in which rays are from t on. `walk` is a cleared one. */
BK_FN void bk_meet_visits(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                          const bk_visits *visits, bk_uint lanes, bk_fw t, bk_walk *walk)
{
    const bk_fw t_out = bk_maxw(t, visits->t_exit);
    bk_uint over, below, on, near;
    bk_cursor next;

    bk_recall(grid, cache, visits, lanes, walk);
    over = bk_bits(bk_meet_records(grid, &visits->ray, walk, lanes, visits->values, &visits->cursor,
                                   t, t_out));
    if (over)
        bk_end_run(walk, bk_mask_of(over));
    below = lanes & bk_bits((walk->side == BK_BELOW) & bk_not(walk->hit.found));
    if (below == 0)
        return;
    /* A run that goes on is left to the next voxel. One whose surface faces away ends it, and is
     * not tested if it is near. */
    next = bk_beside(&visits->ray, &visits->cursor, visits->exit_axis, 0);
    on = bk_find_voxels(grid, cache, visits, below & bk_bits(bk_less(t_out, visits->t_end)), &next);
    near = on & bk_bits(bk_less(t_out, bk_splat(params->coarse)) &
                        (bk_less(t_out, walk->t_near) | bk_not(walk->two_sided)));
    if (near) {
        bk_ulong values[BK_WIDTH];
        bk_rank_voxels(grid, near, &next, values);
        on ^= near ^ bk_find_met(grid, walk, &visits->ray, near, values, &next, t_out);
    }
    bk_end_run(walk, bk_mask_of(below & ~on));
}

#endif
