/* regions.c - makes the regions of a grid from chunks.
 *
 * Regions of 128^3 voxels, the lower nodes of the grid, go through a pipeline. The schedule
 * produces the next region with the chunks that touch it. A worker sums the fragments of their
 * triangles. The results are written in sequence. Every voxel belongs to one region and gets its
 * fragments in the order of the file, so results do not depend on threads or budget. */
#include <inttypes.h>
#include <string.h>

#include "base/parallel.h"
#include "libvoxel/voxelize/voxelize_run.h"

enum { BRICK_SIZE = 8 };

/* ---- the gate ----
 *
 * Units of work finish in any order and are written in sequence, so results pile up after a slow
 * one. A unit asks the gate before it keeps a result. At the limit it waits, unless it is the next
 * to be written: that unit is told that memory is short and may always go on, so there is no
 * deadlock. */

/* Waits for a signal, but not long, so that the caller sees an interruption. */
static void wait_a_little(pthread_cond_t *condition, pthread_mutex_t *lock)
{
    enum { PATIENCE_NS = 50 * 1000 * 1000, SECOND_NS = 1000 * 1000 * 1000 };
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_nsec += PATIENCE_NS;
    until.tv_sec += until.tv_nsec / SECOND_NS;
    until.tv_nsec %= SECOND_NS;
    pthread_cond_clockwait(condition, lock, CLOCK_MONOTONIC, &until);
}

/* Waits until `bytes` more are free for a unit, and takes them; returns 0. Returns 1 and takes
 * nothing if they are not free and the unit is the next to be written. Errors: BSQ_EINTR; the
 * status of another unit that failed. */
static int gate_take(struct vox_run *run, uint64_t sequence, uint64_t bytes)
{
    struct vox_gate *gate = &run->gate;
    int status = 0;
    pthread_mutex_lock(&gate->lock);
    while (gate->held + bytes > run->shares.result_bytes && status == 0) {
        if (gate->turn == sequence)
            status = 1;
        else if ((status = gate->status) == 0 && (status = bsq_check(run->ctx)) == 0)
            wait_a_little(&gate->changed, &gate->lock);
    }
    if (status == 0)
        gate->held += bytes;
    pthread_mutex_unlock(&gate->lock);
    return status;
}

/* Takes bytes even beyond the limit. Only for the unit that is the next to be written. */
static void gate_exceed(struct vox_gate *gate, uint64_t bytes)
{
    pthread_mutex_lock(&gate->lock);
    gate->held += bytes;
    pthread_mutex_unlock(&gate->lock);
}

/* Records that a unit was written, in sequence, and returns `bytes` to the gate. */
static void gate_written(struct vox_gate *gate, uint64_t bytes)
{
    pthread_mutex_lock(&gate->lock);
    gate->held -= bytes;
    gate->turn++;
    pthread_cond_broadcast(&gate->changed);
    pthread_mutex_unlock(&gate->lock);
}

/* Ends all waiting if a unit failed. Returns `status`. */
static int gate_pass(struct vox_gate *gate, int status)
{
    if (status >= 0)
        return status;
    pthread_mutex_lock(&gate->lock);
    if (gate->status == 0)
        gate->status = status;
    pthread_cond_broadcast(&gate->changed);
    pthread_mutex_unlock(&gate->lock);
    return status;
}

/* ---- producing units ---- */

static struct vox_box region_box(const int32_t origin[3])
{
    struct vox_box box;
    for (int a = 0; a < 3; a++) {
        box.lo[a] = origin[a];
        box.hi[a] = origin[a] + VOX_REGION_SIZE - 1;
    }
    return box;
}

/* Begins the next region and collects its chunks. Returns 1, 0 at the end or a negative status. */
static int begin_region(struct vox_run *run)
{
    struct vox_unit *region = &run->current;
    vox_region_key key, after;
    uint32_t chunk;
    if (!vox_schedule_next(run->schedule, &key))
        return 0;
    vox_region_origin(key, region->origin);
    region->chunk_count = 0;
    while (vox_schedule_chunk(run->schedule, &chunk, &after)) {
        BSQ_PASS(BSQ_GROW(run->ctx, "region's chunks", region->chunk_count + 1, &region->chunks,
                          &region->chunk_capacity));
        region->chunks[region->chunk_count++] = chunk;
        vox_chunks_expect(run->chunks, chunk, run->slabs, after);
    }
    run->next_slab = 0;
    return 1;
}

static int fill_unit(struct vox_run *run, struct vox_unit *unit, uint64_t sequence)
{
    const struct vox_unit *region = &run->current;
    const int32_t thickness = VOX_REGION_SIZE / (int32_t)run->slabs;
    int status;
    unit->sequence = sequence;
    if (run->next_slab == run->slabs && (status = begin_region(run)) <= 0)
        return status;
    BSQ_PASS(BSQ_GROW(run->ctx, "region's chunks", region->chunk_count, &unit->chunks,
                      &unit->chunk_capacity));
    memcpy(unit->origin, region->origin, sizeof unit->origin);
    memcpy(unit->chunks, region->chunks, region->chunk_count * sizeof *unit->chunks);
    unit->chunk_count = region->chunk_count;
    unit->window = region_box(region->origin);
    unit->window.lo[0] += (int32_t)run->next_slab * thickness;
    unit->window.hi[0] = unit->window.lo[0] + thickness - 1;
    run->next_slab++;
    return 1;
}

static int regions_produce(void *arg, void *slot, uint64_t sequence)
{
    struct vox_run *run = arg;
    return gate_pass(&run->gate, fill_unit(run, slot, sequence));
}

/* ---- writing units ---- */

static int write_unit(struct vox_run *run, const struct vox_unit *unit)
{
    const struct vox_leaves *leaves = &unit->leaves;
    if (leaves->leaf_count == 0)
        return 0;
    struct fmt_nvdb_region region = {
        .leaf_count = leaves->leaf_count,
        .leaf_ids = leaves->ids,
        .masks = (const uint64_t(*)[8])leaves->masks,
        .record_count = leaves->sides[0].count,
        .second_count = leaves->sides[1].count,
        .records = leaves->sides[0].records,
        .second = leaves->sides[1].records,
        .channels = leaves->sides[0].channels,
        .second_channels = leaves->sides[1].channels,
    };
    memcpy(region.origin, unit->origin, sizeof region.origin);
    run->clamped_colors += leaves->clamped_colors;
    return fmt_nvdb_append(run->writer, &region);
}

/* Writes a unit. Its slot keeps memory of ordinary size for the next unit, at most half of the
 * limit for all slots together. */
static int regions_emit(void *arg, void *slot, uint64_t sequence)
{
    struct vox_run *run = arg;
    struct vox_unit *unit = slot;
    uint64_t give_back = 0;
    (void)sequence;
    int status = write_unit(run, unit);
    if (status < 0)
        return gate_pass(&run->gate, status);
    if (unit->held_bytes > run->shares.result_bytes / 2 / run->unit_count) {
        vox_leaves_free(&unit->leaves);
        give_back = unit->held_bytes;
        unit->held_bytes = 0;
    }
    gate_written(&run->gate, give_back);
    return 0;
}

/* ---- the work on a unit ----
 *
 * A unit is made in as many parts as the accumulator's memory requires. Parts are cut along x
 * first, then y, then z, and taken in ascending order. So their leaves come in the order of the
 * file and are appended. A voxel's fragments come from one part in the order of triangles, however
 * small the part, so results do not depend on memory. */

/* Adds all triangles in the window. Returns 0, VOX_REGION_FULL or a negative status. */
static int add_chunks(struct vox_run *run, const struct vox_unit *unit,
                      const struct vox_box *window, const struct vox_worker *worker,
                      uint64_t *counted)
{
    const struct vox_box region = region_box(unit->origin);
    struct vox_accumulation chunk_sums = {
        .shading = &run->shading,
        .region = &region,
        .window = window,
        .sums = worker->sums,
        .block = worker->block,
    };
    int status = 0;
    for (uint64_t i = 0; i < unit->chunk_count && status == 0; i++) {
        uint32_t number = unit->chunks[i];
        const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(run->file)[number];
        const struct vox_box bounds =
            vox_transform_box(&run->transform, info->bounds_min, info->bounds_max);
        if (!vox_boxes_meet(&bounds, window))
            continue;
        BSQ_PASS(bsq_check(run->ctx));
        BSQ_PASS(vox_chunks_acquire(run->chunks, number, &chunk_sums.chunk));
        status = BSQ_SIMD_PICK(bsq_simd_best(), vox_accumulate_chunk)(&chunk_sums, counted);
        vox_chunks_release(run->chunks, number);
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
static int reserve_result(struct vox_run *run, struct vox_unit *unit,
                          const struct vox_accumulator *sums)
{
    uint64_t bytes = vox_accumulator_result_bytes(sums, &unit->leaves);
    if (bytes <= unit->held_bytes)
        return 0;
    int status = gate_take(run, unit->sequence, bytes - unit->held_bytes);
    if (status == 1) {
        status = write_unit(run, unit);
        vox_leaves_clear(&unit->leaves);
        bytes = vox_accumulator_result_bytes(sums, &unit->leaves);
        if (bytes <= unit->held_bytes)
            return status;
        gate_exceed(&run->gate, bytes - unit->held_bytes);
    }
    if (status == 0)
        unit->held_bytes = bytes;
    return status;
}

static int keep_result(struct vox_run *run, struct vox_unit *unit, struct vox_accumulator *sums)
{
    vox_accumulator_settle(sums);
    BSQ_PASS(reserve_result(run, unit, sums));
    return vox_accumulator_finish(sums, &run->shading.tables, &unit->leaves);
}

static int work_window(struct vox_run *run, struct vox_unit *unit, const struct vox_box *window,
                       const struct vox_worker *worker)
{
    uint64_t counted = 0;
    struct vox_box half[2];
    vox_accumulator_clear(worker->sums);
    int status = add_chunks(run, unit, window, worker, &counted);
    if (status == VOX_REGION_FULL) {
        if (!halve(window, half))
            return bsq_fail(run->ctx, BSQ_EBUG, "one brick does not fit an accumulator");
        status = work_window(run, unit, &half[0], worker);
        return status != 0 ? status : work_window(run, unit, &half[1], worker);
    }
    BSQ_PASS(status);
    BSQ_PASS(keep_result(run, unit, worker->sums));
    bsq_progress_add(run->ctx, counted);
    return 0;
}

static int regions_work(void *arg, void *slot, uint64_t sequence, unsigned worker)
{
    struct vox_run *run = arg;
    struct vox_unit *unit = slot;
    (void)sequence;
    vox_leaves_clear(&unit->leaves);
    int status = work_window(run, unit, &unit->window, &run->own[worker]);
    for (uint64_t i = 0; i < unit->chunk_count; i++)
        vox_chunks_done(run->chunks, unit->chunks[i]);
    return gate_pass(&run->gate, status);
}

int vox_run_regions(struct vox_run *run)
{
    const struct bsq_pipeline pipeline = {
        .produce = regions_produce,
        .work = regions_work,
        .emit = regions_emit,
        .arg = run,
        .slots = run->units,
        .slot_size = sizeof *run->units,
        .slot_count = run->unit_count,
    };
    bsq_progress_begin(run->ctx, "voxelizing", "triangles", run->header->triangle_count);
    const int status = bsq_pipeline_run(run->ctx, &pipeline);
    bsq_progress_end(run->ctx);
    BSQ_PASS(status);
    if (run->clamped_colors > 0)
        BSQ_PASS(bsq_warn_loss(run->ctx,
                               "%s: %" PRIu64 " voxels have colours below 0 or above 1, which the "
                               "grid's 8 bits clamp; bake such colours from the chunk file (.tris)",
                               run->options->tris_path, run->clamped_colors));
    return fmt_shading_tell_losses(&run->shading.scan);
}
