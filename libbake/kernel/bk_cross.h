/* bk_cross.h - where rays cross the surface in a voxel.
 *
 * In an occupied voxel the surface is a plane, and planes of neighbours do not meet exactly. Let f
 * be the ray point's signed distance to the plane, with its sign chosen so that f grows along the
 * ray. The surface is crossed
 *  - in a voxel in which f changes sign,
 *  - at the border of two voxels if f < 0 on leaving one and f > 0 on entering the next,
 *  - where an unbroken run of occupied voxels begins with 0 < f <= margin or ends with
 *    -margin <= f < 0: the scan touched that voxel and not the empty one beside it, so the
 *    surface is inside the run although its plane passes just outside.
 * The first two rules leave no pinhole inside a run; the last closes the run's ends. A run does not
 * include voxels whose surface faces away. */
#ifndef BAKE_KERNEL_BK_CROSS_H
#define BAKE_KERNEL_BK_CROSS_H

#include "bk_surface.h"

/* Lines, with the direction in which they are walked. Positions are relative to the lowest corner
 * of the origin's voxel, so that distances keep their precision in large grids. t is in voxels. */
typedef struct bk_ray {
    bk_iw bx, by, bz; /* that voxel */
    bk_vec3w start;   /* 0 .. 1 */
    bk_vec3w direction;
    bk_vec3w inverse;
    bk_vec3w facing;
    bk_mask valid; /* lanes to trace */
} bk_ray;

/* Points where rays cross a record's plane. */
typedef struct bk_crossing {
    bk_mask found;
    bk_fw t;
    bk_vec3w normal; /* of the record */
    bk_iw low, high; /* words of its number */
} bk_crossing;

/* Side of the sheet in the last voxel on which a ray is: no sheet, before it, after it. */
enum { BK_APART, BK_BELOW, BK_ABOVE };

/* Planes that are farther than this from a point, in voxels, are not of its own surface. */
#define BK_OWN 0.25f

/* The state of walks along half rays. */
typedef struct bk_walk {
    bk_fw t_start, t_limit;
    bk_uint open; /* not 0: open rays, bk_secondary.h */
    bk_fw t_near; /* of open rays: until then they are near a crowded point */
    bk_mask two_sided;
    bk_crossing hit;
    bk_iw side;
    bk_mask falling;   /* the plane's signed distance falls along the ray: f has its sign changed */
    bk_fw outside;     /* if side is BK_BELOW: -f on leaving the voxel */
    bk_crossing ahead; /* if side is BK_BELOW: the crossing of that plane after the voxel */
    bk_fw ahead_margin;
} bk_walk;

/* Positions of rays: the voxel, or the empty aligned node around it. */
typedef struct bk_cursor {
    bk_iw x, y, z;
    bk_iw mask;  /* side - 1 of the voxel or the node */
    bk_iw apart; /* a voxel that differs in these bits from node_x .. is in another leaf or node */
    bk_iw node_x, node_y, node_z; /* any voxel of the leaf or node */
    bk_iw leaf;                   /* the leaf's number, if mask is 0 */
} bk_cursor;

BK_FN bk_crossing bk_no_crossing(void)
{
    const bk_fw zero = bk_splat(0.0f);
    bk_crossing none;

    none.found = bk_mask_of(0);
    none.t = zero;
    none.normal = bk_v3w(zero, zero, zero);
    none.low = none.high = bk_splati(0);
    return none;
}

/* Sets the state of walks that have met nothing yet. */
BK_FN void bk_clear_walk(bk_walk *walk)
{
    walk->hit = walk->ahead = bk_no_crossing();
    walk->side = bk_splati(BK_APART);
    walk->falling = bk_mask_of(0);
    walk->outside = walk->ahead_margin = bk_splat(0.0f);
}

BK_FN bk_crossing bk_select_crossing(bk_mask mask, const bk_crossing *a, const bk_crossing *b)
{
    bk_crossing c;

    c.found = bk_selecti(mask, a->found, b->found);
    c.t = bk_select(mask, a->t, b->t);
    c.normal = bk_select3(mask, a->normal, b->normal);
    c.low = bk_selecti(mask, a->low, b->low);
    c.high = bk_selecti(mask, a->high, b->high);
    return c;
}

BK_FN bk_fw bk_inverse(bk_fw d)
{
    const bk_fw far = bk_select(bk_less(d, bk_splat(0.0f)), bk_splat(-1.0e30f), bk_splat(1.0e30f));

    return bk_select(bk_less(bk_absw(d), bk_splat(1.0e-9f)), far, 1.0f / d);
}

/* Prepares lines. Lanes whose origin is NaN or far, or whose direction is no unit vector, are not
 * traced. */
BK_FN bk_ray bk_ray_along(bk_vec3w origin, bk_vec3w direction, bk_vec3w facing, bk_mask valid)
{
    const bk_fw far = bk_splat(BK_FAR);
    bk_vec3w o, v;
    bk_ray ray;

    ray.valid = valid & bk_less(bk_absw(origin.x), far) & bk_less(bk_absw(origin.y), far) &
                bk_less(bk_absw(origin.z), far) &
                bk_less(bk_absw(bk_dotw(direction, direction) - 1.0f), bk_splat(0.01f));
    o = bk_v3w(bk_keep(ray.valid, origin.x), bk_keep(ray.valid, origin.y),
               bk_keep(ray.valid, origin.z));
    v = bk_v3w(bk_floorw(o.x + 0.5f), bk_floorw(o.y + 0.5f), bk_floorw(o.z + 0.5f));
    ray.bx = bk_to_iw(v.x);
    ray.by = bk_to_iw(v.y);
    ray.bz = bk_to_iw(v.z);
    ray.start = bk_v3w(o.x - v.x + 0.5f, o.y - v.y + 0.5f, o.z - v.z + 0.5f);
    ray.direction = bk_v3w(bk_keep(ray.valid, direction.x), bk_keep(ray.valid, direction.y),
                           bk_keep(ray.valid, direction.z));
    ray.inverse = bk_v3w(bk_inverse(ray.direction.x), bk_inverse(ray.direction.y),
                         bk_inverse(ray.direction.z));
    ray.facing = facing;
    return ray;
}

/* Returns the t at which rays meet the lower face of voxel layer `layer` of an axis. */
BK_FN bk_fw bk_border(bk_iw layer, bk_iw base, bk_fw start, bk_fw inverse)
{
    return (bk_to_fw(layer - base) - start) * inverse;
}

/* Returns the voxel of a coordinate at t, clamped to bounds that contain it. */
BK_FN bk_iw bk_voxel_at(bk_fw start, bk_fw direction, bk_fw t, bk_iw base, bk_iw low, bk_iw high)
{
    return bk_mini(bk_maxi(base + bk_to_iw(bk_floorw(start + direction * t)), low), high);
}

/* Clips [*t_near, *t_far] to the part between two layers. */
BK_FN void bk_clip(bk_int low, bk_int high, bk_iw base, bk_fw start, bk_fw inverse, bk_fw *t_near,
                   bk_fw *t_far)
{
    const bk_fw a = bk_border(bk_splati(low), base, start, inverse);
    const bk_fw b = bk_border(bk_splati(high + 1), base, start, inverse);

    *t_near = bk_maxw(*t_near, bk_minw(a, b));
    *t_far = bk_minw(*t_far, bk_maxw(a, b));
}

/* Finds the part of lines inside the bounds of the active voxels; t_near > t_far: none. */
BK_FN void bk_bounds(const bk_ray *ray, const bk_params *params, bk_fw *t_near, bk_fw *t_far)
{
    const bk_int *low = params->index_min, *high = params->index_max;

    *t_near = bk_splat(-BK_FAR);
    *t_far = bk_splat(BK_FAR);
    bk_clip(low[0], high[0], ray->bx, ray->start.x, ray->inverse.x, t_near, t_far);
    bk_clip(low[1], high[1], ray->by, ray->start.y, ray->inverse.y, t_near, t_far);
    bk_clip(low[2], high[2], ray->bz, ray->start.z, ray->inverse.z, t_near, t_far);
}

/* ---- crossing planes ---- */

/* Takes t as the hit in those lanes if it is nearer than the hit so far. */
BK_FN void bk_take(bk_walk *walk, bk_mask lanes, bk_fw t, const bk_record *record)
{
    const bk_mask better = bk_not(walk->hit.found) | bk_less(t, walk->hit.t);
    const bk_mask taken = lanes & better & bk_not(bk_less(walk->t_limit, t));

    walk->hit.found = walk->hit.found | taken;
    walk->hit.t = bk_select(taken, t, walk->hit.t);
    walk->hit.normal = bk_select3(taken, record->normal, walk->hit.normal);
    walk->hit.low = bk_selecti(taken, record->low, walk->hit.low);
    walk->hit.high = bk_selecti(taken, record->high, walk->hit.high);
}

/* Ends runs of occupied voxels; their last plane may pass just outside. */
BK_FN void bk_end_run(bk_walk *walk, bk_mask lanes)
{
    const bk_mask taken = lanes & (walk->side == BK_BELOW) & bk_not(walk->hit.found) &
                          bk_not(bk_less(walk->t_limit, walk->ahead.t)) &
                          bk_not(bk_less(walk->ahead_margin, walk->outside));

    walk->hit = bk_select_crossing(taken, &walk->ahead, &walk->hit);
    walk->hit.found = walk->hit.found | taken;
    walk->side = bk_selecti(lanes, bk_splati(BK_APART), walk->side);
}

/* Returns the distances of the points at t = 0 from the planes of records in these voxels. */
BK_FN bk_fw bk_plane_distance(const bk_ray *ray, const bk_record *record, const bk_cursor *cursor)
{
    const bk_vec3w from = bk_v3w(bk_to_fw(ray->bx - cursor->x) + (ray->start.x - 0.5f),
                                 bk_to_fw(ray->by - cursor->y) + (ray->start.y - 0.5f),
                                 bk_to_fw(ray->bz - cursor->z) + (ray->start.z - 0.5f));

    return bk_dotw(record->normal, from) - record->offset;
}

/* Returns the lanes whose rays may hit a record, of voxels that they enter at t: one that faces
 * along them, or any if they are two-sided. Near a crowded point, an open ray hits only planes that
 * face it and are not those of the point's own surface; it meets these at flat angles, so a plane
 * that it meets steeply may be close to the point. distance: of bk_plane_distance(). */
BK_FN bk_mask bk_meets(const bk_walk *walk, const bk_ray *ray, const bk_record *record,
                       bk_fw distance, bk_fw t)
{
    const bk_fw zero = bk_splat(0.0f), along = bk_dotw(record->normal, ray->facing);
    bk_fw own;

    if (!walk->open)
        return bk_less(zero, along) | walk->two_sided;
    own = bk_maxw(BK_OWN + 4.0f * BK_OWN * along, zero);
    return bk_not(bk_less(t, walk->t_near)) |
           (bk_less(along, zero) & bk_less(own, bk_absw(distance)));
}

/* Tests a record of the voxels that rays are in from t_in to t_out. side and was_falling: the
 * walk's state on leaving the previous voxels. */
BK_FN void bk_cross_record(bk_walk *walk, const bk_ray *ray, bk_mask lanes, const bk_record *record,
                           const bk_cursor *cursor, bk_fw t_in, bk_fw t_out, bk_iw side,
                           bk_mask was_falling)
{
    const bk_fw zero = bk_splat(0.0f);
    bk_fw f = bk_plane_distance(ray, record, cursor);
    const bk_mask tested = lanes & bk_meets(walk, ray, record, f, t_in);
    bk_fw slope = bk_dotw(record->normal, ray->direction), f_in, f_out, at, t, outside;
    const bk_mask falling = bk_less(slope, zero);
    const bk_mask same = bk_not(falling ^ was_falling);
    bk_mask above, crossed, below, begun, sloped, waits, changed;

    /* A crowded point may lie before a plane, and the start of its ray after it. */
    if (walk->open)
        t_in = bk_keep(bk_less(walk->t_start, t_in), t_in);
    f = bk_select(falling, -f, f);
    slope = bk_select(falling, -slope, slope);
    sloped = bk_less(zero, slope);
    f_in = f + slope * t_in;
    f_out = f + slope * t_out;
    above = bk_less(zero, f_in);
    crossed = bk_not(above) & bk_not(bk_less(f_out, zero));
    below = bk_not(above) & bk_less(f_out, zero);
    /* A run begins after its plane, within the margin. */
    begun = bk_not(same & (side != BK_APART)) & bk_less(f_in, slope) &
            bk_less(walk->t_start, t_in) & bk_not(bk_less(record->margin, f_in));
    at = bk_select(sloped, bk_maxw(t_in, bk_minw(t_out, -f / slope)), t_in);
    t = bk_select(
        crossed, at,
        bk_select(same & (side == BK_BELOW), t_in, bk_maxw(t_in - f_in / slope, walk->t_start)));
    bk_take(walk, tested & (crossed | (above & ((same & (side == BK_BELOW)) | begun))), t, record);
    outside = bk_select(bk_less(-f_out, slope), -f_out, bk_splat(1.0f));
    /* A voxel may have two sheets. If the ray has not reached the plane of one of them yet, that
     * one is kept, unless the plane of the other is nearer and ahead of the ray too. */
    waits = walk->side == BK_BELOW;
    below = below & tested & (bk_not(waits) | bk_less(outside, walk->outside));
    changed = tested & (below | bk_not(waits));
    walk->falling = bk_selecti(changed, falling, walk->falling);
    walk->side = bk_selecti(changed, bk_selecti(below, bk_splati(BK_BELOW), bk_splati(BK_ABOVE)),
                            walk->side);
    walk->outside = bk_select(below, outside, walk->outside);
    walk->ahead.t =
        bk_select(below, bk_select(sloped, t_out - f_out / slope, t_out), walk->ahead.t);
    walk->ahead.normal = bk_select3(below, record->normal, walk->ahead.normal);
    walk->ahead.low = bk_selecti(below, record->low, walk->ahead.low);
    walk->ahead.high = bk_selecti(below, record->high, walk->ahead.high);
    walk->ahead_margin = bk_select(below, record->margin, walk->ahead_margin);
}

/* Loads the first or second records of these value indices. Returns the lanes that have one.
 * *seconds: lanes whose voxel has a second record. */
BK_FN bk_uint bk_load_records(const bk_grid *grid, bk_uint bits, const bk_ulong values[BK_WIDTH],
                              bk_uint second, bk_record *record, bk_uint *seconds)
{
    bk_int normals[BK_WIDTH], planes[BK_WIDTH], low[BK_WIDTH], high[BK_WIDTH];
    bk_uint found = 0;

    bk_store_lanes(normals, bk_splati(0));
    bk_store_lanes(planes, bk_splati(0));
    bk_store_lanes(low, bk_splati(0));
    bk_store_lanes(high, bk_splati(0));
    for (; bits; bits &= bits - 1u) {
        const bk_uint lane = bk_first(bits);
        const bk_ulong number = second ? bk_second(grid, values[lane]) : values[lane];
        if (number == 0)
            continue;
        found |= 1u << lane;
        normals[lane] = (bk_int)grid->normals[number];
        planes[lane] = (bk_int)grid->planes[number];
        low[lane] = (bk_int)(bk_uint)number;
        high[lane] = (bk_int)(bk_uint)(number >> 32);
    }
    record->normal = bk_decode_normalw(bk_load_lanes(normals));
    record->offset = bk_snorm16w(bk_load_lanes(planes));
    record->margin = bk_margin(bk_load_lanes(planes));
    record->low = bk_load_lanes(low);
    record->high = bk_load_lanes(high);
    *seconds = bk_bits((bk_load_lanes(planes) & BK_PLANE_SECOND) != 0);
    return found;
}

/* Tests the records of occupied voxels with these value indices, in the lanes of `bits`. */
BK_FN void bk_cross_voxels(const bk_grid *grid, bk_walk *walk, const bk_ray *ray, bk_uint bits,
                           const bk_ulong values[BK_WIDTH], const bk_cursor *cursor, bk_fw t_in,
                           bk_fw t_out)
{
    const bk_iw side = walk->side;
    const bk_mask falling = walk->falling, lanes = bk_mask_of(bits);
    bk_uint seconds, none;
    bk_record record;

    bk_load_records(grid, bits, values, 0, &record, &seconds);
    walk->side = bk_selecti(lanes, bk_splati(BK_APART), walk->side);
    bk_cross_record(walk, ray, lanes, &record, cursor, t_in, t_out, side, falling);
    if (seconds) {
        seconds = bk_load_records(grid, seconds, values, 1, &record, &none);
        bk_cross_record(walk, ray, bk_mask_of(seconds), &record, cursor, t_in, t_out, side,
                        falling);
    }
}

#endif
