/* context.c - creates contexts; keeps the first failure, warnings and interruption.
 *
 * A message is formatted before a lock is taken and published once through an atomic pointer. So
 * bsq_error() needs no lock, and its text never changes under a reader. */
#include <assert.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/context_internal.h"
#include "base/text.h"
#include "base/context.h"
#include "base/simd/simd.h"

/* The message if there is no memory to format one; never freed. */
static char no_memory_text[] = "out of memory";

/* More threads than processors are of no use, except to show that results do not depend on them. */
enum { ALWAYS_ALLOWED_THREADS = 64, THREADS_A_PROCESSOR = 4 };

/* Fills in the defaults and the limit of threads. */
static void resolve_options(struct bsq_ctx_options *options)
{
    struct bsq_machine machine;
    if (options->memory_bytes > 0 && options->threads > 0 &&
        options->threads <= ALWAYS_ALLOWED_THREADS)
        return; /* nothing depends on the machine */
    bsq_machine(&machine);
    uint64_t most = (uint64_t)THREADS_A_PROCESSOR * machine.processors;
    if (most < ALWAYS_ALLOWED_THREADS)
        most = ALWAYS_ALLOWED_THREADS;
    if (options->memory_bytes == 0)
        options->memory_bytes = machine.memory_bytes / 2;
    if (options->threads == 0)
        options->threads = machine.processors;
    if (options->threads > most)
        options->threads = (unsigned)most;
}

/* A name that is mistyped would otherwise look as if all instruction sets were equally fast. */
static void check_simd(struct bsq_ctx *ctx)
{
    const char *name = getenv("BSQ_SIMD");
    enum bsq_simd level;
    if (!bsq_simd_named(name, &level))
        bsq_warn(ctx, "BSQ_SIMD=%s has no effect: this processor has no such level", name);
}

const char *bsq_version(void)
{
    return BSQ_VERSION;
}

int bsq_ctx_create(const struct bsq_ctx_options *options, struct bsq_ctx **out)
{
    *out = NULL;
    if (options && options->size != 0 && options->size != sizeof *options)
        return BSQ_EUSAGE;
    struct bsq_ctx *ctx = calloc(1, sizeof *ctx);
    if (!ctx)
        return BSQ_ENOMEM;
    if (options)
        ctx->options = *options;
    const unsigned wanted_threads = ctx->options.threads;
    resolve_options(&ctx->options);

    const char *tmpdir = ctx->options.tmpdir;
    if (!tmpdir)
        tmpdir = getenv("TMPDIR");
    ctx->options.tmpdir = NULL;
    if (tmpdir && *tmpdir) {
        ctx->options.tmpdir = strdup(tmpdir);
        if (!ctx->options.tmpdir) {
            free(ctx);
            return BSQ_ENOMEM;
        }
    }
    pthread_mutex_init(&ctx->error_lock, NULL);
    pthread_mutex_init(&ctx->callback_lock, NULL);
    pthread_mutex_init(&ctx->members_lock, NULL);
    if (ctx->options.threads < wanted_threads)
        bsq_warn(ctx, "%u threads are more than this machine can use: %u are used", wanted_threads,
                 ctx->options.threads);
    check_simd(ctx);
    *out = ctx;
    return 0;
}

void *bsq_member_of(struct bsq_ctx *ctx, enum bsq_member member, size_t size,
                    void (*free)(struct bsq_ctx *ctx, void *object))
{
    struct bsq_ctx_member *of = &ctx->members[member];
    if (!of->object)
        *of = (struct bsq_ctx_member){calloc(1, size), free};
    return of->object;
}

/* Frees a member, if the context has it. */
static void drop_member(struct bsq_ctx *ctx, enum bsq_member member)
{
    const struct bsq_ctx_member of = ctx->members[member];
    ctx->members[member].object = NULL;
    if (of.object)
        of.free(ctx, of.object);
}

void bsq_forget_files(struct bsq_ctx *ctx)
{
    pthread_mutex_lock(&ctx->members_lock);
    drop_member(ctx, BSQ_SWEEPS);
    drop_member(ctx, BSQ_JOB_FILES);
    pthread_mutex_unlock(&ctx->members_lock);
}

void bsq_ctx_destroy(struct bsq_ctx *ctx)
{
    if (!ctx)
        return;
    for (int member = 0; member < BSQ_MEMBERS; member++)
        drop_member(ctx, (enum bsq_member)member);
    assert(atomic_load(&ctx->memory_used) == 0 && "memory of this context was not freed");
    bsq_clear_error(ctx);
    pthread_mutex_destroy(&ctx->error_lock);
    pthread_mutex_destroy(&ctx->callback_lock);
    pthread_mutex_destroy(&ctx->members_lock);
    free((char *)ctx->options.tmpdir);
    free(ctx);
}

unsigned bsq_threads(const struct bsq_ctx *ctx)
{
    return ctx->options.threads;
}

const char *bsq_tmpdir(const struct bsq_ctx *ctx)
{
    return ctx->options.tmpdir;
}

/* Formats a message as one printable line, whatever names in it contain. */
static char *format_line(const char *format, va_list arguments)
{
    char *text = NULL;
    const locale_t host = bsq_plain_numbers();
    const int length = vasprintf(&text, format, arguments);
    uselocale(host);
    if (length < 0)
        return no_memory_text;
    char *line = bsq_escape(text, false);
    free(text);
    return line ? line : no_memory_text;
}

static void free_line(char *text)
{
    if (text != no_memory_text)
        free(text);
}

static int record_failure(struct bsq_ctx *ctx, int status, char *text)
{
    assert(status < 0);
    pthread_mutex_lock(&ctx->error_lock);
    if (!atomic_load_explicit(&ctx->error, memory_order_relaxed)) {
        ctx->error_status = status;
        atomic_store_explicit(&ctx->error, text, memory_order_release);
        text = NULL;
    }
    pthread_mutex_unlock(&ctx->error_lock);
    if (text)
        free_line(text);
    return status;
}

int bsq_fail(struct bsq_ctx *ctx, int status, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    char *text = format_line(format, arguments);
    va_end(arguments);
    return record_failure(ctx, status, text);
}

static int status_of_errno(int status, int errnum)
{
    switch (errnum) {
    case ENOSPC:
    case EDQUOT:
    case EIO:
        return BSQ_EIO;
    case ENOMEM:
        return BSQ_ENOMEM;
    default:
        return status;
    }
}

int bsq_fail_errno(struct bsq_ctx *ctx, int status, int errnum, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    char *text = format_line(format, arguments);
    va_end(arguments);
    char buffer[256];
    const char *reason = strerror_r(errnum, buffer, sizeof buffer);
    status = bsq_fail(ctx, status_of_errno(status, errnum), "%s: %s", text, reason);
    free_line(text);
    return status;
}

const char *bsq_error(const struct bsq_ctx *ctx)
{
    const char *text = atomic_load_explicit(&ctx->error, memory_order_acquire);
    return text ? text : "";
}

int bsq_check_size(struct bsq_ctx *ctx, const char *name, size_t size, size_t expected)
{
    if (size == expected)
        return 0;
    return bsq_fail(ctx, BSQ_EUSAGE,
                    "struct %s has %zu bytes, and in version %s of the library %zu: start it with "
                    "its defaults, and compile the program for this version",
                    name, size, bsq_version(), expected);
}

int bsq_clear_report(struct bsq_ctx *ctx, const char *name, void *report, size_t expected)
{
    size_t size;
    memcpy(&size, report, sizeof size);
    if (bsq_check_size(ctx, name, size, expected) < 0)
        return BSQ_EUSAGE;
    memset((char *)report + sizeof size, 0, expected - sizeof size);
    return 0;
}

int bsq_error_status(struct bsq_ctx *ctx)
{
    pthread_mutex_lock(&ctx->error_lock);
    int status = ctx->error_status;
    pthread_mutex_unlock(&ctx->error_lock);
    return status;
}

void bsq_clear_error(struct bsq_ctx *ctx)
{
    pthread_mutex_lock(&ctx->error_lock);
    char *text = atomic_exchange(&ctx->error, NULL);
    ctx->error_status = 0;
    pthread_mutex_unlock(&ctx->error_lock);
    if (text)
        free_line(text);
}

/* Passes a line to on_warning, unless warnings are muted, and frees it. */
static void pass_warning(struct bsq_ctx *ctx, char *text)
{
    pthread_mutex_lock(&ctx->callback_lock);
    if (ctx->options.on_warning && !ctx->muted)
        ctx->options.on_warning(ctx->options.user, text);
    pthread_mutex_unlock(&ctx->callback_lock);
    free_line(text);
}

void bsq_warn(struct bsq_ctx *ctx, const char *format, ...)
{
    if (!ctx->options.on_warning)
        return;
    va_list arguments;
    va_start(arguments, format);
    char *text = format_line(format, arguments);
    va_end(arguments);
    pass_warning(ctx, text);
}

void bsq_set_strict(struct bsq_ctx *ctx, bool strict)
{
    ctx->strict = strict;
}

int bsq_warn_loss(struct bsq_ctx *ctx, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    char *text = format_line(format, arguments);
    va_end(arguments);
    if (ctx->strict)
        return record_failure(ctx, BSQ_EDATA, text);
    pass_warning(ctx, text);
    return 0;
}

void bsq_mute_warnings(struct bsq_ctx *ctx, bool muted)
{
    pthread_mutex_lock(&ctx->callback_lock);
    ctx->muted = muted;
    pthread_mutex_unlock(&ctx->callback_lock);
}

void bsq_interrupt(struct bsq_ctx *ctx)
{
    atomic_store(&ctx->interrupted, 1);
}

void bsq_clear_interruption(struct bsq_ctx *ctx)
{
    atomic_store(&ctx->interrupted, 0);
}

int bsq_check(struct bsq_ctx *ctx)
{
    if (!atomic_load_explicit(&ctx->interrupted, memory_order_relaxed))
        return 0;
    return bsq_fail(ctx, BSQ_EINTR, "interrupted");
}
