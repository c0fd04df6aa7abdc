/* one_ring_lanes.c - sums over the one-rings of vertices, and the normals that follow from them. */
#define SIMD_FLOATS LANE_COUNT
#include "libvoxel/voxelize/cache/smooth_normals.h"

#include <math.h>

void BSQ_SIMD_NAME(vox_add_one_rings)(const struct fmt_tris_chunk *chunk, uint32_t begin,
                                      uint32_t end, const uint32_t *ring_of,
                                      enum bsq_scan_normals weights, double (*rings)[4])
{
    bsq_add_one_rings(chunk->positions, chunk->triangles, begin, end, ring_of, weights,
                      VOX_RING_PARTS, rings);
}

void BSQ_SIMD_NAME(vox_divide_one_rings)(const struct fmt_tris_chunk *chunk, uint32_t begin,
                                         uint32_t end, const uint32_t *ring_of, bool sides,
                                         double (*rings)[4], const struct vox_creases *creases)
{
    const double(*found)[4] = (const double(*)[4])creases->creases;
    if (sides)
        bsq_add_sides(chunk->positions, chunk->triangles, begin, end, ring_of, creases->crease_of,
                      VOX_RING_PARTS, found, rings, creases->seconds);
    else
        bsq_find_farthest(chunk->positions, chunk->triangles, begin, end, ring_of,
                          creases->crease_of, VOX_RING_PARTS, (const double(*)[4])rings,
                          creases->creases);
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
LANES_INLINE void ring_finish(const double *const normals[LANE_COUNT],
                              const double *const moments[LANE_COUNT], double h, doubles normal[4])
{
    doubles n[4], m[4];
    lanes_gather_four(normals, n);
    lanes_gather_four(moments, m);
    doubles length = lanes_sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), weight = n[3];
    lane_mask smooth = bsq_are_smooth(length, weight);
    doubles height = (n[0] * m[0] + n[1] * m[1] + n[2] * m[2]) / (3.0 * length * weight);
    const doubles by_length = 1.0 / length;
    for (int k = 0; k < 3; k++)
        normal[k] = lanes_keep(smooth, n[k] * by_length);
    normal[3] = ring_rounded(lanes_keep(smooth, RISE_SHARE * height)) / h;
}

void BSQ_SIMD_NAME(vox_finish_one_rings)(const double (*rings)[4], const uint32_t *ring_of,
                                         uint32_t count, double h, float (*normals)[4])
{
    for (uint32_t done = 0; done < count; done += LANE_COUNT) {
        const double *sums[LANE_COUNT], *moments[LANE_COUNT];
        double rows[LANE_COUNT][4], *to[LANE_COUNT];
        doubles normal[4];
        for (uint32_t l = 0; l < LANE_COUNT; l++) {
            const uint64_t ring = ring_of[done + l < count ? done + l : done];
            sums[l] = rings[ring * VOX_RING_ROWS];
            moments[l] = rings[ring * VOX_RING_ROWS + 1];
            to[l] = rows[l];
        }
        ring_finish(sums, moments, h, normal);
        lanes_scatter(normal, to);
        for (uint32_t l = 0; l < LANE_COUNT && done + l < count; l++)
            for (int k = 0; k < 4; k++)
                normals[done + l][k] = (float)rows[l][k];
    }
}
