/* curvature.h - the mean curvature of the scan around the hits of a map.
 *
 * In: an image whose texels hold the position and the normal of their hits, and the surface that
 * they lie on, a grid or triangles. Out: the same image with the curvature in the place of the
 * position's first coordinate.
 *
 * The result depends on the scans that a texel sees around its hit only, so charts, tiles and
 * threads leave no trace in it. */
#ifndef BAKE_CURVATURE_CURVATURE_H
#define BAKE_CURVATURE_CURVATURE_H

#include "libbake/surface/surface.h"
#include "libbake/udim/udim.h"

struct bake_curvature {
    const struct bake_surface *surface;
    struct bake_image *image;
    uint32_t offset; /* of the map's first value in a texel of the image */
    double radius;   /* of the neighbourhood, in world units */
    /* The last value of a texel has the bits of its object's number, as surface->sees tells which
     * scans objects see. */
    bool by_objects;
    /* Of a surface that is a single grid, the device that traces it; NULL: the processor does. */
    struct bake_device *device;
};

struct bake_curvature_counts {
    uint64_t texels; /* with hits */
    uint64_t alone;  /* of these, the ones around whose hits no ray found the scan */
};

/* Computes the curvature of all valid texels on all threads, in 1 / world unit: positive where the
 * scan is convex. If only some of the rays around a hit find the scan, they give the value; if none
 * does, it is 0, and counted. Adds to *counts. Must not be called from parallel work. Errors: those
 * of bake_surface_trace(), bake_device_trace_rays() and bake_image_bands(); BSQ_ENOMEM. */
int bake_curvature_trace(struct bsq_ctx *ctx, const struct bake_curvature *curvature,
                         struct bake_curvature_counts *counts);

/* Returns the usual radius in world units: two texels of the tiles' maps, whose side is the root of
 * the mesh's area in these tiles by the charts' area in texels. For grids it is at least two
 * voxels, as the normals of smaller neighbourhoods are hardly independent. */
double bake_curvature_radius(const struct bake_surface *surface, const struct bake_options *options,
                             const struct bake_lowmesh *mesh, const struct bake_udim *udim);

#endif
