/* result_gate.c - waiting for memory, in the order of units. */
#include "libvoxel/voxelize/result_gate.h"

#include "base/parallel.h"

void vox_gate_init(struct vox_result_gate *gate, struct bsq_ctx *ctx, uint64_t limit_bytes)
{
    gate->ctx = ctx;
    gate->limit = limit_bytes;
    gate->held = gate->turn = 0;
    gate->status = 0;
    pthread_mutex_init(&gate->lock, NULL);
    pthread_cond_init(&gate->changed, NULL);
}

void vox_gate_free(struct vox_result_gate *gate)
{
    pthread_cond_destroy(&gate->changed);
    pthread_mutex_destroy(&gate->lock);
}

int vox_gate_take(struct vox_result_gate *gate, uint64_t sequence, uint64_t bytes)
{
    int status = 0;
    pthread_mutex_lock(&gate->lock);
    while (gate->held + bytes > gate->limit && status == 0) {
        if (gate->turn == sequence)
            status = 1;
        else if ((status = gate->status) == 0 && (status = bsq_check(gate->ctx)) == 0)
            bsq_wait_a_little(&gate->changed, &gate->lock);
    }
    if (status == 0)
        gate->held += bytes;
    pthread_mutex_unlock(&gate->lock);
    return status;
}

void vox_gate_exceed(struct vox_result_gate *gate, uint64_t bytes)
{
    pthread_mutex_lock(&gate->lock);
    gate->held += bytes;
    pthread_mutex_unlock(&gate->lock);
}

void vox_gate_written(struct vox_result_gate *gate, uint64_t bytes)
{
    pthread_mutex_lock(&gate->lock);
    gate->held -= bytes;
    gate->turn++;
    pthread_cond_broadcast(&gate->changed);
    pthread_mutex_unlock(&gate->lock);
}

int vox_gate_fail(struct vox_result_gate *gate, int status)
{
    pthread_mutex_lock(&gate->lock);
    if (gate->status == 0)
        gate->status = status;
    pthread_cond_broadcast(&gate->changed);
    pthread_mutex_unlock(&gate->lock);
    return status;
}
