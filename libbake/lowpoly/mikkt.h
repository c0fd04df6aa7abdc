/* mikkt.h - tangent frames by the MikkTSpace convention (Mikkelsen, "Simulation of Wrinkled
 * Surfaces Revisited", 2008, section 2.2 and its reference behaviour), implemented from its
 * definition. */
#ifndef BAKE_LOWPOLY_MIKKT_H
#define BAKE_LOWPOLY_MIKKT_H

#include "base/context.h"

/* Computes one tangent per corner of `count` triangles: unit xyz and in w the sign of the
 * bitangent, B = w * cross(N, T). positions, unit normals and texture coordinates per corner;
 * corners are welded when all three agree exactly, as the convention asks. Where tangents around a
 * corner cancel, xyz is 0; corners that no tangent reaches get the convention's default, (1, 0, 0)
 * with sign -1. `out` has count entries. */
int bake_mikkt(struct bsq_ctx *ctx, uint64_t count, const float (*positions)[3][3],
               const float (*normals)[3][3], const float (*texcoords)[3][2], float (*out)[3][4]);

#endif
