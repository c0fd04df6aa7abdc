/* region_work.c - one unit of work, in as many parts as the accumulator's memory requires.
 *
 * Parts are cut along x first, then y, then z, and taken in ascending order. So their leaves come
 * in the order of the file and are appended. A voxel's fragments come from one part in the order of
 * triangles, however small the part, so results do not depend on memory. */
#include "libvoxel/voxelize/region_work.h"

enum { BRICK_SIZE = 8 };

static struct vox_box region_box(const int32_t origin[3])
{
    struct vox_box box;
    for (int a = 0; a < 3; a++) {
        box.lo[a] = origin[a];
        box.hi[a] = origin[a] + VOX_REGION_SIZE - 1;
    }
    return box;
}

/* Adds all triangles in the window. Returns 0, VOX_REGION_FULL or a negative status. */
static int add_chunks(const struct vox_shared *shared, const struct vox_unit *unit,
                      const struct vox_box *window, const struct vox_worker *worker,
                      uint64_t *counted)
{
    struct vox_box region = region_box(unit->origin);
    struct vox_accumulation job = {
        .shading = &shared->shading,
        .region = &region,
        .window = window,
        .sums = worker->sums,
        .block = worker->block,
    };
    int status = 0;
    for (uint64_t i = 0; i < unit->chunk_count && status == 0; i++) {
        uint32_t number = unit->chunks[i];
        if (!vox_boxes_meet(&shared->bounds[number], window))
            continue;
        if ((status = bsq_check(shared->ctx)) < 0 ||
            (status = vox_chunks_acquire(shared->chunks, number, &job.chunk)) < 0)
            break;
        status = BSQ_SIMD_PICK(bsq_simd_best(), vox_accumulate_chunk)(&job, counted);
        vox_chunks_release(shared->chunks, number);
    }
    return status;
}

/* Cuts the window into two halves of whole bricks, along the first axis that has more than one.
 * Returns false for a single brick. */
static bool halve(const struct vox_box *window, struct vox_box half[2])
{
    for (int a = 0; a < 3; a++) {
        int32_t size = window->hi[a] - window->lo[a] + 1;
        if (size <= BRICK_SIZE)
            continue;
        half[0] = half[1] = *window;
        half[0].hi[a] = window->lo[a] + size / 2 - 1;
        half[1].lo[a] = window->lo[a] + size / 2;
        return true;
    }
    return false;
}

/* Reserves memory for the sums as part of the unit's result. If there is too little, and all units
 * before this one are written, writes what this unit holds. It then exceeds the limit by at most
 * one part's result. */
static int reserve_result(struct vox_shared *shared, struct vox_unit *unit,
                          const struct vox_accumulator *sums)
{
    uint64_t bytes = vox_accumulator_result_bytes(sums, &unit->leaves);
    if (bytes <= unit->held_bytes)
        return 0;
    int status = vox_gate_take(&shared->gate, unit->sequence, bytes - unit->held_bytes);
    if (status == 1) {
        status = shared->write(shared->write_arg, unit);
        vox_leaves_clear(&unit->leaves);
        bytes = vox_accumulator_result_bytes(sums, &unit->leaves);
        if (bytes <= unit->held_bytes)
            return status;
        vox_gate_exceed(&shared->gate, bytes - unit->held_bytes);
    }
    if (status == 0)
        unit->held_bytes = bytes;
    return status;
}

static int keep_result(struct vox_shared *shared, struct vox_unit *unit,
                       struct vox_accumulator *sums)
{
    vox_accumulator_settle(sums);
    int status = reserve_result(shared, unit, sums);
    if (status < 0)
        return status;
    return vox_accumulator_finish(sums, &shared->shading.tables, &unit->leaves);
}

static int work_window(struct vox_shared *shared, struct vox_unit *unit,
                       const struct vox_box *window, const struct vox_worker *worker)
{
    uint64_t counted = 0;
    struct vox_box half[2];
    vox_accumulator_clear(worker->sums);
    int status = add_chunks(shared, unit, window, worker, &counted);
    if (status == VOX_REGION_FULL) {
        if (!halve(window, half))
            return bsq_fail(shared->ctx, BSQ_EBUG, "one brick does not fit an accumulator");
        status = work_window(shared, unit, &half[0], worker);
        return status != 0 ? status : work_window(shared, unit, &half[1], worker);
    }
    if (status == 0)
        status = keep_result(shared, unit, worker->sums);
    if (status == 0)
        bsq_progress_add(shared->ctx, counted);
    return status;
}

int vox_region_work(struct vox_shared *shared, struct vox_unit *unit,
                    const struct vox_worker *worker)
{
    vox_leaves_clear(&unit->leaves);
    int status = work_window(shared, unit, &unit->window, worker);
    for (uint64_t i = 0; i < unit->chunk_count; i++)
        vox_chunks_done(shared->chunks, unit->chunks[i]);
    return status < 0 ? vox_gate_fail(&shared->gate, status) : status;
}
