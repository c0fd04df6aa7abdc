/* bound.h - how far the farthest point of a polygon is from a mesh. */
#ifndef VOX_SIMPLIFY_BOUND_H
#define VOX_SIMPLIFY_BOUND_H

#include "libvoxel/simplify/closest.h"

/* What is known of the largest distance of some points from a mesh. */
struct vox_bound {
    double low, high; /* it is at least and at most this */
    double where[3];  /* the point that is `low` away */
    double slack;     /* what `high` may always be more than `low`, for rounded coordinates */
    double enough;    /* 0, or nothing more is looked for once `low` is above this */
};

/* Returns how large `high` may become: 1 % or the slack more than `low`. */
static inline double vox_bound_allowed(const struct vox_bound *b)
{
    return fmax(1.01 * b->low, b->low + b->slack);
}

/* Adds a point, and another bound. */
void vox_bound_note(struct vox_bound *b, const double where[3], double distance);
void vox_bound_add(struct vox_bound *b, const struct vox_bound *other);

/* Adds a triangle. `high` is a true bound in any case. Where thousands of parts of the triangle do
 * not suffice, it may become twice as high as allowed, or four times, and so on. The result depends
 * on the arguments alone. */
void vox_bound_triangle(const struct vox_closest *tree, const float *const corners[3],
                        struct vox_bound *b);

#endif
