/* result_gate.h - bounds the memory of results that wait to be written.
 *
 * Units of work finish in any order and are written in sequence, so results pile up behind a slow
 * one. A unit asks here before it keeps a result. Where the limit is reached it waits, unless it is
 * the next to be written: that one learns that room is short, and may always go on, so there is no
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
    uint64_t turn;        /* sequence number of the unit to be written next */
    int status;           /* of the first unit that failed */
};

void vox_gate_init(struct vox_result_gate *gate, struct bsq_ctx *ctx, uint64_t limit_bytes);
void vox_gate_free(struct vox_result_gate *gate);

/* Waits until there are `bytes` more for a unit, and takes them: 0. Returns 1, with nothing taken,
 * where there are not and the unit is the next to be written. Errors: BSQ_EINTR; the status of a
 * unit that failed meanwhile. */
int vox_gate_take(struct vox_result_gate *gate, uint64_t sequence, uint64_t bytes);
/* Takes them whether there is room or not; for the unit that is the next to be written. */
void vox_gate_exceed(struct vox_result_gate *gate, uint64_t bytes);
/* Says that a unit was written, in sequence, and gives back `bytes`. */
void vox_gate_written(struct vox_result_gate *gate, uint64_t bytes);
/* Ends all waiting because a unit failed; returns `status`. */
int vox_gate_fail(struct vox_result_gate *gate, int status);

#endif
