/* preview.h - one picture that tells whether a bake is right: the low mesh plain, the low
 * mesh with its maps, and the scan, from the same side in the same light. */
#ifndef BAKE_PREVIEW_PREVIEW_H
#define BAKE_PREVIEW_PREVIEW_H

#include "libbake/lowpoly/lowpoly.h"
#include "libbake/surface/surface.h"
#include "libbake/maps/thumbnail.h"

struct bake_preview {
    const struct bake_lowmesh *mesh;
    const struct bake_surface *surface;
    const struct bk_params *params;      /* of a grid */
    struct bake_thumbnail normal, color; /* of the maps as written, linear; texels may be NULL */
    enum bake_normal_space normal_space;
    bool green_down;
};

struct bake_preview_file;

/* Creates the PNG under a temporary name. */
int bake_preview_open(struct bsq_ctx *ctx, const char *path, struct bake_preview_file **out);
/* Renders and writes. */
int bake_preview_write(struct bake_preview_file *file, const struct bake_preview *preview);
int bake_preview_commit(struct bake_preview_file *file);   /* frees in any case */
void bake_preview_discard(struct bake_preview_file *file); /* NULL is allowed */

#endif
