/* map_image.h - the map while it is being baked: floats by texel, in memory or in a temporary
 * file.
 *
 * Sample 0 of a texel says what is known of it: 0 outside all charts, -1 inside but no ray hit,
 * else the share of its samples that hit, in (0, 1]. Such a texel is called valid; the other
 * samples are its values (unit normal, linear colour) and mean nothing where it is not valid. */
#ifndef BAKE_MAPS_MAP_IMAGE_H
#define BAKE_MAPS_MAP_IMAGE_H

#include "base/context.h"

#define BAKE_OUTSIDE 0.0f
#define BAKE_MISSED  (-1.0f)

struct bake_image;

struct bake_image_options {
    uint32_t width, height; /* texels */
    uint32_t channels;      /* samples a texel */
    uint64_t memory_bytes;  /* an image larger than this goes to a temporary file */
    const char *beside;     /* output path: where temporary files go, see bsq_file_temp() */
};

/* Creates an image of zeros. */
int bake_image_create(struct bsq_ctx *ctx, const struct bake_image_options *options,
                      struct bake_image **out);
void bake_image_free(struct bake_image *image); /* NULL is allowed */

uint32_t bake_image_width(const struct bake_image *image);
uint32_t bake_image_height(const struct bake_image *image);
uint32_t bake_image_channels(const struct bake_image *image);
bool bake_image_in_memory(const struct bake_image *image);

/* Stores a block of texels, interleaved, row by row. Several threads may write disjoint blocks. */
int bake_image_write(struct bake_image *image, uint32_t x, uint32_t y, uint32_t width,
                     uint32_t height, const float *samples);

/* Points *rows at `count` rows from `y` on: at the image itself where it is in memory, else at
 * `buffer` (count * width * channels floats; may be NULL where it is in memory) after reading. */
int bake_image_rows(const struct bake_image *image, uint32_t y, uint32_t count, float *buffer,
                    const float **rows);

#endif
