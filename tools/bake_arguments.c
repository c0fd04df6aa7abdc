/* bake_arguments.c - see bake_arguments.h. */
#include "tools/bake_arguments.h"

#include <stdlib.h>
#include <string.h>

#include "formats/file_kind.h"

static const char usage[] =
    "Usage: bisque-bake [OPTION]... SCAN.nvdb LOW.obj... -o OUT_<MAP>.exr\n"
    "       bisque-bake [OPTION]... SCAN.tris LOW.obj... -o OUT_<MAP>.exr\n"
    "       bisque-bake [OPTION]... SCAN.nvdb LOW.obj -o OUT_<MAP>.exr --part I/N | --merge N\n"
    "       bisque-bake --list devices\n"
    "       bisque-bake --list tiles LOW.obj...\n"
    "Bakes the normals and colours of a scan into texture maps of a low-poly mesh: fast from a\n"
    "voxel grid (SCAN.nvdb), or exactly from the scan's own triangles (SCAN.tris).\n"
    "<MAP> in the output's name is replaced by the name of the map, <UDIM> by the number of the tile,\n"
    "<UVTILE> by u1_v1 and so on, <OBJECT> and <MATERIAL> by names in the low-poly meshes, which then\n"
    "have maps of their own. A name that ends in .exr gives OpenEXR files, one that ends in .png PNG\n"
    "files; -o FOLDER/ gives FOLDER/LOW_<MAP>.exr, or .png with a preset. Options with KEY=VALUE take several, with commas between them: --rays ao=32,thickness=16\n";

/* ---- --size and --tiles ---- */

/* Reads a number at *text and advances *text past it. Returns false unless the number is 1 to
 * `most`. */
static bool take_number(const char **text, unsigned long long most, uint32_t *out)
{
    char *end;
    bool digit = **text >= '0' && **text <= '9';
    unsigned long long value = strtoull(*text, &end, 10);
    *text = end;
    *out = (uint32_t)value;
    return digit && value >= 1 && value <= most;
}

/* Reads a character if it is there. */
static bool bake_args_take(const char **text, char character)
{
    bool there = **text == character;
    *text += there;
    return there;
}

/* Reads a number of texels, such as 4096 or 4k. */
static bool take_side(const char **text, uint32_t *out)
{
    const bool good = take_number(text, BAKE_MAX_SIDE, out);
    const bool thousands = bake_args_take(text, 'k') || bake_args_take(text, 'K');
    const uint64_t texels = thousands ? UINT64_C(1024) * *out : *out;
    *out = (uint32_t)texels;
    return good && texels <= BAKE_MAX_SIDE;
}

static bool take_size(const char **text, uint32_t *width, uint32_t *height)
{
    bool good = take_side(text, width);
    *height = *width;
    return good && (!bake_args_take(text, 'x') || take_side(text, height));
}

/* Adds the size of a tile. */
static int add_tile_size(struct cli *cli, struct bake_options *options,
                         const struct bake_tile_size *size)
{
    for (uint32_t i = 0; i < options->tile_size_count; i++)
        if (options->tile_sizes[i].tile == size->tile)
            return cli_usage(cli, "--size: tile %u is given twice", size->tile);
    struct bake_tile_size *sizes =
        cli_extend(options->tile_sizes, options->tile_size_count, sizeof *sizes);
    sizes[options->tile_size_count++] = *size;
    options->tile_sizes = sizes;
    return 0;
}

/* Reads "1001=4096" or "*=2048". Sets *good, and *others after "*". */
static int take_tile_size(struct cli *cli, const char **text, struct bake_options *options,
                          bool *others, bool *good)
{
    struct bake_tile_size size = {0};
    const bool all = bake_args_take(text, '*');
    *good = (all || take_number(text, BAKE_LAST_TILE, &size.tile)) && bake_args_take(text, '=') &&
            take_size(text, &size.width, &size.height);
    if (!*good)
        return 0;
    if (!all)
        return add_tile_size(cli, options, &size);
    if (*others)
        return cli_usage(cli, "--size: * is given twice");
    *others = true;
    options->width = size.width;
    options->height = size.height;
    return 0;
}

/* Parses N, WxH, or a list of sizes by tile. */
static int parse_sizes(struct cli *cli, const char *text, struct bake_options *options)
{
    const char *at = text;
    const uint32_t width = options->width, height = options->height;
    bool good = take_size(&at, &options->width, &options->height) && *at == '\0';
    int status = 0;
    if (strchr(text, '=')) {
        options->width = width; /* of tiles that the text does not name */
        options->height = height;
        at = text;
        bool others = false;
        do
            status = take_tile_size(cli, &at, options, &others, &good);
        while (status == 0 && good && bake_args_take(&at, ','));
        good = good && *at == '\0';
    }
    if (status == 0 && !good)
        status = cli_usage(cli,
                           "--size: \"%s\" is not N, WxH or TILE=SIZE,...,*=SIZE with numbers from "
                           "1 to %d",
                           text, BAKE_MAX_SIDE);
    return status;
}

/* Parses a list such as "1001-1003,1011". */
static int parse_tiles(struct cli *cli, const char *text, struct bake_options *options)
{
    const char *at = text;
    do {
        struct bake_tile_range range;
        bool good = take_number(&at, BAKE_LAST_TILE, &range.first);
        range.last = range.first;
        if (good && bake_args_take(&at, '-'))
            good = take_number(&at, BAKE_LAST_TILE, &range.last);
        if (!good || (*at != ',' && *at != '\0') || range.first < BAKE_FIRST_TILE ||
            range.last < range.first)
            return cli_usage(cli,
                             "--tiles: \"%s\" is not a list such as 1001-1003,1011 from %d to %d",
                             text, BAKE_FIRST_TILE, BAKE_LAST_TILE);
        struct bake_tile_range *ranges =
            cli_extend(options->tile_ranges, options->tile_range_count, sizeof *ranges);
        ranges[options->tile_range_count++] = range;
        options->tile_ranges = ranges;
    } while (bake_args_take(&at, ','));
    return 0;
}

/* ---- other options with a syntax of their own ---- */

/* Parses "_low,_high". */
static int parse_suffixes(struct cli *cli, struct bake_options *options, const char *text)
{
    char *copy = cli_keep_text("%s", text), *comma = strchr(copy, ',');
    if (!comma || strchr(comma + 1, ','))
        return cli_usage(cli, "--match: \"%s\" is not name or LOW,HIGH", text);
    *comma = '\0';
    options->low_suffix = copy;
    options->high_suffix = comma + 1;
    return 0;
}

/* Parses "3/64". */
static int parse_part(struct cli *cli, const char *text, struct bake_options *options)
{
    const char *at = text;
    if (take_number(&at, BAKE_MAX_PARTS, &options->part) && bake_args_take(&at, '/') &&
        take_number(&at, BAKE_MAX_PARTS, &options->parts) && *at == '\0' &&
        options->part <= options->parts)
        return 0;
    return cli_usage(cli, "--part: \"%s\" is not I/N, such as 3/64, with N to %d", text,
                     BAKE_MAX_PARTS);
}

static int parse_list(struct cli *cli, struct bake_arguments *arguments, const char *text)
{
    unsigned kind = 0;
    const int status = cli_parse_word(cli, "--list", text, "devices tiles", &kind);
    arguments->list_devices = kind == 0;
    arguments->list_tiles = kind == 1;
    return status;
}

static int bake_args_take_option(struct cli *cli, void *arg, const struct bsq_option *row,
                                 const char *text)
{
    struct bake_arguments *arguments = arg;
    struct bake_options *bake = &arguments->bake;
    const char *name = row->name;
    if (strcmp(name, "size") == 0)
        return parse_sizes(cli, text, bake);
    if (strcmp(name, "tiles") == 0)
        return parse_tiles(cli, text, bake);
    if (strcmp(name, "match") == 0) {
        bake->match_names = true;
        return strcmp(text, "name") == 0 ? 0 : parse_suffixes(cli, bake, text);
    }
    if (strcmp(name, "device") == 0) {
        bake->device = text;
        return bake_is_device_name(text)
                   ? 0
                   : cli_usage(cli, "--device: \"%s\" is not " BAKE_DEVICE_NAMES, text);
    }
    if (strcmp(name, "part") == 0)
        return parse_part(cli, text, bake);
    if (strcmp(name, "list") == 0)
        return parse_list(cli, arguments, text);
    return bake_maps_take(cli, arg, row, text);
}

/* ---- all of them ---- */

static const struct bsq_option list_rows[] = {
    {BSQ_ROW("list", "WHAT", "print the devices, or the UDIM tiles of a low-poly mesh, and exit"),
     .heading = "Instead of a bake", BSQ_OWN},
};
enum { LIST_ROWS = sizeof list_rows / sizeof *list_rows };

static const struct bsq_option cli_rows[] = {CLI_STRICT_ROW};

struct cli_table bake_arguments_table(const struct bake_arguments *arguments)
{
    struct cli_table table = {.options = (void *)(uintptr_t)&arguments->bake,
                              .given = (bool *)(uintptr_t)arguments->given};
    table.rows = bake_option_rows(&table.count);
    return table;
}

static int bake_args_check(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    const struct cli_table table = bake_arguments_table(arguments);
    const int count = arguments->file_count;
    if (arguments->list_devices)
        return count == 0 ? 0 : cli_usage(cli, "--list devices takes no files");
    if (arguments->list_tiles)
        return count > 0 ? 0 : cli_usage(cli, "--list tiles takes files: LOW.obj...");
    if (count < 2)
        return cli_usage(cli, "%d input file%s given, not two: SCAN.nvdb and LOW.obj (see --help)",
                         count, count == 1 ? "" : "s");
    if (bake->ao_falloff && bake->ao_distance <= 0)
        return cli_usage(cli, "--ao falloff=linear needs --distance ao=D");
    if (bake->part && cli_is_given(&table, "merge"))
        return cli_usage(cli, "--part and --merge exclude each other");
    if (bake->page_path && (bake->part || (bake->parts && bake->tile_range_count > 0)))
        return cli_usage(cli, "--report shows whole bakes: give it to --merge without --tiles");
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
                   {list_rows, LIST_ROWS, arguments, NULL},
                   {cli_rows, sizeof cli_rows / sizeof *cli_rows, cli, NULL}},
        .take = bake_args_take_option,
        .arguments = arguments,
    };
    bake_defaults(&arguments->bake);
    int status = cli_parse(cli, &command, argc, argv);
    arguments->files = argv + optind;
    arguments->file_count = argc - optind;
    return status != 0 ? status : bake_args_check(cli, arguments);
}

/* ---- which inputs are scans, and which are low-poly meshes ---- */

/* Writes the inputs that are scans, or those that are not, to `out`. Returns their number, or a
 * negative status. */
static int take_inputs(struct cli *cli, const struct bake_arguments *arguments, bool scans,
                       const char **out)
{
    int count = 0;
    for (int i = 0; i < arguments->file_count; i++) {
        enum fmt_kind kind;
        BSQ_PASS(fmt_recognise(cli->ctx, arguments->files[i], &kind));
        if ((kind == FMT_KIND_TRIS || kind == FMT_KIND_NVDB) == scans)
            out[count++] = arguments->files[i];
    }
    return count;
}

/* Points the options at sorted inputs. Without scans, the command of a bake lists its tiles. */
static int use_inputs(struct cli *cli, struct bake_arguments *arguments, int scans, int meshes)
{
    struct bake_options *bake = &arguments->bake;
    if (arguments->list_tiles && meshes == 0)
        return cli_usage(cli, "--list tiles takes files: LOW.obj...");
    if (!arguments->list_tiles && (scans == 0 || meshes == 0))
        return cli_usage(cli, "%d scan%s (.nvdb, .tris) and %d low-poly mesh%s given (see --help)",
                         scans, scans == 1 ? "" : "s", meshes, meshes == 1 ? "" : "es");
    if (scans > 0) {
        bake->scan_path = arguments->paths[0];
        bake->more_scan_paths = arguments->paths + 1;
        bake->more_scan_count = (uint32_t)scans - 1;
    }
    bake->mesh_path = arguments->paths[scans];
    bake->more_mesh_paths = arguments->paths + scans + 1;
    bake->more_mesh_count = (uint32_t)meshes - 1;
    return 0;
}

/* Refuses a low-poly mesh before its scan. */
static int refuse_order(struct cli *cli, char *const *files)
{
    enum fmt_kind kind;
    BSQ_PASS(fmt_recognise(cli->ctx, files[0], &kind));
    if (kind != FMT_KIND_MESH)
        return 0;
    BSQ_PASS(fmt_recognise(cli->ctx, files[1], &kind));
    if (kind == FMT_KIND_TRIS || kind == FMT_KIND_NVDB)
        return cli_usage(cli, "%s is a low-poly mesh, and %s a scan: swap them", files[0],
                         files[1]);
    return 0;
}

int bake_arguments_sort_inputs(struct cli *cli, struct bake_arguments *arguments)
{
    const int count = arguments->file_count;
    arguments->paths = cli_keep(((size_t)count + 1) * sizeof *arguments->paths);
    for (int i = 0; i < count; i++)
        if (strcmp(arguments->files[i], "-") == 0)
            return cli_usage(cli, "-: standard input is not read: scans and low-poly meshes must "
                                  "be files");
    if (count == 2 && !arguments->list_tiles) {
        BSQ_PASS(refuse_order(cli, arguments->files));
        arguments->paths[0] = arguments->files[0];
        arguments->paths[1] = arguments->files[1];
        return use_inputs(cli, arguments, 1, 1);
    }
    const int scans =
        arguments->list_tiles ? 0 : take_inputs(cli, arguments, true, arguments->paths);
    const int meshes =
        scans < 0 ? scans : take_inputs(cli, arguments, false, arguments->paths + scans);
    return meshes < 0 ? meshes : use_inputs(cli, arguments, scans, meshes);
}
