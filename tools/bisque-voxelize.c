/* bisque-voxelize.c - turns a scan into a chunk file and a voxel grid. */
#include <string.h>

#include "formats/material/tile_files.h"
#include "tools/voxelize_report.h"

/* ---- checks before the work: what would otherwise fail after hours ---- */

static int voxelize_tool_recognise_inputs(struct voxelize_job *job)
{
    const struct voxelize_arguments *arguments = job->arguments;
    BSQ_PASS(cli_recognise_scans(job->cli, arguments->inputs, arguments->input_count,
                                 "already a grid; grids are made from meshes or chunk files",
                                 &job->scans));
    if (job->scans.chunk_count > 0)
        return voxelize_arguments_check_part(job->cli, arguments, job->scans.chunks[0],
                                             job->scans.mesh_count > 0);
    return 0;
}

/* Notes the images of the options as inputs. */
static int note_images(struct bsq_ctx *ctx, const struct voxelize_arguments *arguments)
{
    const struct vox_sort_options *sort = &arguments->sort;
    if (sort->texture_path)
        BSQ_PASS(fmt_note_texture(ctx, sort->texture_path, "the texture"));
    if (arguments->grid.scan_normal_map)
        BSQ_PASS(fmt_note_texture(ctx, arguments->grid.scan_normal_map, "the scan's normal map"));
    for (uint32_t i = 0; i < sort->channel_count; i++)
        if (sort->channels[i].texture_path)
            BSQ_PASS(fmt_note_texture(ctx, sort->channels[i].texture_path, "the texture %s",
                                      sort->channels[i].name));
    return 0;
}

/* "out/scan.nvdb" gives "out/scan.tris". */
static const char *default_tris_path(const char *output)
{
    size_t length = strlen(output);
    if (cli_ends_with(output, ".nvdb"))
        length -= strlen(".nvdb");
    return cli_keep_text("%.*s.tris", (int)length, output);
}

/* Sets the path of the chunk file that the job writes. It is kept beside the grid, or by --tris. A
 * grid of chunk files and meshes has no such file without --tris: the file would have the meshes
 * only, under the name of the whole. */
static void choose_tris_path(struct voxelize_job *job)
{
    const struct voxelize_arguments *arguments = job->arguments;
    job->temporary_tris = job->scans.mesh_count > 0 &&
                          (arguments->no_tris || (job->scans.chunk_count > 0 && !arguments->tris));
    job->joins = job->scans.chunk_count > 0 && arguments->sort_only;
    if (arguments->sort_only)
        job->tris_path = arguments->grid.grid_path;
    else if (job->scans.mesh_count == 0)
        job->tris_path = arguments->inputs[0];
    else if (arguments->tris)
        job->tris_path = arguments->tris;
    else
        job->tris_path = default_tris_path(arguments->grid.grid_path);
}

static int voxelize_tool_check_outputs(struct voxelize_job *job)
{
    const struct voxelize_arguments *arguments = job->arguments;
    const bool makes_tris =
        job->scans.mesh_count > 0 && !job->temporary_tris && !arguments->sort_only;
    const char *outputs[] = {arguments->grid.grid_path, makes_tris ? job->tris_path : NULL,
                             arguments->grid.vdb_path};
    return cli_check_outputs(job->cli, outputs, sizeof outputs / sizeof *outputs);
}

static int check_memory(struct cli *cli)
{
    uint64_t least = vox_memory_min(bsq_threads(cli->ctx));
    uint64_t least_mib = (least + (1 << 20) - 1) >> 20;
    if (bsq_memory_limit(cli->ctx) >= least)
        return 0;
    return bsq_fail(cli->ctx, BSQ_ENOMEM, "--memory: %s is too small, %u thread%s at least %lluMiB",
                    cli_size(bsq_memory_limit(cli->ctx)).text, bsq_threads(cli->ctx),
                    bsq_threads(cli->ctx) == 1 ? " needs" : "s need",
                    (unsigned long long)least_mib);
}

/* ---- the work ---- */

static int voxelize_tool_sort_scan(struct voxelize_job *job)
{
    struct voxelize_arguments *arguments = job->arguments;
    struct vox_sort_options *options = &arguments->sort;
    struct bsq_ctx *ctx = job->cli->ctx;
    voxelize_arguments_add_channels(arguments);
    options->tris_path = job->tris_path;
    options->temp_tris = job->temp_tris;
    options->keeps_tris = !job->temporary_tris;
    if (job->scans.chunk_count > 0)
        options->origin_path = job->scans.chunks[0];
    /* A part that nobody keeps gets its normals with the others. */
    options->scan_normals = job->temporary_tris && job->scans.chunk_count > 0
                                ? BSQ_SCAN_NORMALS_FLAT
                                : arguments->grid.scan_normals;
    return vox_sort(ctx, options, &job->sort);
}

static int make_grid(struct voxelize_job *job)
{
    struct vox_voxelize_options *options = &job->arguments->grid;
    const struct vox_join_options how = {.output_path = options->grid_path,
                                         .scan_normals = options->scan_normals,
                                         .ids = options->ids};
    const bool several = job->scans.chunk_count + (job->scans.mesh_count > 0) > 1;
    BSQ_PASS(cli_join(job->cli, job->scans.chunks, job->scans.chunk_count, &how, &job->temp_tris));
    options->tris_path = several ? "the scan" : job->tris_path;
    options->temp_tris = job->temp_tris;
    return vox_voxelize(job->cli->ctx, options, &job->grid);
}

/* Writes all chunk files as one. */
static int join_parts(struct voxelize_job *job)
{
    const struct vox_join_options options = {.size = sizeof options,
                                             .tris_paths = job->scans.chunks,
                                             .tris_count = job->scans.chunk_count,
                                             .temp_tris = job->temp_tris,
                                             .output_path = job->tris_path,
                                             .scan_normals = job->arguments->grid.scan_normals};
    return vox_join(job->cli->ctx, &options, &job->sort);
}

/* Adds the command that makes the grid from the chunk file, which is complete, to the message of an
 * interruption. */
static void tell_how_to_go_on(const struct voxelize_job *job)
{
    const char *inputs = job->tris_path;
    for (uint32_t i = 0; i < job->scans.chunk_count; i++)
        inputs = cli_keep_text("%s %s", inputs, job->scans.chunks[i]);
    bsq_clear_error(job->cli->ctx);
    bsq_fail(job->cli->ctx, BSQ_EINTR,
             "interrupted; \"bisque-voxelize %s -o %s\" with the options of the grid goes on from "
             "there",
             inputs, job->arguments->grid.grid_path);
}

static int do_work(struct voxelize_job *job)
{
    struct voxelize_arguments *arguments = job->arguments;
    arguments->sort.scan_paths = job->scans.meshes;
    arguments->sort.scan_count = job->scans.mesh_count;
    if (arguments->parse_only)
        return vox_parse(job->cli->ctx, &arguments->sort, &job->sort);
    BSQ_PASS(check_memory(job->cli));
    if (arguments->grid.vdb_path)
        BSQ_PASS(vox_check_export(job->cli->ctx));
    choose_tris_path(job);
    BSQ_PASS(voxelize_tool_check_outputs(job));
    BSQ_PASS(bsq_temp_check(job->cli->ctx, arguments->grid.grid_path));
    if (job->scans.mesh_count > 0 && (job->joins || !arguments->sort_only))
        BSQ_PASS(vox_temp_tris_create(job->cli->ctx, &job->temp_tris));
    if (job->scans.mesh_count > 0)
        BSQ_PASS(voxelize_tool_sort_scan(job));
    if (arguments->sort_only)
        return job->joins ? join_parts(job) : 0;
    const int status = make_grid(job);
    if (status == BSQ_EINTR && job->scans.mesh_count > 0 && !job->temporary_tris)
        tell_how_to_go_on(job);
    return status;
}

static int voxelize_tool_run(struct voxelize_job *job)
{
    struct cli *cli = job->cli;
    struct voxelize_arguments *arguments = job->arguments;
    BSQ_PASS(cli_create_context(cli));
    BSQ_PASS(voxelize_arguments_map_inputs(cli, arguments));
    if (cli->verify)
        return cli_verify(cli, (char *const *)arguments->inputs, (int)arguments->input_count);
    if (arguments->info)
        return voxelize_info_print(cli, arguments->inputs, arguments->input_count);
    BSQ_PASS(note_images(cli->ctx, arguments));
    BSQ_PASS(voxelize_tool_recognise_inputs(job));
    BSQ_PASS(do_work(job));
    return voxelize_report_print(job);
}

int main(int argc, char **argv)
{
    struct cli cli;
    struct voxelize_arguments arguments = {0};
    struct voxelize_job job = {.cli = &cli,
                               .arguments = &arguments,
                               .sort.size = sizeof job.sort,
                               .grid.size = sizeof job.grid};
    cli_begin(&cli, "bisque-voxelize", argv);
    int status = voxelize_arguments_parse(&cli, &arguments, argc, argv);
    if (status == 0)
        status = voxelize_tool_run(&job);
    vox_temp_tris_close(job.temp_tris);
    return cli_end(&cli, status);
}
