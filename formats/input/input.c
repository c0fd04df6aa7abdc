/* input.c - see input.h. */
#include "formats/input/input.h"

#include <inttypes.h>
#include <pthread.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include "base/file.h"
#include "formats/input/pipe.h"
#include "formats/input/spool.h"
#include "formats/input/unpack.h"
#include "formats/input/utf16.h"

struct fmt_input {
    struct bsq_ctx *ctx;
    char *path, *beside; /* beside: NULL for "." */
    bool packed;         /* or text in UTF-16: the file's bytes are not those that readers get */
    int pipe_fd;         /* -1: a file */
    uint64_t file_size;
    pthread_mutex_t lock; /* guards `users`, and opening and closing */
    unsigned users;
    struct bsq_file file; /* open while there are users; not for pipes */
    struct spool *spool;  /* of a pipe: from the first use on; of a packed file: while open */
};

/* ---- creating ---- */

bool fmt_input_is_pipe(const char *path)
{
    struct stat info;
    return strcmp(path, "-") == 0 || (stat(path, &info) == 0 && S_ISFIFO(info.st_mode));
}

static int copy_text(struct bsq_ctx *ctx, const char *text, char **out)
{
    const size_t size = strlen(text) + 1;
    int status = bsq_alloc(ctx, "name of an input", size, 1, out);
    if (!status)
        memcpy(*out, text, size);
    return status;
}

_Static_assert(UTF16_HEAD_BYTES <= PACKING_HEAD_BYTES, "one head shows both");

/* Opens a file for a moment, to learn its size and whether it is packed. */
static int examine(struct fmt_input *input)
{
    uint8_t head[PACKING_HEAD_BYTES];
    uint64_t size = 0;
    int status = bsq_file_open(input->ctx, input->path, &input->file);
    if (!status)
        status = bsq_file_read_some(input->ctx, &input->file, head, sizeof head, 0, &size);
    input->file_size = input->file.size;
    input->packed =
        !status && (fmt_packing_of(head, size) != PACKING_NONE || fmt_utf16_recognise(head, size));
    bsq_file_close(input->ctx, &input->file);
    return status;
}

int fmt_input_create(struct bsq_ctx *ctx, const char *path, const char *beside, bool pipes,
                     struct fmt_input **out)
{
    struct fmt_input *input;
    *out = NULL;
    int status = bsq_calloc(ctx, "inputs", 1, sizeof *input, &input);
    if (status)
        return status;
    input->ctx = ctx;
    input->pipe_fd = -1;
    input->file = (struct bsq_file)BSQ_FILE_CLOSED;
    pthread_mutex_init(&input->lock, NULL);
    status = copy_text(ctx, path, &input->path);
    if (!status && beside)
        status = copy_text(ctx, beside, &input->beside);
    if (!status)
        status = pipes && fmt_input_is_pipe(path) ? fmt_pipe_open(ctx, path, &input->pipe_fd)
                                                  : examine(input);
    if (status)
        fmt_input_free(input);
    else
        *out = input;
    return status;
}

void fmt_input_free(struct fmt_input *input)
{
    if (!input)
        return;
    fmt_spool_stop(input->spool);
    bsq_file_close(input->ctx, &input->file);
    if (input->pipe_fd >= 0)
        close(input->pipe_fd);
    pthread_mutex_destroy(&input->lock);
    bsq_free(input->ctx, input->path);
    bsq_free(input->ctx, input->beside);
    bsq_free(input->ctx, input);
}

static bool is_pipe(const struct fmt_input *input)
{
    return input->pipe_fd >= 0;
}

static bool is_plain(const struct fmt_input *input)
{
    return !is_pipe(input) && !input->packed;
}

const char *fmt_input_path(const struct fmt_input *input)
{
    return input->path;
}

const char *fmt_input_beside(const struct fmt_input *input)
{
    return is_pipe(input) ? "" : input->path;
}

uint64_t fmt_input_size(const struct fmt_input *input)
{
    if (is_plain(input))
        return input->file_size;
    return input->spool ? fmt_spool_size(input->spool) : UINT64_MAX;
}

/* ---- opening ---- */

static int start_spool(struct fmt_input *input)
{
    return fmt_spool_start(input->ctx, input->path, input->beside,
                           is_pipe(input) ? NULL : &input->file, input->pipe_fd, &input->spool);
}

static void end_use(struct fmt_input *input)
{
    if (!is_pipe(input)) {
        fmt_spool_stop(input->spool);
        input->spool = NULL;
    }
    bsq_file_close(input->ctx, &input->file);
}

static int begin_use(struct fmt_input *input)
{
    int status = is_pipe(input) ? 0 : bsq_file_open(input->ctx, input->path, &input->file);
    if (!status && !is_plain(input) && !input->spool)
        status = start_spool(input);
    if (status)
        end_use(input);
    return status;
}

int fmt_input_open(struct fmt_input *input)
{
    pthread_mutex_lock(&input->lock);
    int status = input->users > 0 ? 0 : begin_use(input);
    input->users += !status;
    pthread_mutex_unlock(&input->lock);
    return status;
}

int fmt_input_close(struct fmt_input *input)
{
    int status = 0;
    pthread_mutex_lock(&input->lock);
    if (input->users == 1) {
        status = is_pipe(input) ? 0 : bsq_file_check(input->ctx, &input->file);
        end_use(input);
    }
    input->users -= input->users > 0;
    pthread_mutex_unlock(&input->lock);
    return status;
}

/* ---- reading ---- */

int fmt_input_reach(struct fmt_input *input, uint64_t end, uint64_t *size)
{
    if (!is_plain(input))
        return fmt_spool_reach(input->spool, end, size);
    *size = input->file_size;
    return 0;
}

int fmt_input_read_some(struct fmt_input *input, void *buffer, uint64_t size, uint64_t offset,
                        uint64_t *got)
{
    uint64_t all = 0;
    *got = 0;
    if (is_plain(input))
        return bsq_file_read_some(input->ctx, &input->file, buffer, size, offset, got);
    int status = fmt_spool_reach(input->spool, offset + size, &all);
    if (status)
        return status;
    *got = all <= offset ? 0 : all - offset < size ? all - offset : size;
    return *got > 0 ? fmt_spool_read(input->spool, buffer, *got, offset) : 0;
}

int fmt_input_read(struct fmt_input *input, void *buffer, uint64_t size, uint64_t offset)
{
    uint64_t got;
    if (is_plain(input))
        return bsq_file_read(input->ctx, &input->file, buffer, size, offset);
    int status = fmt_input_read_some(input, buffer, size, offset, &got);
    if (!status && got < size)
        status = bsq_fail(input->ctx, BSQ_EDATA,
                          "%s: truncated: %" PRIu64 " bytes expected at byte %" PRIu64
                          " of the unpacked file, %" PRIu64 " there",
                          input->path, size, offset, got);
    return status;
}

bool fmt_input_is_plain(const struct fmt_input *input)
{
    return is_plain(input);
}

int fmt_input_whole(struct fmt_input *input, struct bsq_file *out)
{
    uint64_t size;
    *out = (struct bsq_file)BSQ_FILE_CLOSED;
    if (!is_plain(input))
        fmt_spool_keep(input->spool);
    int status = fmt_input_reach(input, UINT64_MAX, &size);
    if (status)
        return status;
    return is_plain(input) ? bsq_file_duplicate(input->ctx, &input->file, out)
                           : fmt_spool_duplicate(input->spool, out);
}

/* ---- the first bytes ---- */

/* Implements unpack_source. */
struct packed_reader {
    struct bsq_ctx *ctx;
    struct bsq_file file;
    uint64_t at;
};

static int read_packed(void *arg, void *buffer, uint64_t size, uint64_t *got)
{
    struct packed_reader *reader = arg;
    int status = bsq_file_read_some(reader->ctx, &reader->file, buffer, size, reader->at, got);
    reader->at += *got;
    return status;
}

/* Reports why a file cannot be unpacked: it was changed (BSQ_EIO), or it is damaged (BSQ_EDATA). */
static int fail_unpacking(const struct packed_reader *reader, const char *path,
                          const struct unpacker *unpacker)
{
    const int changed = bsq_file_check(reader->ctx, &reader->file);
    return changed ? changed
                   : bsq_fail(reader->ctx, BSQ_EDATA, "%s: %s", path, fmt_unpack_error(unpacker));
}

/* Unpacks the first bytes of a packed file. *taken: the packed bytes that they came from. */
static int unpack_start(struct fmt_input *input, void *buffer, uint64_t size, uint64_t *got,
                        uint64_t *taken)
{
    struct packed_reader reader = {.ctx = input->ctx, .file = BSQ_FILE_CLOSED};
    struct unpacker *unpacker = NULL;
    int status = bsq_file_open(input->ctx, input->path, &reader.file);
    if (!status)
        status = fmt_unpack_create(input->ctx, read_packed, &reader, &unpacker);
    if (!status)
        status = fmt_unpack_read(unpacker, buffer, size, got);
    if (status == BSQ_EDATA)
        status = fail_unpacking(&reader, input->path, unpacker);
    *taken = unpacker ? fmt_unpack_taken(unpacker) : 0;
    fmt_unpack_free(unpacker);
    bsq_file_close(input->ctx, &reader.file);
    return status;
}

int fmt_input_peek(struct fmt_input *input, void *buffer, uint64_t size, uint64_t *got)
{
    uint64_t taken;
    *got = 0;
    if (input->packed)
        return unpack_start(input, buffer, size, got, &taken);
    int status = fmt_input_open(input);
    if (!status)
        status = fmt_input_read_some(input, buffer, size, 0, got);
    int closed = fmt_input_close(input);
    return status ? status : closed;
}

/* ---- small files ---- */

/* Reads to the end of a file into a buffer that grows. */
static int read_to_end(struct bsq_ctx *ctx, struct unpacker *unpacker, uint64_t padding,
                       char **text, uint64_t *capacity, uint64_t *size)
{
    int status = 0;
    for (;;) {
        uint64_t got = 0;
        const uint64_t space = *capacity - padding - *size;
        status = fmt_unpack_read(unpacker, *text + *size, space, &got);
        *size += got;
        if (status || got < space)
            return status;
        status = bsq_grow(ctx, "a text file", *capacity + 1, 1, text, capacity);
        if (status)
            return status;
    }
}

int fmt_input_text(struct bsq_ctx *ctx, const char *path, uint64_t padding, char **text,
                   uint64_t *size)
{
    struct packed_reader reader = {.ctx = ctx, .file = BSQ_FILE_CLOSED};
    struct unpacker *unpacker = NULL;
    uint64_t capacity = 0;
    *text = NULL;
    *size = 0;
    int status = bsq_file_open(ctx, path, &reader.file);
    if (!status && __builtin_add_overflow(reader.file.size, padding + 1, &capacity))
        status = bsq_fail(ctx, BSQ_ENOMEM, "%s: too large", path);
    if (!status)
        status = bsq_alloc(ctx, "a text file", capacity, 1, text);
    if (!status)
        status = fmt_unpack_create(ctx, read_packed, &reader, &unpacker);
    if (!status)
        status = read_to_end(ctx, unpacker, padding, text, &capacity, size);
    if (status == BSQ_EDATA)
        status = fail_unpacking(&reader, path, unpacker);
    if (!status)
        status = bsq_file_check(ctx, &reader.file);
    fmt_unpack_free(unpacker);
    bsq_file_close(ctx, &reader.file);
    if (!status && *text) {
        memset(*text + *size, 0, padding);
    } else {
        bsq_free(ctx, *text);
        *text = NULL;
    }
    return status;
}

static int guess_packed(struct fmt_input *input, uint64_t *bytes)
{
    uint8_t *sample;
    uint64_t got = 0, taken = 0;
    int status = bsq_alloc(input->ctx, "unpacking", FMT_INPUT_SAMPLE_BYTES, 1, &sample);
    if (!status)
        status = unpack_start(input, sample, FMT_INPUT_SAMPLE_BYTES, &got, &taken);
    bsq_free(input->ctx, sample);
    const double ratio = taken > 0 ? (double)got / (double)taken : 0.0;
    *bytes = got < FMT_INPUT_SAMPLE_BYTES ? got : (uint64_t)(ratio * (double)input->file_size);
    return status;
}

int fmt_input_guess(struct fmt_input *input, uint64_t *bytes, bool *plain)
{
    *plain = is_plain(input);
    *bytes = fmt_input_size(input);
    if (input->packed)
        return guess_packed(input, bytes);
    *bytes = *bytes == UINT64_MAX ? 0 : *bytes;
    return 0;
}

bool fmt_input_given(const struct fmt_input *input, uint64_t *bytes, uint64_t *hash)
{
    return input->spool && is_pipe(input) && fmt_spool_given(input->spool, bytes, hash);
}

int fmt_input_drain(struct bsq_ctx *ctx, const char *path, uint64_t *bytes, uint64_t *hash)
{
    enum { AT_ONCE = 128 << 10 };
    uint8_t *buffer;
    uint64_t got = 1;
    int fd = -1;
    XXH3_state_t *state = XXH3_createState();
    int status = bsq_alloc(ctx, "a pipe", AT_ONCE, 1, &buffer);
    *bytes = 0;
    if (!state)
        status = bsq_fail(ctx, BSQ_ENOMEM, "%s: no memory", path);
    if (!status)
        status = fmt_pipe_open(ctx, path, &fd);
    if (!status)
        XXH3_64bits_reset(state);
    while (!status && got > 0) {
        status = fmt_pipe_read(ctx, path, fd, NULL, buffer, AT_ONCE, &got);
        if (!status)
            XXH3_64bits_update(state, buffer, got);
        *bytes += got;
    }
    *hash = status ? 0 : XXH3_64bits_digest(state);
    if (fd >= 0)
        close(fd);
    bsq_free(ctx, buffer);
    XXH3_freeState(state);
    return status;
}
