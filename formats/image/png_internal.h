/* png_internal.h - compresses a band of rows for a PNG file; private to this folder. */
#ifndef FMT_IMAGE_PNG_INTERNAL_H
#define FMT_IMAGE_PNG_INTERNAL_H

#include <zlib.h>

#include "formats/image/image_writer.h"

struct fmt_png_layout {
    uint32_t width, height;
    uint32_t channel_count; /* 1 grey, 3 RGB, 4 RGBA */
    uint32_t bits;          /* 8 or 16 */
    bool labels;            /* do not dither */
    bool srgb;              /* samples are linear light: encode and tag them as sRGB; otherwise they
                             * are data, tagged with gamma 1.0 */
};

/* Encodes one band of rows at a time. Different encoders may work in parallel. */
struct fmt_png_encoder {
    z_stream deflate;
    bool ready;        /* `deflate` is initialised */
    uint8_t *rows[2];  /* the current row as bytes, and the row above it */
    uint8_t *trial;    /* a row, filtered */
    uint8_t *filtered; /* the band: for each row the filter's number and the filtered bytes */
    uint8_t *packed;   /* the band, deflated */
    uint64_t packed_capacity, packed_bytes;
    uint64_t filtered_bytes;
    uint32_t checksum; /* Adler-32 of the filtered bytes */
};

/* Returns the bytes of a row. */
uint64_t fmt_png_row_bytes(const struct fmt_png_layout *layout);

/* Prepares for bands of up to `rows` rows. Free with fmt_png_encoder_free(), also after a failure.
 */
int fmt_png_encoder_create(struct bsq_ctx *ctx, const struct fmt_png_layout *layout, uint32_t rows,
                           struct fmt_png_encoder *out);
void fmt_png_encoder_free(struct bsq_ctx *ctx, struct fmt_png_encoder *encoder);

struct fmt_png_band {
    const float *above; /* samples of the row above; NULL at the top of the image */
    const float *samples;
    uint32_t first_row, rows;
};

/* Encodes a band as a part of a deflate stream. The parts of all bands in order make the stream,
 * which the band with the image's last row ends. Errors: BSQ_EBUG. */
int fmt_png_encode(struct bsq_ctx *ctx, struct fmt_png_encoder *encoder,
                   const struct fmt_png_layout *layout, const struct fmt_png_band *band);

#endif
