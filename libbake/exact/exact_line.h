/* exact_line.h - tests of a line against boxes, eight at a time, none of which is missed, and
 * against triangles; private to this folder. See bk_line.h. */
#ifndef BAKE_EXACT_EXACT_LINE_H
#define BAKE_EXACT_EXACT_LINE_H

#include <math.h>
#include <stdbool.h>

#include "base/simd/simd.h"
#include "libbake/exact/exact_tree.h"
#include "libbake/kernel/bk_line.h"

/* ---- boxes ---- */

/* A part of a line: parameters from `begin` to `end`. */
struct exact_span {
    float begin, end;
};

/* Returns the span between two parameters, rounded outwards. */
static inline struct exact_span exact_span_of(double begin, double end)
{
    return (struct exact_span){(float)(begin - fabs(begin) * BK_LINE_ROUNDING),
                               (float)(end + fabs(end) * BK_LINE_ROUNDING)};
}

/* Sets the parameters where the line enters and leaves boxes, up to rounding. */
LANES_INLINE void exact_line_slabs(const bk_line *line, const struct exact_box8 *boxes, eights *in,
                                   eights *out)
{
    *in = eights_splat(-INFINITY);
    *out = eights_splat(INFINITY);
    for (int k = 0; k < 3; k++) {
        const eights near = *(const eights *)(const void *)boxes->planes[line->near[k]][k];
        const eights far = *(const eights *)(const void *)boxes->planes[line->far[k]][k];
        const eights inverse = eights_splat(line->inverse[k]);
        *in = eights_max((near - eights_splat(line->near_origin[k])) * inverse, *in);
        *out = eights_min((far - eights_splat(line->far_origin[k])) * inverse, *out);
    }
}

/* Returns a bit mask of the boxes that the line crosses within the span, and sets distances[] to
 * the smallest |t - from| inside each. Never misses a box: parameters are widened, see bk_line.h.
 */
static inline unsigned exact_line_crosses(const bk_line *line, const struct exact_box8 *boxes,
                                          struct exact_span span, float from, eights *distances)
{
    const eights less = eights_splat(BK_LINE_LESS), more = eights_splat(BK_LINE_MORE);
    eights in, out;
    exact_line_slabs(line, boxes, &in, &out);
    in = eights_max(eights_min(in * less, in * more), eights_splat(span.begin));
    out = eights_min(eights_max(out * less, out * more), eights_splat(span.end));
    const eights origin = eights_splat(from);
    *distances = eights_max(eights_max(in - origin, origin - out), eights_splat(0.0f));
    return eights_not_above(in, out);
}

/* Likewise between 0 and `end`, with distances from 0. What rounding could do to boxes behind does
 * not matter: a parameter has its right sign. */
LANES_INLINE unsigned exact_line_crosses_ahead(const bk_line *line, const struct exact_box8 *boxes,
                                               float end, eights *distances)
{
    eights in, out;
    exact_line_slabs(line, boxes, &in, &out);
    *distances = eights_max(in * eights_splat(BK_LINE_LESS), eights_splat(0.0f));
    return eights_not_above(*distances,
                            eights_min(out * eights_splat(BK_LINE_MORE), eights_splat(end)));
}

/* ---- triangles ---- */

/* Intersects the line of a shear with a triangle, as bk_cross_triangle() does. */
static inline bool exact_cross_triangle(const bk_shear *s, const float *a, const float *b,
                                        const float *c, bk_line_hit *out)
{
    const bk_uint *k = s->k;
    return bk_cross_triangle(s, bk_v3(a[k[0]], a[k[1]], a[k[2]]), bk_v3(b[k[0]], b[k[1]], b[k[2]]),
                             bk_v3(c[k[0]], c[k[1]], c[k[2]]), out);
}

#endif
