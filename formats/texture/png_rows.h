/* png_rows.h - reads PNG files row by row with libpng; private to this folder.
 *
 * OpenImageIO's reader lets libpng print its messages to standard error. This one returns them. */
#ifndef FMT_TEXTURE_PNG_ROWS_H
#define FMT_TEXTURE_PNG_ROWS_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { FMT_PNG_MESSAGE = 128 };

/* Rows have 1 to 4 channels of 8 or 16 bits, in the machine's byte order. Palettes and small depths
 * are expanded. */
struct fmt_png_info {
    uint32_t width, height;
    int channels, bits;
    bool interlaced;
    double gamma; /* exponent of the file's encoding, such as 0.45455; 0 for sRGB or if unknown */
};

struct fmt_png_rows;

/* Starts to read the file of an open descriptor, which must stay open. Returns 0, or -1 with the
 * reason in `message`; errno is then the error of a failed read, or 0. */
int fmt_png_rows_open(int fd, struct fmt_png_info *info, char message[FMT_PNG_MESSAGE],
                      struct fmt_png_rows **out);

/* Reads the next row from the top. Decodes an interlaced image whole at its first row. Returns as
 * fmt_png_rows_open(). */
int fmt_png_rows_read(struct fmt_png_rows *rows, void *row, char message[FMT_PNG_MESSAGE]);

void fmt_png_rows_close(struct fmt_png_rows *rows); /* NULL is allowed */

#ifdef __cplusplus
}
#endif
#endif
