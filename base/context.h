/* context.h - what every call into Bisque's libraries shares.
 *
 * A context carries the memory budget, the thread pool, the error of the first failure, and the
 * callbacks for progress and warnings. Create one per job; everything that a library allocates for
 * a job is reserved from the context's budget and nothing is global. Functions return 0 or a
 * negative code of enum bsq_status; whoever detects a failure describes it once with bsq_fail(),
 * callers only forward the code.
 *
 * Thread safety: all functions here may be called from any thread, except create and destroy. */
#ifndef BSQ_CONTEXT_H
#define BSQ_CONTEXT_H

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Status codes are negated sysexits(3) values, so that a tool's exit code is -status. */
enum bsq_status {
    BSQ_OK = 0,
    BSQ_EUSAGE = -64,     /* arguments that make no sense, a budget that is too small */
    BSQ_EDATA = -65,      /* input that is damaged or not of the expected kind */
    BSQ_ENOINPUT = -66,   /* input that does not exist or cannot be read */
    BSQ_ENODEVICE = -69,  /* no such compute device */
    BSQ_EBUG = -70,       /* an invariant of Bisque's own does not hold */
    BSQ_ENOMEM = -71,     /* the system or the budget has no memory left */
    BSQ_ECANTCREAT = -73, /* output cannot be created */
    BSQ_EIO = -74,        /* reading or writing failed, disk full included */
    BSQ_EINTR = -75       /* bsq_interrupt() was called */
};

/* One progress report. `done` and `total` count `unit`s ("bytes", "triangles", "texels");
 * total is 0 where it is not known. */
struct bsq_progress {
    const char *stage; /* e.g. "reading", "sorting"; static storage */
    const char *unit;
    uint64_t done, total;
    bool finished; /* last report of this stage */
};

struct bsq_ctx_options {
    uint64_t memory_bytes; /* budget; 0: half of the machine's memory */
    unsigned threads;      /* 0: one per processor that this process may use */
    const char *tmpdir;    /* where temporary files go; NULL: $TMPDIR, else beside the output */
    /* Called at most about ten times a second, never concurrently; may be NULL. */
    void (*on_progress)(void *user, const struct bsq_progress *progress);
    /* Called once per warning with a line without newline, never concurrently; may be NULL. */
    void (*on_warning)(void *user, const char *line);
    void *user;
};

struct bsq_ctx;

/* Creates a context in *out. options may be NULL for all defaults; strings in it are copied.
 * The caller owns *out. Errors: BSQ_ENOMEM. */
int bsq_ctx_create(const struct bsq_ctx_options *options, struct bsq_ctx **out);

/* Stops the threads and frees the context; NULL is allowed. All memory obtained through it must
 * have been freed before. */
void bsq_ctx_destroy(struct bsq_ctx *ctx);

/* Number of worker threads, at least 1 (the calling thread counts as one of them). */
unsigned bsq_threads(const struct bsq_ctx *ctx);

/* Directory for temporary files: the option, else $TMPDIR, else NULL (beside the output). */
const char *bsq_tmpdir(const struct bsq_ctx *ctx);

/* ---- errors ---- */

/* Records the description of a failure and returns `status`. Only the first failure of a context
 * is kept. The text is one line without newline: "scan.obj:12: face refers to vertex 9, ...". */
int bsq_fail(struct bsq_ctx *ctx, int status, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Like bsq_fail() for a failed system call: appends ": " and the text of `errnum`. ENOSPC, EDQUOT
 * and EIO turn `status` into BSQ_EIO, ENOMEM into BSQ_ENOMEM. */
int bsq_fail_errno(struct bsq_ctx *ctx, int status, int errnum, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

/* Text of the first failure, or "" when there was none. Valid until the context is destroyed or
 * bsq_clear_error() is called. */
const char *bsq_error(const struct bsq_ctx *ctx);

/* Forgets the recorded failure, so that the context can be used for another job. */
void bsq_clear_error(struct bsq_ctx *ctx);

/* Passes one line to on_warning. */
void bsq_warn(struct bsq_ctx *ctx, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* ---- interruption ---- */

/* Asks all work of this context to stop soon with BSQ_EINTR. Async-signal-safe. */
void bsq_interrupt(struct bsq_ctx *ctx);

/* 0, or BSQ_EINTR once bsq_interrupt() was called. Long loops call this every few milliseconds. */
int bsq_check(struct bsq_ctx *ctx);

/* ---- memory ---- */

/* All sizes are overflow-checked: count * size that overflows is BSQ_ENOMEM. Memory is aligned to
 * 64 bytes and counts against the budget until bsq_free(). On failure *out is NULL and the error
 * names the bytes asked for, the budget and what is in use. `what` names the purpose. */
int bsq_alloc(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size, void *out);
int bsq_calloc(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size, void *out);

/* Grows *inout (NULL at first) from old_count to at least `count` elements, keeping its content;
 * *capacity (elements) is updated; grows by at least half so that appending is linear. */
int bsq_grow(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size, void *inout,
             uint64_t *capacity);

/* Frees memory of bsq_alloc/calloc/grow; NULL is allowed. */
void bsq_free(struct bsq_ctx *ctx, void *memory);

/* Takes the whole pages in [at, at + bytes) from the system now and not when they are first
 * touched: for threads that have time for it before another one fills them. Content stays; a wish,
 * that older systems do not grant. */
void bsq_touch(void *at, uint64_t bytes);

/* Counts `bytes` that somebody else allocates (a library's cache) against the budget. */
int bsq_reserve(struct bsq_ctx *ctx, const char *what, uint64_t bytes);
void bsq_release(struct bsq_ctx *ctx, uint64_t bytes);

uint64_t bsq_memory_limit(const struct bsq_ctx *ctx); /* the budget in bytes */
uint64_t bsq_memory_used(const struct bsq_ctx *ctx);  /* bytes reserved now */
uint64_t bsq_memory_high(const struct bsq_ctx *ctx);  /* most bytes ever reserved at a time */

/* ---- progress ---- */

/* Starts a stage; `stage` and `unit` must be string literals. One stage at a time. */
void bsq_progress_begin(struct bsq_ctx *ctx, const char *stage, const char *unit, uint64_t total);
/* Adds to the stage's count; any thread, cheap. */
void bsq_progress_add(struct bsq_ctx *ctx, uint64_t count);
void bsq_progress_end(struct bsq_ctx *ctx);

#ifdef __cplusplus
}
#endif
#endif
