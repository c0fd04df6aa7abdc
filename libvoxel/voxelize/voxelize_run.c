/* voxelize_run.c - makes regions from chunk files.
 *
 * Regions of 128^3 voxels, the lower nodes of the grid, go through a pipeline. The schedule
 * produces the next region with the chunks that touch it. A worker sums the fragments of their
 * triangles. The results are written in sequence. Every voxel belongs to one region and gets its
 * fragments in the order of the file, so results do not depend on threads or budget. */
#include "libvoxel/voxelize/voxelize_run.h"

#include <inttypes.h>
#include <string.h>

#include "base/channels.h"
#include "base/parallel.h"
#include "libvoxel/float_precision.h"
#include "libvoxel/temp_tris.h"
#include "libvoxel/voxelize/grid_estimate.h"

/* More bytes of sums than this would not stay in a processor's cache; then regions are made in
 * parts. */
#define ACCUMULATOR_BYTES_USEFUL   (UINT64_C(48) << 20)
#define TEXTURE_CACHE_BYTES_MIN    (UINT64_C(12) << 20)
#define TEXTURE_CACHE_BYTES_USEFUL (UINT64_C(1) << 30)
/* Least bytes for results of regions under way, for each worker. */
#define RESULT_BYTES_MIN (UINT64_C(1) << 20)

/* Units under way for each worker. Some regions take a hundred times as long as others. Meanwhile
 * results of later regions wait in their slots, and no worker has to. */
enum { UNITS_PER_WORKER = 8 };

enum { SLABS_MAX = VOX_REGION_SIZE / 8 };

/* ---- the budget ---- */

struct plan {
    uint64_t cache_slots, accumulator_bytes, result_bytes;
    uint64_t texture_bytes; /* for colours, for further channels and for the normal map each */
};

static uint64_t min64(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* Returns the values of further channels in a record. */
static uint32_t channel_values(const struct vox_run *job)
{
    const char *list = job->options->channels;
    return list ? bsq_channel_list_values(list, strlen(list)) : 0;
}

/* Returns what accumulators sum, as vox_accumulator_create() takes it. */
static unsigned sums_of(const struct vox_run *job)
{
    return (vox_shading_has_color(job->header) ? VOX_SUM_COLORS : 0u) +
           (job->options->ids ? VOX_SUM_IDS : 0u) + VOX_SUM_CHANNEL_VALUE * channel_values(job);
}

/* Gives half of the free memory to the chunk cache and a quarter to the sums. The rest is left to
 * the results under way and to the writer. Fails early if the minimum of all that does not fit. */
static int make_plan(const struct vox_run *job, struct plan *plan)
{
    uint64_t available = bsq_memory_left(job->ctx);
    uint64_t slot = vox_chunks_slot_bytes(job->file, job->smooth != NULL);
    const unsigned sums = sums_of(job);
    plan->texture_bytes = 0;
    const uint64_t caches =
        (vox_shading_needs_textures(job->header) ? 1u : 0u) +
        (vox_shading_channels_need_textures(job->header, job->options->channels) ? 1u : 0u) +
        (vox_shading_needs_normal_map(job->header, job->options->scan_normal_map) ? 1u : 0u);
    if (caches > 0) {
        plan->texture_bytes = min64(available / 4 / caches, TEXTURE_CACHE_BYTES_USEFUL);
        if (plan->texture_bytes < TEXTURE_CACHE_BYTES_MIN)
            plan->texture_bytes = TEXTURE_CACHE_BYTES_MIN;
    }
    uint64_t sums_min = vox_accumulator_bytes_min(sums),
             blocks = job->workers * vox_fragment_block_bytes();
    uint64_t need =
        caches * plan->texture_bytes + slot + blocks + job->workers * (sums_min + RESULT_BYTES_MIN);
    if (available < need)
        return bsq_fail(job->ctx, BSQ_ENOMEM,
                        "%s: a memory budget of %" PRIu64 " bytes is too small: voxelizing with %u "
                        "threads needs %" PRIu64 " bytes beside the %" PRIu64 " in use",
                        job->options->tris_path, bsq_memory_limit(job->ctx), job->workers, need,
                        bsq_memory_used(job->ctx));
    available -= caches * plan->texture_bytes + blocks;
    uint64_t slots = available / 2 / slot;
    plan->cache_slots = slots < 1 ? 1 : min64(min64(slots, job->header->chunk_count), INT32_MAX);
    available -= plan->cache_slots * slot;
    uint64_t share = min64(available / 2 / job->workers, ACCUMULATOR_BYTES_USEFUL);
    plan->accumulator_bytes = share > sums_min ? share : sums_min;
    available -= job->workers * plan->accumulator_bytes;
    /* The other half is for results that grow while they are held, and for the writer. */
    plan->result_bytes = available / 2;
    bsq_note_share(job->ctx, "textures", caches * plan->texture_bytes);
    bsq_note_share(job->ctx, "chunks", plan->cache_slots * slot);
    bsq_note_share(job->ctx, "sums of voxels", job->workers * plan->accumulator_bytes);
    bsq_note_share(job->ctx, "results", plan->result_bytes);
    return 0;
}

/* ---- set-up ---- */

static int check_channels(const struct vox_run *job)
{
    const char *list = job->options->channels;
    uint32_t first;
    if (list && channel_values(job) == 0)
        return bsq_fail(job->ctx, BSQ_EUSAGE, "\"%.60s\" cannot be channels", list);
    if (list && bsq_channel_list_find(list, strlen(list), BSQ_CHANNEL_NORMAL_MAP, &first))
        return bsq_fail(job->ctx, BSQ_EUSAGE,
                        "grids have no channel " BSQ_CHANNEL_NORMAL_MAP
                        ": their normals contain it");
    return 0;
}

static int open_input(struct vox_run *job)
{
    const char *path = job->options->tris_path;
    const struct vox_temp_tris *temp = job->options->temp_tris;
    const uint32_t parts = job->options->part_paths ? job->options->part_count : 0;
    int status = temp || parts > 0 ? fmt_tris_open_parts(job->ctx, job->options->part_paths, parts,
                                                         temp ? &temp->file : NULL, &job->file)
                                   : fmt_tris_open(job->ctx, path, &job->file);
    if (status < 0)
        return status;
    job->header = fmt_tris_get_header(job->file);
    if (job->header->triangle_count == 0)
        return bsq_fail(job->ctx, BSQ_EDATA, "%s: the scan has no triangles", path);
    if (job->header->chunk_count >= UINT32_MAX)
        return bsq_fail(job->ctx, BSQ_EDATA, "%s: %" PRIu64 " chunks are too many", path,
                        job->header->chunk_count);
    status = job->options->ids ? fmt_tris_require_ids(job->file) : 0;
    if (status == 0)
        status = check_channels(job);
    return status < 0 ? status
                      : vox_transform_init(job->ctx, job->header, path, job->options->resolution,
                                           job->options->voxel_size, &job->shared.transform);
}

/* Refuses a grid that does not fit on its disk or in the format, and warns of lost precision. */
static int check_grid(struct vox_run *job)
{
    const unsigned further = (unsigned)vox_shading_has_color(job->header) +
                             (unsigned)job->options->ids + channel_values(job);
    int status = vox_estimate_check(job->ctx, job->file, &job->shared.transform, further,
                                    job->options->grid_path);
    if (status == 0)
        vox_precision_warn_grid(job->ctx, job->options->tris_path, job->header,
                                fmt_tris_chunks(job->file), job->shared.transform.h);
    return status;
}

/* Finds the boxes of chunks in the regions that they touch. */
static int find_boxes(struct vox_run *job)
{
    uint64_t count = job->header->chunk_count;
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(job->file);
    int status = bsq_alloc(job->ctx, "chunk bounds", count, sizeof *job->bounds, &job->bounds);
    if (status < 0)
        return status;
    for (uint64_t i = 0; i < count; i++)
        job->bounds[i] =
            vox_transform_box(&job->shared.transform, infos[i].bounds_min, infos[i].bounds_max);
    job->shared.bounds = job->bounds;
    return vox_chunk_boxes_create(job->ctx, job->file, &job->shared.transform, job->bounds,
                                  bsq_memory_share(job->ctx, "boxes of chunks", 16), &job->boxes,
                                  &job->box_count);
}

int vox_run_open(struct bsq_ctx *ctx, const struct vox_voxelize_options *options,
                 struct vox_run *job)
{
    *job = (struct vox_run){.options = options, .ctx = ctx, .workers = bsq_threads(ctx)};
    job->shared.ctx = ctx;
    for (int a = 0; a < 3; a++) {
        job->index_min[a] = INT32_MAX;
        job->index_max[a] = INT32_MIN;
    }
    int status = 0;
    BSQ_TRY(open_input(job));
    BSQ_TRY(find_boxes(job));
    status = check_grid(job);
done:
    return status;
}

static int make_smooth(struct vox_run *job)
{
    if ((job->header->attributes & FMT_TRIS_NORMALS) ||
        job->options->scan_normals == BSQ_SCAN_NORMALS_FLAT)
        return 0;
    return vox_smooth_create(job->ctx, job->file, job->options->scan_normals, job->workers,
                             bsq_memory_share(job->ctx, "smooth normals", 8), &job->smooth);
}

/* Chooses the slabs that regions are cut into. Few regions would not keep all workers busy. */
static uint32_t choose_slabs(double regions, unsigned workers)
{
    uint32_t slabs = 1;
    if (workers == 1)
        return 1;
    while (slabs < SLABS_MAX && regions * slabs < 16.0 * workers)
        slabs *= 2;
    return slabs;
}

static int make_workers(struct vox_run *job, const struct plan *plan)
{
    int status = bsq_calloc(job->ctx, "workers", job->workers, sizeof *job->own, &job->own);
    for (unsigned i = 0; i < job->workers && status == 0; i++) {
        struct vox_worker *own = &job->own[i];
        status =
            vox_accumulator_create(job->ctx, plan->accumulator_bytes, sums_of(job), &own->sums);
        if (status == 0)
            status = vox_fragment_block_create(job->ctx, &own->block);
    }
    if (status < 0)
        return status;
    uint64_t count = UINT64_C(1) * UNITS_PER_WORKER * job->workers;
    if ((status = bsq_calloc(job->ctx, "workers", count, sizeof *job->units, &job->units)) < 0)
        return status;
    job->unit_count = (unsigned)count;
    for (unsigned i = 0; i < job->unit_count; i++)
        vox_leaves_init(&job->units[i].leaves, job->ctx);
    return 0;
}

static int set_up(struct vox_run *job)
{
    const struct vox_voxelize_options *options = job->options;
    struct vox_shading *shading = &job->shared.shading;
    struct plan plan = {0};
    int status = 0;
    BSQ_TRY(vox_schedule_create(job->ctx, job->boxes, job->box_count, &job->schedule));
    BSQ_TRY(make_smooth(job));
    BSQ_TRY(make_plan(job, &plan));
    BSQ_TRY(vox_shading_init(job->ctx, job->header, plan.texture_bytes, shading));
    if (options->ids)
        BSQ_TRY(vox_shading_use_ids(job->ctx, shading));
    if (options->channels)
        BSQ_TRY(vox_shading_use_channels(job->ctx, job->file, options->channels, plan.texture_bytes,
                                         shading));
    BSQ_TRY(vox_shading_use_normal_map(job->ctx, options->tris_path, options->scan_normal_map,
                                       plan.texture_bytes, shading));
    BSQ_TRY(vox_chunks_create(job->ctx, job->file, &job->shared.transform, job->boxes,
                              job->box_count, job->smooth, (uint32_t)plan.cache_slots,
                              &job->shared.chunks));
    BSQ_TRY(make_workers(job, &plan));
    vox_gate_init(&job->shared.gate, job->ctx, plan.result_bytes);
    job->gate_open = true;
    job->slabs = choose_slabs(vox_region_count(&job->shared.transform.voxels), job->workers);
    job->next_slab = job->slabs;
done:
    return status;
}

/* Frees what the pipeline needed: joining the sections of a grid needs memory too. */
static void end_pipeline(struct vox_run *job)
{
    for (unsigned i = 0; i < job->unit_count; i++) {
        bsq_free(job->ctx, job->units[i].chunks);
        vox_leaves_free(&job->units[i].leaves);
    }
    bsq_free(job->ctx, job->units);
    job->unit_count = 0;
    job->units = NULL;
    for (unsigned i = 0; job->own && i < job->workers; i++) {
        vox_accumulator_destroy(job->own[i].sums);
        vox_fragment_block_destroy(job->ctx, job->own[i].block);
    }
    bsq_free(job->ctx, job->own);
    job->own = NULL;
    bsq_free(job->ctx, job->current.chunks);
    job->current.chunks = NULL;
    vox_chunks_destroy(job->shared.chunks);
    job->shared.chunks = NULL;
    vox_smooth_destroy(job->smooth);
    job->smooth = NULL;
    vox_schedule_destroy(job->schedule);
    job->schedule = NULL;
    bsq_free(job->ctx, job->boxes);
    job->boxes = NULL;
    vox_shading_free(job->ctx, &job->shared.shading);
}

void vox_run_close(struct vox_run *job)
{
    if (!job->ctx)
        return;
    end_pipeline(job);
    if (job->gate_open)
        vox_gate_free(&job->shared.gate);
    bsq_free(job->ctx, job->bounds);
    fmt_tris_close(job->file);
}

/* ---- the pipeline ---- */

/* Begins the next region and collects its chunks. Returns 1, 0 at the end or a negative status. */
static int begin_region(struct vox_run *job)
{
    struct vox_unit *region = &job->current;
    struct vox_region_key key, after;
    uint32_t chunk;
    int status;
    if (!vox_schedule_next(job->schedule, &key))
        return 0;
    vox_region_origin(key, region->origin);
    region->chunk_count = 0;
    while (vox_schedule_chunk(job->schedule, &chunk, &after)) {
        if ((status = bsq_grow(job->ctx, "region's chunks", region->chunk_count + 1,
                               sizeof *region->chunks, &region->chunks, &region->chunk_capacity)) <
            0)
            return status;
        region->chunks[region->chunk_count++] = chunk;
        vox_chunks_expect(job->shared.chunks, chunk, job->slabs, after);
    }
    job->next_slab = 0;
    return 1;
}

static struct vox_box slab_window(const struct vox_run *job, const int32_t origin[3])
{
    int32_t thickness = VOX_REGION_SIZE / (int32_t)job->slabs;
    struct vox_box window;
    for (int a = 0; a < 3; a++) {
        window.lo[a] = origin[a];
        window.hi[a] = origin[a] + VOX_REGION_SIZE - 1;
    }
    window.lo[0] += (int32_t)job->next_slab * thickness;
    window.hi[0] = window.lo[0] + thickness - 1;
    return window;
}

static int fill_unit(struct vox_run *job, struct vox_unit *unit, uint64_t sequence)
{
    const struct vox_unit *region = &job->current;
    int status;
    unit->sequence = sequence;
    if (job->next_slab == job->slabs && (status = begin_region(job)) <= 0)
        return status;
    if ((status = bsq_grow(job->ctx, "region's chunks", region->chunk_count, sizeof *unit->chunks,
                           &unit->chunks, &unit->chunk_capacity)) < 0)
        return status;
    memcpy(unit->origin, region->origin, sizeof unit->origin);
    memcpy(unit->chunks, region->chunks, region->chunk_count * sizeof *unit->chunks);
    unit->chunk_count = region->chunk_count;
    unit->window = slab_window(job, region->origin);
    job->next_slab++;
    return 1;
}

static int produce(void *arg, void *slot, uint64_t sequence)
{
    struct vox_run *job = arg;
    int status = fill_unit(job, slot, sequence);
    return status < 0 ? vox_gate_fail(&job->shared.gate, status) : status;
}

static int work(void *arg, void *slot, uint64_t sequence, unsigned worker)
{
    struct vox_run *job = arg;
    (void)sequence;
    return vox_region_work(&job->shared, slot, &job->own[worker]);
}

static void widen_index(struct vox_run *job, const struct vox_unit *unit)
{
    for (int a = 0; a < 3; a++) {
        int32_t lo = unit->origin[a] + (int32_t)unit->leaves.voxel_min[a];
        int32_t hi = unit->origin[a] + (int32_t)unit->leaves.voxel_max[a];
        job->index_min[a] = lo < job->index_min[a] ? lo : job->index_min[a];
        job->index_max[a] = hi > job->index_max[a] ? hi : job->index_max[a];
    }
}

static int write_unit(void *arg, const struct vox_unit *unit)
{
    struct vox_run *job = arg;
    const struct vox_leaves *leaves = &unit->leaves;
    if (leaves->leaf_count == 0)
        return 0;
    struct fmt_nvdb_region region = {
        .leaf_count = leaves->leaf_count,
        .leaf_ids = leaves->ids,
        .masks = (const uint64_t(*)[8])leaves->masks,
        .record_count = leaves->record_count,
        .second_count = leaves->second_count,
        .records = leaves->records,
        .second = leaves->second,
        .channels = leaves->channels,
        .second_channels = leaves->second_channels,
    };
    memcpy(region.origin, unit->origin, sizeof region.origin);
    widen_index(job, unit);
    return fmt_nvdb_append(job->writer, &region);
}

/* Writes a unit. Its slot keeps memory of ordinary size for the next unit, at most half of the
 * limit for all slots together. */
static int emit(void *arg, void *slot, uint64_t sequence)
{
    struct vox_run *job = arg;
    struct vox_unit *unit = slot;
    uint64_t give_back = 0;
    (void)sequence;
    int status = write_unit(job, unit);
    if (status < 0)
        return vox_gate_fail(&job->shared.gate, status);
    if (unit->held_bytes > job->shared.gate.limit / 2 / job->unit_count) {
        vox_leaves_free(&unit->leaves);
        give_back = unit->held_bytes;
        unit->held_bytes = 0;
    }
    vox_gate_written(&job->shared.gate, give_back);
    return 0;
}

static int run_pipeline(struct vox_run *job)
{
    struct bsq_pipeline pipeline = {
        .produce = produce,
        .work = work,
        .emit = emit,
        .arg = job,
        .slots = job->units,
        .slot_size = sizeof *job->units,
        .slot_count = job->unit_count,
    };
    job->shared.write = write_unit;
    job->shared.write_arg = job;
    bsq_progress_begin(job->ctx, "voxelizing", "triangles", job->header->triangle_count);
    int status = bsq_pipeline_run(job->ctx, &pipeline);
    bsq_progress_end(job->ctx);
    return status;
}

int vox_run_regions(struct vox_run *job, struct fmt_nvdb_writer *writer)
{
    int status = 0;
    job->writer = writer;
    BSQ_TRY(set_up(job));
    BSQ_TRY(run_pipeline(job));
    status = vox_shading_tell_losses(&job->shared.shading);
done:
    end_pipeline(job);
    return status;
}
