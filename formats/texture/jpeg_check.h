/* jpeg_check.h - finds damage in JPEG files with libjpeg; private to this folder.
 *
 * OpenImageIO drops libjpeg's warnings, and libjpeg makes missing parts of an image grey. */
#ifndef FMT_TEXTURE_JPEG_CHECK_H
#define FMT_TEXTURE_JPEG_CHECK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { FMT_JPEG_MESSAGE = 256 };

/* Gives the bytes of a file. Functions return 0 or a failure that the caller of the check gets. */
struct fmt_jpeg_source {
    /* Reads up to `size` bytes; *got is lower at the end of the file only. */
    int (*read)(void *arg, uint64_t offset, void *to, uint64_t size, uint64_t *got);
    int (*check)(void *arg); /* is called often: an interruption is a failure */
    void *arg;
};

/* Decodes a file once, at an eighth of its size. Keeps the coefficients of the whole image in
 * memory if the file is progressive or has a scan for each component, and else some rows. Returns a
 * failure of the source, or 0; `message` is then empty, or libjpeg's text about the first damage.
 * Of a file with all rows, up to 64 bytes before a marker and the mark of its end do not matter:
 * cameras and editors are careless with them. */
int fmt_jpeg_check(const struct fmt_jpeg_source *source, char message[FMT_JPEG_MESSAGE]);

#ifdef __cplusplus
}
#endif
#endif
