/* context_internal.h - private to base: the fields of a context and functions that its files share.
 */
#ifndef BSQ_CONTEXT_INTERNAL_H
#define BSQ_CONTEXT_INTERNAL_H

#include <pthread.h>
#include <stdatomic.h>
#include <sys/types.h>

#include "base/context.h"

struct bsq_identity;

/* What other files of base keep in a context, in the order in which it is freed. */
enum bsq_member { BSQ_POOL, BSQ_JOB_FILES, BSQ_SWEEPS, BSQ_MEMBERS };

struct bsq_ctx_member {
    void *object; /* NULL: there is none */
    void (*free)(struct bsq_ctx *ctx, void *object);
};

struct bsq_stage {
    const char *name, *unit; /* name is NULL between stages */
    uint64_t total;
    atomic_uint_least64_t done;
    atomic_uint_least64_t next_report_ms; /* no report before this time of the coarse clock */
};

struct bsq_ctx {
    struct bsq_ctx_options options; /* tmpdir is a copy, memory_bytes and threads are resolved */
    atomic_uint_least64_t memory_used, memory_high;
    atomic_uint_least64_t temp_bytes;
    atomic_int interrupted;

    pthread_mutex_t error_lock;
    char *_Atomic error; /* first failure; NULL: none */
    int error_status;    /* its code, guarded by error_lock */
    bool strict;         /* see bsq_set_strict() */

    bool muted;                    /* see bsq_mute_warnings(); guarded by callback_lock */
    pthread_mutex_t callback_lock; /* held while on_progress or on_warning runs */
    struct bsq_stage stage;

    pthread_mutex_t members_lock; /* guards the parts, but not the pool, which one thread uses */
    struct bsq_ctx_member members[BSQ_MEMBERS];
};

/* What the machine and its control groups allow this process. */
struct bsq_machine {
    uint64_t memory_bytes;
    unsigned processors; /* at least 1 */
};

void bsq_machine(struct bsq_machine *out);

/* Lowers the limits to those of the control groups that files below `root` describe: "" for this
 * machine, a directory with proc and sys for tests. */
void bsq_apply_control_groups(const char *root, struct bsq_machine *machine);

/* Gives a context a member of `size` bytes, all 0, unless it has one. Returns it; NULL if there
 * is no memory. */
void *bsq_member_of(struct bsq_ctx *ctx, enum bsq_member member, size_t size,
                    void (*free)(struct bsq_ctx *ctx, void *object));

/* Returns the bytes of the budget that a block with a payload of `bytes` takes. */
uint64_t bsq_block_cost(uint64_t bytes);

/* Returns the code of the first failure, 0 if there was none. */
int bsq_error_status(struct bsq_ctx *ctx);

/* Notes an input that was opened. Errors: BSQ_EIO if it is not what the first opening of this path
 * found; those of bsq_note_input(). */
int bsq_hold_input(struct bsq_ctx *ctx, const char *path, const struct bsq_identity *found);

bool bsq_same_identity(const struct bsq_identity *a, const struct bsq_identity *b);

/* Reports that an input changed while the job read it. Returns BSQ_EIO. */
int bsq_fail_changed(struct bsq_ctx *ctx, const char *path);

/* Returns the directory part of a path ("." if it has none), to be freed with free(); NULL if there
 * is no memory. */
char *bsq_dirname(const char *path);
/* Returns the directory of the first output that was noted, or "."; the caller frees it. NULL: out
 * of memory. Thread-safe. */
char *bsq_output_directory(struct bsq_ctx *ctx);

/* Opens a file as open(2) does, with O_CLOEXEC and again after EINTR. The descriptor is 3 or more,
 * and a new file (O_EXCL, O_TMPFILE) is empty. Returns -1 and sets errno on failure. */
int bsq_open(const char *path, int flags, mode_t mode);

/* Writes all bytes to a descriptor. Returns 0 or an errno. */
int bsq_pwrite_all(int fd, const void *buffer, uint64_t size, uint64_t offset);

#endif
