/* dilation.h - for every texel of a map the nearest valid one, band by band.
 *
 * Nearest is exact (Euclidean distance between texel centres); among equally near ones the lowest
 * row, then the lowest column. The result does not depend on the height of the bands or on the
 * number of threads. Time is linear in the number of texels for any padding. */
#ifndef BAKE_MAPS_DILATION_H
#define BAKE_MAPS_DILATION_H

#include "libbake/maps/maps.h"

struct bake_padding;

/* Bytes that one row of a band takes (so that a caller can choose the band's height). */
uint64_t bake_padding_row_bytes(const struct bake_image *image);

/* Prepares for bands of `band_rows` rows (the last may be shorter). Texels farther than `padding`
 * from every valid one have no source; UINT32_MAX: only those of a map without any valid texel.
 * Reads the image once. It must not change until bake_padding_free(). beside: see bsq_file_temp().
 */
int bake_padding_create(struct bsq_ctx *ctx, const struct bake_image *image, uint32_t band_rows,
                        uint32_t padding, const char *beside, struct bake_padding **out);
void bake_padding_free(struct bake_padding *padding); /* NULL is allowed */

/* Goes to the next band, from the top: *first_row and *row_count, 0 after the last one. */
int bake_padding_next_band(struct bake_padding *padding, uint32_t *first_row, uint32_t *row_count);

/* Sources of row `row` of the band: `width` pointers to texels; a valid texel is its own source,
 * NULL where there is none. Only the values of a source count (samples 1 and up), not its sample 0.
 * *texels are the row's own. Concurrent calls need different `worker`; what they return is valid
 * until the same worker's next call. */
void bake_padding_row(struct bake_padding *padding, uint32_t row, unsigned worker,
                      const float *const **sources, const float **texels);

#endif
