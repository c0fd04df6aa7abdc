/* smooth_normals.h - smooth vertex normals: sums over the one-ring of each vertex, the triangles
 * around it.
 *
 * The normal of a vertex is the direction of the sum of its triangles' area vectors. Neighbouring
 * facets that turn too far make a crease, where no normal stands for all of them. Sums in double
 * and in one order of triangles give the same bits however a scan is cut into chunks.
 *
 * A one-ring's sums are rows of four doubles: the area vectors and the areas, both doubled; then,
 * if there is a second row, the moment. That is three times the area times the distance of the
 * triangle's centroid from the vertex, and an unused number. */
#ifndef BSQ_SMOOTH_NORMALS_H
#define BSQ_SMOOTH_NORMALS_H

#include <stdbool.h>

#include "base/simd/simd.h"

/* Least ratio of the summed area vectors' length to the summed areas at a vertex that has a smooth
 * normal. At a crease, below it, triangles keep their own normals. Two sheets of equal area reach
 * the limit, the cosine of half the fold, with a fold of 60 degrees. Both stages use it, so that
 * maps from voxels agree with exact maps. */
#define BSQ_CREASE_SHARE 0.866

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

/* Adds the triangles from `begin` to `end` to the sums of their corners' one-rings. ring_of: the
 * number of each vertex's one-ring. The sums of number 0 are not meant to be used; triangles whose
 * corners all have number 0 are skipped. rows: 1, or 2 with the moment. One-ring n begins at sums[n
 * * rows]. */
LANES_INLINE void bsq_add_one_rings(const float (*positions)[3], const uint32_t (*triangles)[3],
                                    uint32_t begin, uint32_t end, const uint32_t *ring_of, int rows,
                                    double (*sums)[4])
{
    for (uint32_t t = begin; t < end; t++) {
        const uint32_t *v = triangles[t];
        struct row corner[3];
        if ((ring_of[v[0]] | ring_of[v[1]] | ring_of[v[2]]) == 0)
            continue;
        for (int i = 0; i < 3; i++)
            corner[i] = row_of_floats(positions[v[i]]);
        struct row area = bsq_area_vector(corner);
        for (int i = 0; i < 3; i++) {
            double(*ring)[4] = &sums[(uint64_t)ring_of[v[i]] * (uint64_t)rows];
            row_add(ring[0], area);
            if (rows == 2) {
                struct row next = row_difference(corner[(i + 1) % 3], corner[i]);
                struct row previous = row_difference(corner[i], corner[(i + 2) % 3]);
                row_add(ring[1], row_times(row_number(area, 3), row_difference(next, previous)));
            }
        }
    }
}

/* Returns whether a vertex has a normal. length: of its summed area vector; area: its summed areas.
 */
static inline bool bsq_is_smooth(double length, double area)
{
    return length > 0 && length >= BSQ_CREASE_SHARE * area;
}

/* Returns the same for several vertices. */
LANES_INLINE lane_mask bsq_are_smooth(doubles length, doubles area)
{
    return lanes_less(lanes_all(0.0), length) & ~lanes_less(length, BSQ_CREASE_SHARE * area);
}

#endif
