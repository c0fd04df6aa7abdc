/* smooth_normals.h - smooth vertex normals: sums over the one-ring of each vertex, the triangles
 * around it.
 *
 * The normal of a vertex is the direction of the weighted sum of its triangles' unit normals.
 * Neighbouring facets that turn too far make a crease, where no normal stands for all of them. Sums
 * in double and in one order of triangles give the same bits however a scan is cut into chunks.
 *
 * A one-ring's sums are rows of four doubles: the weighted normals and the weights; then, if there
 * is a second row, the moment. That is three times the weight times the distance of the triangle's
 * centroid from the vertex, and an unused number. */
#ifndef BSQ_SMOOTH_NORMALS_H
#define BSQ_SMOOTH_NORMALS_H

#include <stdbool.h>

#include "base/context.h"
#include "base/simd/simd.h"

/* Least ratio of the summed normals' length to the summed weights at a vertex that has a smooth
 * normal. At a crease, below it, triangles keep their own normals. Two sheets of equal weight reach
 * the limit, the cosine of half the fold, with a fold of 60 degrees. Both stages use it, so that
 * maps from voxels agree with exact maps. */
#define BSQ_CREASE_SHARE 0.866

#define BSQ_PI 3.14159265358979323846

/* Returns the area vector and the area of a triangle, both doubled. The corners' fourth numbers
 * must be equal. */
LANES_INLINE struct row bsq_area_vector(const struct row corner[3])
{
    const struct row a = row_difference(corner[1], corner[0]);
    const struct row b = row_difference(corner[2], corner[0]);
    /* The cross product, rotated once. */
    struct row vector =
        row_rotate(row_difference(row_product(a, row_rotate(b)), row_product(row_rotate(a), b)));
    struct row squares = row_product(vector, vector);
    double length = sqrt(row_number(squares, 0) + row_number(squares, 1) + row_number(squares, 2));
    return row_with_last(vector, length);
}

/* Returns the angles whose opposite and adjacent sides in a right triangle have the ratio
 * across / along; `along` may be negative. `across` must be positive. Within 1e-11; the same bits
 * on every processor, unlike the system's functions. */
LANES_INLINE struct row bsq_angles(double across, struct row along)
{
    /* Halved twice, the angle of |along| is below 22.5 degrees, where the series of the arc tangent
     * ends soon. */
    enum { LAST = 23 };
    const struct row one = row_of(1.0, 1.0, 1.0, 1.0), y = row_times(across, one);
    const struct row x = row_max(along, row_times(-1.0, along));
    struct row half =
        row_quotient(y, row_sum(x, row_sqrt(row_sum(row_product(x, x), row_product(y, y)))));
    struct row t =
        row_quotient(half, row_sum(one, row_sqrt(row_sum(one, row_product(half, half)))));
    const struct row square = row_product(t, t);
    struct row sum = row_times(-1.0 / LAST, one);
    for (int n = LAST - 2; n > 0; n -= 2)
        sum = row_sum(row_times((n & 2 ? -1.0 : 1.0) / n, one), row_product(square, sum));
    sum = row_times(4.0, row_product(t, sum));
    for (int i = 0; i < 4; i++)
        sum = row_number(along, i) < 0 ? row_with(sum, i, BSQ_PI - row_number(sum, i)) : sum;
    return sum;
}

/* Returns the factors by which the area vector of a triangle, doubled, counts at its corners; the
 * fourth number is arbitrary. weights: not BSQ_SCAN_NORMALS_FLAT. Zero if the triangle has no area.
 */
LANES_INLINE struct row bsq_corner_factors(const struct row corner[3], double doubled_area,
                                           enum bsq_scan_normals weights)
{
    double square[3], along[3];
    if (weights == BSQ_SCAN_NORMALS_AREA || !(doubled_area > 0))
        return weights == BSQ_SCAN_NORMALS_AREA ? row_of(1.0, 1.0, 1.0, 1.0)
                                                : row_of(0.0, 0.0, 0.0, 0.0);
    for (int i = 0; i < 3; i++) {
        const struct row next = row_difference(corner[(i + 1) % 3], corner[i]);
        const struct row previous = row_difference(corner[(i + 2) % 3], corner[i]);
        const struct row squares = row_product(next, next), dots = row_product(next, previous);
        square[i] = row_number(squares, 0) + row_number(squares, 1) + row_number(squares, 2);
        along[i] = row_number(dots, 0) + row_number(dots, 1) + row_number(dots, 2);
    }
    if (weights == BSQ_SCAN_NORMALS_MAX)
        return row_quotient(
            row_of(1.0, 1.0, 1.0, 1.0),
            row_of(square[0] * square[2], square[1] * square[0], square[2] * square[1], 1.0));
    return row_times(1.0 / doubled_area,
                     bsq_angles(doubled_area, row_of(along[0], along[1], along[2], 0.0)));
}

/* Adds the triangles from `begin` to `end` to the sums of their corners' one-rings. ring_of: the
 * number of each vertex's one-ring. The sums of number 0 are not meant to be used; triangles whose
 * corners all have number 0 are skipped. weights: a constant, not BSQ_SCAN_NORMALS_FLAT. rows: 1,
 * or 2 with the moment. One-ring n begins at sums[n * rows]. */
LANES_INLINE void bsq_add_rings_weighted(const float (*positions)[3],
                                         const uint32_t (*triangles)[3], uint32_t begin,
                                         uint32_t end, const uint32_t *ring_of,
                                         enum bsq_scan_normals weights, int rows, double (*sums)[4])
{
    for (uint32_t t = begin; t < end; t++) {
        const uint32_t *v = triangles[t];
        struct row corner[3];
        if ((ring_of[v[0]] | ring_of[v[1]] | ring_of[v[2]]) == 0)
            continue;
        for (int i = 0; i < 3; i++)
            corner[i] = row_of_floats(positions[v[i]]);
        const struct row area = bsq_area_vector(corner);
        const struct row factors = bsq_corner_factors(corner, row_number(area, 3), weights);
        for (int i = 0; i < 3; i++) {
            double(*ring)[4] = &sums[(uint64_t)ring_of[v[i]] * (uint64_t)rows];
            const struct row normal =
                weights == BSQ_SCAN_NORMALS_AREA ? area : row_times(row_number(factors, i), area);
            row_add(ring[0], normal);
            if (rows == 2) {
                struct row next = row_difference(corner[(i + 1) % 3], corner[i]);
                struct row previous = row_difference(corner[i], corner[(i + 2) % 3]);
                row_add(ring[1], row_times(row_number(normal, 3), row_difference(next, previous)));
            }
        }
    }
}

/* Does the same with weights that need not be constant. */
LANES_INLINE void bsq_add_one_rings(const float (*positions)[3], const uint32_t (*triangles)[3],
                                    uint32_t begin, uint32_t end, const uint32_t *ring_of,
                                    enum bsq_scan_normals weights, int rows, double (*sums)[4])
{
    if (weights == BSQ_SCAN_NORMALS_AREA)
        bsq_add_rings_weighted(positions, triangles, begin, end, ring_of, BSQ_SCAN_NORMALS_AREA,
                               rows, sums);
    else if (weights == BSQ_SCAN_NORMALS_MAX)
        bsq_add_rings_weighted(positions, triangles, begin, end, ring_of, BSQ_SCAN_NORMALS_MAX,
                               rows, sums);
    else
        bsq_add_rings_weighted(positions, triangles, begin, end, ring_of, BSQ_SCAN_NORMALS_ANGLE,
                               rows, sums);
}

/* Returns whether a vertex has a normal. length: of its summed normals; weight: its summed weights.
 */
static inline bool bsq_is_smooth(double length, double weight)
{
    return length > 0 && length >= BSQ_CREASE_SHARE * weight;
}

/* Returns the same for several vertices. */
LANES_INLINE lane_mask bsq_are_smooth(doubles length, doubles weight)
{
    return lanes_less(lanes_all(0.0), length) & ~lanes_less(length, BSQ_CREASE_SHARE * weight);
}

#endif
