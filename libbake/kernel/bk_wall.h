/* bk_wall.h - walls beside points on the surface: other surfaces that rise from the same voxel.
 *
 * A voxel in which two surfaces meet has one record, a mean of both. So where a wall stands on a
 * floor, the voxel hides neither the rays that cross the wall in it nor has the normal of either
 * surface. Both are known from voxels beside it: the normal around which rays start is that of a
 * flat voxel, and the plane of the wall above goes on down to the floor. */
#ifndef BAKE_KERNEL_BK_WALL_H
#define BAKE_KERNEL_BK_WALL_H

#include "bk_surface.h"

/* Distance above the hit at which open rays start, in voxels. It is larger than the margin of any
 * record, see bk_margin(). */
#define BK_LIFT 1.0f

/* Lengths of mean normals below which the surface in a voxel surely folds, and above which it is
 * flat: two halves that meet at 52 and 36 degrees. */
#define BK_FOLD 0.9f
#define BK_FLAT 0.95f
/* A voxel contains points up to this far from its centre on each axis, rounding included. */
#define BK_INSIDE 0.51f
/* Least cosine between a blended normal and that of the flat voxel that is taken instead. */
#define BK_LIKE 0.3f
/* Largest cosine between a point's normal and that of its wall. */
#define BK_STEEP 0.7f
/* Walls are nearer than this, in voxels, also along rays. */
#define BK_WALL_REACH 2.0f

/* Sets the normals `up` of points in voxels in which the surface folds to that normal of a flat
 * voxel of the cell that is most like the blended one. Returns the lanes of points with a fold in
 * their cell. */
BK_FN bk_uint bk_unfold(const bk_cell *cell, const bk_corner corners[8], const bk_weights *at,
                        bk_vec3w *up)
{
    const bk_vec3w blended = *up;
    bk_mask folds = bk_mask_of(0), inside = folds;
    bk_fw like = bk_splat(BK_LIKE);
    bk_vec3w flat = blended;
    bk_uint i;

    for (i = 0; i < 8; i++) {
        const bk_mask there = (bk_load_lanes(cell->present) & (bk_int)(1u << i)) != 0;
        const bk_fw coverage = bk_coverage(bk_load_lanes(cell->planes[i]));
        const bk_mask fold = there & bk_less(coverage, bk_splat(BK_FOLD));
        const bk_fw away = bk_maxw(bk_maxw(bk_absw(at->x.r[i >> 2]), bk_absw(at->y.r[i >> 1 & 1u])),
                                   bk_absw(at->z.r[i & 1u]));
        const bk_fw agreement = bk_dotw(corners[i].normal, blended);
        const bk_mask better =
            there & bk_less(bk_splat(BK_FLAT), coverage) & bk_less(like, agreement);

        folds = folds | fold;
        inside = inside | (fold & bk_less(away, bk_splat(BK_INSIDE)));
        like = bk_select(better, agreement, like);
        flat = bk_select3(better, corners[i].normal, flat);
    }
    *up = bk_select3(inside, flat, blended);
    return bk_bits(folds);
}

/* The plane of a wall. */
typedef struct bk_wall {
    bk_vec3 normal; /* unit; zero: there is none */
    float distance; /* of the point, along the normal */
} bk_wall;

/* Returns the order of walls by the point's distance along their normals: those that face it first,
 * as a point beside the corner of a block is in front of one side and behind the other one. */
BK_FN float bk_wall_order(float distance)
{
    return distance < 0.0f ? BK_WALL_REACH - distance : distance;
}

/* Takes a record as a point's wall if it is flat, steep to the plane through the point with normal
 * `up`, more than half a voxel above that plane, and comes before the wall so far. away: the point,
 * from the centre of the record's voxel. */
BK_FN void bk_take_wall(const bk_grid *grid, bk_ulong number, bk_vec3 away, bk_vec3 up,
                        bk_wall *wall)
{
    const bk_iw planes = bk_splati((bk_int)grid->planes[number]);
    const bk_vec3w normals = bk_decode_normalw(bk_splati((bk_int)grid->normals[number]));
    const bk_fw coverages = bk_coverage(planes), offsets = bk_snorm16w(planes);
    const bk_vec3 normal = bk_lane3(&normals, 0);
    const float coverage = bk_lane(coverages, 0), offset = bk_lane(offsets, 0);
    const float slope = bk_dot(normal, up), distance = bk_dot(normal, away) - offset;

    if (coverage > BK_FLAT && bk_abs(slope) < BK_STEEP &&
        offset * slope - bk_dot(away, up) > 0.5f * BK_LIFT && distance < BK_WALL_REACH &&
        bk_wall_order(distance) < bk_wall_order(wall->distance)) {
        wall->normal = normal;
        wall->distance = distance;
    }
}

/* Finds the first wall of a point on the surface, among the eight voxels around the point BK_LIFT
 * above it. A surface that bends away from the point is below its tangent plane, so it has none
 * there. */
BK_FN bk_wall bk_find_wall(const bk_grid *grid, bk_cache *cache, bk_vec3 point, bk_vec3 up)
{
    const bk_vec3 above = bk_add_scaled(point, BK_LIFT, up);
    const bk_int x = (bk_int)bk_floor(above.x), y = (bk_int)bk_floor(above.y);
    const bk_int z = (bk_int)bk_floor(above.z);
    bk_ulong values[8];
    bk_wall wall;
    bk_uint i;

    wall.normal = bk_v3(0.0f, 0.0f, 0.0f);
    wall.distance = -BK_WALL_REACH;
    bk_cell_values(grid, cache, x, y, z, values);
    BK_ROLLED
    for (i = 0; i < 8; i++) {
        const bk_vec3 away = bk_v3(point.x - (float)(x + (bk_int)(i >> 2)),
                                   point.y - (float)(y + (bk_int)(i >> 1 & 1u)),
                                   point.z - (float)(z + (bk_int)(i & 1u)));
        const bk_ulong second = values[i] ? bk_second(grid, values[i]) : 0;

        if (values[i])
            bk_take_wall(grid, values[i], away, up, &wall);
        if (second)
            bk_take_wall(grid, second, away, up, &wall);
    }
    return wall;
}

/* Returns the lanes of rays from a point that cross its wall less than BK_LIFT above its tangent
 * plane, and sets their t. Above that, voxels of the wall alone end them. rise: cosines between
 * rays and the point's normal. */
BK_FN bk_mask bk_cross_wall(const bk_wall *wall, bk_vec3w direction, bk_fw rise, bk_fw *t)
{
    *t = bk_splat(-wall->distance) / bk_dotw(direction, bk_splat3(wall->normal));
    return bk_less(bk_splat(0.0f), *t) & bk_less(*t, bk_splat(BK_WALL_REACH)) &
           bk_less(*t * rise, bk_splat(BK_LIFT));
}

#endif
