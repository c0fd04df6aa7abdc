/* jpeg_check.c - finds damage in JPEG files.
 *
 * libjpeg leaves a function by longjmp when our callbacks refuse to go on. So all calls of it lie
 * in a function that sets the target, and what must survive the jump lies in a struct. */
#include "formats/texture/jpeg_check.h"

#include <setjmp.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include <jpeglib.h>

#include <jerror.h>

enum { MOST_STRAY_BYTES = 64 };

struct jpeg_check {
    struct jpeg_decompress_struct jpeg;
    struct jpeg_error_mgr errors;
    struct jpeg_source_mgr input;
    struct jpeg_progress_mgr progress;
    jmp_buf target;
    const struct fmt_jpeg_source *source;
    uint64_t offset; /* of the bytes after those in `buffer` */
    int failure;     /* of the source, or 0 */
    char *message;
    JOCTET buffer[16384];
};

static struct jpeg_check *check_of(j_common_ptr jpeg)
{
    return jpeg->client_data;
}

/* ---- messages ---- */

static void leave_with_message(j_common_ptr jpeg)
{
    struct jpeg_check *check = check_of(jpeg);
    check->errors.format_message(jpeg, check->message);
    longjmp(check->target, 1);
}

/* Returns whether the current warning is about damage of the image. */
static bool is_damage(const struct jpeg_check *check)
{
    const struct jpeg_error_mgr *errors = &check->errors;
    switch (errors->msg_code) {
    case JWRN_EXTRANEOUS_DATA: { /* parameters: bytes, and the marker after them */
        const int marker = errors->msg_parm.i[1];
        return errors->msg_parm.i[0] > MOST_STRAY_BYTES ||
               (marker >= JPEG_RST0 && marker <= JPEG_RST0 + 7);
    }
    case JWRN_JPEG_EOF: /* without scans to come, missing rows give the next warning */
        return check->jpeg.progressive_mode ||
               check->jpeg.comps_in_scan < check->jpeg.num_components;
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
    if (level < 0 && is_damage(check_of(jpeg)))
        leave_with_message(jpeg);
}

/* ---- input ---- */

static void leave_with_failure(struct jpeg_check *check, int failure)
{
    check->failure = failure;
    longjmp(check->target, 1);
}

static void do_nothing(j_decompress_ptr jpeg)
{
    (void)jpeg;
}

/* Reads the next bytes. At the end of the file, gives the marker of the end of an image. */
static boolean fill_buffer(j_decompress_ptr jpeg)
{
    static const JOCTET end[] = {0xff, JPEG_EOI};
    struct jpeg_check *check = check_of((j_common_ptr)jpeg);
    uint64_t got = 0;
    const int failure = check->source->read(check->source->arg, check->offset, check->buffer,
                                            sizeof check->buffer, &got);
    if (failure)
        leave_with_failure(check, failure);
    if (got == 0) {
        WARNMS(jpeg, JWRN_JPEG_EOF);
        memcpy(check->buffer, end, sizeof end);
    }
    check->offset += got;
    check->input.next_input_byte = check->buffer;
    check->input.bytes_in_buffer = got ? (size_t)got : sizeof end;
    return TRUE;
}

static void skip_bytes(j_decompress_ptr jpeg, long count)
{
    struct jpeg_check *check = check_of((j_common_ptr)jpeg);
    struct jpeg_source_mgr *input = &check->input;
    if (count <= 0)
        return;
    const size_t here =
        (size_t)count < input->bytes_in_buffer ? (size_t)count : input->bytes_in_buffer;
    input->next_input_byte += here;
    input->bytes_in_buffer -= here;
    check->offset += (uint64_t)count - here;
}

static void on_progress(j_common_ptr jpeg)
{
    struct jpeg_check *check = check_of(jpeg);
    const int failure = check->source->check(check->source->arg);
    if (failure)
        leave_with_failure(check, failure);
}

/* ---- decoding ---- */

static void start(struct jpeg_check *check)
{
    check->jpeg.err = jpeg_std_error(&check->errors);
    check->errors.error_exit = leave_with_message;
    check->errors.emit_message = on_message;
    check->jpeg.client_data = check;
    jpeg_create_decompress(&check->jpeg);
    check->input = (struct jpeg_source_mgr){.init_source = do_nothing,
                                            .fill_input_buffer = fill_buffer,
                                            .skip_input_data = skip_bytes,
                                            .resync_to_restart = jpeg_resync_to_restart,
                                            .term_source = do_nothing};
    check->jpeg.src = &check->input;
    check->progress.progress_monitor = on_progress;
    check->jpeg.progress = &check->progress;
}

static void decode(struct jpeg_check *check)
{
    struct jpeg_decompress_struct *jpeg = &check->jpeg;
    if (setjmp(check->target))
        return;
    start(check);
    jpeg_read_header(jpeg, TRUE);
    jpeg->scale_num = 1;
    jpeg->scale_denom = 8;
    jpeg->out_color_space = jpeg->jpeg_color_space; /* colours do not matter */
    jpeg->do_fancy_upsampling = FALSE;
    jpeg_start_decompress(jpeg);
    JSAMPARRAY row =
        jpeg->mem->alloc_sarray((j_common_ptr)jpeg, JPOOL_IMAGE,
                                jpeg->output_width * (JDIMENSION)jpeg->output_components, 1);
    while (jpeg->output_scanline < jpeg->output_height)
        jpeg_read_scanlines(jpeg, row, 1);
    jpeg_finish_decompress(jpeg);
}

int fmt_jpeg_check(const struct fmt_jpeg_source *source, char message[FMT_JPEG_MESSAGE])
{
    _Static_assert(FMT_JPEG_MESSAGE >= JMSG_LENGTH_MAX, "libjpeg's longest message");
    struct jpeg_check check;
    memset(&check, 0, offsetof(struct jpeg_check, buffer));
    check.source = source;
    check.message = message;
    message[0] = '\0';
    decode(&check);
    jpeg_destroy_decompress(&check.jpeg);
    return check.failure;
}
