/** @file
 * Warnings of data that is lost, which a strict job does not accept. */
#ifndef BSQ_LOSS_H
#define BSQ_LOSS_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Makes bsq_warn_loss() fail, if `strict` is set. Call it before the job. */
void bsq_set_strict(struct bsq_ctx *ctx, bool strict);

/** Warns of data that is lost, as bsq_warn() does. Returns 0. In a strict job, records the line as
 * a failure instead and returns BSQ_EDATA. */
int bsq_warn_loss(struct bsq_ctx *ctx, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/** Holds warnings back, of lost data too, until it is called with false. For code that reads an
 * input again whose warnings were given. A strict job fails all the same. */
void bsq_mute_warnings(struct bsq_ctx *ctx, bool muted);

#ifdef __cplusplus
}
#endif
#endif
