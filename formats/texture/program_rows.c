/* program_rows.c - runs the program that decodes an image, and takes its rows from a pipe.
 *
 * Damaged images make OpenImageIO, libtiff and the libraries below them crash, loop, or take any
 * amount of memory. That is then a line on this image. */
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "formats/texture/image_rows.h"

/* Processor time in seconds that the program may take: LEAST_SECONDS for any file, and a second
 * more for each BYTES_A_SECOND of it, and what it adds itself for the texels. */
enum { LEAST_SECONDS = 30, BYTES_A_SECOND = 1 << 18 };
/* Memory that decoders take for themselves. */
#define OWN_BYTES (UINT64_C(64) << 20)

struct program_rows {
    struct fmt_rows_input *input;
    pid_t process; /* 0: none */
    int pipe;
    uint64_t memory_bytes, seconds; /* the program's limits */
    size_t row_bytes;
};

/* Reads up to `size` bytes; fewer only at the end of the pipe. */
static int read_pipe(struct program_rows *rows, void *to, size_t size, size_t *got)
{
    uint64_t part = 1;
    *got = 0;
    while (*got < size && part > 0) {
        const int status = bsq_pipe_read(rows->input->ctx, rows->pipe, rows->input->path,
                                         (char *)to + *got, size - *got, &part);
        if (status < 0)
            return status;
        *got += part;
    }
    return 0;
}

static const char *library(const struct fmt_rows_input *input)
{
    return input->plugin[0] ? "OpenImageIO" : "libtiff";
}

/* Waits for the end of a program that gave no row, and reports it. */
static int fail_program(struct program_rows *rows, bool has_text)
{
    struct fmt_program_end end = {.state = -1};
    char text[256];
    size_t got = 0;
    const int status = has_text ? read_pipe(rows, text, sizeof text - 1, &got) : 0;
    if (status < 0)
        return status;
    text[got] = '\0';
    fmt_program_finish(rows->input->ctx, rows->process, has_text ? 1 : INFINITY, &end);
    rows->process = 0;
    if (bsq_check(rows->input->ctx) < 0)
        return BSQ_EINTR;
    return fmt_program_fail(rows->input->ctx, rows->input->path, library(rows->input), &end, text,
                            rows->seconds, rows->memory_bytes);
}

/* Reads a mark and what follows it. */
static int take(struct program_rows *rows, void *to, size_t size)
{
    char mark = 0;
    size_t got;
    int status;
    if (rows->process == 0)
        return bsq_fail(rows->input->ctx, BSQ_EBUG, "%s: is read after its end", rows->input->path);
    BSQ_TRY(read_pipe(rows, &mark, 1, &got));
    if (mark == FMT_ROWS_GOOD) {
        BSQ_TRY(read_pipe(rows, to, size, &got));
        if (got == size)
            return 0;
    }
    status = fail_program(rows, mark == FMT_ROWS_BAD);
done:
    return status;
}

static int start(struct program_rows *rows, char *program)
{
    struct fmt_rows_input *input = rows->input;
    struct bsq_ctx *ctx = input->ctx;
    char memory[24], seconds[24];
    int ends[2];
    rows->memory_bytes = input->program_bytes > 0 ? input->program_bytes : bsq_memory_left(ctx);
    rows->seconds = LEAST_SECONDS + input->file.size / BYTES_A_SECOND;
    snprintf(memory, sizeof memory, "%" PRIu64, rows->memory_bytes + OWN_BYTES);
    snprintf(seconds, sizeof seconds, "%" PRIu64, rows->seconds);
    char *const arguments[] = {program, (char *)(uintptr_t)input->plugin, memory, seconds, NULL};
    if (pipe2(ends, O_CLOEXEC) != 0)
        return bsq_fail_errno(ctx, BSQ_ENOINPUT, errno, "%s", input->path);
    rows->pipe = ends[0];
    const int error = fmt_program_start(arguments, input->file.fd, ends[1], &rows->process);
    close(ends[1]);
    if (error == 0)
        return 0;
    rows->process = 0;
    return fmt_program_fail(ctx, input->path, library(input),
                            &(struct fmt_program_end){.error = error}, "", 0, 0);
}

static int open_program(struct fmt_rows_input *input, struct fmt_rows_info *info, void **state)
{
    static const char purpose[] = "textures of this format";
    struct bsq_ctx *ctx = input->ctx;
    struct program_rows *rows;
    struct fmt_rows_head head;
    char program[PATH_MAX];
    int status;
    BSQ_TRY(bsq_calloc(ctx, "a texture's decoder", 1, sizeof *rows, &rows));
    *state = rows;
    *rows = (struct program_rows){.input = input, .pipe = -1};
    BSQ_TRY(fmt_program_find(ctx, input->program, purpose, program));
    if (input->plugin[0]) /* libtiff has few libraries */
        BSQ_TRY(fmt_program_check(ctx, purpose));
    BSQ_TRY(start(rows, program));
    BSQ_TRY(take(rows, &head, sizeof head));
    if (strncmp(head.stamp, fmt_program_stamp, sizeof head.stamp) != 0)
        return bsq_fail(ctx, BSQ_ENOINPUT,
                        "%s need the program %s, which is of another build than this program (%s)",
                        purpose, program, fmt_program_stamp);
    *info = head.info;
    rows->row_bytes = (size_t)info->width * info->channels * info->sample_bytes;
done:
    return status;
}

static int read_program(void *state, void *row)
{
    struct program_rows *rows = state;
    return take(rows, row, rows->row_bytes);
}

static void close_program(void *state)
{
    struct program_rows *rows = state;
    struct fmt_program_end end = {.state = -1};
    if (rows->pipe >= 0)
        close(rows->pipe);
    if (rows->process > 0) /* its work is done, or nobody wants it any more */
        fmt_program_finish(NULL, rows->process, 0, &end);
    bsq_free(rows->input->ctx, rows);
}

const struct fmt_rows_decoder fmt_program_rows = {open_program, read_program, close_program};
