/* bisque-bake.c - bakes a scan into texture maps of a low-poly mesh. */
#include <stdlib.h>
#include <string.h>

#include "base/job_files.h"
#include "base/context.h"
#include "base/output.h"
#include "base/tile_files.h"
#include "tools/bake_farm.h"
#include "tools/bake_report.h"
#include "tools/cli_percent.h"

/* ---- checks before the work ---- */

static int note_inputs(struct cli *cli, const struct bake_options *bake)
{
    int status = 0;
    BSQ_TRY(bsq_note_input(cli->ctx, bake->scan_path, "the scan"));
    for (uint32_t i = 0; i < bake->more_scan_count; i++)
        BSQ_TRY(bsq_note_input(cli->ctx, bake->more_scan_paths[i], "a scan"));
    BSQ_TRY(bsq_note_input(cli->ctx, bake->mesh_path, "the low-poly mesh"));
    for (uint32_t i = 0; i < bake->more_mesh_count; i++)
        BSQ_TRY(bsq_note_input(cli->ctx, bake->more_mesh_paths[i], "a low-poly mesh"));
    if (bake->cage_path)
        BSQ_TRY(bsq_note_input(cli->ctx, bake->cage_path, "the cage"));
    for (uint32_t i = 0; i < bake->transfer_count; i++)
        if (bake->transfers[i].texture_path)
            BSQ_TRY(bsq_note_texture(cli->ctx, bake->transfers[i].texture_path, "the texture %s",
                                     bake->transfers[i].name));
done:
    return status;
}

/* The outputs beside the maps. */
struct outputs {
    struct cli *cli;
    const char *preview, *write_plan; /* NULL: none */
};

/* Checks the file of a map. The library checks those of tiles and objects, which are known when the
 * mesh is. */
static int check_map(void *arg, const struct bake_file *file)
{
    static const char *const tokens[] = {BAKE_UDIM_TOKEN, BAKE_UVTILE_TOKEN, BAKE_OBJECT_TOKEN,
                                         BAKE_MATERIAL_TOKEN};
    const struct outputs *outputs = (const struct outputs *)arg;
    if (outputs->preview && cli_same_file(outputs->preview, file->path))
        return cli_usage(outputs->cli, "%s: two outputs have this name", file->path);
    if (outputs->write_plan && cli_same_file(outputs->write_plan, file->path))
        return cli_usage(outputs->cli, "%s: the plan and a map have this name", file->path);
    for (size_t i = 0; i < sizeof tokens / sizeof *tokens; i++)
        if (strstr(file->path, tokens[i]))
            return 0;
    return bsq_output_check(outputs->cli->ctx, file->path);
}

/* write_plan: the plan that is written, or NULL. */
static int check_outputs(struct cli *cli, const struct bake_options *bake, const char *write_plan)
{
    struct outputs outputs = {cli, bake->preview_path, write_plan};
    int status = 0;
    BSQ_TRY(note_inputs(cli, bake));
    BSQ_TRY(bake_list_files(cli->ctx, bake, NULL, check_map, &outputs));
    if (bake->preview_path && write_plan && cli_same_file(write_plan, bake->preview_path))
        return cli_usage(cli, "%s: the plan and the preview have this name", write_plan);
    if (bake->preview_path)
        BSQ_TRY(cli_check_picture(cli, bake->preview_path));
done:
    return status;
}

/* ---- the work ---- */

/* Sets *missed if the maps are written but more samples missed than is allowed. */
static int bake_maps(struct cli *cli, struct bake_arguments *arguments, bool *missed)
{
    struct bake_options *bake = &arguments->bake;
    struct bake_report report = {0};
    int status = 0;
    bake_report_watch(cli, &report);
    BSQ_TRY(bake_check_options(cli->ctx, bake));
    /* The files have to be known before the work, to check that no input is overwritten. */
    if (bake->maps & BAKE_MAPS_ALL)
        BSQ_TRY(bake_arguments_add_channels(cli, arguments));
    BSQ_TRY(bake_find_maps(cli->ctx, bake, &bake->maps));
    BSQ_TRY(bake_check_options(cli->ctx, bake));
    BSQ_TRY(check_outputs(cli, bake, arguments->farm.write_plan));
    BSQ_TRY(bake_warn_unused(cli->ctx, bake, arguments->given));
    if (arguments->farm.write_plan) {
        status = bake_farm_plan(cli, arguments, &report);
        goto done;
    }
    BSQ_TRY(bake_run(cli->ctx, bake, &report));
    BSQ_TRY(bake_report_print(cli, arguments, &report));
    *missed = bake_report_too_many_missed(cli, arguments, &report);
done:
    bake_report_watch(cli, NULL);
    bake_report_free(&report);
    return status;
}

/* Merges a tile of a plan, or all. Sets *missed as bake_maps() does, for all. */
static int merge_tile(struct cli *cli, const struct bake_arguments *arguments,
                      const struct bake_farm_plan *plan, uint32_t tile, bool *missed)
{
    const bool all = tile == BAKE_ALL_TILES;
    struct bake_report report = {0};
    bool kept = false;
    int status;
    bake_report_watch(cli, &report);
    BSQ_TRY(bake_merge_plan(cli->ctx, plan, tile, arguments->farm.force, &kept, &report));
    if (kept)
        status = cli_say_kept(cli, arguments->farm.plan,
                              all ? "the merge of this plan" : "the merge of this tile");
    else
        status = all ? bake_report_print(cli, arguments, &report)
                     : bake_report_print_tile(cli, arguments, &report, tile);
    if (status == 0 && all)
        *missed = bake_report_too_many_missed(cli, arguments, &report);
done:
    bake_report_watch(cli, NULL);
    bake_report_free(&report);
    return status;
}

/* Merges tiles. A scheduler need not know how many there are. */
static int merge_tiles(struct cli *cli, const struct bake_arguments *arguments,
                       const struct bake_farm_plan *plan)
{
    const struct bake_numbers *range = &arguments->farm.merge_tile;
    const uint32_t count = bake_plan_tile_count(plan);
    int status = 0;
    for (uint32_t tile = range->first; tile <= range->last && status == 0; tile++) {
        cli_percent_turn(cli, tile - range->first, range->last - range->first + 1);
        if (tile < count)
            status = merge_tile(cli, arguments, plan, tile, NULL);
        else if (!cli->json)
            cli_print("%s: there is no tile %u, nothing to do\n", arguments->farm.plan, tile);
        else
            status = cli_print_json(cli, json_pack("{s:o, s:b, s:i}", "path",
                                                   cli_json_text(arguments->farm.plan), "kept", 0,
                                                   "merge_tile", (int)tile));
    }
    return status;
}

/* Merges the parts of a plan. Sets *missed as bake_maps() does. */
static int merge(struct cli *cli, struct bake_arguments *arguments,
                 const struct bake_farm_plan *plan, bool *missed)
{
    int status;
    const double max_missed = bake_arguments_has(arguments, "max_missed")
                                  ? arguments->bake.max_missed
                                  : bake_plan_options(plan)->max_missed;
    arguments->bake = *bake_plan_options(plan);
    arguments->bake.max_missed = max_missed;
    BSQ_TRY(check_outputs(cli, &arguments->bake, NULL));
    status = arguments->farm.merge ? merge_tile(cli, arguments, plan, BAKE_ALL_TILES, missed)
                                   : merge_tiles(cli, arguments, plan);
done:
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
    int status = 0;
    BSQ_TRY(bsq_note_input(cli->ctx, arguments->farm.plan, "the plan"));
    BSQ_TRY(bake_open_plan(cli->ctx, arguments->farm.plan, &plan));
    if (bake_plan_options(plan)->strict)
        bsq_set_strict(cli->ctx, true);
    if (arguments->farm.task.given)
        status = bake_farm_tasks(cli, arguments, plan);
    else if (arguments->farm.merge || arguments->farm.merge_tile.given)
        status = merge(cli, arguments, plan, missed);
    else
        status = bake_farm_print(cli, arguments->farm.plan, plan, false);
done:
    bake_close_plan(plan);
    return status;
}

/* Does what the command line asks for. */
static int work(struct cli *cli, struct bake_arguments *arguments, bool *missed)
{
    int status = 0;
    BSQ_TRY(cli_create_context(cli));
    BSQ_TRY(bake_arguments_map_inputs(cli, arguments));
    if (cli->verify)
        return cli_verify(cli, arguments->files, arguments->file_count);
    if (arguments->list_devices)
        return bake_report_devices(cli);
    if (arguments->farm.plan)
        return work_by_plan(cli, arguments, missed);
    BSQ_TRY(bake_arguments_sort_inputs(cli, arguments));
    status = arguments->list_tiles ? bake_report_tiles(cli, &arguments->bake)
                                   : bake_maps(cli, arguments, missed);
done:
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
        status = work(&cli, &arguments, &missed);
    bake_arguments_free(&arguments);
    int code = cli_end(&cli, status);
    return code ? code : missed;
}
