/* voxelize.c - makes the grid file from chunk files: input, memory and output. regions.c makes the
 * voxels. */
#include <inttypes.h>
#include <malloc.h>
#include <stdio.h>
#include <string.h>

#include "formats/material/channels.h"
#include "base/context.h"
#include "base/job_files.h"
#include "base/text.h"
#include "libvoxel/float_precision.h"
#include "libvoxel/temp_tris.h"
#include "libvoxel/voxelize/voxelize_run.h"

/* More bytes of sums than this would not stay in a processor's cache; then regions are made in
 * parts. */
#define ACCUMULATOR_BYTES_USEFUL   (UINT64_C(48) << 20)
#define TEXTURE_CACHE_BYTES_USEFUL (UINT64_C(1) << 30)
/* Least bytes for results of regions under way, for each worker. */
#define RESULT_BYTES_MIN (UINT64_C(1) << 20)

/* Units under way for each worker. Some regions take a hundred times as long as others. Meanwhile
 * results of later regions wait in their slots, and no worker has to. */
enum { UNITS_PER_WORKER = 8 };

enum { SLABS_MAX = VOX_REGION_SIZE / 8 };

/* ---- memory ---- */

static uint64_t min64(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* Returns the values of further channels in a record. */
static uint32_t channel_values(const struct vox_run *run)
{
    const char *list = run->channels;
    return list ? fmt_channel_list_values(list, strlen(list)) : 0;
}

/* Returns what accumulators sum, as vox_accumulator_create() takes it. */
static unsigned sums_of(const struct vox_run *run)
{
    return (fmt_tris_has_color(run->header) ? VOX_SUM_COLORS : 0u) +
           (run->options->ids ? VOX_SUM_IDS : 0u) + VOX_SUM_CHANNEL_VALUE * channel_values(run);
}

/* Returns whether voxels get something from textures, for which the scan needs texture coordinates.
 */
static bool uses_textures(const struct vox_run *run)
{
    return (run->header->attributes & FMT_TRIS_TEXCOORDS) &&
           fmt_shading_needs_textures(&run->shading.scan);
}

/* Gives two thirds of the free memory to the chunk cache: a chunk that is evicted too early is
 * read and prepared again, which costs far more than a region in parts. Gives half of the rest to
 * the sums. What is left is for the results under way and for the writer. Fails early if the
 * minimum of all that does not fit. */
static int voxelize_divide_memory(const struct vox_run *run, struct vox_shares *shares)
{
    uint64_t available = bsq_memory_left(run->ctx);
    uint64_t slot = vox_chunks_slot_bytes(run->file, run->smooth);
    const unsigned sums = sums_of(run);
    shares->texture_bytes =
        uses_textures(run) ? min64(available / 4, TEXTURE_CACHE_BYTES_USEFUL) : 0;
    uint64_t sums_min = vox_accumulator_bytes_min(sums),
             blocks = run->workers * vox_fragment_block_bytes();
    const uint64_t others_min = run->workers * (sums_min + RESULT_BYTES_MIN);
    uint64_t need = shares->texture_bytes + slot + blocks + others_min;
    if (available < need)
        return bsq_fail(run->ctx, BSQ_ENOMEM,
                        "%s: a memory budget of %" PRIu64 " bytes is too small: voxelizing with %u "
                        "threads needs %" PRIu64 " bytes beside the %" PRIu64 " in use",
                        run->options->tris_path, bsq_memory_limit(run->ctx), run->workers, need,
                        bsq_memory_used(run->ctx));
    available -= shares->texture_bytes + blocks;
    uint64_t slots = min64(available / 3 * 2, available - others_min) / slot;
    shares->cache_slots = slots < 1 ? 1 : min64(min64(slots, run->header->chunk_count), INT32_MAX);
    available -= shares->cache_slots * slot;
    uint64_t share = min64(available / 2 / run->workers, ACCUMULATOR_BYTES_USEFUL);
    shares->accumulator_bytes = share > sums_min ? share : sums_min;
    available -= run->workers * shares->accumulator_bytes;
    /* The other half is for results that grow while they are held, and for the writer. */
    shares->result_bytes = available / 2;
    return 0;
}

/* ---- opening ---- */

/* Lists all channels of the chunk file that a grid can have. */
static int list_channels(struct vox_run *run)
{
    const struct fmt_tris_header *header = run->header;
    uint64_t bytes = 1, at = 0;
    for (uint32_t c = 0; c < header->channel_count; c++)
        bytes += strlen(header->channels[c]) + 1;
    BSQ_PASS(bsq_calloc(run->ctx, "channels", bytes, 1, &run->channels));
    for (uint32_t c = 0; c < header->channel_count; c++)
        if (strcmp(header->channels[c], FMT_CHANNEL_NORMAL_MAP) != 0)
            at += (uint64_t)sprintf(run->channels + at, "%s%s", at > 0 ? "," : "",
                                    header->channels[c]);
    if (at == 0) {
        bsq_free(run->ctx, run->channels);
        run->channels = NULL;
    }
    return 0;
}

/* Sets the list of the grid's channels. */
static int voxelize_choose_channels(struct vox_run *run)
{
    const char *list = run->options->channels;
    if (list && strcmp(list, "all") == 0)
        return list_channels(run);
    return bsq_text_copy(run->ctx, list, &run->channels);
}

static int voxelize_check_channels(const struct vox_run *run)
{
    const char *list = run->channels;
    uint32_t first;
    if (list && channel_values(run) == 0)
        return bsq_fail(run->ctx, BSQ_EUSAGE, "\"%.60s\" cannot be channels", list);
    if (list && fmt_channel_list_find(list, strlen(list), FMT_CHANNEL_NORMAL_MAP, &first))
        return bsq_fail(run->ctx, BSQ_EUSAGE,
                        "grids have no channel " FMT_CHANNEL_NORMAL_MAP
                        ": their normals contain it");
    return 0;
}

static int open_input(struct vox_run *run)
{
    const char *path = run->options->tris_path;
    const struct vox_temp_tris *temp = run->options->temp_tris;
    BSQ_PASS(temp ? fmt_tris_open_temp(run->ctx, &temp->file, &run->file)
                  : fmt_tris_open(run->ctx, path, &run->file));
    run->header = fmt_tris_get_header(run->file);
    if (run->header->triangle_count == 0)
        return bsq_fail(run->ctx, BSQ_EDATA, "%s: the scan has no triangles", path);
    if (run->header->chunk_count >= UINT32_MAX)
        return bsq_fail(run->ctx, BSQ_EDATA, "%s: %" PRIu64 " chunks are too many", path,
                        run->header->chunk_count);
    if (run->options->ids && run->header->ids == FMT_IDS_NONE)
        return bsq_fail(run->ctx, BSQ_EDATA,
                        "%s has no ids: make it with bisque-voxelize --channels id", path);
    BSQ_PASS(voxelize_choose_channels(run));
    BSQ_PASS(voxelize_check_channels(run));
    return vox_transform_init(run->ctx, run->header, path, run->options->resolution,
                              run->options->voxel_size, &run->transform);
}

/* Refuses a grid that does not fit on its disk or in the format, and warns of lost precision. */
static int check_grid(struct vox_run *run)
{
    const unsigned further = (unsigned)fmt_tris_has_color(run->header) +
                             (unsigned)run->options->ids + channel_values(run);
    int status =
        vox_estimate_check(run->ctx, run->file, &run->transform, further, run->options->grid_path);
    if (status == 0)
        vox_precision_warn_grid(run->ctx, run->options->tris_path, run->header,
                                fmt_tris_chunks(run->file), run->transform.h);
    return status;
}

/* Replaces the file by a temporary one with other normals. */
static int replace_normals(struct vox_run *run, enum bsq_scan_normals wanted)
{
    const struct vox_voxelize_options *options = run->options;
    struct vox_temp_tris made = {.ctx = run->ctx, .file = BSQ_FILE_CLOSED};
    struct vox_sort_report report = {.size = sizeof report};
    const struct vox_join_options join = {.size = sizeof join,
                                          .tris_paths = &options->tris_path,
                                          .tris_count = options->temp_tris ? 0 : 1,
                                          .temp_tris = &made,
                                          .output_path = options->grid_path,
                                          .temporary = true,
                                          .scan_normals = wanted};
    int status;
    fmt_tris_close(run->file);
    run->file = NULL;
    if (options->temp_tris)
        BSQ_TRY(bsq_file_duplicate(run->ctx, &options->temp_tris->file, &made.file));
    BSQ_TRY(vox_join(run->ctx, &join, &report));
    BSQ_TRY(fmt_tris_open_temp(run->ctx, &made.file, &run->file));
    run->header = fmt_tris_get_header(run->file);
done:
    bsq_file_close(run->ctx, &made.file);
    return status;
}

/* Makes sure that the file has the normals that the options ask for. */
static int voxelize_choose_normals(struct vox_run *run)
{
    const bool automatic = run->options->scan_normals == BSQ_SCAN_NORMALS_AUTO;
    const enum bsq_scan_normals wanted =
        automatic ? run->header->made_normals : run->options->scan_normals;
    if (run->header->attributes & FMT_TRIS_NORMALS || wanted == BSQ_SCAN_NORMALS_FLAT)
        return 0;
    if (wanted != run->header->made_normals)
        BSQ_PASS(replace_normals(run, wanted));
    run->smooth = run->header->made_normals != 0;
    return 0;
}

static int open_run(struct vox_run *run)
{
    BSQ_PASS(open_input(run));
    BSQ_PASS(voxelize_choose_normals(run));
    BSQ_PASS(vox_chunk_boxes_create(run->ctx, run->file, &run->transform,
                                    bsq_memory_left(run->ctx) / 16, &run->boxes, &run->box_count));
    return check_grid(run);
}

/* ---- what the pipeline needs ---- */

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

static int make_workers(struct vox_run *run)
{
    const uint64_t count = UINT64_C(1) * UNITS_PER_WORKER * run->workers;
    BSQ_PASS(BSQ_CALLOC(run->ctx, "workers", run->workers, &run->own));
    for (struct vox_worker *own = run->own; own < run->own + run->workers; own++) {
        BSQ_PASS(vox_accumulator_create(run->ctx, run->shares.accumulator_bytes, sums_of(run),
                                        &own->sums));
        BSQ_PASS(bsq_alloc(run->ctx, "fragments", vox_fragment_block_bytes(), 1, &own->block));
    }
    BSQ_PASS(BSQ_CALLOC(run->ctx, "workers", count, &run->units));
    run->unit_count = (unsigned)count;
    for (unsigned i = 0; i < run->unit_count; i++)
        vox_leaves_init(&run->units[i].leaves, run->ctx);
    return 0;
}

/* Adds the channels of a list, each of which must be there once only. */
static int add_channels(const struct vox_run *run, struct fmt_shading *shading)
{
    const char *list = run->channels;
    char **names;
    uint32_t count;
    int status = fmt_channel_list_split(run->ctx, list, strlen(list), &names, &count);
    for (uint32_t i = 0; i < count && status == 0; i++) {
        status = fmt_shading_add_channel(shading, names[i], NULL);
        for (uint32_t k = 0; k < i && status == 0; k++)
            if (strcmp(names[k], names[i]) == 0)
                status = bsq_fail(run->ctx, BSQ_EUSAGE, "\"%.60s\" names a channel twice", list);
    }
    bsq_free(run->ctx, names);
    return status;
}

static int voxelize_add_attributes(struct vox_run *run)
{
    const struct vox_voxelize_options *options = run->options;
    struct fmt_shading *shading = &run->shading.scan;
    *shading = (struct fmt_shading){
        .ctx = run->ctx, .path = options->tris_path, .file = run->file, .header = run->header};
    BSQ_PASS(fmt_shading_add_color(shading));
    if (options->ids)
        BSQ_PASS(fmt_shading_add_ids(shading));
    if (run->channels)
        BSQ_PASS(add_channels(run, shading));
    return fmt_shading_add_normal_map(shading, options->scan_normal_map);
}

static int set_up(struct vox_run *run)
{
    struct vox_shading *shading = &run->shading;
    BSQ_PASS(vox_schedule_create(run->ctx, run->boxes, run->box_count, &run->schedule));
    BSQ_PASS(voxelize_add_attributes(run));
    malloc_trim(0); /* what sorting has freed counts as resident until then */
    BSQ_PASS(voxelize_divide_memory(run, &run->shares));
    if (run->shares.texture_bytes > 0)
        BSQ_PASS(fmt_shading_open_textures(&shading->scan, run->shares.texture_bytes));
    BSQ_PASS(vox_shading_prepare(shading));
    BSQ_PASS(vox_chunks_create(run->ctx, run->file, &run->transform, run->boxes, run->box_count,
                               run->smooth, (uint32_t)run->shares.cache_slots, &run->chunks));
    BSQ_PASS(make_workers(run));
    run->slabs = choose_slabs(vox_region_count(&run->transform.voxels), run->workers);
    run->next_slab = run->slabs;
    return 0;
}

/* Frees what the pipeline needed: joining the sections of a grid needs memory too. */
static void tear_down(struct vox_run *run)
{
    for (unsigned i = 0; i < run->unit_count; i++) {
        bsq_free(run->ctx, run->units[i].chunks);
        vox_leaves_free(&run->units[i].leaves);
    }
    for (unsigned i = 0; run->own && i < run->workers; i++) {
        vox_accumulator_destroy(run->own[i].sums);
        bsq_free(run->ctx, run->own[i].block);
    }
    BSQ_FREE(run->ctx, run->units, run->own, run->current.chunks);
    vox_chunks_destroy(run->chunks);
    vox_schedule_destroy(run->schedule);
    bsq_free(run->ctx, run->boxes);
    run->boxes = NULL;
    vox_shading_free(&run->shading);
}

/* ---- the grid file ---- */

/* Gives the grid the names that ids stand for. */
static int name_ids(const struct vox_run *run)
{
    const char **names;
    uint64_t count;
    int status = fmt_shading_id_names(run->ctx, run->header, &names, &count);
    if (status == 0)
        status = fmt_nvdb_set_names(run->writer, names, count);
    bsq_free(run->ctx, (void *)names);
    return status;
}

/* Starts the grid of a run. */
static int create_grid(struct vox_run *run)
{
    const struct vox_transform *transform = &run->transform;
    struct fmt_nvdb_info info = {
        .voxel_size = transform->h,
        .has_color = fmt_tris_has_color(run->header),
        .ids = run->options->ids ? run->header->ids : FMT_IDS_NONE,
        .channels = run->channels,
        .source_triangles = run->header->triangle_count,
    };
    for (int a = 0; a < 3; a++) {
        info.translation[a] = transform->start[a] + 0.5 * transform->h;
        info.scan_min[a] = transform->origin[a] + (double)run->header->bounds_min[a];
        info.scan_max[a] = transform->origin[a] + (double)run->header->bounds_max[a];
    }
    BSQ_PASS(fmt_nvdb_create(run->ctx, run->options->grid_path, &info, &run->writer));
    return info.ids != FMT_IDS_NONE && info.ids != FMT_IDS_COLOR ? name_ids(run) : 0;
}

static void fill_report(const struct vox_run *run, const struct fmt_nvdb_totals *totals,
                        struct vox_voxelize_report *report)
{
    report->triangles = run->header->triangle_count;
    report->voxels = totals->voxels;
    report->second_records = totals->second_records;
    report->leaves = totals->leaves;
    report->lowers = totals->lowers;
    report->uppers = totals->uppers;
    report->grid_bytes = totals->file_bytes;
    report->voxel_size = run->transform.h;
    report->has_color = fmt_tris_has_color(run->header);
    report->rounds_colors = (run->header->attributes & FMT_TRIS_FINE_COLORS) != 0;
    report->has_ids = run->options->ids;
    memcpy(report->index_min, totals->index_min, sizeof report->index_min);
    memcpy(report->index_max, totals->index_max, sizeof report->index_max);
}

static int export_vdb(struct bsq_ctx *ctx, const char *path, struct bsq_output *from,
                      struct bsq_output **out)
{
    struct bsq_file file;
    struct fmt_nvdb_grid grid;
    BSQ_PASS(bsq_output_read(from, &file));
    BSQ_PASS(fmt_nvdb_open_file(ctx, &file, &grid));
    const int status = fmt_vdb_export(ctx, &grid, path, out);
    fmt_nvdb_close(ctx, &grid);
    return status;
}

/* Completes the grid, exports it as OpenVDB if that is asked
 * for, gives the files their names, and fills in the report except for the time. */
static int commit_grid(struct vox_run *run, struct vox_voxelize_report *report)
{
    const char *vdb_path = run->options->vdb_path;
    struct bsq_output_group group = {0};
    struct bsq_output *grid = NULL, *vdb = NULL;
    struct fmt_nvdb_totals totals;
    int status = fmt_nvdb_finish(run->writer, &totals, &grid);
    run->writer = NULL;
    BSQ_TRY(status);
    fill_report(run, &totals, report);
    BSQ_TRY(bsq_output_group_add(&group, grid));
    if (vdb_path) {
        BSQ_TRY(export_vdb(run->ctx, vdb_path, grid, &vdb));
        BSQ_TRY(bsq_output_group_add(&group, vdb));
    }
    status = bsq_output_group_commit(&group);
done:
    bsq_output_group_discard(&group);
    return status;
}

static int note_outputs(struct bsq_ctx *ctx, const struct vox_voxelize_options *options)
{
    BSQ_PASS(options->vdb_path ? vox_check_export(ctx) : 0);
    BSQ_PASS(bsq_note_output(ctx, options->grid_path));
    if (options->vdb_path)
        BSQ_PASS(bsq_note_output(ctx, options->vdb_path));
    return 0;
}

/* ---- the whole ---- */

static int make_regions(struct vox_run *run)
{
    int status = set_up(run);
    if (status == 0)
        status = vox_run_regions(run);
    tear_down(run);
    return status;
}

int vox_check_export(struct bsq_ctx *ctx)
{
    return fmt_vdb_check(ctx);
}

void vox_voxelize_defaults(struct vox_voxelize_options *options)
{
    *options = (struct vox_voxelize_options){.size = sizeof *options, .resolution = 2048};
}

int vox_voxelize(struct bsq_ctx *ctx, const struct vox_voxelize_options *options,
                 struct vox_voxelize_report *report)
{
    struct vox_run run = {
        .options = options,
        .ctx = ctx,
        .workers = bsq_threads(ctx),
        .gate = {.lock = PTHREAD_MUTEX_INITIALIZER, .changed = PTHREAD_COND_INITIALIZER}};
    const double start = bsq_seconds_now();
    int status;
    BSQ_TRY(bsq_clear_report(ctx, "vox_voxelize_report", report, sizeof *report));
    BSQ_TRY(bsq_check_size(ctx, "vox_voxelize_options", options->size, sizeof *options));
    BSQ_TRY(note_outputs(ctx, options));
    BSQ_TRY(open_run(&run));
    BSQ_TRY(create_grid(&run));
    BSQ_TRY(make_regions(&run));
    status = commit_grid(&run, report);
done:
    fmt_nvdb_discard(run.writer);
    BSQ_FREE(ctx, run.boxes, run.channels);
    fmt_tris_close(run.file);
    report->seconds = bsq_seconds_now() - start;
    return status;
}
