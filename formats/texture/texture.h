/* texture.h - filtered lookups in the images of a high-poly mesh.
 *
 * Takes paths of image files and a share of the memory budget, which holds whatever the size of the
 * images. Gives colours in linear light: texels are converted (from sRGB unless the file says
 * otherwise) before they are averaged. Texels of data, such as roughness, are not converted. Each
 * image is decoded once. image_rows.c lists the formats. */
#ifndef FMT_TEXTURE_TEXTURE_H
#define FMT_TEXTURE_TEXTURE_H

#include "base/context.h"
#include "formats/material/channels.h"

struct fmt_textures;

/* An image to open. */
struct fmt_texture_source {
    const char *path; /* NULL: no image */
    bool data;        /* no colours: integers are values from 0 to 1, whatever the file says */
    bool srgb;        /* integers are sRGB, whatever gamma the file names */
    bool alpha;       /* its alpha channel; of an image without one, the first channel, as data */
};

/* Opens `count` images, which source_of() tells one by one: it sets the members of *out, which are
 * zeros before. Sets *out to NULL if none has a path. A path may have tokens for UDIM tiles
 * (formats/material/tile_files.h), each of which is a file. What lies in no tile is black, and so
 * are tiles whose file cannot be read, unless all of a texture cannot. A source that occurs twice
 * is opened once. Reads each image through once, on all threads, so it must not be called from
 * parallel work. The images and their cache take at most cache_bytes (1 MiB if it is less); those
 * that exceed it are copied to a temporary file. Decoders take memory beside that.
 *
 * 0 cache_bytes: keeps no texels, so there are no lookups. Files that cannot be read are no failure
 * then, see fmt_texture_problem().
 *
 * Errors: BSQ_ENOINPUT or BSQ_EDATA for a file that is missing, no image, or damaged; BSQ_EIO,
 * BSQ_ENOMEM. */
int fmt_textures_open(struct bsq_ctx *ctx, uint64_t count,
                      void (*source_of)(const void *arg, uint64_t index,
                                        struct fmt_texture_source *out),
                      const void *arg, uint64_t cache_bytes, struct fmt_textures **out);
/* Tells a source of an array of them. */
static inline void fmt_texture_source_at(const void *sources, uint64_t index,
                                         struct fmt_texture_source *out)
{
    *out = ((const struct fmt_texture_source *)sources)[index];
}
void fmt_textures_close(struct fmt_textures *textures); /* NULL is allowed */

/* Warns of the tiles whose files cannot be read, with what is wrong with the first one of each
 * texture. Errors: BSQ_EDATA in a strict job. */
int fmt_textures_tell_damage(const struct fmt_textures *textures);

/* Warns of files with texels that are not finite, and of tiles without a readable file that lookups
 * have asked for, each once. NULL is allowed. Must not be called during lookups. Errors: BSQ_EDATA
 * in a strict job. */
int fmt_textures_tell_losses(struct fmt_textures *textures);

/* Returns whether an image has an alpha channel; of one in tiles, whether any tile has. */
bool fmt_texture_has_alpha(const struct fmt_textures *textures, uint32_t image);

/* Returns BSQ_ENOINPUT or BSQ_EDATA, and sets the message, if the file of an image, or each of its
 * tiles, cannot be read; 0 if all is well. The textures own the message. */
int fmt_texture_problem(const struct fmt_textures *textures, uint32_t image, const char **text);

/* Averages `image` over an axis-aligned box centred at (u, v). Coordinates are OBJ's: v points up.
 * `wrap` says for both what is beyond the image; tiles do not use it. Unless it repeats, the box is
 * moved into the image. `du` and `dv` are the box's full widths in UV units, raised to one texel
 * (so 0 gives bilinear interpolation) and limited to the whole image. out: RGB, not clamped; linear
 * light or, of data, the values. A value of a texel that is not finite counts as 0. An image of one
 * or two channels gives the first one three times, and a source of alpha gives that. Thread-safe.
 * Errors: BSQ_EIO. */
int fmt_texture_sample(struct fmt_textures *textures, uint32_t image, const uint8_t wrap[2],
                       float u, float v, float du, float dv, float out[3]);

#endif
