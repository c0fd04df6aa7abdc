/* voxelize.c - makes the grid file from the regions of chunk files. */
#include <string.h>

#include "base/clock.h"
#include "base/job_files.h"
#include "libvoxel/voxelize/voxelize_run.h"

/* ---- the grid file ---- */

/* Gives the writer the names that ids stand for. */
static int name_ids(const struct vox_run *run, struct fmt_nvdb_writer *writer)
{
    const uint64_t count = run->header->material_count;
    const char **names;
    int status = bsq_alloc(run->ctx, "names of ids", count + 1, sizeof *names, &names);
    if (status < 0)
        return status;
    for (uint64_t i = 0; i < count; i++)
        names[i] = run->header->materials[i].name ? run->header->materials[i].name : "";
    names[count] = ""; /* triangles without a material */
    status = fmt_nvdb_set_names(writer, names, count + 1);
    bsq_free(run->ctx, (void *)names);
    return status;
}

/* Starts the grid of a run. */
static int create_grid(const struct vox_run *run, struct fmt_nvdb_writer **out)
{
    const struct vox_transform *transform = &run->shared.transform;
    struct fmt_nvdb_info info = {
        .type = run->options->grid_type == VOX_GRID_ONINDEX ? FMT_NVDB_ONINDEX : FMT_NVDB_MASK,
        .voxel_size = transform->h,
        .has_color = vox_shading_has_color(run->header),
        .ids = run->options->ids ? run->header->ids : BSQ_IDS_NONE,
        .channels = run->options->channels,
        .source_triangles = run->header->triangle_count,
    };
    for (int a = 0; a < 3; a++) {
        info.translation[a] = transform->start[a] + 0.5 * transform->h;
        info.scan_min[a] = transform->origin[a] + (double)run->header->bounds_min[a];
        info.scan_max[a] = transform->origin[a] + (double)run->header->bounds_max[a];
    }
    int status = fmt_nvdb_create(run->ctx, run->options->grid_path, &info, out);
    if (status == 0 && info.ids != BSQ_IDS_NONE && info.ids != BSQ_IDS_COLOR) {
        status = name_ids(run, *out);
        if (status < 0) {
            fmt_nvdb_discard(*out);
            *out = NULL;
        }
    }
    return status;
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
    report->voxel_size = run->shared.transform.h;
    report->has_color = vox_shading_has_color(run->header);
    report->has_ids = run->options->ids;
    memcpy(report->index_min, run->index_min, sizeof report->index_min);
    memcpy(report->index_max, run->index_max, sizeof report->index_max);
}

static int export_vdb(struct bsq_ctx *ctx, const char *path, struct bsq_output *from,
                      struct bsq_output **out)
{
    struct bsq_file file;
    struct fmt_nvdb_grid grid;
    int status = bsq_output_read(from, &file);
    if (status == 0)
        status = fmt_nvdb_open_file(ctx, &file, &grid);
    if (status < 0)
        return status;
    status = fmt_vdb_export(ctx, &grid, path, out);
    fmt_nvdb_close(ctx, &grid);
    return status;
}

/* Completes the grid, whose writer it frees in any case, exports it as OpenVDB if that is asked
 * for, gives the files their names, and fills in the report except for the time. */
static int commit_grid(const struct vox_run *run, struct fmt_nvdb_writer *writer,
                       struct vox_voxelize_report *report)
{
    const char *vdb_path = run->options->vdb_path;
    struct bsq_output_group group = {0};
    struct bsq_output *grid = NULL, *vdb = NULL;
    struct fmt_nvdb_totals totals;
    int status = 0;
    BSQ_TRY(fmt_nvdb_finish(writer, &totals, &grid));
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
    int status = options->vdb_path ? vox_check_export(ctx) : 0;
    if (status == 0)
        status = bsq_note_output(ctx, options->grid_path);
    if (status == 0 && options->vdb_path)
        status = bsq_note_output(ctx, options->vdb_path);
    return status;
}

/* ---- the whole ---- */

static int make_grid(struct vox_run *run, struct vox_voxelize_report *report)
{
    struct fmt_nvdb_writer *writer = NULL;
    int status = create_grid(run, &writer);
    if (status == 0)
        status = vox_run_regions(run, writer);
    if (status == 0)
        return commit_grid(run, writer, report);
    fmt_nvdb_discard(writer);
    return status;
}

int vox_check_export(struct bsq_ctx *ctx)
{
    return fmt_vdb_check(ctx);
}

void vox_voxelize_defaults(struct vox_voxelize_options *options)
{
    *options = (struct vox_voxelize_options){.resolution = 2048};
}

int vox_voxelize(struct bsq_ctx *ctx, const struct vox_voxelize_options *options,
                 struct vox_voxelize_report *report)
{
    struct vox_run run = {0};
    double start = bsq_seconds_now();
    memset(report, 0, sizeof *report);
    int status = 0;
    BSQ_TRY(note_outputs(ctx, options));
    BSQ_TRY(vox_run_open(ctx, options, &run));
    status = make_grid(&run, report);
done:
    vox_run_close(&run);
    report->seconds = bsq_seconds_now() - start;
    return status;
}
