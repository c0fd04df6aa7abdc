/* bisque-bake.c - a low mesh and a scan become texture maps. */
#include <stdlib.h>
#include <string.h>

#include "tools/bake_report.h"

/* ---- outputs ---- */

/* Names of all outputs, `paths` of BAKE_MAP_KINDS; those of maps that are not asked for are NULL.
 */
static int name_outputs(struct cli *cli, const struct bake_options *bake, char **paths)
{
    for (unsigned i = 0; i < BAKE_MAP_KINDS; i++) {
        if (!(bake->maps & bake_map_names[i].map))
            continue;
        paths[i] = bake_map_path(bake->output_path, bake_map_names[i].map);
        if (!paths[i])
            return bsq_fail(cli->ctx, BSQ_ENOMEM, "%s: out of memory", bake->output_path);
    }
    return 0;
}

static int check_outputs(struct cli *cli, const struct bake_options *bake, char *const *paths)
{
    const char *const inputs[] = {bake->scan_path, bake->mesh_path};
    bool several = (bake->maps & (bake->maps - 1)) != 0;
    int status = 0;
    if (several && !strstr(bake->output_path, "<MAP>"))
        return cli_usage(cli, "%s: several maps need \"<MAP>\" in the output's name",
                         bake->output_path);
    for (unsigned i = 0; i < BAKE_MAP_KINDS && status == 0; i++) {
        if (!paths[i])
            continue;
        if (bake->preview_path && cli_same_file(bake->preview_path, paths[i]))
            return cli_usage(cli, "%s: two outputs have this name", paths[i]);
        status = cli_check_output(cli, paths[i], inputs, 2);
    }
    if (status == 0 && bake->preview_path)
        status = cli_check_picture(cli, bake->preview_path, inputs, 2);
    return status;
}

/* Where no maps were asked for: normals, and colours where the scan has them. The library would
 * choose so by itself; here it has to be known beforehand which files there will be. */
static int choose_maps(struct cli *cli, struct bake_options *bake)
{
    bool has_color = false;
    if (bake->maps != BAKE_MAPS_DEFAULT)
        return 0;
    int status = bake_scan_has_color(cli->ctx, bake->scan_path, &has_color);
    bake->maps = BAKE_MAP_NORMAL | (has_color ? BAKE_MAP_COLOR : 0);
    return status;
}

/* ---- the work ---- */

static int bake_maps(struct cli *cli, struct bake_arguments *arguments)
{
    char *paths[BAKE_MAP_KINDS] = {NULL};
    struct bake_report report = {0};
    int status = bake_check_options(cli->ctx, &arguments->bake);
    if (status == 0)
        status = choose_maps(cli, &arguments->bake);
    if (status == 0)
        status = name_outputs(cli, &arguments->bake, paths);
    if (status == 0)
        status = check_outputs(cli, &arguments->bake, paths);
    if (status == 0)
        status = bake_run(cli->ctx, &arguments->bake, &report);
    if (status == 0)
        status = bake_report_print(cli, arguments, &report, paths);
    for (unsigned i = 0; i < BAKE_MAP_KINDS; i++)
        free(paths[i]);
    return status;
}

int main(int argc, char **argv)
{
    struct cli cli;
    struct bake_arguments arguments = {0};
    cli_begin(&cli, "bisque-bake", argv);
    int status = bake_arguments_parse(&cli, &arguments, argc, argv);
    if (status == 0)
        status = cli_create_context(&cli);
    if (status == 0 && cli.verify)
        status = cli_verify(&cli, arguments.files, arguments.file_count);
    else if (status == 0)
        status = arguments.list_devices ? bake_report_devices(&cli) : bake_maps(&cli, &arguments);
    return cli_end(&cli, status);
}
