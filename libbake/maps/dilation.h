/* dilation.h - finds for every texel of a map the nearest valid texel, band by band; private to
 * this folder.
 *
 * Distances are exact: Euclidean, between texel centres. Among equally near texels the lowest row
 * wins, then the lowest column. The result does not depend on the height of the bands or on the
 * number of threads. Time is linear in the number of texels for any padding. */
#ifndef BAKE_MAPS_DILATION_H
#define BAKE_MAPS_DILATION_H

#include "libbake/maps/maps.h"

struct bake_dilation;

/* Returns the bytes that one row of a band takes, for the caller to choose a band's height. */
uint64_t bake_dilation_row_bytes(const struct bake_image *image);

/* Prepares for bands of `band_rows` rows; the last band may be shorter. Texels farther than
 * `padding` texels from every valid texel have no source; UINT32_MAX sets no limit. Reads the image
 * once; the image must not change until bake_dilation_free(). beside: see bsq_file_temp(). Errors:
 * BSQ_ENOMEM, BSQ_EIO. */
int bake_dilation_create(struct bsq_ctx *ctx, const struct bake_image *image, uint32_t band_rows,
                         uint32_t padding, const char *beside, struct bake_dilation **out);
void bake_dilation_free(struct bake_dilation *dilation); /* NULL is allowed */

/* Goes to the next band, from the top. Sets *row_count to 0 after the last band. */
int bake_dilation_next_band(struct bake_dilation *dilation, uint32_t *first_row,
                            uint32_t *row_count);

/* Finds the sources of row `row` of the band: `width` pointers to texels, NULL for a texel without
 * a source. A valid texel is its own source. Only a source's values may be used (samples 1 and up),
 * not its sample 0. *texels points to the texels of the row itself. Concurrent calls need different
 * `worker`; results are valid until the same worker's next call. */
void bake_dilation_row(struct bake_dilation *dilation, uint32_t row, unsigned worker,
                       const float *const **sources, const float **texels);

#endif
