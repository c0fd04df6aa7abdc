/* options.h - checks of a bake's options; private to libbake/. */
#ifndef BAKE_OPTIONS_OPTIONS_H
#define BAKE_OPTIONS_OPTIONS_H

#include "libbake/maps/maps.h"

/* Checks output path, sample type and the sizes of all tiles for these maps. Errors: BSQ_EUSAGE. */
int bake_check_maps(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps);

/* Checks that ranges and sizes are of tiles that exist. Errors: BSQ_EUSAGE. */
int bake_check_tile_numbers(struct bsq_ctx *ctx, const struct bake_options *options);

/* What the scans of a bake are. */
struct bake_scans_found {
    bool grid, normals; /* one is a grid; all have normals of their own, as grids do */
};
/* Warns of options without effect, see bake_inspect(). */
void bake_warn_of_options(struct bsq_ctx *ctx, const struct bake_options *options,
                          const bool *given, const struct bake_scans_found *scans);

#endif
