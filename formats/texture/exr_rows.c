/* exr_rows.c - reads OpenEXR files row by row, as formats/image does. */
#include "formats/image/exr_read.h"
#include "formats/texture/image_rows.h"

struct exr_rows {
    struct fmt_rows_input *input;
    struct fmt_exr_rows *rows;
};

static int open_exr(struct fmt_rows_input *input, struct fmt_rows_info *info, void **state)
{
    struct exr_rows *rows;
    struct fmt_exr_size size;
    int status = bsq_calloc(input->ctx, "an EXR decoder", 1, sizeof *rows, &rows);
    *state = rows;
    if (status < 0)
        return status;
    rows->input = input;
    BSQ_TRY(fmt_exr_rows_open(input->ctx, input->path, &input->file, &size, &rows->rows));
    *info = (struct fmt_rows_info){.width = size.width,
                                   .height = size.height,
                                   .channels = size.channels,
                                   .sample_bytes = sizeof(float),
                                   .alpha = size.channels % 2 ? -1 : (int32_t)size.channels - 1};
done:
    return status;
}

static int read_exr(void *state, void *row)
{
    const struct exr_rows *rows = state;
    return fmt_exr_rows_read(rows->rows, row);
}

static void close_exr(void *state)
{
    struct exr_rows *rows = state;
    fmt_exr_rows_close(rows->rows);
    bsq_free(rows->input->ctx, rows);
}

const struct fmt_rows_decoder fmt_exr_texture_rows = {open_exr, read_exr, close_exr};
