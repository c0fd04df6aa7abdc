/* map_encode.h - encodes texels of the image as rows of a map's file, and describes the map in the
 * file's header; private to this folder. */
#ifndef BAKE_MAPS_MAP_ENCODE_H
#define BAKE_MAPS_MAP_ENCODE_H

#include "libbake/maps/maps.h"

struct bake_encoder {
    const struct bake_map_row *row;
    uint32_t offset; /* of the map's first value in a texel of the image; of the mask, the place of
                      * what it is multiplied by, or 0 */
    struct bake_encoding encoding;
    double factor[3], bias[3]; /* sample = factor * the image's value + bias */
};

/* Prepares an encoder for map `number` of an image with the maps `maps`. */
void bake_encoder_init(const struct bake_encoding_facts *facts, uint32_t maps, unsigned number,
                       struct bake_encoder *out);

/* Encodes a row from the results of bake_dilation_row(). channels: of the image. */
void bake_encode_row(const struct bake_encoder *encoder, const float *const *sources,
                     const float *texels, uint32_t channels, uint32_t width, float *out);

/* Limits samples to the largest 16-bit float, 65504, and its negative. Returns the number of
 * samples beyond them, which would become infinite in a file. */
uint32_t bake_limit_to_half(float *samples, uint32_t count);

/* Lists the attributes of a map's file. The list points to texts in *out. */
void bake_describe_map(const struct bake_options *options, unsigned number,
                       const struct bake_traced *traced, struct bake_attributes *out);

/* Lists the attributes that decode the samples of a map whose values have a unit; otherwise none.
 */
void bake_describe_encoding(const struct bake_encoder *encoder, struct bake_attributes *out);

#endif
