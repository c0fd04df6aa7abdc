/* input.c - see input.h.
 *
 * Bytes that are unpacked go to a temporary file, whoever wants them: the steps of a pipeline that
 * cut a file into parts run beside those that parse it, so both cores are busy without a thread
 * for unpacking.
 *
 * The temporary file of a packed file is a ring: byte n of the unpacked stream is at
 * n % RING_BYTES, and new bytes replace old ones. So its pages stay in memory, and a large scan
 * takes no more space. Whoever wants bytes that were replaced unpacks the file again; from then on
 * the temporary file holds all of it. What came through a pipe cannot come again, so it is all kept
 * from the start. */
#include "formats/input/input.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <pthread.h>
#include <stdatomic.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/text.h"
#include "formats/input/unpack.h"

/* Bytes that are unpacked at once, and kept. Fuzz targets unpack their small files in several steps
 * too. */
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION
enum { STEP_BYTES = 1 << 10, RING_BYTES = 16 << 10 };
#else
enum { STEP_BYTES = 256 << 10, RING_BYTES = 128 << 20 };
#endif
/* The free space of the disk is checked again after this number of bytes. */
#define DISK_STEP_BYTES ((uint64_t)64 << 20)

struct fmt_input {
    struct bsq_ctx *ctx;
    char *path, *beside; /* beside: NULL for "." */
    bool named;          /* other files may be beside it */
    bool packed;
    const struct bsq_source *source; /* NULL: a file or a pipe */
    int pipe_fd;                     /* -1: a file, or a source */
    atomic_uint_least64_t size;      /* of all that readers get; UINT64_MAX: not known yet */

    pthread_mutex_t lock; /* held while somebody opens, closes or unpacks */
    unsigned users;
    struct bsq_file file; /* open while there are users; not for pipes */
    /* Of a pipe: from the first use on; of a packed file: while open. */
    struct unpacker *unpacker;
    uint64_t taken; /* packed bytes that were read */

    pthread_rwlock_t stored_lock; /* written to with `lock` held; guards all below */
    struct bsq_file temp;
    uint64_t stored; /* unpacked bytes that were written to `temp` */
    bool whole;      /* `temp` is no ring */
    int status;      /* 1: more bytes can be unpacked; 0: these are all; < 0: why no more come */
};

static bool is_pipe(const struct fmt_input *input)
{
    return input->pipe_fd >= 0;
}

bool fmt_input_is_plain(const struct fmt_input *input)
{
    return !is_pipe(input) && !input->packed;
}

/* ---- packed bytes ---- */

bool fmt_input_is_pipe(const char *path)
{
    struct stat info;
    return strcmp(path, "-") == 0 || (stat(path, &info) == 0 && S_ISFIFO(info.st_mode));
}

/* Does not wait for a writer. */
static int open_pipe(struct fmt_input *input)
{
    const char *path = input->path;
    input->pipe_fd =
        strcmp(path, "-") == 0
            ? fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, STDERR_FILENO + 1)
            : bsq_fd_above_standard(open(path, O_RDONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC));
    return is_pipe(input) ? 0 : bsq_fail_errno(input->ctx, BSQ_ENOINPUT, errno, "%s", path);
}

/* Implements unpack_source. */
static int read_packed(void *arg, void *buffer, uint64_t size, uint64_t *got)
{
    struct fmt_input *input = arg;
    int status =
        is_pipe(input)
            ? bsq_pipe_read(input->ctx, input->pipe_fd, input->path, buffer, size, got)
            : bsq_file_read_some(input->ctx, &input->file, buffer, size, input->taken, got);
    input->taken += status == 0 ? *got : 0;
    return status;
}

/* ---- unpacked bytes ---- */

/* Returns the first byte that the temporary file still has. */
static uint64_t first_kept(const struct fmt_input *input)
{
    return input->whole || input->stored <= RING_BYTES ? 0 : input->stored - RING_BYTES;
}

/* Reads bytes of the temporary file, which may be a ring. */
static int read_stored(const struct fmt_input *input, uint8_t *to, uint64_t size, uint64_t offset)
{
    const uint64_t at = input->whole ? offset : offset % RING_BYTES;
    const uint64_t before = input->whole || size < RING_BYTES - at ? size : RING_BYTES - at;
    BSQ_PASS(bsq_file_read(input->ctx, &input->temp, to, before, at));
    if (before < size)
        BSQ_PASS(bsq_file_read(input->ctx, &input->temp, to + before, size - before, 0));
    return 0;
}

/* Appends bytes to the temporary file. Before each DISK_STEP_BYTES after the first ones, twice as
 * much space must be free, so that no stream fills the disk. */
static int store(struct fmt_input *input, const uint8_t *bytes, uint64_t size)
{
    const uint64_t end = input->stored + size;
    const uint64_t at = input->whole ? input->stored : input->stored % RING_BYTES;
    const uint64_t before = input->whole || size < RING_BYTES - at ? size : RING_BYTES - at;
    const bool grows = input->whole || input->stored < RING_BYTES;
    if (grows && input->stored > 0 && input->stored / DISK_STEP_BYTES != end / DISK_STEP_BYTES)
        BSQ_PASS(bsq_require_disk(input->ctx, input->beside, 2 * DISK_STEP_BYTES));
    BSQ_PASS(bsq_file_write(input->ctx, &input->temp, bytes, before, at));
    if (before < size)
        BSQ_PASS(bsq_file_write(input->ctx, &input->temp, bytes + before, size - before, 0));
    input->stored = end;
    return 0;
}

/* Unpacks the next bytes, and stores those before a damage, too. */
static void unpack_step(struct fmt_input *input)
{
    const uint8_t *bytes;
    uint64_t size = 0;
    int status = bsq_check(input->ctx);
    if (status == 0)
        status = fmt_unpack_next(input->unpacker, &bytes, &size);
    pthread_rwlock_wrlock(&input->stored_lock);
    if (size > 0 && (status >= 0 || status == BSQ_EDATA)) {
        const int stored = store(input, bytes, size);
        status = stored < 0 ? stored : status;
    }
    input->status = status;
    if (status == 0)
        input->size = input->stored;
    pthread_rwlock_unlock(&input->stored_lock);
}

/* Starts to unpack from the first byte on. The lock is held. */
static int start_unpacking(struct fmt_input *input, bool whole)
{
    int status = 0;
    pthread_rwlock_wrlock(&input->stored_lock);
    fmt_unpack_free(input->unpacker);
    input->unpacker = NULL;
    input->taken = input->stored = 0;
    input->whole = whole;
    if (input->temp.fd < 0)
        BSQ_TRY(bsq_file_temp(input->ctx, input->beside, "an unpacked mesh", &input->temp));
    BSQ_TRY(fmt_unpack_create(input->ctx, read_packed, input, STEP_BYTES, &input->unpacker));
done:
    input->status = status < 0 ? status : 1;
    pthread_rwlock_unlock(&input->stored_lock);
    return status;
}

/* Has all bytes kept. Unpacks again if some were replaced. */
static int keep_all(struct fmt_input *input)
{
    int status = 0;
    pthread_mutex_lock(&input->lock);
    if (first_kept(input) > 0)
        status = start_unpacking(input, true);
    pthread_rwlock_wrlock(&input->stored_lock);
    input->whole = true;
    pthread_rwlock_unlock(&input->stored_lock);
    pthread_mutex_unlock(&input->lock);
    return status;
}

/* Unpacks until `end` bytes are stored, or all. Damage is described here, for the reader that
 * wanted the bytes. */
static int unpack_until(struct fmt_input *input, uint64_t end)
{
    pthread_mutex_lock(&input->lock);
    while (input->stored < end && input->status > 0)
        unpack_step(input);
    int status = input->stored < end && input->status < 0 ? input->status : 0;
    if (status == BSQ_EDATA) {
        const int changed = is_pipe(input) ? 0 : bsq_file_check(input->ctx, &input->file);
        status = changed ? changed
                         : bsq_fail(input->ctx, BSQ_EDATA, "%s: %s", input->path,
                                    fmt_unpack_error(input->unpacker));
    }
    pthread_mutex_unlock(&input->lock);
    return status;
}

/* ---- creating ---- */

/* Opens a file for a moment, to learn its size and whether it is packed. */
static int input_examine(struct fmt_input *input)
{
    uint8_t head[UNPACK_HEAD_BYTES];
    uint64_t size = 0;
    int status = 0;
    BSQ_TRY(bsq_file_open(input->ctx, input->path, &input->file));
    BSQ_TRY(bsq_file_read_some(input->ctx, &input->file, head, sizeof head, 0, &size));
    input->packed = fmt_unpack_recognise(head, size);
    if (!input->packed)
        input->size = input->file.size;
done:
    bsq_file_close(input->ctx, &input->file);
    return status;
}

static int input_create(struct bsq_ctx *ctx, const char *path, const char *beside, bool pipes,
                        const struct bsq_source *source, struct fmt_input **out)
{
    struct fmt_input *input;
    int status = 0;
    *out = NULL;
    BSQ_PASS(BSQ_CALLOC(ctx, "inputs", 1, &input));
    input->ctx = ctx;
    input->source = source;
    input->pipe_fd = -1;
    input->size = UINT64_MAX;
    input->file = input->temp = (struct bsq_file)BSQ_FILE_CLOSED;
    pthread_mutex_init(&input->lock, NULL);
    pthread_rwlock_init(&input->stored_lock, NULL);
    BSQ_TRY(bsq_text_copy(ctx, path, &input->path));
    BSQ_TRY(bsq_text_copy(ctx, beside, &input->beside));
    if (source)
        input->size = source->bytes;
    else
        BSQ_TRY(pipes && fmt_input_is_pipe(path) ? open_pipe(input) : input_examine(input));
    input->named = !source && !is_pipe(input);
    *out = input;
done:
    if (status < 0)
        fmt_input_free(input);
    return status;
}

int fmt_input_create(struct bsq_ctx *ctx, const char *path, const char *beside, bool pipes,
                     struct fmt_input **out)
{
    return input_create(ctx, path, beside, pipes, NULL, out);
}

int fmt_input_create_source(struct bsq_ctx *ctx, const char *name, const struct bsq_source *source,
                            struct fmt_input **out)
{
    BSQ_PASS(bsq_check_size(ctx, "bsq_source", source->size, sizeof *source));
    return input_create(ctx, name, NULL, false, source, out);
}

/* Drops what was unpacked. */
static void end_use(struct fmt_input *input)
{
    fmt_unpack_free(input->unpacker);
    input->unpacker = NULL;
    bsq_file_close(input->ctx, &input->temp);
    bsq_file_close(input->ctx, &input->file);
}

void fmt_input_free(struct fmt_input *input)
{
    if (!input)
        return;
    end_use(input);
    if (is_pipe(input))
        close(input->pipe_fd);
    pthread_rwlock_destroy(&input->stored_lock);
    pthread_mutex_destroy(&input->lock);
    BSQ_FREE(input->ctx, input->path, input->beside, input);
}

const char *fmt_input_path(const struct fmt_input *input)
{
    return input->path;
}

const char *fmt_input_beside(const struct fmt_input *input)
{
    return input->named ? input->path : "";
}

uint64_t fmt_input_size(const struct fmt_input *input)
{
    return input->size;
}

/* ---- opening ---- */

static int begin_use(struct fmt_input *input)
{
    int status = 0;
    if (!is_pipe(input) && !input->source)
        BSQ_TRY(bsq_file_open(input->ctx, input->path, &input->file));
    if (!fmt_input_is_plain(input) && !input->unpacker)
        BSQ_TRY(start_unpacking(input, is_pipe(input)));
done:
    if (status < 0)
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
    if (input->users == 1 && !is_pipe(input)) {
        status = input->source ? 0 : bsq_file_check(input->ctx, &input->file);
        end_use(input);
        if (input->packed)
            input->size = UINT64_MAX;
    }
    input->users -= input->users > 0;
    pthread_mutex_unlock(&input->lock);
    return status;
}

/* ---- reading ---- */

/* Reads up to `size` bytes that a callback gives. */
static int read_source(const struct fmt_input *input, void *buffer, uint64_t size, uint64_t offset,
                       uint64_t *got)
{
    const struct bsq_source *source = input->source;
    const uint64_t left = offset < source->bytes ? source->bytes - offset : 0;
    *got = size < left ? size : left;
    const int status = *got > 0 ? source->read(source->user, buffer, *got, offset) : 0;
    return status < 0 ? bsq_fail(input->ctx, status, "%s: the callback failed", input->path) : 0;
}

int fmt_input_reach(struct fmt_input *input, uint64_t end, uint64_t *size)
{
    int status = fmt_input_is_plain(input) ? 0 : unpack_until(input, end);
    *size = input->size;
    return status;
}

int fmt_input_read_some(struct fmt_input *input, void *buffer, uint64_t size, uint64_t offset,
                        uint64_t *got)
{
    const uint64_t end = size < UINT64_MAX - offset ? offset + size : UINT64_MAX;
    *got = 0;
    if (input->source)
        return read_source(input, buffer, size, offset, got);
    if (fmt_input_is_plain(input))
        return bsq_file_read_some(input->ctx, &input->file, buffer, size, offset, got);
    for (bool read = false; !read;) {
        BSQ_PASS(unpack_until(input, end));
        pthread_rwlock_rdlock(&input->stored_lock);
        const bool come = input->stored >= end || input->status <= 0;
        read = come && first_kept(input) <= offset;
        *got = input->stored <= offset ? 0 : input->stored - offset;
        *got = *got < size ? *got : size;
        const int status = read && *got > 0 ? read_stored(input, buffer, *got, offset) : 0;
        pthread_rwlock_unlock(&input->stored_lock);
        BSQ_PASS(status);
        if (come && !read)
            BSQ_PASS(keep_all(input));
    }
    return 0;
}

int fmt_input_read(struct fmt_input *input, void *buffer, uint64_t size, uint64_t offset)
{
    uint64_t got;
    if (fmt_input_is_plain(input) && !input->source)
        return bsq_file_read(input->ctx, &input->file, buffer, size, offset);
    BSQ_PASS(fmt_input_read_some(input, buffer, size, offset, &got));
    if (got < size && !is_pipe(input) &&
        !input->source) /* it may have been changed before it was unpacked again */
        BSQ_PASS(bsq_file_check(input->ctx, &input->file));
    if (got < size)
        return bsq_fail(input->ctx, BSQ_EDATA,
                        "%s: truncated: %" PRIu64 " bytes expected at byte %" PRIu64
                        " of the %s, %" PRIu64 " there",
                        input->path, size, offset, input->source ? "input" : "unpacked file", got);
    return 0;
}

int fmt_input_whole(struct fmt_input *input, struct bsq_file *out)
{
    *out = (struct bsq_file)BSQ_FILE_CLOSED;
    if (input->source)
        return bsq_fail(input->ctx, BSQ_EDATA,
                        "%s: a callback can give OBJ, PLY and STL meshes only", input->path);
    if (fmt_input_is_plain(input))
        return bsq_file_duplicate(input->ctx, &input->file, out);
    BSQ_PASS(keep_all(input));
    BSQ_PASS(unpack_until(input, UINT64_MAX));
    const struct bsq_file named = {
        .fd = input->temp.fd, .size = input->stored, .path = input->path};
    return bsq_file_duplicate(input->ctx, &named, out);
}

int fmt_input_peek(struct fmt_input *input, void *buffer, uint64_t size, uint64_t *got)
{
    *got = 0;
    BSQ_PASS(fmt_input_open(input));
    int status = fmt_input_read_some(input, buffer, size, 0, got);
    const int closed = fmt_input_close(input);
    return status ? status : closed;
}

int fmt_input_text(struct bsq_ctx *ctx, const char *path, uint64_t padding, char **text,
                   uint64_t *size)
{
    struct fmt_input *input = NULL;
    int status = 0;
    *text = NULL;
    BSQ_TRY(fmt_input_create(ctx, path, NULL, false, &input));
    BSQ_TRY(fmt_input_open(input));
    BSQ_TRY(fmt_input_reach(input, UINT64_MAX, size));
    BSQ_TRY(bsq_alloc(ctx, "a text file", *size + padding + 1, 1, text));
    BSQ_TRY(fmt_input_read(input, *text, *size, 0));
    BSQ_TRY(fmt_input_close(input));
    memset(*text + *size, 0, padding);
done:
    if (status < 0) {
        bsq_free(ctx, *text);
        *text = NULL;
    }
    fmt_input_free(input);
    return status;
}
