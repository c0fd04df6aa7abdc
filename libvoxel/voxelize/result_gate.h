/* result_gate.h - bounds the memory of results that wait to be written.
 *
 * Units of work finish in any order and are written in sequence, so results pile up after a slow
 * one. A unit asks the gate before it keeps a result. At the limit it waits, unless it is the next
 * to be written: that unit is told that memory is short and may always go on, so there is no
 * deadlock. */
#ifndef VOX_VOXELIZE_RESULT_GATE_H
#define VOX_VOXELIZE_RESULT_GATE_H

#include <pthread.h>

#include "base/context.h"

struct vox_result_gate {
    struct bsq_ctx *ctx;
    pthread_mutex_t lock;
    pthread_cond_t changed;
    uint64_t limit, held; /* bytes */
    uint64_t turn;        /* sequence number of the unit that is written next */
    int status;           /* of the first unit that failed */
};

void vox_gate_init(struct vox_result_gate *gate, struct bsq_ctx *ctx, uint64_t limit_bytes);
void vox_gate_free(struct vox_result_gate *gate);

/* Waits until `bytes` more are free for a unit, and takes them; returns 0. Returns 1 and takes
 * nothing if they are not free and the unit is the next to be written. Errors: BSQ_EINTR; the
 * status of another unit that failed. */
int vox_gate_take(struct vox_result_gate *gate, uint64_t sequence, uint64_t bytes);
/* Takes bytes even beyond the limit. Only for the unit that is the next to be written. */
void vox_gate_exceed(struct vox_result_gate *gate, uint64_t bytes);
/* Records that a unit was written, in sequence, and returns `bytes` to the gate. */
void vox_gate_written(struct vox_result_gate *gate, uint64_t bytes);
/* Ends all waiting because a unit failed. Returns `status`. */
int vox_gate_fail(struct vox_result_gate *gate, int status);

#endif
