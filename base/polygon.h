/* polygon.h - splits a polygon into triangles. */
#ifndef BSQ_POLYGON_H
#define BSQ_POLYGON_H

#include <stdint.h>

/* Splits a planar or nearly planar simple polygon, convex or concave, of n >= 3 corners into n - 2
 * triangles. Clips ears on its projection along the Newell normal (Eberly, "Triangulation by Ear
 * Clipping", 2002). positions: n triples. triangles: capacity for 3 * (n - 2) corner numbers in [0,
 * n); the winding is the polygon's. scratch: capacity for 2 * n uint32_t. Always gives n - 2
 * triangles, also for degenerate or self-intersecting polygons, whose triangles may have any shape.
 * Quads and convex polygons take O(n). */
void bsq_triangulate(const double (*positions)[3], uint32_t n, uint32_t *triangles,
                     uint32_t *scratch);

#endif
