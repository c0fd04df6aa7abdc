/* image_rows.h - reads image files as a stream of rows.
 *
 * PNG, JPEG and OpenEXR files are decoded here. A program decodes others, a process for each image:
 * bisque-tiff, by libtiff, or bisque-texture, by OpenImageIO, whose libraries take a while to load.
 */
#ifndef FMT_TEXTURE_IMAGE_ROWS_H
#define FMT_TEXTURE_IMAGE_ROWS_H

#include <stdio.h>

#include "formats/material/file_extent.h"
#include "formats/program/program.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What a decoder tells of an image. */
struct fmt_rows_info {
    uint32_t width, height;
    uint32_t channels;     /* interleaved in each row */
    uint32_t sample_bytes; /* 1, 2: integers in the machine's byte order; 4: floats */
    int32_t alpha;         /* the channel with the alpha; below 0: none */
    double gamma;          /* exponent that turns integers into linear light; 0: the sRGB curve */
    uint64_t bytes;        /* memory that reading rows takes; small buffers are not counted */
    bool whole;            /* the image is decoded whole, in `bytes` */
};

/* Where a decoder reads. */
struct fmt_rows_input {
    struct bsq_ctx *ctx;
    const char *path; /* for messages */
    struct bsq_file file;
    const char *program; /* that decodes it; NULL: it is decoded here */
    const char *plugin;  /* OpenImageIO's name of the format */
    unsigned sharers;    /* images that may be decoded at the same time, this one included */
    FILE *stream;        /* the file, for decoders here */
    uint64_t offset;     /* of the stream */
    int status;          /* of a failed read of the stream, or 0 */
};

/* A decoder. Errors: BSQ_EDATA, BSQ_EIO, BSQ_EINTR, BSQ_ENOMEM; BSQ_RETRY of an OpenEXR file that
 * OpenImageIO can decode. */
struct fmt_rows_decoder {
    /* Reads the header. `input` must stay. Sets *state also after a failure; NULL: nothing. */
    int (*open)(struct fmt_rows_input *input, struct fmt_rows_info *info, void **state);
    int (*read)(void *state, void *row); /* reads the next row from the top */
    void (*close)(void *state);
};

extern const struct fmt_rows_decoder fmt_png_rows, fmt_jpeg_rows, fmt_exr_texture_rows,
    fmt_program_rows;

/* Sets the name and the value of text number `i` before the texels of a PNG file; the decoder's
 * state owns both. Returns false if there are fewer texts. */
bool fmt_png_text(const void *state, uint32_t i, const char **name, const char **value);

/* An image that is being read. */
struct fmt_rows {
    struct fmt_rows_input input;
    struct fmt_rows_info info;
    const struct fmt_rows_decoder *decoder;
    void *state;
    uint64_t reserved_bytes;
};

/* Opens an image, of a file or of an extent of a file (formats/material/file_extent.h). The content
 * tells the format. Reserves the memory for decoding; a program gets half of what is left, or its
 * share if several are opened at a time (`sharers`). `rows` must not move. Close it, also after a
 * failure. Errors: those of bsq_file_open() and of decoders. */
int fmt_rows_open(struct bsq_ctx *ctx, const char *path, unsigned sharers, struct fmt_rows *rows);
void fmt_rows_close(struct fmt_rows *rows); /* zeros are allowed */

/* Reports what a decoder says of a file, for decoders here, unless the file could not be read.
 * Returns BSQ_EDATA or the status of the failed read. */
int fmt_rows_fail(const struct fmt_rows_input *input, const char *what, const char *reason);
#define FMT_ROWS_UNREADABLE "not a readable image"
#define FMT_ROWS_DAMAGED    "damaged image"

#ifdef __cplusplus
}
#endif
#endif
