/* exr_read.h - reads OpenEXR files through OpenEXR's C API: whole, or their colours row by row.
 *
 * In: a scanline or tiled file. Out: its first part at full resolution, all channels as float, and
 * the header's texts; or rows of colours; or tiles of all channels. Deep and subsampled images are
 * refused; a damaged file is BSQ_EDATA. */
#ifndef FMT_IMAGE_EXR_READ_H
#define FMT_IMAGE_EXR_READ_H

#include "base/file.h"

struct fmt_exr_attribute { /* a string attribute of the header */
    char *name, *value;
};

struct fmt_exr_image {
    int32_t x, y; /* of the first texel, in the whole image that it is a part of */
    uint32_t width, height, channel_count;
    char **channels;          /* names, in the file's (alphabetical) order */
    float *samples;           /* height x width x channel_count, interleaved */
    uint32_t attribute_count; /* of the header's string attributes; owned */
    struct fmt_exr_attribute *attributes;
};
/* Reads a file on all threads. Free *out with fmt_exr_image_free(). Errors: BSQ_ENOINPUT,
 * BSQ_EDATA, BSQ_EIO, BSQ_ENOMEM. */
int fmt_exr_read(struct bsq_ctx *ctx, const char *path, struct fmt_exr_image *out);
void fmt_exr_image_free(struct bsq_ctx *ctx, struct fmt_exr_image *image);
/* Returns the number of the channel with this name, or UINT32_MAX. */
uint32_t fmt_exr_channel(const struct fmt_exr_image *image, const char *name);
/* Returns the value of the string attribute with this name, or NULL; owned by the image. */
const char *fmt_exr_image_attribute(const struct fmt_exr_image *image, const char *name);

/* An image that is read from the top: red, green and blue, or one channel, and the alpha if there
 * is one. */
struct fmt_exr_size {
    uint32_t width, height, channels;
};
struct fmt_exr_rows;
/* Opens an image. `path` is for messages; it and `input` must stay. Close *out, also after a
 * failure. Errors: BSQ_RETRY for DWAA and DWAB, which OpenEXR's C API cannot decode; BSQ_EDATA,
 * BSQ_EIO, BSQ_ENOMEM. */
int fmt_exr_rows_open(struct bsq_ctx *ctx, const char *path, const struct bsq_file *input,
                      struct fmt_exr_size *size, struct fmt_exr_rows **out);
int fmt_exr_rows_read(struct fmt_exr_rows *rows, float *out); /* the next row */
void fmt_exr_rows_close(struct fmt_exr_rows *rows);           /* NULL is allowed */

/* Opens an image whose channels are these `count`, in any order, to read its tiles. Close *out with
 * fmt_exr_rows_close(), also after a failure. Errors: BSQ_EDATA if it has others; those of
 * fmt_exr_rows_open(). */
int fmt_exr_tiles_open(struct bsq_ctx *ctx, const char *path, const struct bsq_file *input,
                       const char *const *channels, uint32_t count, struct fmt_exr_rows **out);
/* Returns what the file's header says; there are no samples. Owned by `rows`. */
const struct fmt_exr_image *fmt_exr_rows_image(const struct fmt_exr_rows *rows);
/* Returns the side of the tiles in texels; 0: there are none, or they are no squares of at most
 * 8192. */
uint32_t fmt_exr_tile_side(const struct fmt_exr_rows *rows);
/* Reads a tile. *samples: its first texel, with the channels in the order of fmt_exr_tiles_open();
 * rows of the tile are a side of tiles apart. It is valid until the next one is read. */
int fmt_exr_tile_read(struct fmt_exr_rows *rows, uint32_t column, uint32_t row,
                      const float **samples);

#endif
