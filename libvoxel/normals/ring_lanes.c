/* ring_lanes.c - sums over the one-rings of vertices, and the normals that follow from them. */
#define SIMD_FLOATS LANE_COUNT
#include "libvoxel/normals/rings.h"

#include "base/geometry/vertex_normal.h"

void BSQ_SIMD_NAME(vox_rings_add)(const struct vox_rings *r, enum vox_ring_step step,
                                  enum bsq_scan_normals weights, const float (*positions)[3],
                                  const uint32_t (*triangles)[3], const uint32_t (*of)[3],
                                  uint32_t count)
{
    if (step == VOX_RING_SUM)
        bsq_add_one_rings(positions, triangles, of, count, weights, r->sums, r->units);
    else if (step == VOX_RING_FARTHEST)
        bsq_find_farthest(positions, triangles, of, count, r->crease_of,
                          (const double(*)[4])r->sums, r->creases);
    else
        bsq_add_sides(positions, triangles, of, count, r->crease_of, (const double(*)[4])r->creases,
                      r->firsts, r->seconds, r->spreads);
}

/* Share of the height of a one-ring's centroid above its vertex, by which the surface rises
 * (docs/decisions/0009-when-vertex-normals-count.md). */
#define RISE_SHARE (9.0 / 8.0)
/* Share of the weights that the length of summed normals must have: less is rounding. */
#define LEAST_LENGTH 1e-6

/* Returns |a| with the sign of b. */
LANES_INLINE doubles ring_with_sign(doubles a, doubles b)
{
    return (doubles)(((lane_ints)a & INT64_MAX) | ((lane_ints)b & INT64_MIN));
}

/* Returns the bits of a coordinate of the unfolded octahedron. */
LANES_INLINE lane_ints ring_code(doubles coordinate)
{
    const double zero = 1 << (BSQ_VERTEX_NORMAL_BITS - 1);
    return lanes_integer_bits(coordinate * (zero - 1.0) + zero) &
           ((1 << BSQ_VERTEX_NORMAL_BITS) - 1);
}

/* Returns the bits of a rise, rounded. */
LANES_INLINE lane_ints ring_rise_code(doubles rise)
{
    const lane_mask fits = lanes_less(lanes_abs(rise), lanes_all(0x1p127));
    const float_ints bits = (float_ints) __builtin_convertvector(lanes_keep(fits, rise), floats);
    const lane_ints wide = __builtin_convertvector(bits, lane_ints) & UINT32_MAX;
    return (wide + ((1 << 11) - 1) + (wide >> 12 & 1)) >> 12 << BSQ_VERTEX_RISE_SHIFT;
}

/* Packs directions and rises. */
LANES_INLINE lane_ints ring_encode(const doubles n[3], doubles rise)
{
    const doubles sum = 1.0 / (lanes_abs(n[0]) + lanes_abs(n[1]) + lanes_abs(n[2]));
    const doubles x = n[0] * sum, y = n[1] * sum;
    const lane_mask below = lanes_less(n[2], lanes_all(0.0));
    const doubles u = lanes_select(below, ring_with_sign(1.0 - lanes_abs(y), x), x);
    const doubles v = lanes_select(below, ring_with_sign(1.0 - lanes_abs(x), y), y);
    return ring_code(u) | ring_code(v) << BSQ_VERTEX_NORMAL_BITS | ring_rise_code(rise);
}

void BSQ_SIMD_NAME(vox_rings_pack)(const double (*rings)[4], const uint32_t *ring_of,
                                   uint32_t count, uint64_t *normals)
{
    for (uint32_t done = 0; done < count; done += LANE_COUNT) {
        const double *sums[LANE_COUNT], *moments[LANE_COUNT];
        doubles n[4], m[4];
        long long packed[LANE_COUNT];
        for (uint32_t l = 0; l < LANE_COUNT; l++) {
            const uint64_t ring = ring_of[done + l < count ? done + l : done];
            sums[l] = rings[ring * BSQ_RING_ROWS];
            moments[l] = rings[ring * BSQ_RING_ROWS + 1];
        }
        lanes_gather_four(sums, n);
        lanes_gather_four(moments, m);
        const doubles length = lanes_sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), weight = n[3];
        const lane_mask smooth = lanes_less(LEAST_LENGTH * weight, length);
        const doubles height = (n[0] * m[0] + n[1] * m[1] + n[2] * m[2]) / (3.0 * length * weight);
        const lane_ints code = ring_encode(n, RISE_SHARE * height);
        lanes_store_ints((lane_ints)lanes_keep(smooth, (doubles)code), packed);
        for (uint32_t l = 0; l < LANE_COUNT && done + l < count; l++)
            normals[done + l] = (uint64_t)packed[l];
    }
}
