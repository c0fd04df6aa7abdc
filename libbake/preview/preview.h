/* preview.h - a picture that shows whether a bake is right. Takes the low-poly mesh, thumbnails of
 * its maps and the scan's surface; gives a PNG. A row of the picture shows one view of three things
 * in the same light and from both sides: the mesh plain, the mesh with its maps, and the scan.
 * Below it stands how far the second is from the third. Views go around, or look at the front of a
 * mesh that is open. */
#ifndef BAKE_PREVIEW_PREVIEW_H
#define BAKE_PREVIEW_PREVIEW_H

#include "libbake/lowpoly/lowpoly.h"
#include "libbake/surface/surface.h"
#include "libbake/maps/maps.h"
#include "libbake/udim/udim.h"

/* A UDIM tile with linear thumbnails, whose `texels` are NULL if the map is not baked. Channel 0 of
 * `missed` has the share of texels inside charts whose rays met nothing, channel 1 of the others.
 */
struct bake_preview_tile {
    struct bake_udim_tile udim;
    const struct bake_thumbnail *normal, *color, *missed;
};

struct bake_preview {
    const struct bake_lowmesh *mesh;
    const struct bake_surface *surface;
    const struct bake_preview_tile *tiles; /* by number */
    uint32_t tile_count;
    const struct bake_options *options;
};

/* Where cameras are, in degrees: the first around the mesh from its front on; down; and from one to
 * the next. */
struct bake_preview_views {
    double from, above, step;
};

/* Returns the vertical axis, 1 or 2, of `preview_up`, or else the one along which the mesh stands
 * on a larger rectangle. Axis 1 if there is no such difference, or if the mesh is thin along
 * axis 2. */
int bake_preview_up_axis(const struct bake_preview *preview);

/* Renders on all threads. Must not be called from parallel work. *out: the complete PNG, for the
 * caller to commit. Errors: those of fmt_image_create() and bake_surface_trace(), BSQ_EIO,
 * BSQ_ENOMEM, BSQ_EINTR. */
int bake_preview_write(struct bsq_ctx *ctx, const char *path, const struct bake_preview *preview,
                       struct bake_preview_views *views, struct bsq_output **out);

#endif
