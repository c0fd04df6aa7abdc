/* bisque-bake.c - bakes a scan into texture maps of a low-poly mesh. */
#include <stdlib.h>
#include <string.h>

#include "tools/bake_farm.h"
#include "tools/bake_report.h"
#include "tools/page.h"

/* Sets *missed if the maps are written but more samples missed than is allowed. */
static int bake_maps(struct cli *cli, struct bake_arguments *arguments, bool *missed)
{
    struct bake_options *bake = &arguments->bake;
    struct bake_report report = {.size = sizeof report};
    int status = 0;
    bake_report_watch(cli, &report);
    BSQ_TRY(bake_arguments_look(cli, arguments));
    if (arguments->farm.write_plan) {
        status = bake_farm_plan(cli, arguments, &report);
        goto done;
    }
    if (bake->reference_path)
        BSQ_TRY(bake_report_note_references(cli, bake->reference_path));
    if (bake->page_path) {
        BSQ_TRY(bake_page_open(cli->ctx, bake->page_path, &bake->page));
        bake->on_rows = bake_page_take;
        bake->rows_user = bake->page;
    }
    BSQ_TRY(bake_run(cli->ctx, bake, &report));
    BSQ_TRY(bake_report_print(cli, arguments, &report));
    *missed = bake_report_too_many_missed(cli, arguments, &report);
done:
    bake_report_watch(cli, NULL);
    bake_page_close(bake->page);
    bake_report_free(&report);
    return status;
}

/* Merges a tile of a plan, or all. Sets *missed as bake_maps() does, for all. */
static int bake_tool_merge_tile(struct cli *cli, const struct bake_arguments *arguments,
                                const struct bake_farm_plan *plan, uint32_t tile, bool *missed)
{
    const bool all = tile == BAKE_ALL_TILES;
    struct bake_report report = {.size = sizeof report};
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
    const struct bake_numbers *range = &arguments->farm.task;
    const uint32_t count = bake_describe_plan(plan).tiles;
    int status = 0;
    for (uint32_t tile = range->first; tile <= range->last && status == 0; tile++) {
        cli_percent_turn(cli, tile - range->first, range->last - range->first + 1);
        if (tile < count)
            status = bake_tool_merge_tile(cli, arguments, plan, tile, NULL);
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
static int bake_tool_merge(struct cli *cli, struct bake_arguments *arguments,
                           const struct bake_farm_plan *plan, bool *missed)
{
    const struct cli_table table = bake_arguments_table(arguments);
    const double max_missed = cli_is_given(&table, "max-missed")
                                  ? arguments->bake.max_missed
                                  : bake_describe_plan(plan).options->max_missed;
    arguments->bake = *bake_describe_plan(plan).options;
    arguments->bake.max_missed = max_missed;
    int status = 0;
    if (arguments->bake.reference_path)
        BSQ_TRY(bake_report_note_references(cli, arguments->bake.reference_path));
    status = arguments->farm.task.given
                 ? merge_tiles(cli, arguments, plan)
                 : bake_tool_merge_tile(cli, arguments, plan, BAKE_ALL_TILES, missed);
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
    if (bake_describe_plan(plan).options->strict)
        bsq_set_strict(cli->ctx, true);
    if (arguments->farm.merge)
        status = bake_tool_merge(cli, arguments, plan, missed);
    else if (arguments->farm.task.given)
        status = bake_farm_tasks(cli, arguments, plan);
    else
        status = bake_farm_print(cli, arguments->farm.plan, plan, false);
done:
    bake_close_plan(plan);
    return status;
}

/* Does what the command line asks for. */
static int bake_tool_work(struct cli *cli, struct bake_arguments *arguments, bool *missed)
{
    int status = 0;
    BSQ_TRY(cli_create_context(cli));
    BSQ_TRY(bake_arguments_map_inputs(cli, arguments));
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
        status = bake_tool_work(&cli, &arguments, &missed);
    bake_arguments_free(&arguments);
    int code = cli_end(&cli, status);
    return code ? code : missed;
}
