/* smooth_normals.h - smooth vertex normals: sums over the one-ring of each vertex, the triangles
 * around it.
 *
 * The normal of a vertex is the direction of the weighted sum of its triangles' unit normals.
 * Facets that turn far, but little on each of two sides, make a crease, where no normal stands for
 * all of them. There the triangles are divided into two sides, each with a normal of its own. A
 * triangle's corner takes the normal that is closer to the triangle's plane, or the triangle's own
 * if both are far from it (docs/decisions/0008-normals-of-scans-without-normals.md). Sums in double
 * and in one order of triangles give the same bits however a scan is cut into chunks.
 *
 * A one-ring's sums are BSQ_RING_ROWS rows of four doubles: the weighted normals and the weights;
 * and the moment, which is three times the weight times the distance of the triangle's centroid
 * from the vertex, and an unused number. `units` has a third row: the unit normals and the number
 * of triangles. */
#ifndef BSQ_SMOOTH_NORMALS_H
#define BSQ_SMOOTH_NORMALS_H

#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "base/context.h"
#include "base/simd/simd.h"

/* Least ratio of the summed normals' length to the summed weights at a vertex that is surely no
 * crease, and on one side of a crease that has a normal. Two sheets of equal weight reach the
 * limit, the cosine of half the fold, with a fold of 60 degrees. */
#define BSQ_CREASE_SHARE 0.866
/* Least cosine of the angle between a triangle's plane and the normal of its vertex, 45 degrees. Of
 * two sheets of any weights, with a fold below this, none is a crease. */
#define BSQ_FACET_COSINE 0.70710678118654752
/* Least sum of the squared distances of unit normals from their mean if two of them are more than
 * 45 degrees apart. */
#define BSQ_CREASE_SPREAD 0.2928
/* Share of a one-ring's spread that both sides of a crease have at most: what the lengths of their
 * sums lack of their weights, beside the same of the sum of both. Noise has more. */
#define BSQ_SIDES_SHARE 0.03
/* Largest variance of the normals of a crease that has more than two sides, such as the corner of
 * a box, across the plane that fits them best. Noise has more. */
#define BSQ_SIDES_FLATNESS 0.0001

#define BSQ_PI 3.14159265358979323846

/* Rows of a one-ring's sums. */
enum { BSQ_RING_ROWS = 2 };

/* Returns the area vector of a triangle, doubled, and 0. The corners' fourth numbers must be equal.
 */
LANES_INLINE struct row bsq_doubled_vector(const struct row corner[3])
{
    const struct row a = row_difference(corner[1], corner[0]);
    const struct row b = row_difference(corner[2], corner[0]);
    /* The cross product, rotated once. */
    return row_rotate(row_difference(row_product(a, row_rotate(b)), row_product(row_rotate(a), b)));
}

/* Returns the sum of the squares of the first three numbers. */
LANES_INLINE double bsq_row_square(struct row x)
{
    const struct row squares = row_product(x, x);
    return row_number(squares, 0) + row_number(squares, 1) + row_number(squares, 2);
}

/* Returns the area vector and the area of a triangle, both doubled. The corners' fourth numbers
 * must be equal. */
LANES_INLINE struct row bsq_area_vector(const struct row corner[3])
{
    const struct row vector = bsq_doubled_vector(corner);
    return row_with_last(vector, sqrt(bsq_row_square(vector)));
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

/* Returns three times the distance of a triangle's centroid from its corner i. */
LANES_INLINE struct row bsq_centroid_of(const struct row corner[3], int i)
{
    const struct row next = row_difference(corner[(i + 1) % 3], corner[i]);
    const struct row previous = row_difference(corner[i], corner[(i + 2) % 3]);
    return row_difference(next, previous);
}

/* Returns the unit normal of an area vector and 1; zeros without an area. */
LANES_INLINE struct row bsq_unit_normal(struct row area)
{
    const double length = row_number(area, 3);
    return row_times(length > 0 ? 1.0 / length : 0.0, area);
}

/* Reads the corners of a triangle. */
LANES_INLINE void bsq_corners_of(const float (*positions)[3], const uint32_t v[3],
                                 struct row corner[3])
{
    for (int i = 0; i < 3; i++)
        corner[i] = row_of_floats(positions[v[i]]);
}

/* Triangles that are summed together: each step for all of them, so that a processor has many of
 * their square roots and divisions under way. */
enum { BSQ_FACETS = 32 };
struct bsq_facets {
    double vectors[BSQ_FACETS][4], centroids[BSQ_FACETS][3][4];
    double areas[BSQ_FACETS], inverses[BSQ_FACETS]; /* doubled; 0 without an area */
} __attribute__((aligned(64)));

LANES_INLINE void bsq_facets_of(const float (*positions)[3], const uint32_t (*triangles)[3],
                                uint32_t count, struct bsq_facets *out)
{
    for (uint32_t t = 0; t < count; t++) {
        struct row corner[3];
        bsq_corners_of(positions, triangles[t], corner);
        const struct row vector = bsq_doubled_vector(corner);
        row_store(vector, out->vectors[t]);
        out->areas[t] = bsq_row_square(vector);
        for (int i = 0; i < 3; i++)
            row_store(bsq_centroid_of(corner, i), out->centroids[t][i]);
    }
    for (uint32_t t = 0; t < count; t += LANE_COUNT) {
        const doubles area = lanes_sqrt(lanes_load(&out->areas[t]));
        lanes_store(area, &out->areas[t]);
        lanes_store(lanes_keep(lanes_less(lanes_all(0.0), area), 1.0 / area), &out->inverses[t]);
    }
}

/* Adds `count` triangles to the sums of the one-rings at their corners, whose numbers are `rings`.
 * weights: a constant, not BSQ_SCAN_NORMALS_FLAT. One-ring n begins at sums[n * BSQ_RING_ROWS]. */
LANES_INLINE void bsq_add_rings_weighted(const float (*positions)[3],
                                         const uint32_t (*triangles)[3], const uint32_t (*rings)[3],
                                         uint32_t count, enum bsq_scan_normals weights,
                                         double (*sums)[4], double (*units)[4])
{
    struct bsq_facets facets = {.areas = {0}};
    for (uint32_t t = 0; t < count; t++) {
        const uint32_t at = t % BSQ_FACETS;
        struct row factors, corner[3];
        if (at == 0)
            bsq_facets_of(positions, &triangles[t], count - t < BSQ_FACETS ? count - t : BSQ_FACETS,
                          &facets);
        const struct row area = row_with_last(row_load(facets.vectors[at]), facets.areas[at]);
        const struct row unit = row_times(facets.inverses[at], area);
        if (weights != BSQ_SCAN_NORMALS_AREA) {
            bsq_corners_of(positions, triangles[t], corner);
            factors = bsq_corner_factors(corner, facets.areas[at], weights);
        }
        for (int i = 0; i < 3; i++) {
            const uint64_t ring = rings[t][i];
            double(*to)[4] = &sums[ring * BSQ_RING_ROWS];
            const struct row normal =
                weights == BSQ_SCAN_NORMALS_AREA ? area : row_times(row_number(factors, i), area);
            row_add(to[0], normal);
            row_add(to[1], row_times(row_number(normal, 3), row_load(facets.centroids[at][i])));
            row_add(units[ring], unit);
        }
    }
}

/* Does the same with weights that need not be constant. */
LANES_INLINE void bsq_add_one_rings(const float (*positions)[3], const uint32_t (*triangles)[3],
                                    const uint32_t (*rings)[3], uint32_t count,
                                    enum bsq_scan_normals weights, double (*sums)[4],
                                    double (*units)[4])
{
    if (weights == BSQ_SCAN_NORMALS_AREA)
        bsq_add_rings_weighted(positions, triangles, rings, count, BSQ_SCAN_NORMALS_AREA, sums,
                               units);
    else if (weights == BSQ_SCAN_NORMALS_MAX)
        bsq_add_rings_weighted(positions, triangles, rings, count, BSQ_SCAN_NORMALS_MAX, sums,
                               units);
    else
        bsq_add_rings_weighted(positions, triangles, rings, count, BSQ_SCAN_NORMALS_ANGLE, sums,
                               units);
}

/* Returns whether one normal stands for triangles. length: of their summed normals; weight: their
 * summed weights. */
static inline bool bsq_is_smooth(double length, double weight)
{
    return length > 0 && length >= BSQ_CREASE_SHARE * weight;
}

/* ---- creases ----
 *
 * One-rings that may be creases (bsq_may_fold()) are numbered from 1 on; all others have number 0
 * in `crease_of`. Then bsq_find_farthest() looks at all triangles, and bsq_divide_ring() finds
 * which one-rings fold: the others get number 0. bsq_add_sides() adds all triangles again, to
 * `firsts` and `seconds` at the number of the crease, and bsq_is_crease() decides. Sides are
 * weighted by angle, whatever the weights of the sums: where a surface ends, areas depend on how
 * its last quads are cut. For the covariance of the whole one-ring, the rows of `spreads` sum its
 * weighted normals times their x, and times their y.
 *
 * A crease begins as {0, 0, 0, INFINITY}. It becomes the unit normal of the triangle farthest from
 * the summed normal, and its dot product with that; then a direction of the second side's
 * normals. */

static inline double bsq_row_dot(const double a[4], const double b[4])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Returns whether two triangles may be more than 45 degrees apart. units: sums of unit normals, and
 * their number. */
static inline bool bsq_may_fold(const double units[4])
{
    return bsq_row_dot(units, units) < (units[3] - BSQ_CREASE_SPREAD) * units[3];
}

/* Reads the corners of a triangle. Returns false if none of them is at a crease. */
LANES_INLINE bool bsq_crease_corners(const float (*positions)[3], const uint32_t v[3],
                                     const uint32_t rings[3], const uint32_t *crease_of,
                                     struct row corner[3])
{
    if ((crease_of[rings[0]] | crease_of[rings[1]] | crease_of[rings[2]]) == 0)
        return false;
    bsq_corners_of(positions, v, corner);
    return true;
}

/* Finds the farthest triangles among the first `count`. */
LANES_INLINE void bsq_find_farthest(const float (*positions)[3], const uint32_t (*triangles)[3],
                                    const uint32_t (*rings)[3], uint32_t count,
                                    const uint32_t *crease_of, const double (*sums)[4],
                                    double (*creases)[4])
{
    for (uint32_t t = 0; t < count; t++) {
        struct row corner[3];
        double normal[4];
        if (!bsq_crease_corners(positions, triangles[t], rings[t], crease_of, corner))
            continue;
        row_store(bsq_unit_normal(bsq_area_vector(corner)), normal);
        for (int i = 0; i < 3 && normal[3] > 0; i++) {
            const uint32_t ring = rings[t][i];
            double *crease = creases[crease_of[ring]];
            const double dot = bsq_row_dot(normal, sums[(uint64_t)ring * BSQ_RING_ROWS]);
            if (crease_of[ring] == 0 || dot >= crease[3])
                continue;
            memcpy(crease, normal, 3 * sizeof *crease);
            crease[3] = dot;
        }
    }
}

/* Decides whether a one-ring folds, so that it is divided. Normals of the second side are closer to
 * the farthest triangle's than to the part of the summed normal at right angles to it. */
static inline bool bsq_divide_ring(const double total[4], double crease[4])
{
    const double length = sqrt(bsq_row_dot(total, total));
    double along[4] = {0};
    if (!isfinite(crease[3]) ||
        (bsq_is_smooth(length, total[3]) && crease[3] >= BSQ_FACET_COSINE * length))
        return false;
    for (int k = 0; k < 3; k++)
        along[k] = total[k] - crease[3] * crease[k];
    const double size = sqrt(bsq_row_dot(along, along));
    for (int k = 0; k < 3 && size > 1e-6 * total[3]; k++)
        crease[k] -= along[k] / size;
    return true;
}

/* Adds the first `count` triangles to the sides of creases. */
LANES_INLINE void bsq_add_sides(const float (*positions)[3], const uint32_t (*triangles)[3],
                                const uint32_t (*rings)[3], uint32_t count,
                                const uint32_t *crease_of, const double (*creases)[4],
                                double (*firsts)[4], double (*seconds)[4], double (*spreads)[4])
{
    for (uint32_t t = 0; t < count; t++) {
        struct row corner[3];
        double normal[4];
        if (!bsq_crease_corners(positions, triangles[t], rings[t], crease_of, corner))
            continue;
        const struct row area = bsq_area_vector(corner), unit = bsq_unit_normal(area);
        const struct row factors =
            bsq_corner_factors(corner, row_number(area, 3), BSQ_SCAN_NORMALS_ANGLE);
        row_store(area, normal);
        for (int i = 0; i < 3; i++) {
            const uint64_t crease = crease_of[rings[t][i]], at = crease * BSQ_RING_ROWS;
            const struct row weighted = row_times(row_number(factors, i), area);
            if (crease == 0)
                continue;
            double(*side)[4] =
                bsq_row_dot(normal, creases[crease]) > 0 ? &seconds[at] : &firsts[at];
            row_add(side[0], weighted);
            row_add(side[1], row_times(row_number(weighted, 3), bsq_centroid_of(corner, i)));
            row_add(spreads[at], row_times(row_number(weighted, 0), unit));
            row_add(spreads[at + 1], row_times(row_number(weighted, 1), unit));
        }
    }
}

/* Decides whether a divided one-ring is a crease: the normals of each side are close to each other
 * beside the fold, or all normals are close to a plane, as three directions are, and those of a
 * cylinder's rim. The normals of noise scatter in all directions. */
static inline bool bsq_is_crease(const double a[4], const double b[4], const double (*spreads)[4])
{
    const double *x = spreads[0], *y = spreads[1];
    const double weight = a[3] + b[3],
                 mean[4] = {(a[0] + b[0]) / weight, (a[1] + b[1]) / weight, (a[2] + b[2]) / weight};
    const double within = weight - sqrt(bsq_row_dot(a, a)) - sqrt(bsq_row_dot(b, b));
    if (within < BSQ_SIDES_SHARE * weight * (1.0 - sqrt(bsq_row_dot(mean, mean))))
        return true;
    const double xx = x[0] / weight - mean[0] * mean[0], xy = x[1] / weight - mean[0] * mean[1],
                 xz = x[2] / weight - mean[0] * mean[2], yy = y[1] / weight - mean[1] * mean[1],
                 yz = y[2] / weight - mean[1] * mean[2],
                 zz = 1.0 - (x[0] + y[1]) / weight - mean[2] * mean[2];
    const double minors[3] = {yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy};
    const double determinant = xx * minors[0] - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
    /* The least eigenvalue of the covariance, if the others are much larger. */
    return determinant <= BSQ_SIDES_FLATNESS * (minors[0] + minors[1] + minors[2]);
}

#endif
