/* one_ring_lanes.c - sums over the one-rings of vertices, and the normals that follow from them. */
#define SIMD_FLOATS LANE_COUNT
#include "libvoxel/voxelize/cache/smooth_normals.h"

#include <math.h>

void BSQ_SIMD_NAME(vox_add_one_rings)(const struct fmt_tris_chunk *chunk, uint32_t begin,
                                      uint32_t end, const uint32_t *ring_of,
                                      enum bsq_scan_normals weights, struct vox_one_ring *rings)
{
    bsq_add_one_rings(chunk->positions, chunk->triangles, begin, end, ring_of, weights, 3,
                      (double(*)[4])(void *)rings);
}

void BSQ_SIMD_NAME(vox_divide_one_rings)(const struct fmt_tris_chunk *chunk, uint32_t begin,
                                         uint32_t end, const uint32_t *ring_of, bool sides,
                                         struct vox_one_ring *rings,
                                         const struct vox_creases *creases)
{
    double(*sums)[4] = (double(*)[4])(void *)rings;
    if (sides)
        bsq_add_sides(chunk->positions, chunk->triangles, begin, end, ring_of, creases->crease_of,
                      3, (const double(*)[4])creases->creases, sums,
                      (double(*)[4])(void *)creases->seconds);
    else
        bsq_find_farthest(chunk->positions, chunk->triangles, begin, end, ring_of,
                          creases->crease_of, 3, (const double(*)[4])sums, creases->creases);
}

/* Share of the height of a one-ring's centroid above its vertex, by which the surface rises
 * (docs/decisions/0009-when-vertex-normals-count.md). */
#define RISE_SHARE (9.0 / 8.0)

/* Rounds to float. */
LANES_INLINE doubles ring_rounded(doubles x)
{
    return __builtin_convertvector(__builtin_convertvector(x, floats), doubles);
}

/* Computes normals, and the surface's heights above the vertices. Returns which may be creases. */
LANES_INLINE lane_mask ring_finish(const struct vox_one_ring *const from[LANE_COUNT], double h,
                                   doubles normal[4])
{
    const double *row[3][LANE_COUNT];
    doubles n[4], u[4], m[4];
    for (int l = 0; l < LANE_COUNT; l++) {
        row[0][l] = from[l]->normal;
        row[1][l] = from[l]->units;
        row[2][l] = from[l]->moment;
    }
    lanes_gather_four(row[0], n);
    lanes_gather_four(row[1], u);
    lanes_gather_four(row[2], m);
    doubles length = lanes_sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), weight = n[3];
    lane_mask smooth = bsq_are_smooth(length, weight);
    doubles height = (n[0] * m[0] + n[1] * m[1] + n[2] * m[2]) / (3.0 * length * weight);
    for (int k = 0; k < 3; k++)
        normal[k] = lanes_keep(smooth, n[k] / length);
    normal[3] = ring_rounded(lanes_keep(smooth, RISE_SHARE * height)) / h;
    return lanes_less(u[0] * u[0] + u[1] * u[1] + u[2] * u[2], (u[3] - BSQ_CREASE_SPREAD) * u[3]);
}

void BSQ_SIMD_NAME(vox_finish_one_rings)(const struct vox_one_ring *rings, const uint32_t *ring_of,
                                         uint32_t count, double h, float (*normals)[4],
                                         struct vox_creases *creases)
{
    creases->vertex_count = 0;
    for (uint32_t done = 0; done < count; done += LANE_COUNT) {
        const struct vox_one_ring *from[LANE_COUNT];
        double rows[LANE_COUNT][4], *to[LANE_COUNT];
        doubles normal[4];
        for (uint32_t l = 0; l < LANE_COUNT; l++) {
            from[l] = &rings[ring_of[done + l < count ? done + l : done]];
            to[l] = rows[l];
        }
        const uint32_t may_fold = lanes_bits(ring_finish(from, h, normal));
        lanes_scatter(normal, to);
        for (uint32_t l = 0; l < LANE_COUNT && done + l < count; l++)
            for (int k = 0; k < 4; k++)
                normals[done + l][k] = (float)rows[l][k];
        for (uint32_t l = 0; may_fold && l < LANE_COUNT && done + l < count; l++)
            if (may_fold >> l & 1)
                creases->vertices[creases->vertex_count++] = done + l;
    }
}
