/* exr_rows.c - reads OpenEXR files row by row, as formats/image does. */
#include "formats/image/exr_read.h"
#include "formats/texture/image_rows.h"

static int open_exr(struct fmt_rows_input *input, struct fmt_rows_info *info, void **state)
{
    struct fmt_exr_rows *rows;
    struct fmt_exr_size size = {0};
    const int status = fmt_exr_rows_open(input->ctx, input->path, &input->file, &size, &rows);
    *state = rows;
    *info = (struct fmt_rows_info){.width = size.width,
                                   .height = size.height,
                                   .channels = size.channels,
                                   .sample_bytes = sizeof(float),
                                   .alpha = size.channels % 2 ? -1 : (int32_t)size.channels - 1};
    return status;
}

static int read_exr(void *state, void *row)
{
    return fmt_exr_rows_read(state, row);
}

static void close_exr(void *state)
{
    fmt_exr_rows_close(state);
}

const struct fmt_rows_decoder fmt_exr_texture_rows = {open_exr, read_exr, close_exr};
