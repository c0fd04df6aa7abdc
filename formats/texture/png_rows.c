/* png_rows.c - reads PNG files row by row.
 *
 * libpng leaves a function by longjmp when it fails. So each call of it lies in a function that
 * sets the target, and which keeps no variable across the jump. */
#include "formats/texture/png_rows.h"

#include <errno.h>
#include <png.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

struct fmt_png_rows {
    int fd;
    off_t offset;
    int error; /* errno of a failed read, or 0 */
    jmp_buf target;
    png_structp png;
    png_infop info;
    char message[FMT_PNG_MESSAGE];
    size_t row_bytes;
    uint32_t height, next;
    bool interlaced;
    png_bytep whole; /* the decoded image, if it is interlaced */
};

/* ---- callbacks ---- */

static void on_error(png_structp png, png_const_charp text)
{
    struct fmt_png_rows *rows = png_get_error_ptr(png);
    snprintf(rows->message, sizeof rows->message, "%s", text);
    longjmp(rows->target, 1);
}

/* Ignores what libpng thinks odd but can read, such as an unusual colour profile. */
static void on_warning(png_structp png, png_const_charp text)
{
    (void)png, (void)text;
}

static void read_bytes(png_structp png, png_bytep to, size_t size)
{
    struct fmt_png_rows *rows = png_get_io_ptr(png);
    while (size > 0) {
        ssize_t count = pread(rows->fd, to, size, rows->offset);
        if (count < 0 && errno == EINTR)
            continue;
        if (count < 0)
            rows->error = errno;
        if (count <= 0)
            png_error(png, count < 0 ? "the file cannot be read" : "the file is cut off");
        to += count;
        size -= (size_t)count;
        rows->offset += count;
    }
}

static int fail(const struct fmt_png_rows *rows, char message[FMT_PNG_MESSAGE])
{
    memcpy(message, rows->message, sizeof rows->message);
    errno = rows->error;
    return -1;
}

/* ---- opening ---- */

static void describe(struct fmt_png_rows *rows, struct fmt_png_info *out)
{
    int intent;
    out->width = png_get_image_width(rows->png, rows->info);
    out->height = png_get_image_height(rows->png, rows->info);
    out->channels = png_get_channels(rows->png, rows->info);
    out->bits = png_get_bit_depth(rows->png, rows->info);
    out->interlaced = png_get_interlace_type(rows->png, rows->info) != PNG_INTERLACE_NONE;
    if (png_get_sRGB(rows->png, rows->info, &intent) ||
        !png_get_gAMA(rows->png, rows->info, &out->gamma))
        out->gamma = 0;
    rows->height = out->height;
    rows->interlaced = out->interlaced;
    rows->row_bytes = png_get_rowbytes(rows->png, rows->info);
}

static int read_header(struct fmt_png_rows *rows, struct fmt_png_info *out)
{
    static const uint16_t probe = 1;
    if (setjmp(rows->target))
        return -1;
    png_set_read_fn(rows->png, rows, read_bytes);
    png_read_info(rows->png, rows->info);
    png_set_expand(rows->png);
    if (*(const uint8_t *)&probe)
        png_set_swap(rows->png);
    png_set_interlace_handling(rows->png);
    png_read_update_info(rows->png, rows->info);
    describe(rows, out);
    return 0;
}

int fmt_png_rows_open(int fd, struct fmt_png_info *info, char message[FMT_PNG_MESSAGE],
                      struct fmt_png_rows **out)
{
    memset(info, 0, sizeof *info);
    struct fmt_png_rows *rows = calloc(1, sizeof *rows);
    *out = NULL;
    snprintf(message, FMT_PNG_MESSAGE, "out of memory");
    errno = ENOMEM;
    if (!rows)
        return -1;
    rows->fd = fd;
    rows->png = png_create_read_struct(PNG_LIBPNG_VER_STRING, rows, on_error, on_warning);
    rows->info = rows->png ? png_create_info_struct(rows->png) : NULL;
    int status = rows->info ? read_header(rows, info) : -1;
    if (rows->info && status < 0)
        status = fail(rows, message);
    if (status == 0) {
        *out = rows;
    } else {
        int error = errno;
        fmt_png_rows_close(rows);
        errno = error;
    }
    return status;
}

void fmt_png_rows_close(struct fmt_png_rows *rows)
{
    if (!rows)
        return;
    png_destroy_read_struct(&rows->png, &rows->info, NULL);
    free(rows->whole);
    free(rows);
}

/* ---- rows ---- */

static int read_row(struct fmt_png_rows *rows, png_bytep row)
{
    if (setjmp(rows->target))
        return -1;
    png_read_row(rows->png, row, NULL);
    return 0;
}

/* The seven passes of an interlaced image go over all rows, each of which keeps earlier pixels. */
static int read_whole(struct fmt_png_rows *rows)
{
    enum { PASSES = 7 };
    rows->whole = calloc(rows->height, rows->row_bytes);
    if (!rows->whole) {
        snprintf(rows->message, sizeof rows->message, "out of memory");
        rows->error = ENOMEM;
        return -1;
    }
    for (int pass = 0; pass < PASSES; pass++)
        for (uint32_t y = 0; y < rows->height; y++)
            if (read_row(rows, rows->whole + y * rows->row_bytes) < 0)
                return -1;
    return 0;
}

int fmt_png_rows_read(struct fmt_png_rows *rows, void *row, char message[FMT_PNG_MESSAGE])
{
    rows->error = 0;
    if (!rows->interlaced)
        return read_row(rows, row) < 0 ? fail(rows, message) : 0;
    if (!rows->whole && read_whole(rows) < 0)
        return fail(rows, message);
    memcpy(row, rows->whole + rows->next++ * rows->row_bytes, rows->row_bytes);
    return 0;
}
