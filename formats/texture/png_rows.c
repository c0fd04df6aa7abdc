/* png_rows.c - reads PNG files row by row.
 *
 * libpng leaves a function by longjmp when it fails. So each call of it lies in a function that
 * sets the target, and which keeps no variable across the jump. libpng prints nothing here. */
#include <math.h>
#include <png.h>
#include <setjmp.h>
#include <stdlib.h>
#include <string.h>

#include "formats/texture/image_rows.h"

struct png_rows {
    struct fmt_rows_input *input;
    jmp_buf target;
    png_structp png;
    png_infop info;
    char message[128];
    size_t row_bytes;
    uint32_t height, next;
    bool interlaced;
    png_bytep whole; /* the decoded image, if it is interlaced */
};

/* ---- callbacks ---- */

static void on_error(png_structp png, png_const_charp text)
{
    struct png_rows *rows = png_get_error_ptr(png);
    snprintf(rows->message, sizeof rows->message, "%s", text);
    longjmp(rows->target, 1);
}

/* Ignores what libpng thinks odd but can read, such as an unusual colour profile. */
static void on_warning(png_structp png, png_const_charp text)
{
    (void)png, (void)text;
}

static png_voidp png_rows_allocate(png_structp png, png_alloc_size_t size)
{
    struct png_rows *rows = png_get_mem_ptr(png);
    struct fmt_rows_input *input = rows->input;
    void *memory = malloc(size);
    if (!memory && input->status == 0)
        input->status = bsq_fail(input->ctx, BSQ_ENOMEM, "%s: out of memory", input->path);
    return memory;
}

static void deallocate(png_structp png, png_voidp memory)
{
    (void)png;
    free(memory);
}

static const char *reason(const struct png_rows *rows)
{
    return feof(rows->input->stream) ? "the file is cut off" : rows->message;
}

/* ---- opening ---- */

/* Rounds as OpenImageIO does, so that common exponents share a table. */
static double gamma_of(const struct png_rows *rows)
{
    double exponent;
    int intent;
    if (png_get_sRGB(rows->png, rows->info, &intent) ||
        !png_get_gAMA(rows->png, rows->info, &exponent) || exponent <= 0)
        return 0;
    return (double)(roundf(100 * (float)(1 / exponent)) / 100);
}

static void png_rows_describe(struct png_rows *rows, struct fmt_rows_info *out)
{
    out->width = png_get_image_width(rows->png, rows->info);
    out->height = rows->height = png_get_image_height(rows->png, rows->info);
    out->channels = png_get_channels(rows->png, rows->info);
    out->sample_bytes = png_get_bit_depth(rows->png, rows->info) / 8;
    out->alpha = out->channels % 2 == 0 ? (int32_t)out->channels - 1 : -1;
    out->gamma = gamma_of(rows);
    rows->row_bytes = png_get_rowbytes(rows->png, rows->info);
    rows->interlaced = png_get_interlace_type(rows->png, rows->info) != PNG_INTERLACE_NONE;
    out->whole = rows->interlaced;
    out->bytes = rows->interlaced ? (uint64_t)rows->row_bytes * out->height : 0;
}

/* Expands palettes and small depths. */
static int png_rows_read_header(struct png_rows *rows, struct fmt_rows_info *out)
{
    static const uint16_t probe = 1;
    if (setjmp(rows->target))
        return -1;
    png_init_io(rows->png, rows->input->stream);
    png_read_info(rows->png, rows->info);
    png_set_expand(rows->png);
    if (*(const uint8_t *)&probe)
        png_set_swap(rows->png);
    png_set_interlace_handling(rows->png);
    png_read_update_info(rows->png, rows->info);
    png_rows_describe(rows, out);
    return 0;
}

static int open_png(struct fmt_rows_input *input, struct fmt_rows_info *info, void **state)
{
    struct png_rows *rows;
    *state = NULL;
    BSQ_PASS(BSQ_CALLOC(input->ctx, "a PNG decoder", 1, &rows));
    *state = rows;
    rows->input = input;
    rows->png = png_create_read_struct_2(PNG_LIBPNG_VER_STRING, rows, on_error, on_warning, rows,
                                         png_rows_allocate, deallocate);
    rows->info = rows->png ? png_create_info_struct(rows->png) : NULL;
    return rows->info && png_rows_read_header(rows, info) == 0
               ? 0
               : fmt_rows_fail(input, FMT_ROWS_UNREADABLE, reason(rows));
}

bool fmt_png_text(const void *state, uint32_t i, const char **name, const char **value)
{
    const struct png_rows *rows = state;
    png_textp texts = NULL;
    int count = 0;
    png_get_text(rows->png, rows->info, &texts, &count);
    if (i >= (uint32_t)count)
        return false;
    *name = texts[i].key;
    *value = texts[i].text;
    return true;
}

static void close_png(void *state)
{
    struct png_rows *rows = state;
    png_destroy_read_struct(&rows->png, &rows->info, NULL);
    free(rows->whole);
    bsq_free(rows->input->ctx, rows);
}

/* ---- rows ---- */

static int read_row(struct png_rows *rows, png_bytep row)
{
    if (setjmp(rows->target))
        return fmt_rows_fail(rows->input, FMT_ROWS_DAMAGED, reason(rows));
    png_read_row(rows->png, row, NULL);
    return 0;
}

/* The seven passes of an interlaced image go over all rows, each of which keeps earlier pixels. */
static int png_rows_read_whole(struct png_rows *rows)
{
    enum { PASSES = 7 };
    struct bsq_ctx *ctx = rows->input->ctx;
    rows->whole = calloc(rows->height, rows->row_bytes);
    if (!rows->whole)
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", rows->input->path);
    for (int pass = 0; pass < PASSES; pass++)
        for (uint32_t y = 0; y < rows->height; y++) {
            BSQ_PASS(bsq_check(ctx));
            BSQ_PASS(read_row(rows, rows->whole + y * rows->row_bytes));
        }
    return 0;
}

static int read_png(void *state, void *row)
{
    struct png_rows *rows = state;
    int status = 0;
    if (!rows->interlaced)
        return read_row(rows, row);
    if (!rows->whole)
        status = png_rows_read_whole(rows);
    if (status == 0)
        memcpy(row, rows->whole + rows->next++ * rows->row_bytes, rows->row_bytes);
    return status;
}

const struct fmt_rows_decoder fmt_png_rows = {open_png, read_png, close_png};
