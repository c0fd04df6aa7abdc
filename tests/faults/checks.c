/* checks.c - counts how often a program looks for an interruption, as calls of the kind "check";
 * see fault.h. The programs in $TESTS/bin are those of the build, linked once more with it. So a
 * test can interrupt, stop or kill a program at the same point of its work on any machine. */
#include <stdatomic.h>
#include <stdint.h>

#include "tests/faults/fault.h"

struct bsq_ctx;

int __real_bsq_check(struct bsq_ctx *ctx);
int __wrap_bsq_check(struct bsq_ctx *ctx);
void __real_bsq_progress_begin(struct bsq_ctx *ctx, const char *stage, const char *unit,
                               uint64_t total);
void __wrap_bsq_progress_begin(struct bsq_ctx *ctx, const char *stage, const char *unit,
                               uint64_t total);

static _Atomic(const char *) current = ""; /* the stage that began last */

int __wrap_bsq_check(struct bsq_ctx *ctx)
{
    fault_at("check", "check", atomic_load(&current));
    return __real_bsq_check(ctx);
}

void __wrap_bsq_progress_begin(struct bsq_ctx *ctx, const char *stage, const char *unit,
                               uint64_t total)
{
    atomic_store(&current, stage);
    __real_bsq_progress_begin(ctx, stage, unit, total);
}
