/* bake_arguments.c - see bake_arguments.h. */
#include "tools/bake_arguments.h"

#include <stdlib.h>
#include <string.h>

static const char usage[] =
    "Usage: bisque-bake [OPTION]... SCAN.nvdb LOW.obj... -o OUT_<MAP>.exr\n"
    "       bisque-bake [OPTION]... SCAN.tris LOW.obj... -o OUT_<MAP>.exr\n"
    "       bisque-bake [OPTION]... SCAN.nvdb LOW.obj -o OUT_<MAP>.exr --tasks N --plan PLAN\n"
    "       bisque-bake --plan PLAN --task I\n"
    "       bisque-bake --plan PLAN --merge [--task I]\n"
    "       bisque-bake --plan PLAN\n"
    "       bisque-bake --list devices\n"
    "       bisque-bake --list tiles LOW.obj...\n"
    "Bakes the normals and colours of a scan into texture maps of a low-poly mesh: fast from a\n"
    "voxel grid (SCAN.nvdb), or exactly from the scan's own triangles (SCAN.tris).\n"
    "<MAP> in the output's name is replaced by the name of the map, <UDIM> by the number of the tile,\n"
    "<UVTILE> by u1_v1 and so on, <OBJECT> and <MATERIAL> by names in the low-poly meshes, which then\n"
    "have maps of their own. A name that ends in .exr gives OpenEXR files, one that ends in .png PNG\n"
    "files; -o FOLDER/ gives FOLDER/LOW_<MAP>.exr, or .png with a preset. Options with KEY=VALUE take several, with commas between them: --rays ao=32,thickness=16\n";

/* ---- other options with a syntax of their own ---- */

/* Parses "_low,_high". The texts live as long as the arguments. */
static int parse_suffixes(struct cli *cli, struct bake_arguments *arguments, const char *text)
{
    char *copy = strdup(text), *comma = copy ? strchr(copy, ',') : NULL;
    free(arguments->suffixes);
    arguments->suffixes = copy;
    if (!copy)
        return cli_usage(cli, "--match: out of memory");
    if (!comma || strchr(comma + 1, ','))
        return cli_usage(cli, "--match: \"%s\" is not name or LOW,HIGH", text);
    *comma = '\0';
    arguments->bake.low_suffix = copy;
    arguments->bake.high_suffix = comma + 1;
    return 0;
}

static int parse_list(struct cli *cli, struct bake_arguments *arguments, const char *text)
{
    unsigned kind = 0;
    const int status = cli_parse_word(cli, "--list", text, "devices tiles", &kind);
    arguments->list_devices = kind == 0;
    arguments->list_tiles = kind == 1;
    return status;
}

static int take_option(struct cli *cli, void *arg, const struct bsq_option *row, const char *text)
{
    struct bake_arguments *arguments = arg;
    struct bake_options *bake = &arguments->bake;
    const char *name = row->name;
    if (strcmp(name, "size") == 0)
        return bake_parse_sizes(cli, text, bake);
    if (strcmp(name, "tiles") == 0)
        return bake_parse_tiles(cli, text, bake);
    if (strcmp(name, "match") == 0) {
        bake->match_names = true;
        return strcmp(text, "name") == 0 ? 0 : parse_suffixes(cli, arguments, text);
    }
    if (strcmp(name, "device") == 0) {
        bake->device = text;
        return bake_is_device_name(text)
                   ? 0
                   : cli_usage(cli, "--device: \"%s\" is not " BAKE_DEVICE_NAMES, text);
    }
    if (strcmp(name, "task") == 0)
        return bake_farm_parse(cli, name, text, &arguments->farm.task);
    if (strcmp(name, "merge-tile") == 0) {
        arguments->farm.merge = true;
        return bake_farm_parse(cli, name, text, &arguments->farm.task);
    }
    if (strcmp(name, "list") == 0)
        return parse_list(cli, arguments, text);
    if (strcmp(name, "half") != 0 && strcmp(name, "float") != 0)
        return bake_maps_take(cli, arg, row, text);
    bake->sample_type = strcmp(name, "half") == 0 ? BAKE_HALF : BAKE_FLOAT;
    return 0;
}

/* ---- all of them ---- */

static const struct bsq_option list_rows[] = {
    {BSQ_ROW("list", "WHAT", "print the devices, or the UDIM tiles of a low-poly mesh, and exit"),
     .heading = "Instead of a bake", BSQ_OWN},
    /* Old names; those of other options are in their rows. */
    {.name = "list-devices", BSQ_MEMBER(FLAG, struct bake_arguments, list_devices)},
    {.name = "list-tiles", BSQ_MEMBER(FLAG, struct bake_arguments, list_tiles)},
    {.name = "mask-opacity", BSQ_MEMBER(FLAG, struct bake_arguments, mask_opacity)},
    {.name = "half", BSQ_OWN},
    {.name = "float", BSQ_OWN},
};
enum { LIST_ROWS = sizeof list_rows / sizeof *list_rows };

static const struct bsq_option cli_rows[] = {
    CLI_STRICT_ROW, {.name = "verify", BSQ_MEMBER(FLAG, struct cli, verify)}, /* an old name */
};

struct cli_table bake_arguments_table(const struct bake_arguments *arguments)
{
    struct cli_table table = {.options = (void *)(uintptr_t)&arguments->bake,
                              .given = (bool *)(uintptr_t)arguments->given};
    table.rows = bake_option_rows(&table.count);
    return table;
}

static int check_arguments(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    const int count = arguments->file_count;
    if (cli->verify)
        return 0;
    if (arguments->list_devices)
        return count == 0 ? 0 : cli_usage(cli, "--list devices takes no files");
    if (arguments->list_tiles)
        return count > 0 ? 0 : cli_usage(cli, "--list tiles takes files: LOW.obj...");
    if (bake_farm_check(cli, arguments) < 0)
        return BSQ_EUSAGE;
    if (arguments->farm.plan)
        return 0;
    if (count < 2)
        return cli_usage(cli, "%d input file%s given, not two: SCAN.nvdb and LOW.obj (see --help)",
                         count, count == 1 ? "" : "s");
    if (bake->ao_falloff && bake->ao_distance <= 0)
        return cli_usage(cli, "--ao falloff=linear needs --distance ao=D");
    if (!bake->output_path)
        return cli_usage(cli, "no output given: add -o 'OUT_<MAP>.exr'");
    arguments->bake.strict = cli->strict;
    return bake_maps_finish(cli, arguments);
}

int bake_arguments_parse(struct cli *cli, struct bake_arguments *arguments, int argc, char **argv)
{
    const struct cli_command command = {
        .usage = usage,
        .print_more = bake_maps_print,
        .tables = {bake_arguments_table(arguments),
                   {bake_task_rows, BAKE_TASK_ROWS, &arguments->farm, NULL},
                   {list_rows, LIST_ROWS, arguments, NULL},
                   {cli_rows, sizeof cli_rows / sizeof *cli_rows, cli, NULL}},
        .take = take_option,
        .arguments = arguments,
    };
    bake_defaults(&arguments->bake);
    int status = cli_parse(cli, &command, argc, argv);
    arguments->files = argv + optind;
    arguments->file_count = argc - optind;
    return status != 0 ? status : check_arguments(cli, arguments);
}

void bake_arguments_free(struct bake_arguments *arguments)
{
    bake_maps_free(arguments);
    free(arguments->output);
    free(arguments->paths);
    free(arguments->suffixes);
    free((void *)(uintptr_t)arguments->bake.tile_sizes);
    free((void *)(uintptr_t)arguments->bake.tile_ranges);
}
