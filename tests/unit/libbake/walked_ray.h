/* walked_ray.h - a secondary ray that goes through every voxel on its way: what rays through the
 * tree of leaves must find. */
#ifndef TESTS_WALKED_RAY_H
#define TESTS_WALKED_RAY_H

#include "libbake/kernel/bk_secondary.h"

/* Returns what a ray of a point finds, as bk_add_up() takes it: the distance of its first hit, or
 * -1. direction: of unit length. */
float walked_ray(const bk_grid *grid, const bk_params *params, const bk_rays *kind,
                 const bk_viewpoint *point, bk_vec3w direction);

#endif
