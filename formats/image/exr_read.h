/* exr_read.h - reads a whole OpenEXR file into memory, through OpenEXR's C API.
 *
 * In: the path of a scanline or tiled file. Out: its first part at full resolution, all channels as
 * float, and the header's texts. Deep and subsampled images are refused; a damaged file is
 * BSQ_EDATA. */
#ifndef FMT_IMAGE_EXR_READ_H
#define FMT_IMAGE_EXR_READ_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

struct fmt_exr_attribute { /* a string attribute of the header */
    char *name, *value;
};

struct fmt_exr_image {
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

#ifdef __cplusplus
}
#endif
#endif
