/* bisque-bake.c - bakes a scan into texture maps of a low-poly mesh. */

#include <unistd.h>

#include "tools/bake_report.h"

/* Sets *missed if the maps are written but more samples missed than is allowed. */
static int bake_maps(struct cli *cli, struct bake_arguments *arguments, bool *missed)
{
    struct bake_options *bake = &arguments->bake;
    struct bake_report report = {.size = sizeof report};
    int status = 0;
    bake_report_watch(cli, &report);
    BSQ_TRY(bake_arguments_complete(cli, arguments));
    if (bake->reference_path)
        BSQ_TRY(bake_report_note_references(cli, bake->reference_path));
    if (bake->page_path) {
        BSQ_TRY(bake_page_open(cli->ctx, bake->page_path, &bake->page));
        bake->on_rows = bake_page_take;
        bake->rows_user = bake->page;
    }
    BSQ_TRY(bake_run(cli->ctx, bake, &report));
    if (bake->part) {
        status = bake_report_print_part(cli, arguments, &report);
        goto done;
    }
    BSQ_TRY(bake_report_print(cli, arguments, &report));
    *missed = bake_report_too_many_missed(cli, arguments, &report);
done:
    bake_report_watch(cli, NULL);
    bake_page_close(bake->page);
    bake_report_free(&report);
    return status;
}

/* Does what the command line asks for. */
static int bake_tool_work(struct cli *cli, struct bake_arguments *arguments, bool *missed)
{
    BSQ_PASS(cli_create_context(cli));
    if (arguments->list_devices)
        return bake_report_devices(cli);
    BSQ_PASS(bake_arguments_sort_inputs(cli, arguments));
    return arguments->list_tiles ? bake_report_tiles(cli, &arguments->bake)
                                 : bake_maps(cli, arguments, missed);
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
    if (arguments.new_folder)
        rmdir(arguments.new_folder); /* unless it has maps */
    int code = cli_end(&cli, status);
    return code ? code : missed;
}
