/* fit.h - whether the low-poly mesh fits the scan, and how long its rays must be. Takes both; gives
 * lengths, or a failure that names the options with which the mesh fits. */
#ifndef BAKE_FIT_FIT_H
#define BAKE_FIT_FIT_H

#include "libbake/lowpoly/lowpoly.h"
#include "libbake/surface/surface.h"

/* Chooses ray lengths in world units, along the low-poly mesh's normals (front) and against them
 * (back); lengths that the options give stay:
 *   1. Casts 16384 rays from points spread evenly over the low-poly mesh, both ways along its
 *      normals, up to a tenth of the diagonal of the scan's bounds.
 *   2. Takes the 99.9th percentile of the distances of the hits on either side.
 *   3. Returns one and a half times that percentile plus two details (struct bake_surface).
 * Rays meet the samples of chunk files that have any. Then what these may hide is added, too. If
 * fewer than one ray in a hundred hits, both are a twentieth of the diagonal. If most rays that hit
 * nothing find something farther outwards, up to half of the diagonal, this counts too, with a
 * warning.
 *
 * Unless the options say that meshes are baked as they are, compares the distances with those of a
 * mesh that is turned by right angles, scaled by the factor of a unit, mirrored or inverted, if its
 * bounds are then like the scan's. If one of these fits much better: BSQ_EDATA, with the options
 * that mend it. Warns of meshes that only fit after a shift or another scale, of lengths that were
 * chosen although much of the mesh is far from the scan, and of an open scan if the surface's
 * parameters have thickness without a distance. Deterministic. Errors: also those of
 * bake_surface_trace(). */
int bake_fit(const struct bake_surface *surface, const struct bake_lowmesh *mesh,
             const struct bake_options *options, double *front, double *back);

#endif
