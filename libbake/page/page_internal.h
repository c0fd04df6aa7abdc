/* page_internal.h - a page while it is written; private to this folder. */
#ifndef BAKE_PAGE_PAGE_INTERNAL_H
#define BAKE_PAGE_PAGE_INTERNAL_H

#include "libbake/page/items.h"

struct bake_page {
    struct bsq_ctx *ctx;
    const char *path;
    struct bsq_output *output;
    char *frame_text, *frame; /* the frame, and what of it is not written yet */

    struct row_picture { /* pictures of the files whose rows come; the last one first */
        struct row_picture *next;
        const char *path;
        struct bake_page_picture picture;
    } * pictures;
};

void bake_page_free_pictures(struct bake_page *page);

#endif
