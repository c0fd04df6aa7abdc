/* filter.h - less noise in maps of rays from hits, without rays.
 *
 * In: a complete image whose texels hold one or two values, and the position and the normal of
 * their hits. Out: the same image, in which each value is the weighted mean of those near it on the
 * scan. So charts that lie side by side in the image do not mix, and chart borders do not show.
 *
 * The result depends on the image and the size of a texel only: not on threads or the budget. */
#ifndef BAKE_FILTER_FILTER_H
#define BAKE_FILTER_FILTER_H

#include "libbake/maps/maps.h"

struct bake_filter {
    struct bake_image *image;
    uint32_t count;      /* of the values: 1 or 2 */
    uint32_t offsets[2]; /* of the values in a texel of the image */
    /* The variance that noise gives a value p, divided by p (1 - p); 0: not known, so means replace
     * all values. */
    double noise[2];
    /* Of BAKE_GUIDE_VALUES: position in world units, unit normal or 0, any two values. */
    uint32_t guide;
    double texel; /* side of a texel on the mesh, in world units; 0: nothing is near */
};

/* Filters all valid texels on all threads. Must not be called from parallel work. Errors: those of
 * bake_image_bands(); BSQ_ENOMEM, BSQ_EINTR. */
int bake_filter(struct bsq_ctx *ctx, const struct bake_filter *filter);

#endif
