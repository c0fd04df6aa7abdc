/* one_ring_lanes.c - sums over the one-rings of vertices, and the normals that follow from them. */
#define SIMD_FLOATS LANE_COUNT
#include "libvoxel/voxelize/cache/smooth_normals.h"

#include <math.h>

void BSQ_SIMD_NAME(vox_add_one_rings)(const struct fmt_tris_chunk *chunk, uint32_t begin,
                                      uint32_t end, const uint32_t *ring_of,
                                      enum bsq_scan_normals weights, struct vox_one_ring *rings)
{
    bsq_add_one_rings(chunk->positions, chunk->triangles, begin, end, ring_of, weights, 2,
                      (double(*)[4])(void *)rings);
}

/* Share of the height of a one-ring's centroid above its vertex, by which the surface rises
 * (docs/decisions/0009-when-vertex-normals-count.md). */
#define RISE_SHARE (9.0 / 8.0)

/* Rounds to float. */
LANES_INLINE doubles ring_rounded(doubles x)
{
    return __builtin_convertvector(__builtin_convertvector(x, floats), doubles);
}

/* Computes normals, and the surface's heights above the vertices. */
LANES_INLINE void ring_finish(const struct vox_one_ring *const from[LANE_COUNT], double h,
                              doubles normal[4])
{
    const double *half[2][LANE_COUNT];
    doubles n[4], m[4];
    for (int l = 0; l < LANE_COUNT; l++) {
        half[0][l] = from[l]->normal;
        half[1][l] = from[l]->moment;
    }
    lanes_gather_four(half[0], n);
    lanes_gather_four(half[1], m);
    doubles length = lanes_sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), weight = n[3];
    lane_mask smooth = bsq_are_smooth(length, weight);
    doubles height = (n[0] * m[0] + n[1] * m[1] + n[2] * m[2]) / (3.0 * length * weight);
    for (int k = 0; k < 3; k++)
        normal[k] = lanes_keep(smooth, n[k] / length);
    normal[3] = ring_rounded(lanes_keep(smooth, RISE_SHARE * height)) / h;
}

void BSQ_SIMD_NAME(vox_finish_one_rings)(const struct vox_one_ring *rings, const uint32_t *ring_of,
                                         uint32_t count, double h, float (*normals)[4])
{
    for (uint32_t done = 0; done < count; done += LANE_COUNT) {
        const struct vox_one_ring *from[LANE_COUNT];
        double rows[LANE_COUNT][4], *to[LANE_COUNT];
        doubles normal[4];
        for (uint32_t l = 0; l < LANE_COUNT; l++) {
            from[l] = &rings[ring_of[done + l < count ? done + l : done]];
            to[l] = rows[l];
        }
        ring_finish(from, h, normal);
        lanes_scatter(normal, to);
        for (uint32_t l = 0; l < LANE_COUNT && done + l < count; l++)
            for (int k = 0; k < 4; k++)
                normals[done + l][k] = (float)rows[l][k];
    }
}
