/* bk_trace.h - the first surface along a ray through the grid.
 *
 * Empty space is skipped node by node, as large as the tree knows it (Museth, "Hierarchical Digital
 * Differential Analyzer for Efficient Ray-Marching in OpenVDB", 2014); inside a leaf the ray goes
 * from voxel to voxel (Amanatides & Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", 1987).
 * Where a ray meets a voxel border depends on the border alone, not on the way there, so errors do
 * not add up.
 *
 * In an occupied voxel the surface is a plane, and planes of neighbours do not meet exactly. Let f
 * be the ray point's signed distance to the plane, its sign chosen so that f grows along the ray.
 * The surface is crossed
 *  - in a voxel where f changes sign,
 *  - at the border of two voxels where f < 0 on leaving one and f > 0 on entering the next,
 *  - where an unbroken run of occupied voxels begins with 0 < f <= margin or ends with
 *    -margin <= f < 0: the scan touched that voxel and not the empty one beside it, so the
 *    surface is inside the run although its plane passes just outside.
 * The first two leave no pinhole inside a run; the last closes the run's ends. Voxels whose surface faces away
 * from where hits are wanted are no part of a run. */
#ifndef BK_TRACE_H
#define BK_TRACE_H

#include "bk_surface.h"

/* Cosine below which a ray is too flat for its hit to be moved onto the blended surface. */
#define BK_GRAZING 0.1f

/* Coordinates from here on are no ray. */
#define BK_FAR 1.0e9f

/* A half ray. Position relative to the lowest corner of the voxel that holds the origin, so that
 * distances keep their precision in large grids; t in voxels. */
typedef struct bk_ray {
    bk_int bx, by, bz; /* that voxel */
    bk_vec3 start;     /* 0 .. 1 */
    bk_vec3 direction;
    bk_vec3 inverse;
} bk_ray;

/* Where a ray crosses a record's plane. */
typedef struct bk_crossing {
    bk_uint found;
    float t;
    bk_record record;
} bk_crossing;

enum { BK_APART, BK_BELOW, BK_ABOVE };

BK_FN bk_crossing bk_no_crossing(void)
{
    bk_crossing none;
    none.found = 0;
    none.t = 0.0f;
    none.record.normal = bk_v3(0.0f, 0.0f, 0.0f);
    none.record.offset = none.record.margin = 0.0f;
    none.record.number = 0;
    return none;
}

/* A walk along a half ray. */
typedef struct bk_walk {
    bk_ray ray;
    float t_start, t_limit;
    bk_vec3 facing;
    bk_uint two_sided;
    bk_crossing hit;
    /* The sheet in the voxel just left: on which side of it the ray is, and which way it is
     * crossed. */
    bk_uint side;
    bk_uint falling;   /* the plane's own distance falls along the ray */
    float outside;     /* -f on leaving, where side is BK_BELOW */
    bk_crossing ahead; /* of that plane beyond the voxel */
} bk_walk;

BK_FN float bk_inverse(float d)
{
    if (bk_abs(d) < 1.0e-9f)
        return d < 0.0f ? -1.0e30f : 1.0e30f;
    return 1.0f / d;
}

BK_FN void bk_ray_set(bk_ray *ray, bk_vec3 origin, bk_vec3 direction)
{
    float x = bk_floor(origin.x + 0.5f), y = bk_floor(origin.y + 0.5f);
    float z = bk_floor(origin.z + 0.5f);

    ray->bx = (bk_int)x;
    ray->by = (bk_int)y;
    ray->bz = (bk_int)z;
    ray->start = bk_v3(origin.x - x + 0.5f, origin.y - y + 0.5f, origin.z - z + 0.5f);
    ray->direction = direction;
    ray->inverse = bk_v3(bk_inverse(direction.x), bk_inverse(direction.y), bk_inverse(direction.z));
}

/* t at which the ray meets the lower face of voxel layer `layer` of an axis. */
BK_FN float bk_border(bk_int layer, bk_int base, float start, float inverse)
{
    return ((float)(layer - base) - start) * inverse;
}

/* Layer whose lower face a ray leaves an aligned node through; mask = side - 1. */
BK_FN bk_int bk_exit_layer(bk_int v, bk_int mask, float inverse)
{
    return inverse >= 0.0f ? (v | mask) + 1 : v & ~mask;
}

/* Voxel of a coordinate at t, kept inside a node that is known to hold it. */
BK_FN bk_int bk_voxel_at(float start, float direction, float t, bk_int base, bk_int low,
                         bk_int high)
{
    return bk_clamp_int(base + (bk_int)bk_floor(start + direction * t), low, high);
}

/* Shortens [*t_near, *t_far] to the part between two layers. */
BK_FN void bk_clip(bk_int low, bk_int high, bk_int base, float start, float inverse, float *t_near,
                   float *t_far)
{
    float a = bk_border(low, base, start, inverse), b = bk_border(high + 1, base, start, inverse);
    *t_near = bk_max(*t_near, bk_min(a, b));
    *t_far = bk_min(*t_far, bk_max(a, b));
}

/* Where the ray's line is inside the bounds of the grid's active voxels; t_near > t_far: nowhere.
 */
BK_FN void bk_bounds(const bk_ray *ray, const bk_params *params, float *t_near, float *t_far)
{
    const bk_int *low = params->index_min, *high = params->index_max;

    *t_near = -BK_FAR;
    *t_far = BK_FAR;
    bk_clip(low[0], high[0], ray->bx, ray->start.x, ray->inverse.x, t_near, t_far);
    bk_clip(low[1], high[1], ray->by, ray->start.y, ray->inverse.y, t_near, t_far);
    bk_clip(low[2], high[2], ray->bz, ray->start.z, ray->inverse.z, t_near, t_far);
}

BK_FN void bk_take(bk_walk *walk, float t, const bk_record *record)
{
    if (t <= walk->t_limit && (!walk->hit.found || t < walk->hit.t)) {
        walk->hit.found = 1;
        walk->hit.t = t;
        walk->hit.record = *record;
    }
}

/* The run of occupied voxels ends: its last plane may pass just outside. */
BK_FN void bk_end_run(bk_walk *walk)
{
    if (walk->side == BK_BELOW && walk->outside <= walk->ahead.record.margin)
        bk_take(walk, walk->ahead.t, &walk->ahead.record);
    walk->side = BK_APART;
}

/* Tests one record of voxel (x, y, z), which the ray is in from t_in to t_out. side and
 * was_falling: what the walk knew when it left the voxel before. */
BK_FN void bk_cross_record(bk_walk *walk, const bk_record *record, bk_int x, bk_int y, bk_int z,
                           float t_in, float t_out, bk_uint side, bk_uint was_falling)
{
    const bk_ray *ray = &walk->ray;
    bk_vec3 from;
    float f, slope, f_in, f_out;
    bk_uint falling;

    if (!walk->two_sided && !(bk_dot(record->normal, walk->facing) > 0.0f))
        return;
    from = bk_v3((float)(ray->bx - x) + (ray->start.x - 0.5f),
                 (float)(ray->by - y) + (ray->start.y - 0.5f),
                 (float)(ray->bz - z) + (ray->start.z - 0.5f));
    f = bk_dot(record->normal, from) - record->offset;
    slope = bk_dot(record->normal, ray->direction);
    falling = slope < 0.0f;
    if (falling) {
        f = -f;
        slope = -slope;
    }
    f_in = f + slope * t_in;
    f_out = f + slope * t_out;
    if (falling != was_falling)
        side = BK_APART;
    walk->falling = falling;
    if (f_in > 0.0f) {
        walk->side = BK_ABOVE;
        if (side == BK_BELOW)
            bk_take(walk, t_in, record);
        else if (side == BK_APART && f_in <= record->margin && f_in < slope && t_in > walk->t_start)
            bk_take(walk, bk_max(t_in - f_in / slope, 0.0f), record);
    } else if (f_out >= 0.0f) {
        walk->side = BK_ABOVE;
        bk_take(walk, slope > 0.0f ? bk_max(t_in, bk_min(t_out, -f / slope)) : t_in, record);
    } else {
        walk->side = BK_BELOW;
        walk->outside = -f_out < slope ? -f_out : 1.0f;
        walk->ahead.t = slope > 0.0f ? t_out - f_out / slope : t_out;
        walk->ahead.record = *record;
    }
}

/* An occupied voxel with value index v. */
BK_FN void bk_cross_voxel(const bk_grid *grid, bk_walk *walk, bk_ulong v, bk_int x, bk_int y,
                          bk_int z, float t_in, float t_out)
{
    bk_uint side = walk->side, falling = walk->falling;
    bk_uint plane = grid->planes[v];
    bk_record record = bk_load(grid, v, plane);

    walk->side = BK_APART;
    bk_cross_record(walk, &record, x, y, z, t_in, t_out, side, falling);
    if (plane & BK_PLANE_SECOND) {
        bk_ulong number = bk_second(grid, v);
        if (number) {
            record = bk_load(grid, number, grid->planes[number]);
            bk_cross_record(walk, &record, x, y, z, t_in, t_out, side, falling);
        }
    }
    if (walk->side == BK_APART && side == BK_BELOW && !walk->hit.found) {
        /* No sheet here faces the right way: for the one before, the run has ended. */
        walk->side = side;
        bk_end_run(walk);
    }
}

/* Goes through a leaf from voxel (*px, *py, *pz) at *pt on; ends in the first voxel outside the
 * leaf, or where the walk has a hit or *pt reaches t_end. */
BK_FN void bk_walk_leaf(const bk_grid *grid, bk_walk *walk, bk_uint leaf, bk_int *px, bk_int *py,
                        bk_int *pz, float *pt, float t_end)
{
    const bk_ray *ray = &walk->ray;
    const bk_vec3 start = ray->start, inverse = ray->inverse;
    const BK_GLOBAL bk_ulong *words = grid->leaves + (bk_ulong)leaf * BK_LEAF_WORDS;
    /* 1 where the ray goes up the axis: it leaves a voxel through the lower face of the next. */
    const bk_int ax = inverse.x >= 0.0f, ay = inverse.y >= 0.0f;
    const bk_int az = inverse.z >= 0.0f;
    /* Low bits of the first layer outside the leaf. */
    const bk_int end_x = ax ? 0 : 7, end_y = ay ? 0 : 7, end_z = az ? 0 : 7;
    bk_int x = *px, y = *py, z = *pz, inside = 1;
    float tx = bk_border(x + ax, ray->bx, start.x, inverse.x);
    float ty = bk_border(y + ay, ray->by, start.y, inverse.y);
    float tz = bk_border(z + az, ray->bz, start.z, inverse.z);
    float t = *pt;

    do {
        const float t_out = bk_max(t, bk_min(tx, bk_min(ty, tz)));
        const bk_uint layer = (bk_uint)x & 7u, bit = ((bk_uint)y & 7u) << 3 | ((bk_uint)z & 7u);
        if (words[BK_LEAF_MASK + layer] >> bit & 1u)
            bk_cross_voxel(grid, walk, bk_leaf_rank(words, layer, bit), x, y, z, t,
                           bk_min(t_out, walk->t_limit));
        else if (walk->side != BK_APART)
            bk_end_run(walk);
        if (walk->hit.found)
            return;
        t = t_out;
        if (tx <= ty && tx <= tz) {
            x += 2 * ax - 1;
            tx = bk_border(x + ax, ray->bx, start.x, inverse.x);
            inside = (x & 7) != end_x;
        } else if (ty <= tz) {
            y += 2 * ay - 1;
            ty = bk_border(y + ay, ray->by, start.y, inverse.y);
            inside = (y & 7) != end_y;
        } else {
            z += 2 * az - 1;
            tz = bk_border(z + az, ray->bz, start.z, inverse.z);
            inside = (z & 7) != end_z;
        }
    } while (inside && t < t_end);
    *px = x;
    *py = y;
    *pz = z;
    *pt = t;
}

/* Moves (*px, *py, *pz) to where the ray leaves the empty aligned node of 1 << level voxels around
 * it. */
BK_FN void bk_skip(const bk_ray *ray, bk_uint level, bk_int *px, bk_int *py, bk_int *pz, float *pt)
{
    const bk_int mask = ((bk_int)1 << level) - 1;
    const bk_vec3 start = ray->start, direction = ray->direction, inverse = ray->inverse;
    bk_int x = *px, y = *py, z = *pz;
    bk_int fx = bk_exit_layer(x, mask, inverse.x), fy = bk_exit_layer(y, mask, inverse.y);
    bk_int fz = bk_exit_layer(z, mask, inverse.z);
    float tx = bk_border(fx, ray->bx, start.x, inverse.x);
    float ty = bk_border(fy, ray->by, start.y, inverse.y);
    float tz = bk_border(fz, ray->bz, start.z, inverse.z);
    float t = bk_max(*pt, bk_min(tx, bk_min(ty, tz)));

    if (tx <= ty && tx <= tz) {
        *px = inverse.x >= 0.0f ? fx : fx - 1;
        *py = bk_voxel_at(start.y, direction.y, t, ray->by, y & ~mask, y | mask);
        *pz = bk_voxel_at(start.z, direction.z, t, ray->bz, z & ~mask, z | mask);
    } else if (ty <= tz) {
        *px = bk_voxel_at(start.x, direction.x, t, ray->bx, x & ~mask, x | mask);
        *py = inverse.y >= 0.0f ? fy : fy - 1;
        *pz = bk_voxel_at(start.z, direction.z, t, ray->bz, z & ~mask, z | mask);
    } else {
        *px = bk_voxel_at(start.x, direction.x, t, ray->bx, x & ~mask, x | mask);
        *py = bk_voxel_at(start.y, direction.y, t, ray->by, y & ~mask, y | mask);
        *pz = inverse.z >= 0.0f ? fz : fz - 1;
    }
    *pt = t;
}

/* Walks a half ray from walk->t_start to walk->t_limit; the outcome is walk->hit. t_near, t_far:
 * where the ray is inside the grid's bounds. */
BK_FN void bk_walk_ray(const bk_grid *grid, const bk_params *params, bk_cache *cache, bk_walk *walk,
                       float t_near, float t_far)
{
    const bk_ray *ray = &walk->ray;
    const bk_int *low = params->index_min, *high = params->index_max;
    const float t_end = bk_min(walk->t_limit, t_far);
    float t = bk_max(walk->t_start, t_near);
    bk_int x, y, z;

    walk->hit.found = 0;
    walk->side = BK_APART;
    walk->falling = 0;
    if (!(t <= t_end))
        return;
    x = bk_voxel_at(ray->start.x, ray->direction.x, t, ray->bx, low[0], high[0]);
    y = bk_voxel_at(ray->start.y, ray->direction.y, t, ray->by, low[1], high[1]);
    z = bk_voxel_at(ray->start.z, ray->direction.z, t, ray->bz, low[2], high[2]);
    do {
        bk_uint level = bk_locate(grid, cache, x, y, z);
        if (level == 0) {
            bk_walk_leaf(grid, walk, cache->leaf, &x, &y, &z, &t, t_end);
        } else {
            bk_end_run(walk);
            if (!walk->hit.found)
                bk_skip(ray, level, &x, &y, &z, &t);
        }
    } while (!walk->hit.found && t < t_end);
    if (!walk->hit.found)
        bk_end_run(walk);
}

/* Normal, colour and final distance of a plane crossing, on the blended surface. */
BK_FN void bk_shade(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                    const bk_ray *ray, const bk_crossing *crossing, bk_hit *hit)
{
    const bk_uint has_color = params->flags & BK_HAS_COLOR;
    bk_vec3 normal = crossing->record.normal;
    bk_vec3 color = bk_v3(0.0f, 0.0f, 0.0f);
    float t = crossing->t;
    bk_uint blended = 0;

    if (!(params->flags & BK_NEAREST)) {
        const bk_vec3 at = bk_add_scaled(ray->start, t, ray->direction);
        const bk_blend blend =
            bk_blend_around(grid, cache, ray->bx, ray->by, ray->bz, at, normal, has_color);
        blended = blend.found;
        if (blended) {
            float slope = bk_dot(blend.normal, ray->direction);
            if (bk_abs(slope) > BK_GRAZING)
                t -= bk_max(-0.5f, bk_min(0.5f, blend.distance / slope));
            normal = blend.normal;
            color = blend.color;
        }
    }
    if (has_color && !blended)
        color = bk_decode_color(grid->colors[crossing->record.number]);
    hit->found = 1;
    hit->t = t;
    hit->normal[0] = normal.x;
    hit->normal[1] = normal.y;
    hit->normal[2] = normal.z;
    hit->color[0] = color.x;
    hit->color[1] = color.y;
    hit->color[2] = color.z;
}

/* The surface at the smallest |t| in [t_min, t_max] along a line through `origin` with unit
 * direction. The line is walked from its origin both ways; the second walk ends where the first one
 * hit. Surfaces whose normal has no positive dot product with `facing` are passed unless
 * BK_TWO_SIDED is set. */
BK_FN void bk_trace(const bk_grid *grid, const bk_params *params, bk_cache *cache, bk_vec3 origin,
                    bk_vec3 direction, float t_min, float t_max, bk_vec3 facing, bk_hit *hit)
{
    bk_walk walk;
    bk_crossing nearest;
    float t_near, t_far;
    bk_uint inward;

    hit->found = 0;
    hit->t = 0.0f;
    hit->normal[0] = hit->normal[1] = hit->normal[2] = 0.0f;
    hit->color[0] = hit->color[1] = hit->color[2] = 0.0f;
    if (!(bk_abs(origin.x) < BK_FAR && bk_abs(origin.y) < BK_FAR && bk_abs(origin.z) < BK_FAR &&
          bk_abs(bk_dot(direction, direction) - 1.0f) < 0.01f))
        return;
    bk_ray_set(&walk.ray, origin, direction);
    bk_bounds(&walk.ray, params, &t_near, &t_far);
    walk.facing = facing;
    walk.two_sided = params->flags & BK_TWO_SIDED;
    walk.hit = nearest = bk_no_crossing();
    walk.t_start = bk_max(t_min, 0.0f);
    walk.t_limit = t_max;
    bk_walk_ray(grid, params, cache, &walk, t_near, t_far);
    nearest = walk.hit;
    walk.t_start = bk_max(-t_max, 0.0f);
    walk.t_limit = nearest.found ? bk_min(-t_min, nearest.t) : -t_min;
    walk.ray.direction = bk_scale(direction, -1.0f);
    walk.ray.inverse = bk_scale(walk.ray.inverse, -1.0f);
    bk_walk_ray(grid, params, cache, &walk, -t_far, -t_near);
    inward = walk.hit.found && !(nearest.found && nearest.t <= walk.hit.t);
    if (inward)
        nearest = walk.hit;
    else
        walk.ray.direction = direction;
    if (!nearest.found)
        return;
    bk_shade(grid, params, cache, &walk.ray, &nearest, hit);
    if (inward)
        hit->t = -hit->t;
}

#endif
