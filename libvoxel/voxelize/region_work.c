/* region_work.c - one unit of work, in as many parts as the accumulator's memory asks for.
 *
 * Parts are cut along x first, then y, then z, and taken in ascending order, so that their leaves
 * come in the order of the file and are simply appended. A voxel's pieces come from one part in the
 * order of triangles, however small the part, so the result does not depend on the memory. */
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
static int add_chunks(const struct vox_scan *scan, const struct vox_unit *unit,
                      const struct vox_box *window, const struct vox_worker *worker,
                      uint64_t *counted)
{
    struct vox_box region = region_box(unit->origin);
    struct vox_accumulation what = {
        .shading = &scan->shading,
        .region = &region,
        .window = window,
        .sums = worker->sums,
        .block = worker->block,
    };
    int status = 0;
    for (uint64_t i = 0; i < unit->chunk_count && status == 0; i++) {
        uint32_t number = unit->chunks[i];
        if (!vox_boxes_meet(&scan->boxes[number], window))
            continue;
        if ((status = bsq_check(scan->ctx)) < 0 ||
            (status = vox_chunks_acquire(scan->chunks, number, &what.chunk)) < 0)
            break;
        status = BSQ_SIMD_PICK(bsq_simd_best(), vox_accumulate_chunk)(&what, counted);
        vox_chunks_release(scan->chunks, number);
    }
    return status;
}

/* Cuts the window in two halves of whole bricks along the first axis that has more than one. */
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

/* Takes memory for the sums as a part of the unit's result. Where there is too little of it, and
 * all units before this are written, so is what this one holds: a full region needs no more than a
 * part of it. */
static int make_room(struct vox_scan *scan, struct vox_unit *unit,
                     const struct vox_accumulator *sums)
{
    uint64_t bytes = vox_accumulator_result_bytes(sums, &unit->leaves);
    if (bytes <= unit->held_bytes)
        return 0;
    int status = vox_gate_take(&scan->gate, unit->sequence, bytes - unit->held_bytes);
    if (status == 1) {
        status = scan->write(scan->write_arg, unit);
        vox_leaves_clear(&unit->leaves);
        bytes = vox_accumulator_result_bytes(sums, &unit->leaves);
        if (bytes <= unit->held_bytes)
            return status;
        vox_gate_exceed(&scan->gate, bytes - unit->held_bytes);
    }
    if (status == 0)
        unit->held_bytes = bytes;
    return status;
}

static int keep_result(struct vox_scan *scan, struct vox_unit *unit,
                       const struct vox_accumulator *sums)
{
    int status = make_room(scan, unit, sums);
    if (status < 0)
        return status;
    return vox_accumulator_finish(sums, &scan->shading.tables, &unit->leaves);
}

static int work_window(struct vox_scan *scan, struct vox_unit *unit, const struct vox_box *window,
                       const struct vox_worker *worker)
{
    uint64_t counted = 0;
    struct vox_box half[2];
    vox_accumulator_clear(worker->sums);
    int status = add_chunks(scan, unit, window, worker, &counted);
    if (status == VOX_REGION_FULL) {
        if (!halve(window, half))
            return bsq_fail(scan->ctx, BSQ_EBUG, "one brick does not fit an accumulator");
        status = work_window(scan, unit, &half[0], worker);
        return status != 0 ? status : work_window(scan, unit, &half[1], worker);
    }
    if (status == 0)
        status = keep_result(scan, unit, worker->sums);
    if (status == 0)
        bsq_progress_add(scan->ctx, counted);
    return status;
}

int vox_region_work(struct vox_scan *scan, struct vox_unit *unit, const struct vox_worker *worker)
{
    vox_leaves_clear(&unit->leaves);
    int status = work_window(scan, unit, &unit->window, worker);
    for (uint64_t i = 0; i < unit->chunk_count; i++)
        vox_chunks_done(scan->chunks, unit->chunks[i]);
    return status < 0 ? vox_gate_fail(&scan->gate, status) : status;
}
