/* ring_lanes.h - sums over the rings of triangles around vertices; coordinates side by side. */
#ifndef VOX_RING_LANES_H
#define VOX_RING_LANES_H

#include <math.h>

#include "libvoxel/lane_code.h"

typedef double ring_four __attribute__((vector_size(32), aligned(8), may_alias));
typedef float ring_floats __attribute__((vector_size(16)));

/* The coordinates with these numbers. */
#define RING_TURN(x, i, j, k) __builtin_shufflevector(x, x, i, j, k, 3)

/* What a triangle adds to the rings around its corners, in the form of struct vox_ring. */
struct ring_share {
    ring_four area, moment[3];
};

static inline __attribute__((always_inline)) void
ring_share_of(const struct fmt_tris_chunk *chunk, const uint32_t v[3], struct ring_share *share)
{
    ring_four corner[3], edge[3];
    for (int i = 0; i < 3; i++) {
        const float *p = chunk->positions[v[i]];
        const ring_floats floats = {p[0], p[1], p[2], 0.0f};
        corner[i] = __builtin_convertvector(floats, ring_four);
    }
    for (int i = 0; i < 3; i++)
        edge[i] = corner[(i + 1) % 3] - corner[i];
    const ring_four a = edge[0], b = -edge[2];
    ring_four area = RING_TURN(a, 1, 2, 0) * RING_TURN(b, 2, 0, 1) -
                     RING_TURN(a, 2, 0, 1) * RING_TURN(b, 1, 2, 0);
    ring_four squares = area * area;
    double length = sqrt(squares[0] + squares[1] + squares[2]);
    area[3] = length;
    share->area = area;
    for (int i = 0; i < 3; i++)
        share->moment[i] = length * (edge[i] - edge[(i + 2) % 3]);
}

static void add_rings(const struct fmt_tris_chunk *chunk, const uint32_t *ring_of,
                      struct vox_ring *rings)
{
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        const uint32_t *v = chunk->triangles[t];
        if ((ring_of[v[0]] | ring_of[v[1]] | ring_of[v[2]]) == 0)
            continue;
        struct ring_share share;
        ring_share_of(chunk, v, &share);
        for (int i = 0; i < 3; i++) {
            struct vox_ring *ring = &rings[ring_of[v[i]]];
            *(ring_four *)ring->area_vector += share.area;
            *(ring_four *)ring->moment += share.moment[i];
        }
    }
}

#endif
