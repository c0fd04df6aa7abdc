/* mikkt.h - tangent frames by the MikkTSpace convention, and the topology that they need; private
 * to this folder.
 *
 * Implemented from the convention's definition (Mikkelsen, "Simulation of Wrinkled Surfaces
 * Revisited", 2008, section 2.2) and compared with tangents that Blender computed. A corner is
 * numbered 3 * triangle + i; the edge with the same number runs from that corner to the next one of
 * its triangle. */
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

/* ---- topology ---- */

#define MIKKT_NONE UINT32_MAX

/* Loops over corners or triangles check for an interruption after this many iterations. */
enum { MIKKT_CORNERS_A_CHECK = 1 << 18 };

struct mikkt_input {
    uint32_t corner_count; /* three a triangle */
    const float (*positions)[3];
    const float (*normals)[3];
    const float (*texcoords)[2];
};

static inline uint32_t mikkt_next(uint32_t corner)
{
    return corner % 3 == 2 ? corner - 2 : corner + 1;
}
static inline uint32_t mikkt_previous(uint32_t corner)
{
    return corner % 3 == 0 ? corner + 2 : corner - 1;
}

/* Checks whether two corners coincide: the triangle then has no tangent and no place in the
 * topology. */
static inline bool mikkt_is_degenerate(const struct mikkt_input *input, uint32_t triangle)
{
    const float(*p)[3] = input->positions + 3 * (uint64_t)triangle;
    for (int i = 0; i < 3; i++) {
        const float *a = p[i], *b = p[(i + 1) % 3];
        if (a[0] == b[0] && a[1] == b[1] && a[2] == b[2])
            return true;
    }
    return false;
}

/* Sets vertices[corner] to the first corner with the same position, and the same normal and texture
 * coordinates if these are not NULL; -0 equals 0. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int bake_mikkt_weld(struct bsq_ctx *ctx, const struct mikkt_input *input, uint32_t *vertices);

/* Sets twins[edge] to the edge between the same two vertices in the opposite direction, or to
 * MIKKT_NONE. If more than two triangles meet at an edge, pairs are made in the order of edge
 * numbers. Degenerate triangles get no twins. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int bake_mikkt_find_twins(struct bsq_ctx *ctx, const struct mikkt_input *input,
                          const uint32_t *vertices, uint32_t *twins);

#endif
