/* texture.h - colour images of a scan, read through OpenImageIO's tile cache.
 *
 * The cache takes a bounded share of the budget whatever the images' size. Lookups are
 * linear-light RGB: sRGB files are converted per texel before filtering. */
#ifndef FMT_IMAGE_TEXTURE_H
#define FMT_IMAGE_TEXTURE_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

struct fmt_textures;

/* Opens `count` images (entries may be NULL: no image; equal ones are opened once). Every image is
 * read through once, on all threads, so this must not be called from parallel work. cache_bytes (at
 * least 12 MiB) is reserved from the budget, less where the images are small; scanline files that
 * exceed it go to temporary files. A file that is missing, no image or damaged: BSQ_ENOINPUT or
 * BSQ_EDATA with its name. */
int fmt_textures_open(struct bsq_ctx *ctx, const char *const *paths, uint32_t count,
                      uint64_t cache_bytes, struct fmt_textures **out);
void fmt_textures_close(struct fmt_textures *textures);

/* Size in texels of an image. */
void fmt_texture_size(const struct fmt_textures *textures, uint32_t image, uint32_t *width,
                      uint32_t *height);

/* Samples `image` at OBJ texture coordinates (v upwards, wrapping), averaged over an axis-aligned
 * box of full widths `du`, `dv` in UV units (a texel at least, so 0 is bilinear interpolation;
 * the whole image at most); wide boxes are read from averages. out: linear RGB, not clamped.
 * Thread-safe. Errors: BSQ_EDATA where the file cannot be read any more. */
int fmt_texture_sample(struct fmt_textures *textures, uint32_t image, float u, float v, float du,
                       float dv, float out[3]);

#ifdef __cplusplus
}
#endif
#endif
