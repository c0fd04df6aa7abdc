/* curvature.h - the mean curvature of the scan around the hits of a map.
 *
 * In: an image whose texels hold the position and the normal of their hits, and the surface that
 * they lie on, a grid or triangles. Out: the same image with the curvature in the place of the
 * position's first coordinate.
 *
 * The result depends on the surface around a hit only, so charts, tiles, threads and devices leave
 * no trace in it. */
#ifndef BAKE_CURVATURE_CURVATURE_H
#define BAKE_CURVATURE_CURVATURE_H

#include "libbake/surface/surface.h"
#include "libbake/udim/udim.h"

struct bake_curvature {
    const struct bake_surface *surface;
    const struct bk_params *params; /* used for grids only */
    struct bake_image *image;
    uint32_t place; /* of the map's first value in a texel of the image */
    double radius;  /* of the neighbourhood, in world units */
};

/* Computes the curvature of all valid texels on all threads, in 1 / world unit: positive where the
 * scan is convex, 0 if its surroundings are not found. Must not be called from parallel work.
 * Errors: those of bake_surface_trace(), bake_image_rows() and bake_image_write(); BSQ_ENOMEM. */
int bake_curvature_trace(struct bsq_ctx *ctx, const struct bake_curvature *job);

/* Returns the usual radius in world units: two texels of the tiles' maps, whose side is the root of
 * the mesh's area in these tiles by the charts' area in texels. For grids it is at least two
 * voxels, as the normals of smaller neighbourhoods are hardly independent. */
double bake_curvature_radius(const struct bake_surface *surface, const struct bake_options *options,
                             const struct bake_lowmesh *mesh, const struct bake_udim *udim);

#endif
