/* bisque-voxelize.c - turns a scan into a chunk file and a voxel grid. */
#include <string.h>

#include "formats/material/tile_files.h"
#include "tools/voxelize_arguments.h"

/* The state and results of a job. */
struct voxelize_job {
    struct cli *cli;
    struct voxelize_arguments *arguments;
    struct cli_scans scans;          /* the inputs */
    const char *tris_path;           /* of the chunk file */
    bool temporary_tris;             /* the sorted meshes are temporary: no file has them alone */
    bool joins;                      /* chunk files become one, at tris_path */
    struct vox_temp_tris *temp_tris; /* the chunk file that this job writes, or NULL; owned */
    struct vox_sort_report sort;
    struct vox_voxelize_report grid;
};

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

/* ---- results ---- */

static void print_meshes(const struct voxelize_job *job)
{
    if (job->scans.mesh_count == 1)
        cli_print("%s: ", job->scans.meshes[0]);
    else
        cli_print("%u files: ", job->scans.mesh_count);
}

static void print_read(const struct voxelize_job *job)
{
    const struct vox_sort_report *sort = &job->sort;
    print_meshes(job);
    cli_print("%s, %s, %s, %s, %.2f s\n", cli_counted(sort->vertices, "vertex", "vertices").text,
              cli_counted(sort->faces, "face", "faces").text,
              cli_counted(sort->triangles, "triangle", "triangles").text,
              cli_size(sort->bytes_read).text, sort->seconds_read);
    const char *first = "left out: ";
    const char *next = cli_print_count(first, sort->degenerate_triangles, "degenerate triangle",
                                       "degenerate triangles");
    next = cli_print_count(next, sort->short_faces, "face with fewer than three corners",
                           "faces with fewer than three corners");
    next = cli_print_count(next, sort->broken_faces, "face without a finite position",
                           "faces without finite positions");
    next = cli_print_count(next, sort->skipped_lines, "unknown line", "unknown lines");
    if (next != first)
        putchar('\n');
}

/* Prints what the scan has, and what of it the chunk file keeps. */
static void print_kept(const struct voxelize_job *job)
{
    const struct vox_sort_report *sort = &job->sort;
    const char *comma = "";
    const struct {
        bool there;
        const char *text;
    } kept[] = {
        {true, "positions"},
        {sort->has_normals, "normals"},
        {sort->has_texcoords, "texture coordinates"},
        {sort->has_colors,
         sort->has_fine_colors ? "vertex colours of more than 8 bits" : "vertex colours"},
        {sort->has_material_colors, "colours of materials"},
        {sort->uses_textures, "textures"},
        {sort->kept_channels[0], sort->kept_channels},
    };
    cli_print("kept: ");
    for (size_t i = 0; i < sizeof kept / sizeof *kept; i++)
        if (kept[i].there) {
            cli_print("%s%s", comma, kept[i].text);
            comma = ", ";
        }
    cli_print("\n");
    if (sort->unused_texcoords)
        cli_print(
            "not kept: texture coordinates, because there is no texture; --texture FILE gives "
            "one\n");
    if (sort->unkept_channels[0])
        cli_print("not kept: %s of the materials; --channels all keeps them\n",
                  sort->unkept_channels);
}

static void print_tris(const struct voxelize_job *job)
{
    if (job->joins || (job->scans.mesh_count > 0 && !job->temporary_tris))
        cli_print("%s: %s, %s, %.2f s\n", job->tris_path,
                  cli_counted(job->sort.chunks, "chunk", "chunks").text,
                  cli_size(job->sort.tris_bytes).text, job->sort.seconds_sort);
    if (job->scans.mesh_count > 0 && !job->temporary_tris && job->sort.outer_texture[0])
        cli_print("%s needs its textures where they are now, such as %s%s\n", job->tris_path,
                  job->sort.outer_texture,
                  job->arguments->sort.embed_textures ? ""
                                                      : "; --embed-textures copies them into it");
}

static void print_grid(const struct vox_voxelize_options *options,
                       const struct vox_voxelize_report *grid)
{
    cli_print("%s: %s in %lld x %lld x %lld, voxel size %g, %s%s%s, %.2f s\n", options->grid_path,
              cli_counted(grid->voxels, "voxel", "voxels").text,
              (long long)grid->index_max[0] - grid->index_min[0] + 1,
              (long long)grid->index_max[1] - grid->index_min[1] + 1,
              (long long)grid->index_max[2] - grid->index_min[2] + 1, grid->voxel_size,
              cli_size(grid->grid_bytes).text,
              grid->rounds_colors ? ", with colour in 8 bits, of more"
              : grid->has_color   ? ", with colour"
                                  : "",
              grid->has_ids ? ", with ids" : "", grid->seconds);
    if (options->vdb_path)
        cli_print("%s: the same as OpenVDB\n", options->vdb_path);
}

/* Returns an array of the names of a list. */
static json_t *names_json(const char *list)
{
    json_t *names = json_array();
    while (*list) {
        const size_t length = strcspn(list, ",");
        cli_json_append(&names, json_stringn(list, length));
        list += list[length] ? length + 1 : length;
    }
    return names;
}

static json_t *sort_json(const struct vox_sort_report *sort)
{
    return json_pack(
        "{s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:[f, f, f], s:b, s:b, s:b,"
        " s:b, s:b, s:b, s:b, s:b, s:o, s:o, s:o, s:f, s:f}",
        CLI_COUNT(sort, bytes_read), CLI_COUNT(sort, vertices), CLI_COUNT(sort, faces),
        CLI_COUNT(sort, triangles), CLI_COUNT(sort, degenerate_triangles),
        CLI_COUNT(sort, short_faces), CLI_COUNT(sort, broken_faces), CLI_COUNT(sort, lost_corners),
        CLI_COUNT(sort, skipped_lines), CLI_COUNT(sort, chunks), CLI_COUNT(sort, tris_bytes),
        CLI_COUNT(sort, temp_bytes), "origin", sort->origin[0], sort->origin[1], sort->origin[2],
        "has_normals", (int)sort->has_normals, "has_texcoords", (int)sort->has_texcoords,
        "has_colors", (int)sort->has_colors, "has_fine_colors", (int)sort->has_fine_colors,
        "has_material_colors", (int)sort->has_material_colors, "unused_texcoords",
        (int)sort->unused_texcoords, "double_sided", (int)sort->double_sided, "uses_textures",
        (int)sort->uses_textures, "outer_texture",
        cli_json_text(sort->outer_texture[0] ? sort->outer_texture : NULL), "kept_channels",
        names_json(sort->kept_channels), "unkept_channels", names_json(sort->unkept_channels),
        CLI_VALUE(sort, seconds_read), CLI_VALUE(sort, seconds_sort));
}

static json_t *grid_json(const struct vox_voxelize_report *grid)
{
    return json_pack(
        "{s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:f, s:[i, i, i], s:[i, i, i], s:b, s:b, s:b, s:f}",
        CLI_COUNT(grid, triangles), CLI_COUNT(grid, voxels), CLI_COUNT(grid, second_records),
        CLI_COUNT(grid, leaves), CLI_COUNT(grid, lowers), CLI_COUNT(grid, uppers),
        CLI_COUNT(grid, grid_bytes), CLI_VALUE(grid, voxel_size), "index_min", grid->index_min[0],
        grid->index_min[1], grid->index_min[2], "index_max", grid->index_max[0], grid->index_max[1],
        grid->index_max[2], "has_color", (int)grid->has_color, "rounds_colors",
        (int)grid->rounds_colors, "has_ids", (int)grid->has_ids, CLI_VALUE(grid, seconds));
}

static int voxelize_report_print_json(const struct voxelize_job *job)
{
    const struct voxelize_arguments *arguments = job->arguments;
    bool keeps_tris = !arguments->parse_only && (job->joins || !job->temporary_tris);
    const bool no_grid = arguments->parse_only || arguments->sort_only;
    json_t *inputs = json_array();
    for (uint32_t i = 0; i < arguments->input_count; i++)
        cli_json_append(&inputs, cli_json_text(arguments->inputs[i]));
    json_t *root =
        json_pack("{s:o, s:o, s:o, s:o, s:o, s:o}", "inputs", inputs, "grid_path",
                  cli_json_text(no_grid ? NULL : arguments->grid.grid_path), "tris_path",
                  cli_json_text(keeps_tris ? job->tris_path : NULL), "vdb_path",
                  cli_json_text(arguments->grid.vdb_path), "scan",
                  job->scans.mesh_count == 0 && !job->joins ? json_null() : sort_json(&job->sort),
                  "grid", no_grid ? json_null() : grid_json(&job->grid));
    return cli_print_json(job->cli, root);
}

/* Warns of a scan in parts that are far from each other. A connected surface that spans the grid
 * touches at least as many voxels as the longest side has; with fewer voxels there is a gap. */
static void warn_of_stray_parts(const struct voxelize_job *job)
{
    const struct vox_voxelize_report *grid = &job->grid;
    int64_t side = 0;
    for (int a = 0; a < 3; a++) {
        int64_t length = (int64_t)grid->index_max[a] - grid->index_min[a] + 1;
        side = length > side ? length : side;
    }
    if (!job->arguments->parse_only && !job->arguments->sort_only && grid->voxels < (uint64_t)side)
        bsq_warn(job->cli->ctx,
                 "%s: only %s in a grid of %lld along the longest side: is there something far "
                 "away from the scan, or are its files in different units?",
                 job->arguments->grid.grid_path, cli_counted(grid->voxels, "voxel", "voxels").text,
                 (long long)side);
}

static int voxelize_report_print(const struct voxelize_job *job)
{
    warn_of_stray_parts(job);
    if (job->cli->json)
        return voxelize_report_print_json(job);
    if (job->scans.mesh_count > 0 && !job->joins)
        print_read(job);
    if (job->scans.mesh_count > 0 && !job->joins && !job->arguments->parse_only)
        print_kept(job);
    if (!job->arguments->parse_only)
        print_tris(job);
    if (!job->arguments->parse_only && !job->arguments->sort_only)
        print_grid(&job->arguments->grid, &job->grid);
    cli_print_cost(job->cli);
    return 0;
}

/* ---- the whole ---- */

static int voxelize_tool_run(struct voxelize_job *job)
{
    struct cli *cli = job->cli;
    struct voxelize_arguments *arguments = job->arguments;
    BSQ_PASS(cli_create_context(cli));
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
