/* spool.c - see spool.h.
 *
 * The temporary file is a ring: byte n of the unpacked stream is at n % RING_BYTES, and new bytes
 * replace old ones. So its pages stay in memory, and a large scan takes no more space. Who wants
 * bytes that were replaced starts the stream again; from then on the file holds all of it. What
 * came through a pipe cannot come again, so it is all kept from the start. */
#include <errno.h>
#include <pthread.h>
#include <string.h>
#include <xxhash.h>

#include "base/parallel.h"
#include "formats/input/pipe.h"
#include "formats/input/spool.h"
#include "formats/input/unpack.h"

/* Bytes that are unpacked ahead of what readers have requested, and at once. Fuzz targets unpack
 * their small files in several steps too. */
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION
enum { AHEAD_BYTES = 4 << 10, STEP_BYTES = 1 << 10, RING_BYTES = 16 << 10 };
#else
enum { AHEAD_BYTES = 4 << 20, STEP_BYTES = 256 << 10, RING_BYTES = 128 << 20 };
#endif
/* The free space of the disk is checked again after this number of bytes. */
#define DISK_STEP_BYTES ((uint64_t)64 << 20)

struct spool {
    struct bsq_ctx *ctx;
    const char *path, *beside;
    const struct bsq_file *file; /* NULL: a pipe */
    int pipe_fd;
    struct bsq_file temp;
    struct unpacker *unpacker;
    uint8_t *buffer; /* STEP_BYTES */
    XXH3_state_t *hash;
    uint64_t taken;  /* packed bytes that were read */
    uint64_t stored; /* unpacked bytes that were written to the file */
    pthread_t thread;
    bool has_thread, has_lock;
    atomic_bool stop;

    pthread_mutex_t lock; /* guards all below */
    pthread_cond_t arrived, requested;
    uint64_t done, wanted; /* bytes that were unpacked; bytes that readers have requested */
    uint64_t size;         /* of all; UINT64_MAX: not known yet */
    unsigned starts;       /* how often the stream was started again */
    bool whole, again;     /* the file is no ring; the stream is to be started again */
    bool ended;
    int status; /* of the thread; the spool has `done` bytes and no more */
};

/* ---- packed bytes ---- */

/* Implements unpack_source. */
static int read_packed(void *arg, void *buffer, uint64_t size, uint64_t *got)
{
    struct spool *spool = arg;
    int status = spool->file
                     ? bsq_file_read_some(spool->ctx, spool->file, buffer, size, spool->taken, got)
                     : fmt_pipe_read(spool->ctx, spool->path, spool->pipe_fd, &spool->stop, buffer,
                                     size, got);
    if (status)
        return status;
    spool->taken += *got;
    if (spool->hash)
        XXH3_64bits_update(spool->hash, buffer, *got);
    return 0;
}

/* ---- the thread ---- */

/* Returns whether there is nothing to do, or nothing that readers want yet. The lock is held. */
static bool is_idle(const struct spool *spool)
{
    if (spool->stop || spool->again)
        return false;
    return spool->ended || spool->status ||
           (spool->done >= spool->wanted && spool->done - spool->wanted >= AHEAD_BYTES);
}

/* Waits until readers want more. Returns false if the thread must stop. */
static bool wait_for_request(struct spool *spool)
{
    pthread_mutex_lock(&spool->lock);
    while (is_idle(spool))
        pthread_cond_wait(&spool->requested, &spool->lock);
    bool stop = spool->stop;
    pthread_mutex_unlock(&spool->lock);
    return !stop;
}

/* Starts the stream again if a reader asked for it. *whole: whether the file is no ring. */
static int start_again(struct spool *spool, bool *whole)
{
    int status = 0;
    pthread_mutex_lock(&spool->lock);
    *whole = spool->whole;
    if (spool->again) {
        fmt_unpack_free(spool->unpacker);
        spool->unpacker = NULL;
        status = fmt_unpack_create(spool->ctx, read_packed, spool, &spool->unpacker);
        spool->again = false;
        spool->starts++;
        spool->taken = spool->stored = spool->done = 0;
        spool->ended = false;
        spool->status = status;
    }
    pthread_mutex_unlock(&spool->lock);
    return status;
}

/* Moves the next bytes to the temporary file. Before each DISK_STEP_BYTES after the first ones,
 * twice as much space must be free, so that no stream fills the disk. */
static int unpack_step(struct spool *spool, bool whole, uint64_t *got)
{
    int status = fmt_unpack_read(spool->unpacker, spool->buffer, STEP_BYTES, got);
    const uint64_t before = spool->stored, after = before + *got;
    const bool grows = whole || before < RING_BYTES;
    if (!status && grows && before > 0 && before / DISK_STEP_BYTES != after / DISK_STEP_BYTES)
        status = bsq_require_disk(spool->ctx, spool->beside, 2 * DISK_STEP_BYTES);
    if (*got > 0) { /* also the bytes before a damage */
        const uint64_t at = whole ? before : before % RING_BYTES;
        int written = status && status != BSQ_EDATA
                          ? status
                          : bsq_file_write(spool->ctx, &spool->temp, spool->buffer, *got, at);
        spool->stored += written ? 0 : *got;
        status = status ? status : written;
    }
    return status;
}

/* Takes one step. */
static void advance(struct spool *spool)
{
    uint64_t got = 0;
    bool whole = false;
    int status = bsq_check(spool->ctx);
    if (!status)
        status = start_again(spool, &whole);
    if (!status)
        status = unpack_step(spool, whole, &got);
    pthread_mutex_lock(&spool->lock);
    spool->done = spool->stored;
    spool->status = status;
    spool->ended = !status && got < STEP_BYTES;
    if (spool->ended)
        spool->size = spool->done;
    pthread_cond_broadcast(&spool->arrived);
    pthread_mutex_unlock(&spool->lock);
}

static void *run(void *arg)
{
    struct spool *spool = arg;
    while (wait_for_request(spool))
        advance(spool);
    return NULL;
}

/* ---- the spool ---- */

static int make_hash(struct spool *spool)
{
    spool->hash = XXH3_createState();
    if (!spool->hash)
        return bsq_fail_errno(spool->ctx, BSQ_ENOMEM, ENOMEM, "%s", spool->path);
    XXH3_64bits_reset(spool->hash);
    return 0;
}

static int set_up(struct spool *spool)
{
    struct bsq_ctx *ctx = spool->ctx;
    pthread_mutexattr_t recursive;
    pthread_mutexattr_init(&recursive);
    pthread_mutexattr_settype(&recursive, PTHREAD_MUTEX_RECURSIVE);
    pthread_mutex_init(&spool->lock, &recursive);
    pthread_mutexattr_destroy(&recursive);
    pthread_cond_init(&spool->arrived, NULL);
    pthread_cond_init(&spool->requested, NULL);
    spool->has_lock = true;
    int status = bsq_file_temp(ctx, spool->beside, "an unpacked mesh", &spool->temp);
    if (!status && !spool->file)
        status = make_hash(spool);
    if (!status)
        status = bsq_alloc(ctx, "unpacking", STEP_BYTES, 1, &spool->buffer);
    if (!status)
        status = fmt_unpack_create(ctx, read_packed, spool, &spool->unpacker);
    if (!status)
        spool->has_thread = bsq_thread_start(&spool->thread, run, spool);
    return status;
}

int fmt_spool_start(struct bsq_ctx *ctx, const char *path, const char *beside,
                    const struct bsq_file *file, int pipe_fd, struct spool **out)
{
    struct spool *spool;
    *out = NULL;
    int status = bsq_calloc(ctx, "unpacking", 1, sizeof *spool, &spool);
    if (status)
        return status;
    spool->ctx = ctx;
    spool->path = path;
    spool->beside = beside;
    spool->file = file;
    spool->pipe_fd = pipe_fd;
    spool->temp = (struct bsq_file)BSQ_FILE_CLOSED;
    spool->size = UINT64_MAX;
    spool->whole = !file;
    status = set_up(spool);
    if (status)
        fmt_spool_stop(spool);
    else
        *out = spool;
    return status;
}

void fmt_spool_stop(struct spool *spool)
{
    if (!spool)
        return;
    if (spool->has_thread) {
        pthread_mutex_lock(&spool->lock);
        spool->stop = true;
        pthread_cond_broadcast(&spool->requested);
        pthread_mutex_unlock(&spool->lock);
        pthread_join(spool->thread, NULL);
    }
    if (spool->has_lock) {
        pthread_cond_destroy(&spool->requested);
        pthread_cond_destroy(&spool->arrived);
        pthread_mutex_destroy(&spool->lock);
    }
    fmt_unpack_free(spool->unpacker);
    XXH3_freeState(spool->hash);
    bsq_free(spool->ctx, spool->buffer);
    bsq_file_close(spool->ctx, &spool->temp);
    bsq_free(spool->ctx, spool);
}

/* ---- reading ---- */

/* Waits for news, but not for long. Makes them itself if there is no thread: the
 * lock is held meanwhile, because other readers want the same. The lock is held. */
static void wait_for_arrival(struct spool *spool)
{
    if (!spool->has_thread) {
        advance(spool);
        return;
    }
    bsq_wait_a_little(&spool->arrived, &spool->lock);
}

/* Returns why no more bytes come. Damage is described here, by the reader that wanted the bytes. */
static int explain(const struct spool *spool)
{
    if (spool->status != BSQ_EDATA)
        return spool->status;
    const int changed = spool->file ? bsq_file_check(spool->ctx, spool->file) : 0;
    return changed ? changed
                   : bsq_fail(spool->ctx, BSQ_EDATA, "%s: %s", spool->path,
                              fmt_unpack_error(spool->unpacker));
}

/* Returns whether all `end` bytes have come, or no more do. The lock is held. */
static bool has_come(const struct spool *spool, uint64_t end)
{
    return !spool->again && (spool->done >= end || spool->ended || spool->status);
}

int fmt_spool_reach(struct spool *spool, uint64_t end, uint64_t *size)
{
    int status = 0;
    pthread_mutex_lock(&spool->lock);
    if (end > spool->wanted)
        spool->wanted = end;
    pthread_cond_signal(&spool->requested);
    while (!has_come(spool, end) && !status) {
        wait_for_arrival(spool);
        status = bsq_check(spool->ctx);
    }
    if (!status && spool->done < end && !spool->ended)
        status = explain(spool);
    *size = spool->size;
    pthread_mutex_unlock(&spool->lock);
    return status;
}

/* Returns the first byte that the file still has. The step that is being written replaces bytes
 * already. The lock is held. */
static uint64_t first_kept(const struct spool *spool)
{
    const uint64_t end = spool->done + STEP_BYTES;
    return spool->whole || end < RING_BYTES ? 0 : end - RING_BYTES;
}

/* Has all bytes kept. Starts again if some were replaced. The lock is held. */
static void keep_all(struct spool *spool)
{
    if (spool->whole)
        return;
    spool->again = first_kept(spool) > 0;
    spool->whole = true;
    pthread_cond_signal(&spool->requested);
}

void fmt_spool_keep(struct spool *spool)
{
    pthread_mutex_lock(&spool->lock);
    keep_all(spool);
    pthread_mutex_unlock(&spool->lock);
}

/* Reads bytes of the file, which may be a ring. */
static int read_stored(const struct spool *spool, bool whole, void *buffer, uint64_t size,
                       uint64_t offset)
{
    const uint64_t at = whole ? offset : offset % RING_BYTES;
    const uint64_t left = whole || size < RING_BYTES - at ? size : RING_BYTES - at;
    int status = bsq_file_read(spool->ctx, &spool->temp, buffer, left, at);
    if (!status && left < size)
        status = bsq_file_read(spool->ctx, &spool->temp, (char *)buffer + left, size - left, 0);
    return status;
}

/* What a reader found in the file. */
struct sight {
    unsigned starts;
    bool whole, there;
};

/* Looks whether bytes are there, and makes them come again if they were replaced. */
static int look(struct spool *spool, uint64_t size, uint64_t offset, struct sight *sight)
{
    uint64_t all;
    if (size > RING_BYTES / 2)
        fmt_spool_keep(spool);
    int status = fmt_spool_reach(spool, offset + size, &all);
    if (status)
        return status;
    pthread_mutex_lock(&spool->lock);
    if (first_kept(spool) > offset)
        keep_all(spool);
    *sight = (struct sight){.starts = spool->starts,
                            .whole = spool->whole,
                            .there = !spool->again && spool->done >= offset + size};
    if (!spool->again && spool->ended && !sight->there)
        status = bsq_fail(spool->ctx, BSQ_EIO, "%s: changed while it was read", spool->path);
    pthread_mutex_unlock(&spool->lock);
    return status;
}

/* Returns whether the bytes from `offset` on were not replaced since a reader looked. */
static bool are_kept(struct spool *spool, const struct sight *sight, uint64_t offset)
{
    pthread_mutex_lock(&spool->lock);
    const bool kept =
        spool->starts == sight->starts && !spool->again && first_kept(spool) <= offset;
    pthread_mutex_unlock(&spool->lock);
    return kept;
}

int fmt_spool_read(struct spool *spool, void *buffer, uint64_t size, uint64_t offset)
{
    struct sight sight;
    int status;
    do {
        status = look(spool, size, offset, &sight);
        if (!status && sight.there)
            status = read_stored(spool, sight.whole, buffer, size, offset);
    } while (!status && !(sight.there && are_kept(spool, &sight, offset)));
    return status;
}

int fmt_spool_duplicate(const struct spool *spool, struct bsq_file *out)
{
    const struct bsq_file named = {
        .fd = spool->temp.fd, .size = spool->stored, .path = (char *)spool->path};
    return bsq_file_duplicate(spool->ctx, &named, out);
}

uint64_t fmt_spool_size(struct spool *spool)
{
    pthread_mutex_lock(&spool->lock);
    uint64_t size = spool->size;
    pthread_mutex_unlock(&spool->lock);
    return size;
}

bool fmt_spool_given(struct spool *spool, uint64_t *bytes, uint64_t *hash)
{
    pthread_mutex_lock(&spool->lock);
    bool ended = spool->ended && spool->hash;
    pthread_mutex_unlock(&spool->lock);
    if (!ended)
        return false;
    *bytes = spool->taken;
    *hash = XXH3_64bits_digest(spool->hash);
    return true;
}
