/* closest.h - how far points are from a mesh. */
#ifndef VOX_CLOSEST_H
#define VOX_CLOSEST_H

#include <math.h>

#include "base/context.h"
#include "base/simd/simd.h"

struct vox_closest_node;

/* A tree of boxes over triangles, which stay the caller's. */
struct vox_closest {
    const float (*positions)[3];
    const uint32_t (*triangles)[3];
    struct vox_closest_node *nodes;
    enum bsq_simd level;
};

/* Builds a tree. in_order: triangles that follow each other are neighbours, as in a chunk, so their
 * order is kept; such a tree takes less time to build, and queries more. The caller frees it with
 * vox_closest_free(). Errors: BSQ_ENOMEM. */
int vox_closest_build(struct bsq_ctx *ctx, const float (*positions)[3],
                      const uint32_t (*triangles)[3], uint32_t triangle_count, bool in_order,
                      struct vox_closest *out);
void vox_closest_free(struct bsq_ctx *ctx, struct vox_closest *tree);

enum { VOX_CLOSEST_BATCH = 32 };

/* Lowers each of `squares` to the squared distance of a point from the closest triangle, unless it
 * is less already. triangles: NULL, or receives the numbers of these triangles, if a square was
 * lowered. Up to VOX_CLOSEST_BATCH points that lie close together take less time than one by one.
 * Thread-safe. */
void vox_closest_squares(const struct vox_closest *tree, const float (*points)[3], unsigned count,
                         double *squares, uint32_t *triangles);
/* Does the same for one point. Returns the triangle; UINT32_MAX: none is closer. Thread-safe. */
uint32_t vox_closest_point(const struct vox_closest *tree, const double point[3], double *square);

/* Calls `found` for each triangle whose box is at most this squared distance away from a box, with
 * its own one, until a call returns true; then returns true. Thread-safe. */
bool vox_closest_near(const struct vox_closest *tree, const float low[3], const float high[3],
                      double square, bool (*found)(void *arg, uint32_t triangle, double square),
                      void *arg);

static inline void vox_closest_corners(const struct vox_closest *tree, uint32_t triangle,
                                       const float *corners[3])
{
    for (int k = 0; k < 3; k++)
        corners[k] = tree->positions[tree->triangles[triangle][k]];
}

/* Return the squared distance of a point from a triangle, or `most` if that is less. */
double vox_triangle_square(const float *const corners[3], const float point[3], double most);
double vox_triangle_square_at(const float *const corners[3], const double point[3], double most);

static inline double vox_square_between(const float p[3], const float q[3])
{
    double square = 0;
    for (int k = 0; k < 3; k++)
        square += ((double)p[k] - (double)q[k]) * ((double)p[k] - (double)q[k]);
    return square;
}

/* Returns the squared distance of two boxes, or a little less, because differences are rounded; 0
 * if they touch. Without branches, which would be hard to predict. */
static inline double vox_box_square(const float low[3], const float high[3],
                                    const float other_low[3], const float other_high[3])
{
    double square = 0;
    for (int k = 0; k < 3; k++) {
        const float below = low[k] - other_high[k], above = other_low[k] - high[k];
        const double out = (double)(below > above ? below : above);
        const double gap = 0.5 * (out + fabs(out)); /* 0 where the boxes overlap */
        square += gap * gap;
    }
    return square * (1 - 4e-7);
}

#endif
