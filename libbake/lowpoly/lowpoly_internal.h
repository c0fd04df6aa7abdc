/* lowpoly_internal.h - what corners of the low-poly mesh get: normals and directions of rays; and
 * its place; private to this folder. */
#ifndef BAKE_LOWPOLY_LOWPOLY_INTERNAL_H
#define BAKE_LOWPOLY_LOWPOLY_INTERNAL_H

#include "libbake/lowpoly/lowpoly.h"

/* Scales, turns and shifts positions and normals, as the options ask for. */
void bake_transform_mesh(const struct bake_options *options, struct fmt_mesh *mesh);

/* ---- directions ---- */

/* Writes the mean of the unit normals of corners in one place, weighted by the corners' angles or
 * by the triangles' areas, to each of them. firsts: of each corner, the first one in its place.
 * Corners whose normals agree keep them to the bit, and so do corners whose normals cancel. Errors:
 * BSQ_ENOMEM, BSQ_EINTR. */
int bake_mean_normals(struct bsq_ctx *ctx, bool by_area, uint32_t corners,
                      const float (*positions)[3], const float (*normals)[3],
                      const uint32_t *firsts, float (*out)[3]);

/* Writes the unit directions of `count` triangles' corners to `out`, and their reaches. `positions`
 * and unit `normals` are per corner.
 *
 * BAKE_RAYS_SMOOTH: corners in one place share a direction, the mean of their normals weighted by
 * the corners' angles, so that no split of the mesh tears a gap between rays. Corners whose normals
 * agree keep them to the bit, and so do corners whose normals cancel. BAKE_RAYS_MESH: the normals.
 * BAKE_RAYS_FACE: the triangle's own normal, or the corners' if it has no area.
 *
 * A reach is how far outside of the mesh the surface may lie that it stands for: one and a half
 * times the height of the arcs that have the normals at the ends of the edges around it.
 * Errors: BSQ_ENOMEM, BSQ_EINTR. */
int bake_ray_directions(struct bsq_ctx *ctx, enum bake_rays rays, uint64_t count,
                        const float (*positions)[3][3], const float (*normals)[3][3],
                        float (*out)[3][3], float (*reaches)[3]);

/* Replaces the directions of a low-poly mesh by the way from each corner to the same corner of the
 * cage mesh of the options, which is placed like it. `path` and `mesh` are of the low-poly mesh.
 * Errors: those of fmt_mesh_load(); BSQ_EDATA, with the first face that differs, if the two have
 * not the same faces. */
int bake_cage_directions(struct bsq_ctx *ctx, const struct bake_options *options, const char *path,
                         const struct fmt_mesh *mesh, struct bake_lowmesh *out);

/* Turns unit directions into the way to a cage at this distance. */
void bake_extrude(double distance, struct bake_lowmesh *mesh);

#endif
