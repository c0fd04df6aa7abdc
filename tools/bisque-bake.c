/* bisque-bake.c - bakes a scan into texture maps of a low-poly mesh. */
#include <stdlib.h>
#include <string.h>

#include "base/job_files.h"
#include "base/output.h"
#include "base/tile_files.h"
#include "tools/bake_farm.h"
#include "tools/bake_report.h"

/* ---- outputs ---- */

/* Names the files of all maps, of which there is one for each UDIM tile. The caller frees *out with
 * free_paths(), also after a failure. */
static int name_outputs(struct cli *cli, const struct bake_options *bake, char ***out)
{
    char **paths = *out = calloc(bake_path_count(bake), sizeof *paths);
    if (!paths)
        return bsq_fail(cli->ctx, BSQ_ENOMEM, "%s: out of memory", bake->output_path);
    for (unsigned i = 0; i < bake_path_count(bake); i++) {
        if (i < MOST_MAPS ? !(bake->maps & 1u << i) : bake->transfers[i - MOST_MAPS].no_file)
            continue;
        paths[i] = i < MOST_MAPS ? bake_map_path(bake->output_path, (enum bake_map)(1u << i))
                                 : bake_transfer_path(bake->output_path, bake_path_name(bake, i));
        if (!paths[i])
            return bsq_fail(cli->ctx, BSQ_ENOMEM, "%s: out of memory", bake->output_path);
    }
    return 0;
}

static void free_paths(const struct bake_options *bake, char **paths)
{
    for (unsigned i = 0; paths && i < bake_path_count(bake); i++)
        free(paths[i]);
    free(paths);
}

/* write_plan: the plan that is written, or NULL. */
static int check_outputs(struct cli *cli, const struct bake_options *bake, const char *write_plan,
                         char *const *paths)
{
    int status = bsq_note_input(cli->ctx, bake->scan_path, "the scan");
    for (uint32_t i = 0; i < bake->more_scan_count && status == 0; i++)
        status = bsq_note_input(cli->ctx, bake->more_scan_paths[i], "a scan");
    if (status == 0)
        status = bsq_note_input(cli->ctx, bake->mesh_path, "the low-poly mesh");
    for (uint32_t i = 0; i < bake->more_mesh_count && status == 0; i++)
        status = bsq_note_input(cli->ctx, bake->more_mesh_paths[i], "a low-poly mesh");
    if (status == 0 && bake->cage_path)
        status = bsq_note_input(cli->ctx, bake->cage_path, "the cage");
    for (uint32_t i = 0; i < bake->transfer_count && status == 0; i++)
        if (bake->transfers[i].texture_path)
            status = bsq_note_texture(cli->ctx, bake->transfers[i].texture_path, "the texture %s",
                                      bake->transfers[i].name);
    for (unsigned i = 0; i < bake_path_count(bake) && status == 0; i++) {
        if (!paths[i])
            continue;
        if (bake->preview_path && cli_same_file(bake->preview_path, paths[i]))
            return cli_usage(cli, "%s: two outputs have this name", paths[i]);
        if (write_plan && cli_same_file(write_plan, paths[i]))
            return cli_usage(cli, "%s: the plan and a map have this name", paths[i]);
        /* bake_run() checks the files of tiles and objects, which are known when the mesh is. */
        if (!strstr(paths[i], BAKE_UDIM_TOKEN) && !strstr(paths[i], BAKE_UVTILE_TOKEN) &&
            !strstr(paths[i], BAKE_OBJECT_TOKEN) && !strstr(paths[i], BAKE_MATERIAL_TOKEN))
            status = bsq_output_check(cli->ctx, paths[i]);
    }
    if (status == 0 && bake->preview_path && write_plan &&
        cli_same_file(write_plan, bake->preview_path))
        return cli_usage(cli, "%s: the plan and the preview have this name", write_plan);
    if (status == 0 && bake->preview_path)
        status = cli_check_picture(cli, bake->preview_path);
    return status;
}

/* ---- the work ---- */

/* Sets *missed if the maps are written but more samples missed than is allowed. */
static int bake_maps(struct cli *cli, struct bake_arguments *arguments, bool *missed)
{
    struct bake_options *bake = &arguments->bake;
    char **paths = NULL;
    struct bake_report report = {0};
    bake_report_watch(cli, &report);
    int status = bake_check_options(cli->ctx, bake);
    /* The files have to be known before the work, to check that no input is overwritten. */
    if (status == 0 && bake->maps & BAKE_MAPS_ALL)
        status = bake_arguments_add_channels(cli, arguments);
    if (status == 0)
        status = bake_find_maps(cli->ctx, bake, &bake->maps);
    if (status == 0)
        status = bake_check_options(cli->ctx, bake);
    if (status == 0)
        status = name_outputs(cli, bake, &paths);
    if (status == 0)
        status = check_outputs(cli, bake, arguments->farm.write_plan, paths);
    if (status == 0)
        status = bake_warn_unused(cli->ctx, bake, arguments->given);
    if (status == 0 && arguments->farm.write_plan)
        status = bake_farm_plan(cli, arguments, &report);
    else if (status == 0)
        status = bake_run(cli->ctx, bake, &report);
    if (status == 0 && !arguments->farm.write_plan) {
        status = bake_report_print(cli, arguments, &report, paths);
        *missed = status == 0 && bake_report_too_many_missed(cli, arguments, &report);
    }
    bake_report_watch(cli, NULL);
    bake_report_free(&report);
    free_paths(bake, paths);
    return status;
}

/* Merges the parts of a plan. Sets *missed as bake_maps() does. */
static int merge(struct cli *cli, struct bake_arguments *arguments,
                 const struct bake_farm_plan *plan, bool *missed)
{
    char **paths = NULL;
    struct bake_report report = {0};
    bool kept = false;
    bake_report_watch(cli, &report);
    const double max_missed = bake_arguments_has(arguments, "max_missed")
                                  ? arguments->bake.max_missed
                                  : bake_plan_options(plan)->max_missed;
    arguments->bake = *bake_plan_options(plan);
    arguments->bake.max_missed = max_missed;
    int status = name_outputs(cli, &arguments->bake, &paths);
    if (status == 0)
        status = check_outputs(cli, &arguments->bake, NULL, paths);
    if (status == 0)
        status = bake_merge_plan(cli->ctx, plan, arguments->farm.force, &kept, &report);
    if (status == 0 && kept)
        status = bake_farm_say_merged(cli, arguments);
    else if (status == 0)
        status = bake_report_print(cli, arguments, &report, paths);
    *missed = status == 0 && bake_report_too_many_missed(cli, arguments, &report);
    bake_report_watch(cli, NULL);
    bake_report_free(&report);
    free_paths(&arguments->bake, paths);
    /* The plan owns what these point to. */
    arguments->bake.transfers = NULL;
    arguments->bake.transfer_count = 0;
    arguments->bake.tile_sizes = NULL;
    arguments->bake.tile_ranges = NULL;
    return status;
}

/* Bakes tasks of a plan, merges its parts, or prints what it asks for. */
static int work_by_plan(struct cli *cli, struct bake_arguments *arguments, bool *missed)
{
    struct bake_farm_plan *plan = NULL;
    int status = bsq_note_input(cli->ctx, arguments->farm.plan, "the plan");
    if (status == 0)
        status = bake_open_plan(cli->ctx, arguments->farm.plan, &plan);
    if (status == 0)
        status = arguments->farm.merge        ? merge(cli, arguments, plan, missed)
                 : arguments->farm.task_given ? bake_farm_tasks(cli, arguments, plan)
                                              : bake_farm_print(cli, arguments->farm.plan, plan);
    bake_close_plan(plan);
    return status;
}

int main(int argc, char **argv)
{
    struct cli cli;
    struct bake_arguments arguments = {0};
    bool missed = false;
    cli_begin(&cli, "bisque-bake", argv);
    int status = bake_arguments_parse(&cli, &arguments, argc, argv);
    if (status == 0)
        status = cli_create_context(&cli);
    if (status == 0)
        status = bake_arguments_map_inputs(&cli, &arguments);
    if (status == 0 && cli.verify)
        status = cli_verify(&cli, arguments.files, arguments.file_count);
    else if (status == 0 && !arguments.list_devices && !arguments.farm.plan)
        status = bake_arguments_sort_inputs(&cli, &arguments);
    if (status == 0 && !cli.verify)
        status = arguments.list_devices ? bake_report_devices(&cli)
                 : arguments.list_tiles ? bake_report_tiles(&cli, &arguments.bake)
                 : arguments.farm.plan  ? work_by_plan(&cli, &arguments, &missed)
                                        : bake_maps(&cli, &arguments, &missed);
    bake_arguments_free(&arguments);
    int code = cli_end(&cli, status);
    return code ? code : missed;
}
