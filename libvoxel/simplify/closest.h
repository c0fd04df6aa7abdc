/* closest.h - the point of a mesh that is closest to a given one. */
#ifndef VOX_CLOSEST_H
#define VOX_CLOSEST_H

#include "base/context.h"

struct vox_closest_node;

/* A tree of boxes over triangles, which stay the caller's. */
struct vox_closest {
    const float (*positions)[3];
    const uint32_t (*triangles)[3];
    struct vox_closest_node *nodes;
    uint32_t *order; /* numbers of triangles, by leaves */
};

/* Builds a tree. in_order: triangles that follow each other are neighbours, as in a chunk, so their
 * order is kept; such a tree takes less time to build, and queries more. The caller frees it with
 * vox_closest_free(). Errors: BSQ_ENOMEM. */
int vox_closest_build(struct bsq_ctx *ctx, const float (*positions)[3],
                      const uint32_t (*triangles)[3], uint32_t triangle_count, bool in_order,
                      struct vox_closest *out);
void vox_closest_free(struct bsq_ctx *ctx, struct vox_closest *tree);

/* Returns the squared distance of a point from the closest triangle, or `most` if none is closer
 * than that. Thread-safe. */
double vox_closest_square(const struct vox_closest *tree, const double point[3], double most);

/* Returns the squared distance of a point from a box; 0 inside. */
static inline double vox_box_square(const float low[3], const float high[3], const double point[3])
{
    double square = 0;
    for (int k = 0; k < 3; k++) {
        const double below = (double)low[k] - point[k], above = point[k] - (double)high[k];
        const double out = below > above ? below : above;
        square += out > 0 ? out * out : 0;
    }
    return square;
}

#endif
