/* items.h - what jobs add to a page; libbake/bake.h has the rest.
 *
 * An item is a small JSON object: what it is, and a PNG or GLB file as base64. */
#ifndef BAKE_PAGE_ITEMS_H
#define BAKE_PAGE_ITEMS_H

#include <jansson.h>

#include "libbake/maps/maps.h"

/* A picture of a map: a thumbnail, and the range of each channel. */
struct bake_page_picture {
    struct bake_thumbnail texels;
    float low[3], high[3];          /* of all values, not only of those in the thumbnail */
    bool color;                     /* values are linear light */
    const char *path;               /* of the file whose rows come */
    struct bake_page_picture *next; /* of another such file */
};

struct bake_page {
    struct bsq_ctx *ctx;
    const char *path; /* also names outputs that become items and get no name of their own */
    struct bsq_output *output;
    struct bake_page_picture *pictures; /* of the files whose rows come; the last one first */
};

/* Adds an item with the bytes of an output, which stays the caller's. Takes over `head`; NULL means
 * that there was no memory for it. Errors: BSQ_EIO, BSQ_ENOMEM. */
int bake_page_add(struct bake_page *page, json_t *head, struct bsq_output *output);

/* Begins a picture of a map of this size. Free it with bake_thumbnail_free(). */
int bake_page_begin_picture(struct bsq_ctx *ctx, uint32_t width, uint32_t height,
                            struct bake_page_picture *out);
/* Adds rows of a map to a picture; channels beyond the third do not count. */
int bake_page_take_rows(struct bsq_ctx *ctx, struct bake_page_picture *picture, uint32_t channels,
                        uint32_t first_row, uint32_t rows, const float *samples);
/* Adds a picture as an item, whose texels it may change. It gets the member "range", of the values
 * of each channel. Takes over `head`. Errors: those of bake_page_add(). */
int bake_page_add_picture(struct bake_page *page, json_t *head, struct bake_page_picture *picture);

#endif
