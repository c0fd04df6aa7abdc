/* bisque-voxelize.c - turns a scan into a chunk file and a voxel grid. */
#include <assert.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "base/channels.h"
#include "base/clock.h"
#include "base/job_files.h"
#include "base/output.h"
#include "base/tile_files.h"
#include "formats/file_kind.h"
#include "formats/input/input.h"
#include "formats/mesh/mesh_reader.h"
#include "tools/voxelize_farm.h"
#include "tools/voxelize_report.h"

/* ---- checks before the work: what would otherwise fail after hours ---- */

static bool channels_have_images(const struct voxelize_arguments *arguments)
{
    bool any = false;
    for (uint32_t i = 0; i < arguments->channel_count; i++)
        any |= arguments->channels[i].texture_path != NULL;
    return any;
}

/* Returns the option that has no effect on chunk files alone; NULL: there is none. */
static const char *option_for_meshes(const struct voxelize_arguments *arguments)
{
    return arguments->tris                   ? "--tris"
           : arguments->texture              ? "--texture"
           : arguments->ids                  ? "--id"
           : arguments->resume               ? "--resume"
           : channels_have_images(arguments) ? "the images of --channels"
                                             : NULL;
}

/* Checks the options if chunk files are among the inputs. */
static int check_parts(const struct voxelize_job *job)
{
    const struct voxelize_arguments *arguments = job->arguments;
    const char *part = job->parts[0], *option = option_for_meshes(arguments);
    if (arguments->parse_only)
        return cli_usage(job->cli, "%s: --parse-only reads meshes", part);
    if (arguments->placements)
        return cli_usage(job->cli,
                         "%s is a chunk file: --scale, --up and --translate are for meshes", part);
    if (arguments->sort_only)
        return cli_usage(job->cli, "%s: only meshes can be sorted, and an input is a chunk file",
                         arguments->output);
    if (job->mesh_count == 0 && option)
        return cli_usage(job->cli, "%s is already a chunk file: leave out %s", part, option);
    if (job->mesh_count == 0 && voxelize_keeps_normal_map(arguments))
        return cli_usage(job->cli,
                         "%s is already a chunk file: leave out the channel " BSQ_CHANNEL_NORMAL_MAP
                         ", because its normals contain it if it has one",
                         part);
    if (job->mesh_count > 0 && !arguments->tris && (arguments->resume || arguments->channel_count))
        return cli_usage(job->cli, "%s: beside chunk files, meshes are kept with --tris only",
                         arguments->resume ? "--resume" : "--channels");
    return 0;
}

/* Finds out whether an input is a mesh or a chunk file. */
static int recognise_input(struct voxelize_job *job, const char *path)
{
    enum fmt_kind kind = FMT_KIND_MESH;
    /* A pipe can be read only once. */
    int status = fmt_input_is_pipe(path) ? 0 : fmt_recognise(job->cli->ctx, path, &kind);
    if (status < 0)
        return status;
    if (kind == FMT_KIND_TRIS)
        job->parts[job->part_count++] = path;
    else if (kind == FMT_KIND_OTHER || kind == FMT_KIND_MESH)
        job->meshes[job->mesh_count++] = path;
    else
        return bsq_fail(job->cli->ctx, BSQ_EDATA,
                        "%s: already a grid; grids are made from meshes or chunk files", path);
    return 0;
}

static int recognise_inputs(struct voxelize_job *job)
{
    const struct voxelize_arguments *arguments = job->arguments;
    int status = 0;
    job->meshes = calloc(arguments->input_count, sizeof *job->meshes);
    /* And one for what the meshes were sorted to by an earlier run. */
    job->parts = calloc((size_t)arguments->input_count + 1, sizeof *job->parts);
    if (!job->meshes || !job->parts)
        return bsq_fail_errno(job->cli->ctx, BSQ_ENOMEM, ENOMEM, "%s", arguments->inputs[0]);
    for (uint32_t i = 0; i < arguments->input_count && status == 0; i++)
        status = recognise_input(job, arguments->inputs[i]);
    if (status < 0)
        return status;
    if (job->mesh_count > 0 && arguments->farm.write_plan)
        return cli_usage(job->cli, "%s: tasks share chunk files: sort it first, with -o FILE.tris",
                         job->meshes[0]);
    return job->part_count > 0 ? check_parts(job) : 0;
}

/* "out/scan.nvdb" gives "out/scan.tris". */
static char *default_tris_path(const char *output)
{
    char *path = NULL;
    size_t length = strlen(output);
    if (cli_ends_with(output, ".nvdb"))
        length -= strlen(".nvdb");
    if (asprintf(&path, "%.*s.tris", (int)length, output) < 0)
        return NULL;
    return path;
}

/* Sets the path of the chunk file that the job writes. It is kept beside the grid, or by --tris. A
 * grid of chunk files and meshes has no such file without --tris: the file would have the meshes
 * only, under the name of the whole. */
static int choose_tris_path(struct voxelize_job *job)
{
    const struct voxelize_arguments *arguments = job->arguments;
    job->temporary_tris =
        job->mesh_count > 0 && (arguments->no_tris || (job->part_count > 0 && !arguments->tris));
    if (job->mesh_count == 0)
        job->tris_path = strdup(arguments->inputs[0]);
    else if (arguments->tris || arguments->sort_only)
        job->tris_path = strdup(arguments->sort_only ? arguments->output : arguments->tris);
    else
        job->tris_path = default_tris_path(arguments->output);
    if (!job->tris_path)
        return bsq_fail_errno(job->cli->ctx, BSQ_ENOMEM, ENOMEM, "%s", arguments->output);
    return 0;
}

static int note_inputs(struct bsq_ctx *ctx, const struct voxelize_arguments *arguments)
{
    int status = 0;
    for (uint32_t i = 0; i < arguments->input_count && status == 0; i++)
        if (!fmt_input_is_pipe(arguments->inputs[i]))
            status = bsq_note_input(ctx, arguments->inputs[i], "the scan");
    if (status == 0 && arguments->texture)
        status = bsq_note_texture(ctx, arguments->texture, "the texture");
    if (status == 0 && arguments->scan_normal_map)
        status = bsq_note_texture(ctx, arguments->scan_normal_map, "the scan's normal map");
    for (uint32_t i = 0; i < arguments->channel_count && status == 0; i++)
        if (arguments->channels[i].texture_path)
            status = bsq_note_texture(ctx, arguments->channels[i].texture_path, "the texture %s",
                                      arguments->channels[i].name);
    return status;
}

static int check_outputs(struct voxelize_job *job)
{
    const struct voxelize_arguments *arguments = job->arguments;
    const bool makes_tris = job->mesh_count > 0 && !job->temporary_tris && !arguments->sort_only;
    const char *outputs[] = {arguments->output, makes_tris ? job->tris_path : NULL, arguments->vdb,
                             arguments->farm.write_plan};
    for (unsigned i = 0; i < sizeof outputs / sizeof *outputs; i++) {
        if (!outputs[i])
            continue;
        for (unsigned j = 0; j < i; j++) {
            if (outputs[j] && cli_same_file(outputs[i], outputs[j]))
                return cli_usage(job->cli, "%s: two outputs have this name", outputs[i]);
        }
        int status = bsq_output_check(job->cli->ctx, outputs[i]);
        if (status < 0)
            return status;
    }
    return 0;
}

/* Sorting and voxelizing both need temporary files. */
static int check_temporary_files(struct voxelize_job *job)
{
    struct bsq_file file;
    int status = bsq_file_temp(job->cli->ctx, job->arguments->output, "chunks", &file);
    bsq_file_close(job->cli->ctx, &file);
    return status;
}

static int check_memory(struct cli *cli)
{
    uint64_t least = vox_memory_min(bsq_threads(cli->ctx));
    uint64_t least_mib = (least + (1 << 20) - 1) >> 20;
    char limit[CLI_TEXT];
    if (bsq_memory_limit(cli->ctx) >= least)
        return 0;
    return bsq_fail(cli->ctx, BSQ_ENOMEM, "--memory: %s is too small, %u thread%s at least %lluMiB",
                    cli_size_text(bsq_memory_limit(cli->ctx), limit), bsq_threads(cli->ctx),
                    bsq_threads(cli->ctx) == 1 ? " needs" : "s need",
                    (unsigned long long)least_mib);
}

/* ---- --parse-only ---- */

static int count_block(void *arg, const struct fmt_mesh_block *block)
{
    bsq_progress_add(arg, block->byte_size);
    return 0;
}

/* Parses the inputs, keeps nothing, and fills in the report of reading. */
static int parse_inputs(struct voxelize_job *job)
{
    struct bsq_ctx *ctx = job->cli->ctx;
    struct fmt_mesh_reader *reader;
    struct fmt_mesh_totals totals = {0};
    double start = bsq_seconds_now();
    const struct fmt_mesh_inputs inputs = {
        .paths = job->meshes, .path_count = job->mesh_count, .pipes = true};
    int status = fmt_mesh_open_inputs(ctx, &inputs, &reader);
    if (status < 0)
        return status;
    bsq_progress_begin(ctx, "reading", "bytes", fmt_mesh_bytes(reader));
    status = fmt_mesh_read(reader, count_block, ctx, &totals);
    bsq_progress_end(ctx);
    fmt_mesh_close(reader);
    job->sort = (struct vox_sort_report){
        .bytes_read = totals.bytes,
        .vertices = totals.vertices,
        .faces = totals.faces,
        .triangles = totals.corners - 2 * totals.faces,
        .short_faces = totals.short_faces,
        .skipped_lines = totals.skipped_lines,
        .seconds_read = bsq_seconds_now() - start,
    };
    return status;
}

/* ---- the work ---- */

/* Lists the channels that the chunk file keeps: those of the options, and the normal map. */
static int list_channels(const struct voxelize_job *job, struct vox_channel **list, uint32_t *count)
{
    const struct voxelize_arguments *arguments = job->arguments;
    *list = calloc(arguments->channel_count + (size_t)1, sizeof **list);
    if (!*list)
        return bsq_fail_errno(job->cli->ctx, BSQ_ENOMEM, ENOMEM, "%s", job->tris_path);
    for (uint32_t i = 0; i < arguments->channel_count; i++)
        (*list)[i] = arguments->channels[i];
    *count = arguments->channel_count;
    if (arguments->scan_normal_map)
        (*list)[(*count)++] =
            (struct vox_channel){BSQ_CHANNEL_NORMAL_MAP, arguments->scan_normal_map};
    return 0;
}

static int sort_with(struct voxelize_job *job, const struct vox_channel *channels, uint32_t count)
{
    const struct voxelize_arguments *arguments = job->arguments;
    struct vox_sort_options options = {
        .scan_paths = job->meshes,
        .scan_count = job->mesh_count,
        .placements = arguments->placements,
        .texture_path = arguments->texture,
        .ids = !arguments->channel_ids ? VOX_IDS_NONE
               : arguments->ids        ? arguments->ids
                                       : VOX_IDS_MATERIAL,
        .channels = channels,
        .channel_count = count,
        .tris_path = job->tris_path,
        .temp_tris = job->temp_tris,
        .keeps_tris = !job->temporary_tris,
        .check_textures = true,
    };
    struct bsq_ctx *ctx = job->cli->ctx;
    int status = 0;
    /* A temporary chunk file is always removed, so such a job cannot be resumed. */
    if (!job->temporary_tris && (status = vox_job_open(ctx, &options, &job->record)) < 0)
        return status;
    if (arguments->resume)
        status = vox_job_resume(job->record, &job->resumed);
    else if (arguments->sort_only && !arguments->farm.force && !job->cli->strict)
        status = vox_job_is_done(job->record, &job->resumed);
    if (status < 0 || job->resumed)
        return status;
    options.job = job->record;
    status = vox_sort(ctx, &options, &job->sort);
    return status == 0 && job->record ? vox_job_record(job->record) : status;
}

static int sort_scan(struct voxelize_job *job)
{
    struct vox_channel *channels = NULL;
    uint32_t count = 0;
    int status = list_channels(job, &channels, &count);
    if (status == 0)
        status = sort_with(job, channels, count);
    free(channels);
    return status;
}

static struct vox_voxelize_options grid_options(struct voxelize_job *job)
{
    const struct voxelize_arguments *arguments = job->arguments;
    if (job->resumed && job->part_count > 0) /* there is no open file of this run */
        job->parts[job->part_count++] = job->tris_path;
    const struct vox_voxelize_options options = {
        .tris_path = job->tris_path,
        .part_paths = job->part_count > 0 ? job->parts : NULL,
        .part_count = job->part_count,
        .temp_tris = job->resumed ? NULL : job->temp_tris,
        .grid_path = arguments->output,
        .resolution = arguments->resolution,
        .voxel_size = arguments->voxel_size,
        .grid_type = arguments->grid_type,
        .scan_normals = arguments->scan_normals,
        .vdb_path = arguments->vdb,
        .ids = arguments->channel_ids,
        .channels = arguments->channel_list,
        .scan_normal_map = arguments->scan_normal_map,
    };
    return options;
}

/* Makes the grid, or the plan of its tasks. */
static int make_grid(struct voxelize_job *job)
{
    const struct vox_voxelize_options options = grid_options(job);
    return job->arguments->farm.write_plan
               ? voxelize_farm_plan(job->cli, &job->arguments->farm, &options)
               : vox_voxelize(job->cli->ctx, &options, &job->grid);
}

static int do_work(struct voxelize_job *job)
{
    const struct voxelize_arguments *arguments = job->arguments;
    if (arguments->parse_only)
        return parse_inputs(job);
    assert(arguments->output); /* see check_arguments() */
    int status = check_memory(job->cli);
    if (status == 0 && arguments->vdb)
        status = vox_check_export(job->cli->ctx);
    if (status == 0)
        status = choose_tris_path(job);
    if (status == 0)
        status = check_outputs(job);
    if (status == 0)
        status = check_temporary_files(job);
    if (status == 0 && job->mesh_count > 0 && !arguments->sort_only)
        status = vox_temp_tris_create(job->cli->ctx, &job->temp_tris);
    if (status == 0 && job->mesh_count > 0)
        status = sort_scan(job);
    if (status == 0 && !arguments->sort_only)
        status = make_grid(job);
    if (status == 0 && !arguments->sort_only)
        vox_job_finish(job->record);
    return status;
}

static int run(struct cli *cli, const struct voxelize_arguments *arguments)
{
    struct voxelize_job job = {
        .cli = cli,
        .arguments = arguments,
    };
    if (cli->verify)
        return cli_verify(cli, (char *const *)arguments->inputs, (int)arguments->input_count);
    if (arguments->farm.plan)
        return voxelize_farm_by_plan(cli, &arguments->farm);
    int status = note_inputs(cli->ctx, arguments);
    if (status == 0)
        status = recognise_inputs(&job);
    if (status == 0)
        status = do_work(&job);
    vox_temp_tris_close(job.temp_tris);
    if (status == 0 && arguments->sort_only && job.resumed)
        status = cli_tasks_say_kept(cli, job.tris_path, "this chunk file");
    else if (status == 0 && !arguments->farm.write_plan)
        status = voxelize_report_print(&job);
    vox_job_close(job.record);
    free(job.tris_path);
    free(job.meshes);
    free(job.parts);
    return status;
}

int main(int argc, char **argv)
{
    struct cli cli;
    struct voxelize_arguments arguments = {0};
    cli_begin(&cli, "bisque-voxelize", argv);
    int status = voxelize_arguments_parse(&cli, &arguments, argc, argv);
    if (status == 0)
        status = cli_create_context(&cli);
    if (status == 0)
        status = voxelize_arguments_map_inputs(&cli, &arguments);
    if (status == 0)
        status = run(&cli, &arguments);
    voxelize_arguments_free(&arguments);
    return cli_end(&cli, status);
}
