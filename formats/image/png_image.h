/* png_image.h - maps and previews as PNG, written through libpng. */
#ifndef FMT_IMAGE_PNG_IMAGE_H
#define FMT_IMAGE_PNG_IMAGE_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

struct fmt_png_options {
    uint32_t width, height;
    uint32_t channel_count; /* 1 grey, 3 RGB, 4 RGBA */
    uint32_t bits;          /* 8 (dithered) or 16 */
    bool srgb; /* samples are linear light, to be encoded as sRGB and tagged so; else raw, tagged
                  with gamma 1.0 */
};

struct fmt_png_writer;

/* Starts `path` (whole or not at all). */
int fmt_png_create(struct bsq_ctx *ctx, const char *path, const struct fmt_png_options *options,
                   struct fmt_png_writer **out);
/* Rows top to bottom, interleaved float 0..1 (clamped). 8 bit: ordered dither (a fixed
 * blue-noise-like pattern), so the same input gives the same bytes. */
int fmt_png_write_rows(struct fmt_png_writer *writer, const float *samples, uint32_t rows);
/* Optional: completes the temporary file, so that little is left that can fail in commit. */
int fmt_png_finish(struct fmt_png_writer *writer);
/* Gives the file its final name; frees the writer in any case. */
int fmt_png_commit(struct fmt_png_writer *writer);
void fmt_png_discard(struct fmt_png_writer *writer); /* NULL is allowed */

#ifdef __cplusplus
}
#endif
#endif
