/** @file
 * libbake: a page that shows the result of a bake or a comparison.
 *
 * The page is one HTML file that needs no network. Style, script and frame are files that are
 * installed with Bisque; three.js is taken from Debian's package libjs-three. Without that package,
 * the page has pictures instead of the mesh. */
#ifndef BAKE_PAGE_H
#define BAKE_PAGE_H

#include "libbake/bake.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Begins a page under a temporary name; `path` ends in .html. Errors: BSQ_EUSAGE, BSQ_ENOINPUT if
 * its parts are not installed, BSQ_ECANTCREAT, BSQ_EIO, BSQ_ENOMEM. */
int bake_page_open(struct bsq_ctx *ctx, const char *path, struct bake_page **out);
/** Adds pictures of maps: bake_options.on_rows, with the page as rows_user. */
int bake_page_take(void *page, const struct bake_rows *rows);
/** Completes the page with the figures that it shows, a JSON object as the programs print it, and
 * gives it its name. Errors: BSQ_EIO, BSQ_ECANTCREAT. */
int bake_page_finish(struct bake_page *page, const char *json);
/** Frees a page, and removes it if it is not finished; NULL is allowed. */
void bake_page_close(struct bake_page *page);

#ifdef __cplusplus
}
#endif
#endif
