/* exact_tree.h - a tree of boxes with four children a node, for triangles and for chunks.
 *
 * Boxes are sorted along a Hilbert curve and packed four by four, level by level, so building takes
 * linear time, child numbers need no storage, and memory is known beforehand (Kamel & Faloutsos,
 * "On Packing R-trees", 1993). Scans are many small triangles of like size, where a costlier
 * heuristic gains little, while a chunk's tree serves only the rays of one batch. */
#ifndef BAKE_EXACT_EXACT_TREE_H
#define BAKE_EXACT_EXACT_TREE_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

enum { EXACT_TREE_LEVELS = 17, EXACT_TREE_STACK = 3 * EXACT_TREE_LEVELS + 1 };

/* Boxes of four children; those that are missing are empty. */
struct exact_box4 {
    _Alignas(16) float planes[2][3][4]; /* lower, upper; by axis; of each child */
};

struct exact_box {
    float low[3], high[3];
};

struct exact_tree {
    struct exact_box4 *nodes;          /* by level, the leaves first */
    uint32_t *order;                   /* child c of leaf node k is box order[4 k + c] */
    uint32_t count;                    /* of boxes */
    uint32_t levels;                   /* 0 where there are no boxes */
    uint32_t first[EXACT_TREE_LEVELS]; /* node of each level; the last level is the root alone */
};

/* Largest number of boxes: their numbers share a sort key with the place on the curve. */
#define EXACT_TREE_BOXES (UINT32_C(1) << 31)

/* Bytes of `memory` and of `scratch` for bake_exact_tree_build(). */
uint64_t bake_exact_tree_bytes(uint32_t count);
uint64_t bake_exact_tree_scratch_bytes(uint32_t count);

/* Builds the tree of `count` boxes in `memory`, which must outlive it. Both are 64-byte aligned. */
void bake_exact_tree_build(struct exact_tree *tree, uint32_t count, const struct exact_box *boxes,
                           void *memory, void *scratch);

/* Writes the numbers of the boxes that overlap `box`, at most tree->count; returns how many. */
uint32_t bake_exact_tree_overlapping(const struct exact_tree *tree, const struct exact_box *box,
                                     uint32_t *out);

/* Place of a point on the curve through the cube at `low` with this side; 33 bits. Points outside
 * count as on its border. */
uint64_t bake_exact_curve_place(const float point[3], const float low[3], double side);

/* ---- lines ---- */

/* A line prepared for tests against boxes. Position and direction are taken as exact. */
struct exact_line {
    float near_origin[3], far_origin[3]; /* for the planes where it enters and leaves a box */
    float inverse[3];
    uint32_t near[3], far[3]; /* which of a box's planes these are: 0 lower, 1 upper */
};

/* Components of a unit vector below this count as zero, so that reciprocals do not overflow. */
static inline float exact_component(float d)
{
    return fabsf(d) < 1e-18f ? 0.0f : d;
}

/* False where the line is none: no direction, or not finite. */
static inline bool exact_line_set(struct exact_line *line, const float origin[3],
                                  const float direction[3])
{
    bool any = false;
    for (int k = 0; k < 3; k++) {
        float d = exact_component(direction[k]), o = origin[k];
        if (!isfinite(o) || !isfinite(d))
            return false;
        any |= d != 0.0f;
        /* A line in parallel with a pair of planes is inside of them or not; moved apart by a
         * rounding step, it never lies on one, where the product would not be a number. */
        line->near_origin[k] = d != 0.0f ? o : nextafterf(o, INFINITY);
        line->far_origin[k] = d != 0.0f ? o : nextafterf(o, -INFINITY);
        line->inverse[k] = d != 0.0f ? 1.0f / d : 3e38f;
        line->near[k] = d < 0.0f;
        line->far[k] = !line->near[k];
    }
    return any;
}

/* Part of a line between two parameters, rounded outwards. */
struct exact_span {
    float begin, end;
};

static inline struct exact_span exact_span_of(double begin, double end)
{
    /* Conversion rounds to nearest: half a step. */
    const double widen = 1.2e-7;
    return (struct exact_span){(float)(begin - fabs(begin) * widen),
                               (float)(end + fabs(end) * widen)};
}

/* Which of four boxes the line crosses within the span, as bits; distances[]: smallest |t| there.
 * Conservative: subtraction, reciprocal and product are each rounded once, so crossings are off by
 * less than 3 * 2^-24 of their size (Ize, "Robust BVH Ray Traversal", JCGT 2(2), 2013). */
#define EXACT_WIDEN 4.8e-7f
#ifdef __SSE2__
static inline __m128 exact_widen4(__m128 t, __m128 amount)
{
    const __m128 sign = _mm_and_ps(t, _mm_set1_ps(-0.0f));
    return _mm_mul_ps(t, _mm_add_ps(_mm_set1_ps(1.0f), _mm_xor_ps(sign, amount)));
}

static inline unsigned exact_line_crosses4(const struct exact_line *line,
                                           const struct exact_box4 *boxes, struct exact_span span,
                                           float distances[4])
{
    __m128 in = _mm_set1_ps(-INFINITY), out = _mm_set1_ps(INFINITY);
    for (int k = 0; k < 3; k++) {
        const float *near = boxes->planes[line->near[k]][k];
        const float *far = boxes->planes[line->far[k]][k];
        const __m128 inverse = _mm_set1_ps(line->inverse[k]);
        const __m128 from = _mm_sub_ps(_mm_load_ps(near), _mm_set1_ps(line->near_origin[k]));
        const __m128 to = _mm_sub_ps(_mm_load_ps(far), _mm_set1_ps(line->far_origin[k]));
        in = _mm_max_ps(_mm_mul_ps(from, inverse), in);
        out = _mm_min_ps(_mm_mul_ps(to, inverse), out);
    }
    in = _mm_max_ps(exact_widen4(in, _mm_set1_ps(-EXACT_WIDEN)), _mm_set1_ps(span.begin));
    out = _mm_min_ps(exact_widen4(out, _mm_set1_ps(EXACT_WIDEN)), _mm_set1_ps(span.end));
    const __m128 behind = _mm_xor_ps(out, _mm_set1_ps(-0.0f));
    _mm_storeu_ps(distances, _mm_max_ps(_mm_max_ps(in, behind), _mm_setzero_ps()));
    return (unsigned)_mm_movemask_ps(_mm_cmple_ps(in, out));
}
#else
static inline unsigned exact_line_crosses4(const struct exact_line *line,
                                           const struct exact_box4 *boxes, struct exact_span span,
                                           float distances[4])
{
    unsigned bits = 0;
    for (unsigned c = 0; c < 4; c++) {
        float in = -INFINITY, out = INFINITY;
        for (int k = 0; k < 3; k++) {
            const float near = boxes->planes[line->near[k]][k][c];
            const float far = boxes->planes[line->far[k]][k][c];
            const float from = (near - line->near_origin[k]) * line->inverse[k];
            const float to = (far - line->far_origin[k]) * line->inverse[k];
            in = from > in ? from : in;
            out = to < out ? to : out;
        }
        in *= 1.0f - copysignf(EXACT_WIDEN, in);
        out *= 1.0f + copysignf(EXACT_WIDEN, out);
        in = in > span.begin ? in : span.begin;
        out = out < span.end ? out : span.end;
        const float distance = in > -out ? in : -out;
        distances[c] = distance > 0.0f ? distance : 0.0f;
        bits |= (unsigned)(in <= out) << c;
    }
    return bits;
}
#endif

#endif
