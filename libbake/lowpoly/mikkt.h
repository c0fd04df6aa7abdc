/* mikkt.h - tangent frames by the MikkTSpace convention, and the welding of corners; private to
 * this folder.
 *
 * Implemented from the convention's definition (Mikkelsen, "Simulation of Wrinkled Surfaces
 * Revisited", 2008, section 2.2) and compared with tangents that Blender computed. */
#ifndef BAKE_LOWPOLY_MIKKT_H
#define BAKE_LOWPOLY_MIKKT_H

#include "base/context.h"

/* Computes one tangent per corner of `count` triangles: unit xyz, and in w the sign of the
 * bitangent B = w * cross(N, T). Positions, unit normals and texture coordinates are per corner;
 * corners are welded if all three agree exactly. If the tangents around a corner cancel, xyz is 0.
 * Corners that no tangent reaches get the convention's default, (1, 0, 0) with sign -1. `out` has
 * `count` entries. Errors: BSQ_EDATA for too many triangles, BSQ_ENOMEM, BSQ_EINTR. */
int bake_mikkt(struct bsq_ctx *ctx, uint64_t count, const float (*positions)[3][3],
               const float (*normals)[3][3], const float (*texcoords)[3][2], float (*out)[3][4]);

/* ---- welding ---- */

struct mikkt_input {
    uint32_t corner_count; /* three a triangle */
    const float (*positions)[3];
    const float (*normals)[3];
    const float (*texcoords)[2];
};

/* Sets vertices[corner] to the first corner with the same position, and the same normal and texture
 * coordinates if these are not NULL; -0 equals 0. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int bake_mikkt_weld(struct bsq_ctx *ctx, const struct mikkt_input *input, uint32_t *vertices);

#endif
