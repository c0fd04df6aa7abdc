/* curvature_radius.c - the usual size of the neighbourhood in which curvature is measured. */
#include <math.h>

#include "libbake/curvature/curvature.h"

/* Adds a triangle's area in world units and in texels. */
static void add_areas(const struct bake_lowmesh *mesh, uint64_t triangle, double texels_a_tile,
                      double *world, double *texels)
{
    double(*p)[3] = mesh->positions[triangle];
    float(*t)[2] = mesh->texcoords[triangle];
    double a[3], b[3], u[2], v[2];
    for (int k = 0; k < 3; ++k) {
        a[k] = p[1][k] - p[0][k];
        b[k] = p[2][k] - p[0][k];
    }
    for (int k = 0; k < 2; ++k) {
        u[k] = (double)t[1][k] - (double)t[0][k];
        v[k] = (double)t[2][k] - (double)t[0][k];
    }
    const double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2];
    const double z = a[0] * b[1] - a[1] * b[0];
    *world += 0.5 * sqrt(x * x + y * y + z * z);
    *texels += 0.5 * fabs(u[0] * v[1] - u[1] * v[0]) * texels_a_tile;
}

double bake_curvature_radius(const struct bake_surface *surface, const struct bake_options *options,
                             const struct bake_lowmesh *mesh, const struct bake_udim *udim)
{
    double world = 0, texels = 0;
    for (uint32_t i = 0; i < udim->count; ++i) {
        const struct bake_udim_tile *tile = &udim->tiles[i];
        uint32_t width, height;
        bake_tile_size_of(options, tile->number, &width, &height);
        for (uint64_t t = tile->first; t < tile->first + tile->count; ++t)
            add_areas(mesh, t, (double)width * (double)height, &world, &texels);
    }
    const double two_texels = texels > 0 ? 2.0 * sqrt(world / texels) : 0;
    const double least = (!bake_surface_has_grids(surface) ? 0.01 : 2.0) * surface->detail;
    return isfinite(two_texels) ? fmax(two_texels, least) : least;
}
