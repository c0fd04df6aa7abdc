/* skew.h - the skew map, which turns rays towards the normals of the low-poly mesh's faces.
 *
 * Takes grey images in the texture space of the low-poly mesh, one for all UDIM tiles or one for
 * each; gives their values. White is 1: rays run along the face's normal. Black is 0. */
#ifndef BAKE_SKEW_SKEW_H
#define BAKE_SKEW_SKEW_H

#include "formats/texture/texture.h"

/* The part of a skew map for one tile. */
struct bake_skew_image {
    struct fmt_textures *textures; /* NULL: there is no skew map */
    uint32_t number;               /* of the tile among those that were opened */
};

/* Opens the images of `count` UDIM tiles: `path` with its tokens replaced, as bake_tile_path()
 * does. Takes memory from the budget. Close *out with fmt_textures_close(), also after a failure.
 * Must not be called from parallel work. Errors: those of fmt_textures_open(). */
int bake_skew_open(struct bsq_ctx *ctx, const char *path, const uint32_t *tiles, uint32_t count,
                   struct fmt_textures **out);

/* Sets *out to the mean of the first channel over a box around (u, v) in the tile, with v upwards
 * and sides du and dv: from 0 to BK_SKEW_ONE. Thread-safe. Errors: BSQ_EDATA, BSQ_EIO. */
int bake_skew_sample(const struct bake_skew_image *image, float u, float v, float du, float dv,
                     uint32_t *out);

#endif
