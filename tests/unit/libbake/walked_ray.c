/* walked_ray.c - see walked_ray.h. Borders are crossed in the order of their t and, if these are
 * equal, of their axes. */
#include "tests/unit/libbake/walked_ray.h"

#include <math.h>
#include <stdbool.h>

/* Moves to the next voxel. Returns the t of the border. */
static float next_voxel(const bk_ray *ray, bk_cursor *cursor)
{
    const float inverse[3] = {ray->inverse.x, ray->inverse.y, ray->inverse.z};
    const float start[3] = {ray->start.x, ray->start.y, ray->start.z};
    const bk_int base[3] = {ray->bx, ray->by, ray->bz};
    bk_int *voxel[3] = {&cursor->x, &cursor->y, &cursor->z};
    float first = INFINITY;
    int axis = 0;
    for (int k = 0; k < 3; k++) {
        const float t = bk_border(*voxel[k] + (inverse[k] >= 0), base[k], start[k], inverse[k]);
        if (t < first) {
            first = t;
            axis = k;
        }
    }
    *voxel[axis] += inverse[axis] >= 0 ? 1 : -1;
    return first;
}

/* Meets the records of a voxel in which the ray is from t to t_out. Returns false if the voxel is
 * empty or ends a run of voxels below a surface. */
static bool meet_voxel(const bk_grid *grid, const bk_params *params, const bk_ray *ray,
                       bk_walk *walk, bk_cursor *cursor, float t, float t_out)
{
    bk_cache cache = bk_cache_empty();
    bk_ulong value;
    if (bk_locate(grid, &cache, cursor->x, cursor->y, cursor->z) != 0)
        return false;
    cursor->leaf = (bk_int)cache.leaf;
    value = bk_leaf_value(grid, cache.leaf, cursor->x, cursor->y, cursor->z);
    if (value == 0)
        return false;
    if (t < params->coarse)
        return !bk_meet_records(grid, ray, walk, 1, &value, cursor, t, t_out);
    walk->hit.found = ~0;
    walk->hit.t = t + (walk->two_sided ? 0 : BK_FAR_DEPTH);
    walk->side = BK_APART;
    return true;
}

float walked_ray(const bk_grid *grid, const bk_params *params, const bk_rays *kind,
                 const bk_viewpoint *point, bk_vec3w direction)
{
    const bk_ray ray = bk_ray_along(bk_splat3(bk_ray_start(kind, point)), direction,
                                    bk_scalew(direction, point->side), ~0);
    const float rise = bk_ray_rise(kind, point, direction);
    float t_near, t_far, t;
    bk_cursor cursor;
    bk_walk walk;
    if (kind->open && point->crowded == BK_CROWDED_BY_WALL) {
        bk_cache cache = bk_cache_empty();
        const bk_wall wall = bk_find_wall(grid, &cache, point->solid_from, point->normal);
        if (bk_cross_wall(&wall, direction, rise, &t) && t <= kind->limit)
            return t;
    }
    bk_set_walk(kind, rise, &walk);
    bk_bounds(&ray, params, &t_near, &t_far);
    const float t_end = fminf(kind->limit, t_far);
    if (bk_begin_walk(params, &ray, &walk, t_near, t_end, &t, &cursor)) {
        do {
            bk_cursor here = cursor;
            const float t_out = fmaxf(t, next_voxel(&ray, &cursor));
            if (!meet_voxel(grid, params, &ray, &walk, &here, t, t_out) && walk.side != BK_APART)
                bk_end_run(&walk, ~0);
            t = t_out;
        } while (t < t_end && !walk.hit.found);
        bk_end_run(&walk, ~0);
    }
    if (walk.hit.found)
        return fminf(walk.hit.t, kind->limit);
    return !kind->open && !(t_far < kind->limit) ? kind->limit : -1;
}
