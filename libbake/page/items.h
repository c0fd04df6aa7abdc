/* items.h - what jobs add to a page; its public header is libbake/page.h.
 *
 * An item is a small JSON object: what it is, and a PNG or GLB file as base64. */
#ifndef BAKE_PAGE_ITEMS_H
#define BAKE_PAGE_ITEMS_H

#include <jansson.h>

#include "libbake/maps/maps.h"
#include "libbake/page.h"

/* Returns the page's final name, for outputs that become items and get no name of their own. */
const char *bake_page_path(const struct bake_page *page);

/* Adds an item with the bytes of an output, which stays the caller's. Takes over `head`; NULL means
 * that there was no memory for it. Errors: BSQ_EIO, BSQ_ENOMEM. */
int bake_page_add(struct bake_page *page, json_t *head, struct bsq_output *output);

/* Adds a picture as an item: a thumbnail, whose texels it may change and frees. It gets the members
 * "range", of the values of each channel, and "shown", what became 0 and 1; `color` says that the
 * values are linear light. Errors: those of bake_page_add(). */
struct bake_page_picture {
    struct bake_thumbnail texels;
    float low[3], high[3]; /* of all values, not only of those in the thumbnail */
    bool color;
};
int bake_page_add_picture(struct bake_page *page, json_t *head, struct bake_page_picture *picture);

/* Adds rows of a map to a picture; channels beyond the third do not count. */
int bake_page_take_rows(struct bsq_ctx *ctx, struct bake_page_picture *picture, uint32_t channels,
                        uint32_t first_row, uint32_t rows, const float *samples);

/* Begins a picture of a map of this size. */
int bake_page_begin_picture(struct bsq_ctx *ctx, uint32_t width, uint32_t height,
                            struct bake_page_picture *out);

#endif
