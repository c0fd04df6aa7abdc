/* thumbnail.h - a map made smaller by averaging, as texture of the preview. */
#ifndef BAKE_MAPS_THUMBNAIL_H
#define BAKE_MAPS_THUMBNAIL_H

#include "base/context.h"

struct bake_thumbnail {
    uint32_t full_width, full_height; /* of the map */
    uint32_t factor;                  /* texels of the map along a side of one texel here */
    uint32_t width, height;
    float (*texels)[3]; /* NULL: there is no such map */
};

/* Sides are at most `side` texels. Free with bake_thumbnail_free(). */
int bake_thumbnail_create(struct bsq_ctx *ctx, uint32_t full_width, uint32_t full_height,
                          uint32_t side, struct bake_thumbnail *out);
void bake_thumbnail_free(struct bsq_ctx *ctx, struct bake_thumbnail *thumbnail);

/* Adds rows of the map, three samples a texel; every row is added once. */
int bake_thumbnail_add(struct bsq_ctx *ctx, struct bake_thumbnail *thumbnail, uint32_t first_row,
                       uint32_t rows, const float *samples);

/* Bilinear lookup at texture coordinates (v upwards), clamped at the borders. */
void bake_thumbnail_sample(const struct bake_thumbnail *thumbnail, float u, float v, float out[3]);

#endif
