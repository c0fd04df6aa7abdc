/* ray_distance.h - how far from the low mesh the scan lies. */
#ifndef BAKE_SURFACE_RAY_DISTANCE_H
#define BAKE_SURFACE_RAY_DISTANCE_H

#include "libbake/lowpoly/lowpoly.h"
#include "libbake/surface/surface.h"

/* Chooses ray lengths in world units, along the normal and against it:
 *   1. 16384 rays from points spread evenly over the low mesh, along its normals, both ways, up to
 *      a tenth of the diagonal of the scan's bounds.
 *   2. Of those that hit, the 99.9th percentile of the distance on either side.
 *   3. One and a half times that, and two voxels (struct bake_surface's detail).
 * Where fewer than one ray in a hundred hits, a twentieth of the diagonal. Deterministic. */
int bake_measure_distances(const struct bake_surface *surface, const struct bk_params *params,
                           const struct bake_lowmesh *mesh, double *front, double *back);

#endif
