/* map_files.h - the files that a bake writes. */
#ifndef BAKE_MAPS_MAP_FILES_H
#define BAKE_MAPS_MAP_FILES_H

#include "libbake/bake.h"
#include "libbake/maps/map_image.h"
#include "libbake/maps/thumbnail.h"

struct bake_map_files;

/* Checks output path, sample type and size against each other. Errors: BSQ_EUSAGE. */
int bake_map_files_check(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps);

/* Samples that a texel of struct bake_image has for these maps, its share of hits included. */
uint32_t bake_map_channels(uint32_t maps);

/* How the map was traced. */
struct bake_traced {
    double front, back;   /* as used */
    const char *sampling; /* "trilinear", "nearest" or "exact" */
};

/* Creates the files under temporary names, so that a directory that cannot be written to is known
 * before the work. traced: for the files' attributes. Errors: BSQ_ECANTCREAT. */
int bake_map_files_open(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps,
                        const struct bake_traced *traced, struct bake_map_files **out);

/* Pads, encodes and writes all rows of the image; adds them to the thumbnails, each of which may be
 * NULL. Adds to *padding, *resolve and *write the seconds that went into padding, encoding and
 * files. */
int bake_map_files_write(struct bake_map_files *files, const struct bake_image *image,
                         struct bake_thumbnail *normal, struct bake_thumbnail *color,
                         double *padding, double *resolve, double *write);

/* Gives all files their final names; frees in any case. */
int bake_map_files_commit(struct bake_map_files *files);
void bake_map_files_discard(struct bake_map_files *files); /* NULL is allowed */

#endif
