/* polygon.h - splits a polygon into triangles. */
#ifndef BSQ_POLYGON_H
#define BSQ_POLYGON_H

#include "base/context.h"

/* Returns bsq_check() for one of 65536 corners, else 0: a polygon may be as large as a scan, and
 * loops over its corners take little time for each. */
static inline int bsq_check_corner(struct bsq_ctx *ctx, uint32_t corner)
{
    return corner % 65536 == 65535 ? bsq_check(ctx) : 0;
}

/* Returns the bytes of scratch memory that bsq_triangulate() needs for n corners; 0 for few. */
uint64_t bsq_triangulate_scratch(uint32_t n);

/* Splits a planar or nearly planar simple polygon, convex or concave, of n >= 3 corners into n - 2
 * triangles. Clips ears on its projection along the Newell normal (Eberly, "Triangulation by Ear
 * Clipping", 2002). positions: n triples. triangles: capacity for 3 * (n - 2) corner numbers in [0,
 * n); the winding is the polygon's. scratch: aligned to 8 bytes. Always gives n - 2 triangles, also
 * for degenerate or self-intersecting polygons, whose triangles may have any shape. Quads and
 * convex polygons take O(n), others up to O(n^2). Errors: BSQ_EINTR.
 */
int bsq_triangulate(struct bsq_ctx *ctx, const double (*positions)[3], uint32_t n,
                    uint32_t *triangles, void *scratch);

#endif
