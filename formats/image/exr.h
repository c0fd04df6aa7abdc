/* exr.h - maps as OpenEXR scanline files, written and read through OpenEXR's C API. */
#ifndef FMT_IMAGE_EXR_H
#define FMT_IMAGE_EXR_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

enum fmt_exr_type { FMT_EXR_HALF, FMT_EXR_FLOAT };

struct fmt_exr_attribute { /* a string attribute of the header */
    const char *name, *value;
};

struct fmt_exr_options {
    uint32_t width, height;
    uint32_t channel_count;
    const char *const *channels; /* names in the order of the samples, e.g. "R", "G", "B" */
    enum fmt_exr_type type;      /* ZIP compressed */
    bool data;                   /* not colour: marked so that readers do not transform it */
    const struct fmt_exr_attribute *attributes;
    uint32_t attribute_count;
};

struct fmt_exr_writer;

/* Starts `path` (whole or not at all). */
int fmt_exr_create(struct bsq_ctx *ctx, const char *path, const struct fmt_exr_options *options,
                   struct fmt_exr_writer **out);
/* Rows come top to bottom, `rows` at a time (any number); samples are interleaved float:
 * rows x width x channel_count. Compression uses all threads. */
int fmt_exr_write_rows(struct fmt_exr_writer *writer, const float *samples, uint32_t rows);
/* Optional: completes the temporary file, so that little is left that can fail in commit. For jobs
 * that write several files and want all or none. */
int fmt_exr_finish(struct fmt_exr_writer *writer);
/* Gives the file its final name; frees the writer in any case. */
int fmt_exr_commit(struct fmt_exr_writer *writer);
void fmt_exr_discard(struct fmt_exr_writer *writer); /* NULL is allowed */

/* A whole image in memory (for comparison and tests): the first part of a scanline or tiled file
 * (its full resolution), all channels as float. Deep and subsampled images are refused; a damaged
 * file is BSQ_EDATA. */
struct fmt_exr_image {
    uint32_t width, height, channel_count;
    char **channels;          /* names, in the file's (alphabetical) order */
    float *samples;           /* height x width x channel_count, interleaved */
    uint32_t attribute_count; /* of the header's string attributes; owned */
    struct fmt_exr_attribute *attributes;
};
int fmt_exr_read(struct bsq_ctx *ctx, const char *path, struct fmt_exr_image *out);
void fmt_exr_image_free(struct bsq_ctx *ctx, struct fmt_exr_image *image);
/* Number of the channel with this name, or UINT32_MAX. */
uint32_t fmt_exr_channel(const struct fmt_exr_image *image, const char *name);
/* Value of the string attribute with this name, or NULL; owned by the image. */
const char *fmt_exr_image_attribute(const struct fmt_exr_image *image, const char *name);

#ifdef __cplusplus
}
#endif
#endif
