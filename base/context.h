/** @file
 * The context: what every call into Bisque's libraries shares.
 *
 * A context carries the memory budget, the threads, the error of the first failure, and the
 * callbacks for progress and warnings. Create one for each job. Libraries reserve all memory of a
 * job from its context. They keep no global state, print nothing and never exit. The one exception
 * is a handler of SIGBUS, which the process has while any file is mapped (base/file.h).
 *
 * Functions return 0 or a negative code of enum bsq_status. Whoever detects a failure describes it
 * once with bsq_fail(); callers only forward the code.
 *
 * Thread safety: any thread may call any function here, except bsq_ctx_create() and
 * bsq_ctx_destroy(). */
#ifndef BSQ_CONTEXT_H
#define BSQ_CONTEXT_H

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <time.h>

#include "base/version.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Status codes. Each is a negated exit code of sysexits(3), so a tool's exit code is -status. */
enum bsq_status {
    BSQ_OK = 0,           /**< Success. */
    BSQ_EUSAGE = -64,     /**< Arguments that make no sense. */
    BSQ_EDATA = -65,      /**< Input that is damaged or not of the expected kind. */
    BSQ_ENOINPUT = -66,   /**< Input that does not exist or cannot be read. */
    BSQ_ENODEVICE = -69,  /**< No such compute device. */
    BSQ_EBUG = -70,       /**< An invariant of Bisque does not hold. */
    BSQ_ENOMEM = -71,     /**< The system has no memory left, or the budget is too small. */
    BSQ_ECANTCREAT = -73, /**< Output that cannot be created. */
    BSQ_EIO = -74,        /**< Reading or writing failed; a full disk is one reason. */
    BSQ_EINTR = -75,      /**< bsq_interrupt() was called. */
    BSQ_RETRY = -1        /**< Another method is needed. Stays inside of a library. */
};

/** Normals of a scan (the high-poly mesh) that has none of its own. Smooth normals are interpolated
 * between vertices. The normal of a vertex is the weighted mean of its triangles' normals; at
 * creases, which ANGLE does not have, each of two sides has one, or the triangles keep their own.
 */
enum bsq_scan_normals {
    BSQ_SCAN_NORMALS_AUTO,  /**< The default: those of the chunk file; of a mesh, smooth ones. */
    BSQ_SCAN_NORMALS_AREA,  /**< Smooth; weights are the triangles' areas. */
    BSQ_SCAN_NORMALS_ANGLE, /**< Smooth; weights are the triangles' angles at the vertex (Thuermer
                               and Wuethrich 1998), as of Blender's Shade Smooth. */
    BSQ_SCAN_NORMALS_MAX,   /**< Smooth; weights are the sine of the angle over the product of both
                               edges' lengths (Max 1999). */
    BSQ_SCAN_NORMALS_FLAT,  /**< The normals of the triangles. */
    BSQ_SCAN_NORMALS_SMOOTH = BSQ_SCAN_NORMALS_AREA /**< The usual ones. */
};

/** Which axis points upwards in a mesh. */
enum bsq_up {
    BSQ_UP_KEEP, /**< As in the file. */
    BSQ_UP_Y,    /**< The file has z upwards; it is turned so that y is: (x, z, -y). */
    BSQ_UP_Z     /**< The file has y upwards; it is turned so that z is: (x, -z, y). */
};

/** Where a mesh file lies in the scan: scaled, then turned, then shifted, in double precision.
 * Normals are turned. */
struct bsq_placement {
    double scale;        /**< Factor of all positions, above 0. */
    enum bsq_up up;      /**< Turns the mesh around the x axis. */
    double translate[3]; /**< Added to all positions. */
};

/** A progress report. */
struct bsq_progress {
    const char *stage; /**< For example "reading" or "sorting"; static storage. */
    const char *unit;  /**< What is counted: "bytes", "triangles", "texels"; static storage. */
    uint64_t done;     /**< Units that are done. */
    uint64_t total;    /**< Units in all; 0 if unknown. */
    bool finished;     /**< True in the last report of a stage. */
};

/** Options of a context. All zeros are the defaults. */
struct bsq_ctx_options {
    size_t size;           /**< Of the structure, or 0; see bsq_check_size(). */
    uint64_t memory_bytes; /**< Budget; 0: half of what machine and control groups allow. */
    unsigned threads;      /**< 0: one for each usable processor. A number above 64 and above 4 per
                              processor is lowered, with a warning. */
    const char *tmpdir; /**< Directory of temporary files. NULL: $TMPDIR, else that of the output.
                         */
    /** Called at most about ten times a second, never concurrently; may be NULL. */
    void (*on_progress)(void *user, const struct bsq_progress *progress);
    /** Called for each warning, a line without a newline, never concurrently; may be NULL. */
    void (*on_warning)(void *user, const char *line);
    void *user; /**< Passed to both callbacks. */
};

struct bsq_ctx;

/** Creates a context in *out, which the caller owns. `options` may be NULL for the defaults;
 * strings in it are copied. Errors: BSQ_ENOMEM; BSQ_EUSAGE for options of another size. */
int bsq_ctx_create(const struct bsq_ctx_options *options, struct bsq_ctx **out);

/** Stops the threads and frees the context; NULL is allowed. All memory that was allocated from it
 * must be freed before. */
void bsq_ctx_destroy(struct bsq_ctx *ctx);

/** Forgets which files the job read and wrote, so that the context can be used for another job. A
 * job must find its inputs unchanged whenever it opens them, and must not write them. */
void bsq_forget_files(struct bsq_ctx *ctx);

/** Notes an input. It may be missing: then no output may be created there. The text of `format`
 * says what it is, for messages: "the texture that s.mtl:12 names". Files that this job wrote
 * before are not protected. Files that a library opens are noted by themselves. Errors: BSQ_EUSAGE,
 * which names both files, if the job writes this file; BSQ_ENOMEM. */
int bsq_note_input(struct bsq_ctx *ctx, const char *path, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/** Checks before the work that an output can be created and that it is none of the inputs that are
 * noted so far. Errors: BSQ_ECANTCREAT if the directory is missing or not writable, or if the name
 * belongs to something that a regular file cannot replace, or is "-"; BSQ_EUSAGE if the job reads
 * this file; BSQ_ENOMEM. */
int bsq_output_check(struct bsq_ctx *ctx, const char *path);

/** Checks before the work that temporary files can be created, beside an output if the context
 * names no directory for them. Errors: BSQ_ECANTCREAT, BSQ_EIO, BSQ_ENOMEM. */
int bsq_temp_check(struct bsq_ctx *ctx, const char *output);

/** Returns whether both paths name one file, which need not exist. */
bool bsq_same_file(const char *a, const char *b);

/** Returns the number of worker threads, at least 1. The calling thread counts as one of them. */
unsigned bsq_threads(const struct bsq_ctx *ctx);

/** Returns the directory of temporary files: the option, else $TMPDIR, else NULL, which means the
 * output's directory. */
const char *bsq_tmpdir(const struct bsq_ctx *ctx);

/** An input that is no file: a callback gives its bytes, in the format of a mesh file, such as PLY.
 */
struct bsq_source {
    size_t size;    /**< Of the structure, see bsq_check_size(). */
    uint64_t bytes; /**< Of the input. */
    /** Copies `count` bytes from byte number `offset` on to `to`; all of them exist. Called on
     * several threads at once, and more than once for the same bytes, which must not change.
     * Returns 0, or a negative code of enum bsq_status, which ends the job. */
    int (*read)(void *user, void *to, uint64_t count, uint64_t offset);
    void *user; /**< Passed to the callback. */
};

/* ---- errors ---- */

/** Runs a step of a function that returns a status. If the step fails, keeps its code in the local
 * variable `status` and continues at the label `done`, where the function frees what it holds and
 * returns `status`. Codes above 0 are no failures. */
#define BSQ_TRY(step)                                                                              \
    do {                                                                                           \
        status = (step);                                                                           \
        if (status < 0)                                                                            \
            goto done;                                                                             \
    } while (0)

/** Runs a step of a function that holds nothing to free: if the step fails, returns its code. */
#define BSQ_PASS(step)                                                                             \
    do {                                                                                           \
        const int status_ = (step);                                                                \
        if (status_ < 0)                                                                           \
            return status_;                                                                        \
    } while (0)

/** Records the description of a failure and returns `status`. A context keeps only its first
 * failure. The text is a line without a newline: "scan.obj:12: face refers to vertex 9, ...". */
int bsq_fail(struct bsq_ctx *ctx, int status, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/** Records a failed system call as bsq_fail() does, and appends ": " and the text of `errnum`.
 * ENOSPC, EDQUOT and EIO change `status` to BSQ_EIO, ENOMEM changes it to BSQ_ENOMEM. */
int bsq_fail_errno(struct bsq_ctx *ctx, int status, int errnum, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

/** Returns the text of the first failure, or "" if there was none. It is valid until
 * bsq_clear_error() or bsq_ctx_destroy(). */
const char *bsq_error(const struct bsq_ctx *ctx);

/** Checks the first member of a structure that a program filled in: its `size` in bytes, which the
 * structure's defaults set. A structure that was not started with them, or is of another version,
 * has another one than the library, which is `expected`. Errors: BSQ_EUSAGE. */
int bsq_check_size(struct bsq_ctx *ctx, const char *name, size_t size, size_t expected);

/** Checks the size of a report in the same way, and sets all that follows it to zero. The caller
 * starts a report with `{.size = sizeof report}`. Errors: BSQ_EUSAGE. */
int bsq_clear_report(struct bsq_ctx *ctx, const char *name, void *report, size_t expected);

/** Forgets the recorded failure, for callers that can go on without what failed, and before another
 * job. An interruption stays; see bsq_clear_interruption(). */
void bsq_clear_error(struct bsq_ctx *ctx);

/** Returns a copy of `text` as all messages have it: "\xHH" replaces each byte that is not part of
 * valid UTF-8 or is part of a control character: C0 and C1, line and paragraph separators, and
 * characters that change the direction of text. A newline stays if `keep_newlines` is set. The
 * result is valid UTF-8 in one line, and a terminal shows it as it is. A backslash stays, so this
 * cannot be undone. Free it with free(); NULL if there is no memory. */
char *bsq_escape(const char *text, bool keep_newlines);

/** Passes a line to on_warning. */
void bsq_warn(struct bsq_ctx *ctx, const char *format, ...) __attribute__((format(printf, 2, 3)));

/** Makes bsq_warn_loss() fail, if `strict` is set. Call it before the job. */
void bsq_set_strict(struct bsq_ctx *ctx, bool strict);

/** Warns of data that is lost, as bsq_warn() does. Returns 0. In a strict job, records the line as
 * a failure instead and returns BSQ_EDATA. */
int bsq_warn_loss(struct bsq_ctx *ctx, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/** Holds warnings back, of lost data too, until it is called with false. For code that reads an
 * input again whose warnings were given. A strict job fails all the same. */
void bsq_mute_warnings(struct bsq_ctx *ctx, bool muted);

/* ---- interruption ---- */

/** Makes all work of this context stop soon with BSQ_EINTR. Async-signal-safe. */
void bsq_interrupt(struct bsq_ctx *ctx);

/** Forgets bsq_interrupt(), so that the context can be used for another job. */
void bsq_clear_interruption(struct bsq_ctx *ctx);

/** Returns BSQ_EINTR after bsq_interrupt(), else 0. Long loops call this every few milliseconds. */
int bsq_check(struct bsq_ctx *ctx);

/* ---- memory ---- */

/** Allocates `count` elements of `size` bytes, aligned to 64 bytes, and stores the pointer in *out.
 * The memory counts against the budget until bsq_free(). `what` names its purpose in errors.
 * Errors: BSQ_ENOMEM, also if count * size overflows; then *out is NULL, and the text names the
 * bytes requested, the budget and the bytes in use. */
int bsq_alloc(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size, void *out);

/** Allocates as bsq_alloc() does and sets all bytes to 0. */
int bsq_calloc(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size, void *out);

/** Grows *inout, NULL at first, to at least `count` elements of `size` bytes and keeps its content.
 * Updates *capacity, in elements. Grows by half, or by what the budget allows of that, so appending
 * takes linear time.
 * Errors: as bsq_alloc(); then *inout stays as it was. */
int bsq_grow(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size, void *inout,
             uint64_t *capacity);

/** @cond */
/* Lets the compiler warn if the last argument is not the address of a pointer. */
#define BSQ_ADDRESS_OF_POINTER(out) ((void)sizeof(*(out) == (const volatile void *)0), (out))
#define bsq_alloc(ctx, what, count, size, out)                                                     \
    bsq_alloc(ctx, what, count, size, BSQ_ADDRESS_OF_POINTER(out))
#define bsq_calloc(ctx, what, count, size, out)                                                    \
    bsq_calloc(ctx, what, count, size, BSQ_ADDRESS_OF_POINTER(out))
#define bsq_grow(ctx, what, count, size, inout, capacity)                                          \
    bsq_grow(ctx, what, count, size, BSQ_ADDRESS_OF_POINTER(inout), capacity)
/** @endcond */

/** As bsq_alloc(), for elements of the type that *out points to. */
#define BSQ_ALLOC(ctx, what, count, out) bsq_alloc(ctx, what, count, sizeof **(out), out)
/** As bsq_calloc(), likewise. */
#define BSQ_CALLOC(ctx, what, count, out) bsq_calloc(ctx, what, count, sizeof **(out), out)
/** As bsq_grow(), likewise. */
#define BSQ_GROW(ctx, what, count, inout, capacity)                                                \
    bsq_grow(ctx, what, count, sizeof **(inout), inout, capacity)

/** Frees memory of bsq_alloc(), bsq_calloc() or bsq_grow(); NULL is allowed. */
void bsq_free(struct bsq_ctx *ctx, void *memory);

/** Frees `count` blocks as bsq_free() does. */
void bsq_free_all(struct bsq_ctx *ctx, void *const *blocks, size_t count);
/** Frees all blocks that follow `ctx`. */
#define BSQ_FREE(ctx, ...)                                                                         \
    bsq_free_all(ctx, (void *const[]){__VA_ARGS__},                                                \
                 sizeof((void *const[]){__VA_ARGS__}) / sizeof(void *))

/** Counts `bytes` that other code allocates, such as a library's cache, against the budget.
 * Errors: BSQ_ENOMEM. */
int bsq_reserve(struct bsq_ctx *ctx, const char *what, uint64_t bytes);

/** Returns `bytes` of bsq_reserve() to the budget. */
void bsq_release(struct bsq_ctx *ctx, uint64_t bytes);

/** Returns the memory budget in bytes. */
uint64_t bsq_memory_limit(const struct bsq_ctx *ctx);

/** Returns the bytes that are reserved now. */
uint64_t bsq_memory_used(const struct bsq_ctx *ctx);

/** Returns the largest number of bytes that was reserved at any time. */
uint64_t bsq_memory_high(const struct bsq_ctx *ctx);

/** Returns the bytes of the budget that are not reserved now. */
uint64_t bsq_memory_left(const struct bsq_ctx *ctx);

/** Alignment in bytes of all memory from bsq_alloc(), bsq_calloc() and bsq_grow(). */
#define BSQ_ALIGNMENT 64

/** Rounds up to a multiple of `step`, which is not 0. The result must not exceed UINT64_MAX. */
static inline uint64_t bsq_align_up(uint64_t value, uint64_t step)
{
    return (value + step - 1) / step * step;
}

/* ---- time and progress ---- */

/** Returns seconds on a clock that only goes forward. */
static inline double bsq_seconds_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/** Starts a stage with `total` units; 0 if unknown. `stage` and `unit` must be string literals. A
 * context has one stage at a time. */
void bsq_progress_begin(struct bsq_ctx *ctx, const char *stage, const char *unit, uint64_t total);

/** Adds `count` units to the stage's count. Cheap enough for inner loops. */
void bsq_progress_add(struct bsq_ctx *ctx, uint64_t count);
/** Adds the part of `units` that lies between two shares of them, 0 to 1, in whole units. Parts
 * that follow each other from 0 to 1 add all. */
void bsq_progress_add_share(struct bsq_ctx *ctx, uint64_t units, double begin, double end);

/** Ends the stage. */
void bsq_progress_end(struct bsq_ctx *ctx);

#ifdef __cplusplus
}
#endif
#endif
