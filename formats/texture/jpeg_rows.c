/* jpeg_rows.c - reads JPEG files row by row, and finds their damage.
 *
 * libjpeg makes missing or damaged parts of an image grey, and only warns of them; such warnings
 * are failures here. But in a file with all rows, up to 64 bytes before a marker and the mark of
 * its end do not matter: cameras and editors are careless with them.
 *
 * libjpeg leaves a function by longjmp when our callbacks refuse to go on. So all calls of it lie
 * in functions that set the target, and what must survive the jump lies in a struct. */
#include <setjmp.h>
#include <stdio.h>

#include <jpeglib.h>

#include <jerror.h>

#include "formats/texture/image_rows.h"

enum { MOST_STRAY_BYTES = 64, COEFFICIENTS_BYTES = 128 /* of a block */ };

struct jpeg_rows {
    struct fmt_rows_input *input;
    struct jpeg_decompress_struct jpeg;
    struct jpeg_error_mgr errors;
    struct jpeg_progress_mgr progress;
    jmp_buf target;
    bool created, started;
    JSAMPROW inks; /* a row of CMYK */
    char message[JMSG_LENGTH_MAX];
};

static struct jpeg_rows *rows_of(j_common_ptr jpeg)
{
    return jpeg->client_data;
}

/* ---- messages ---- */

static void leave_with_message(j_common_ptr jpeg)
{
    struct jpeg_rows *rows = rows_of(jpeg);
    struct fmt_rows_input *input = rows->input;
    rows->errors.format_message(jpeg, rows->message);
    if (rows->errors.msg_code == JERR_OUT_OF_MEMORY && input->status == 0)
        input->status = bsq_fail(input->ctx, BSQ_ENOMEM, "%s: out of memory", input->path);
    longjmp(rows->target, 1);
}

/* Returns whether the current warning is about damage of the image. */
static bool is_damage(const struct jpeg_rows *rows)
{
    const struct jpeg_error_mgr *errors = &rows->errors;
    switch (errors->msg_code) {
    case JWRN_EXTRANEOUS_DATA: { /* parameters: bytes, and the marker after them */
        const int marker = errors->msg_parm.i[1];
        return errors->msg_parm.i[0] > MOST_STRAY_BYTES ||
               (marker >= JPEG_RST0 && marker <= JPEG_RST0 + 7);
    }
    case JWRN_JPEG_EOF: /* without scans to come, missing rows give the next warning */
        return !rows->started || rows->jpeg.progressive_mode ||
               rows->jpeg.comps_in_scan < rows->jpeg.num_components;
    case JWRN_HIT_MARKER:
    case JWRN_HUFF_BAD_CODE:
    case JWRN_ARITH_BAD_CODE:
    case JWRN_MUST_RESYNC:
        return true;
    default: /* odd, but the image is whole */
        return false;
    }
}

/* level: -1 for a warning, otherwise a trace message. */
static void on_message(j_common_ptr jpeg, int level)
{
    if (level < 0 && is_damage(rows_of(jpeg)))
        leave_with_message(jpeg);
}

static void on_progress(j_common_ptr jpeg)
{
    struct jpeg_rows *rows = rows_of(jpeg);
    const int status = bsq_check(rows->input->ctx);
    if (status == 0)
        return;
    rows->input->status = status;
    longjmp(rows->target, 1);
}

/* ---- opening ---- */

static void jpeg_rows_start(struct jpeg_rows *rows)
{
    rows->jpeg.err = jpeg_std_error(&rows->errors);
    rows->errors.error_exit = leave_with_message;
    rows->errors.emit_message = on_message;
    rows->jpeg.client_data = rows;
    rows->created = true;
    jpeg_create_decompress(&rows->jpeg);
    jpeg_stdio_src(&rows->jpeg, rows->input->stream);
    rows->progress.progress_monitor = on_progress;
    rows->jpeg.progress = &rows->progress;
}

/* libjpeg keeps the coefficients of the whole image if a file is progressive or has a scan for each
 * component. */
static uint64_t coefficient_bytes(const struct jpeg_decompress_struct *jpeg)
{
    uint64_t bytes = 0;
    for (int c = 0; c < jpeg->num_components; c++)
        bytes += (uint64_t)jpeg->comp_info[c].width_in_blocks *
                 jpeg->comp_info[c].height_in_blocks * COEFFICIENTS_BYTES;
    return bytes;
}

static int jpeg_rows_read_header(struct jpeg_rows *rows, struct fmt_rows_info *out)
{
    struct jpeg_decompress_struct *jpeg = &rows->jpeg;
    if (setjmp(rows->target))
        return -1;
    jpeg_rows_start(rows);
    jpeg_read_header(jpeg, TRUE);
    const bool inks = jpeg->jpeg_color_space == JCS_CMYK || jpeg->jpeg_color_space == JCS_YCCK;
    if (inks)
        jpeg->out_color_space = JCS_CMYK;
    out->width = jpeg->image_width;
    out->height = jpeg->image_height;
    out->channels = inks ? 3 : (uint32_t)jpeg->num_components;
    out->sample_bytes = 1;
    out->alpha = -1;
    out->whole = jpeg_has_multiple_scans(jpeg);
    out->bytes = out->whole ? coefficient_bytes(jpeg) : 0;
    return 0;
}

static int open_jpeg(struct fmt_rows_input *input, struct fmt_rows_info *info, void **state)
{
    struct jpeg_rows *rows;
    *state = NULL;
    BSQ_PASS(BSQ_CALLOC(input->ctx, "a JPEG decoder", 1, &rows));
    *state = rows;
    rows->input = input;
    return jpeg_rows_read_header(rows, info) < 0
               ? fmt_rows_fail(input, FMT_ROWS_UNREADABLE, rows->message)
               : 0;
}

static void close_jpeg(void *state)
{
    struct jpeg_rows *rows = state;
    if (rows->created)
        jpeg_destroy_decompress(&rows->jpeg);
    bsq_free(rows->input->ctx, rows);
}

/* ---- rows ---- */

/* Inks are stored inverted: as the light that they let through. */
static void mix_inks(const JSAMPLE *inks, JDIMENSION width, uint8_t *rgb)
{
    for (JDIMENSION x = 0; x < width; x++, inks += 4)
        for (int c = 0; c < 3; c++)
            *rgb++ = (uint8_t)((inks[c] * inks[3] + 127) / 255);
}

static int read_jpeg(void *state, void *row)
{
    struct jpeg_rows *rows = state;
    struct jpeg_decompress_struct *jpeg = &rows->jpeg;
    const bool inks = jpeg->out_color_space == JCS_CMYK;
    if (setjmp(rows->target))
        return fmt_rows_fail(rows->input, FMT_ROWS_DAMAGED, rows->message);
    if (!rows->started) {
        rows->started = true;
        jpeg_start_decompress(jpeg);
        if (inks)
            rows->inks = *jpeg->mem->alloc_sarray((j_common_ptr)jpeg, JPOOL_IMAGE,
                                                  4 * jpeg->output_width, 1);
    }
    jpeg_read_scanlines(jpeg, inks ? &rows->inks : (JSAMPARRAY)&row, 1);
    if (inks)
        mix_inks(rows->inks, jpeg->output_width, row);
    if (jpeg->output_scanline == jpeg->output_height)
        jpeg_finish_decompress(jpeg);
    return rows->input->status; /* libjpeg takes a failed read for the end */
}

const struct fmt_rows_decoder fmt_jpeg_rows = {open_jpeg, read_jpeg, close_jpeg};
