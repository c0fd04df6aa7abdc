/* probe.h - asks drivers for their devices in a process of its own.
 *
 * Drivers may end the process that loads them (some abort where /sys is not mounted), hang, print,
 * or keep hundreds of megabytes. A program that only wants to know whether there is a GPU does not
 * have to share that. */
#ifndef BAKE_DEVICE_PROBE_H
#define BAKE_DEVICE_PROBE_H

#include "libbake/bake.h"

/* What the asking function tells, in the other process. */
struct bake_answers;
void bake_answer_device(struct bake_answers *answers, const struct bake_device_info *device);
void bake_answer_warning(struct bake_answers *answers, const char *line);

/* Calls ask() in a copy of this process, and here fn for each device and bsq_warn() for each
 * warning in the order of the answers; both only after ask() is done. Where it crashes or takes
 * longer than 30 seconds that is a warning, and there are no devices. `what` names the drivers. fn
 * may be NULL. Errors: BSQ_ENOMEM. */
int bake_probe(struct bsq_ctx *ctx, const char *what, void (*ask)(struct bake_answers *answers),
               void (*fn)(void *arg, const struct bake_device_info *device), void *arg);

#endif
