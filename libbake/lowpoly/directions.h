/* directions.h - directions of rays at the corners of the low-poly mesh; private to this folder. */
#ifndef BAKE_LOWPOLY_DIRECTIONS_H
#define BAKE_LOWPOLY_DIRECTIONS_H

#include "libbake/lowpoly/lowpoly.h"

/* Writes the unit directions of `count` triangles' corners to `out`. `positions` and unit `normals`
 * are per corner.
 *
 * BAKE_RAYS_SMOOTH: corners in one place share a direction, the mean of their normals weighted by
 * the corners' angles, so that no split of the mesh tears a gap between rays. Corners whose normals
 * agree keep them to the bit, and so do corners whose normals cancel. BAKE_RAYS_MESH: the normals.
 * BAKE_RAYS_FACE: the triangle's own normal, or the corners' if it has no area.
 * Errors: BSQ_ENOMEM, BSQ_EINTR. */
int bake_ray_directions(struct bsq_ctx *ctx, enum bake_rays rays, uint64_t count,
                        const float (*positions)[3][3], const float (*normals)[3][3],
                        float (*out)[3][3]);

/* Replaces the directions of a low-poly mesh, loaded from `path`, by the way from each corner to
 * the same corner of the cage mesh at `cage_path`. Errors: those of fmt_mesh_load(); BSQ_EDATA,
 * with the first face that differs, if the two have not the same faces. */
int bake_cage_directions(struct bsq_ctx *ctx, const char *path, const struct fmt_mesh *mesh,
                         const char *cage_path, struct bake_lowmesh *out);

#endif
