/* ring_lanes.h - sums over the rings of triangles around vertices; coordinates side by side. */
#ifndef VOX_RING_LANES_H
#define VOX_RING_LANES_H

#include <math.h>

#include "libvoxel/lane_code.h"
#include "libvoxel/lanes.h"

/* What a triangle adds to the rings around its corners, in the form of struct vox_ring. */
struct ring_share {
    struct row area, moment[3];
};

LANES_INLINE void ring_share_of(const struct fmt_tris_chunk *chunk, const uint32_t v[3],
                                struct ring_share *share)
{
    struct row corner[3], edge[3];
    for (int i = 0; i < 3; i++) {
        const float *p = chunk->positions[v[i]];
        corner[i] = row_of((double)p[0], (double)p[1], (double)p[2], 0.0);
    }
    for (int i = 0; i < 3; i++)
        edge[i] = row_difference(corner[(i + 1) % 3], corner[i]);
    /* The cross product, turned around once. */
    const struct row a = edge[0], b = row_difference(corner[2], corner[0]);
    struct row area =
        row_turn(row_difference(row_product(a, row_turn(b)), row_product(row_turn(a), b)));
    struct row squares = row_product(area, area);
    double length = sqrt(row_number(squares, 0) + row_number(squares, 1) + row_number(squares, 2));
    share->area = row_with_last(area, length);
    for (int i = 0; i < 3; i++)
        share->moment[i] = row_times(length, row_difference(edge[i], edge[(i + 2) % 3]));
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
            row_add(ring->area_vector, share.area);
            row_add(ring->moment, share.moment[i]);
        }
    }
}

#endif
