/* program_rows.c - runs the program that decodes an image into a temporary file, and takes its rows
 * from there.
 *
 * Damaged images make OpenImageIO, libtiff and the libraries below them crash, loop, or take any
 * amount of memory. That is then a line on this image. */
#include "formats/texture/image_rows.h"

/* Processor time in seconds that the program may take: LEAST_SECONDS for any file, and a second
 * more for each BYTES_A_SECOND of it, and what it adds itself for the texels. */
enum { LEAST_SECONDS = 30, BYTES_A_SECOND = 1 << 18 };

struct program_rows {
    struct bsq_ctx *ctx;
    struct bsq_file file; /* temporary: struct fmt_rows_info, and the rows */
    uint64_t at, row_bytes;
};

/* Lets the program decode the image. It gets half of the memory that is left, as texels need some
 * too, or its share of that. */
static int program_rows_run(const struct fmt_rows_input *input, struct bsq_file *out,
                            struct fmt_rows_info *info)
{
    struct bsq_ctx *ctx = input->ctx;
    const uint64_t bytes = bsq_memory_left(ctx) / 2 / input->sharers;
    const struct fmt_converter how = {.program = input->program,
                                      .purpose = "textures of this format",
                                      .library = input->plugin[0] ? "OpenImageIO" : "libtiff",
                                      .path = input->path,
                                      .option = (char *)(uintptr_t)input->plugin,
                                      .memory = bytes,
                                      .seconds = LEAST_SECONDS + input->file.size / BYTES_A_SECOND};
    if (input->plugin[0]) /* libtiff has few libraries */
        BSQ_PASS(fmt_program_check(ctx, how.purpose));
    BSQ_PASS(bsq_file_temp(ctx, NULL, "a decoded image", out));
    BSQ_PASS(bsq_reserve(ctx, "decoding a texture", bytes));
    const int status = fmt_program_convert(ctx, &how, input->file.fd, out);
    bsq_release(ctx, bytes);
    BSQ_PASS(status);
    if (out->size >= sizeof *info)
        BSQ_PASS(bsq_file_read(ctx, out, info, sizeof *info, 0));
    const uint64_t texels = (uint64_t)info->width * info->height;
    return out->size == sizeof *info + texels * info->channels * info->sample_bytes
               ? 0
               : fmt_program_misfit(ctx, &how);
}

static int open_program(struct fmt_rows_input *input, struct fmt_rows_info *info, void **state)
{
    struct program_rows *rows;
    BSQ_PASS(BSQ_CALLOC(input->ctx, "a texture's decoder", 1, &rows));
    *state = rows;
    *rows = (struct program_rows){.ctx = input->ctx, .file = BSQ_FILE_CLOSED, .at = sizeof *info};
    BSQ_PASS(program_rows_run(input, &rows->file, info));
    rows->row_bytes = (uint64_t)info->width * info->channels * info->sample_bytes;
    return 0;
}

static int read_program(void *state, void *row)
{
    struct program_rows *rows = state;
    const int status = bsq_file_read(rows->ctx, &rows->file, row, rows->row_bytes, rows->at);
    rows->at += rows->row_bytes;
    return status;
}

static void close_program(void *state)
{
    struct program_rows *rows = state;
    bsq_file_close(rows->ctx, &rows->file);
    bsq_free(rows->ctx, rows);
}

const struct fmt_rows_decoder fmt_program_rows = {open_program, read_program, close_program};
