/* mikkt_topology.h - which corners are one vertex, and which edges lie side by side.
 *
 * A corner is numbered 3 * triangle + i. The edge with the same number runs from that corner to the
 * next one of its triangle. */
#ifndef BAKE_LOWPOLY_MIKKT_TOPOLOGY_H
#define BAKE_LOWPOLY_MIKKT_TOPOLOGY_H

#include "base/context.h"

#define MIKKT_NONE UINT32_MAX

/* Loops over corners or triangles look for an interruption once in so many. */
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

/* Two corners in one place: such a triangle has no tangent and takes no part in the topology. */
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

/* vertices[corner] = the first corner with equal position, normal and texture coordinates (as
 * numbers: -0 equals 0). */
int bake_mikkt_weld(struct bsq_ctx *ctx, const struct mikkt_input *input, uint32_t *vertices);

/* twins[edge] = the edge between the same two vertices in the opposite direction, MIKKT_NONE where
 * there is none. Where more than two triangles meet, edges are paired in the order of their
 * numbers. Degenerate triangles get no twins. */
int bake_mikkt_find_twins(struct bsq_ctx *ctx, const struct mikkt_input *input,
                          const uint32_t *vertices, uint32_t *twins);

#endif
