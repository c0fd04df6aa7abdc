/* voxelize_arguments.c - see voxelize_arguments.h. */
#include "tools/voxelize_arguments.h"

#include "base/channels.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static const char usage[] =
    "Usage: bisque-voxelize [OPTION]... SCAN.obj... -o SCAN.nvdb\n"
    "       bisque-voxelize [OPTION]... SCAN.tris... -o SCAN.nvdb\n"
    "       bisque-voxelize [OPTION]... SCAN.obj... -o SCAN.tris\n"
    "       bisque-voxelize [OPTION]... SCAN.tris... -o SCAN.nvdb --tasks N --write-plan PLAN\n"
    "       bisque-voxelize --plan PLAN --task I\n"
    "       bisque-voxelize --plan PLAN --merge\n"
    "       bisque-voxelize --plan PLAN\n"
    "       bisque-voxelize --verify FILE...\n"
    "Turns a scan (a high-poly mesh) of any size into a sparse grid of surface voxels with normals\n"
    "and colours. Several files are read as one scan. The sorted triangles of meshes are kept in a chunk\n"
    "file (SCAN.tris), which makes grids of other resolutions without reading them again.\n";

/* Bit of bsq_option.needs: the option does nothing if no grid is made. */
enum { GRID = 1 };

#define OPTION(name_, argument_, help_) .name = name_, .argument = argument_, .help = help_
#define MEMBER(kind, member)            BSQ_MEMBER(kind, struct voxelize_arguments, member)
#define OWN                             .own_syntax = true, .kind = BSQ_OPTION_NONE

static const struct bsq_option rows[] = {
    {OPTION("output", "FILE", "the grid, a NanoVDB file; a name that ends in .tris sorts only"),
     .letter = 'o', .heading = "Grid", MEMBER(OUTPUT, output)},
    {OPTION("resolution", "N", "voxels along the scan's longest side (default: 2048)"),
     MEMBER(COUNT, resolution), BSQ_RANGE(1, VOX_RESOLUTION_MAX, 0), .needs = GRID},
    {OPTION("voxel-size", "X",
            "edge of a voxel in the scan's units, instead of a resolution\n"
            "(default: by the resolution)"),
     MEMBER(NUMBER, voxel_size), BSQ_RANGE(0, DBL_MAX, 0), .positive = true, .needs = GRID},
    {OPTION("grid-type", "TYPE", "mask or onindex (NanoVDB 32.6 and later)"),
     MEMBER(CHOICE, grid_type), .words = "mask onindex", .needs = GRID},
    {OPTION("vdb", "FILE", "also write the grid as an OpenVDB file"), MEMBER(OUTPUT, vdb),
     .needs = GRID},

    {OPTION("scan-normals", "NAME",
            "for a scan without normals: smooth, flat; or smooth ones by\n"
            "weight: area, angle or max (default: smooth, which is area)"),
     .heading = "Scan", MEMBER(CHOICE, scan_normals), .words = "smooth/area angle max flat",
     .needs = GRID},
    {OPTION("channels", "LIST",
            "what else to keep in chunks and grid: id; and for maps\n"
            "transfer:NAME, NAME of the materials or NAME=FILE"),
     OWN},
    {OPTION("scan-normal-map", "FILE",
            "the scan's own normal map in tangent space, added to its normals"),
     MEMBER(INPUT, scan_normal_map)},
    {OPTION("id", "KIND", "what ids tell apart: material, object or color (default: material)"),
     MEMBER(CHOICE, ids), .words = "none material object color"},
    {OPTION("texture", "FILE", "colours for a scan with texture coordinates but no MTL file"),
     MEMBER(INPUT, texture)},
    {OPTION("scale", "X", "multiply the scan's positions by X"), .own_syntax = true,
     MEMBER(NUMBER, scale), BSQ_RANGE(0, DBL_MAX, 1), .positive = true},
    {OPTION("up", "AXIS", "turn the scan so that y or z points upwards"), OWN},
    {OPTION("translate", "X,Y,Z",
            "then shift the scan; these three options, given once, are for all\n"
            "files; given once for each file, they are for the files in order"),
     OWN},

    {OPTION("tris", "FILE", "name of the chunk file (default: the output's, ending in .tris)"),
     .heading = "Chunk file", MEMBER(OUTPUT, tris), .needs = GRID},
    {OPTION("no-tris", NULL, "do not keep the chunk file"), MEMBER(FLAG, no_tris), .needs = GRID},
    {OPTION("resume", NULL, "continue the same job from its chunk file, if that is complete"),
     MEMBER(FLAG, resume)},
    {OPTION("parse-only", NULL, "only read the mesh files, to measure the reader"),
     MEMBER(FLAG, parse_only)},
};
enum { ROWS = sizeof rows / sizeof *rows };
_Static_assert(sizeof rows / sizeof *rows <= VOXELIZE_MOST_ROWS, "a flag for each row");

static const struct bsq_option cli_rows[] = {CLI_TMPDIR_ROW, CLI_STRICT_ROW, CLI_VERIFY_ROW};

/* ---- where files lie ---- */

/* Makes space for one more element. */
static int add_element(struct cli *cli, void *array, uint32_t count, size_t size)
{
    void *old, *grown;
    memcpy(&old, array, sizeof old);
    grown = reallocarray(old, count + 1, size);
    if (!grown)
        return cli_usage(cli, "no memory for the arguments");
    memcpy(array, &grown, sizeof grown);
    /* cppcheck-suppress memleak; the copied pointer owns it */
    return 0;
}

static int parse_scale(struct cli *cli, struct voxelize_arguments *a, const struct bsq_option *row,
                       const char *text)
{
    int status = add_element(cli, &a->scales, a->scale_count, sizeof *a->scales);
    if (status == 0)
        status = cli_parse_value(cli, "--scale", row, text, a);
    if (status == 0)
        a->scales[a->scale_count++] = a->scale;
    return status;
}

static int parse_up(struct cli *cli, struct voxelize_arguments *a, const char *text)
{
    unsigned axis = 0;
    int status = add_element(cli, &a->ups, a->up_count, sizeof *a->ups);
    if (status == 0)
        status = cli_parse_word(cli, "--up", text, "y z", &axis);
    if (status == 0)
        a->ups[a->up_count++] = axis == 0 ? VOX_UP_Y : VOX_UP_Z;
    return status;
}

static int parse_translation(struct cli *cli, struct voxelize_arguments *a, const char *text)
{
    int status = add_element(cli, &a->translations, a->translation_count, sizeof *a->translations);
    const char *end = text;
    const bool decimal = strspn(text, "0123456789.eE+-,") == strlen(text);
    for (int axis = 0; axis < 3 && status == 0; axis++) {
        const char *from = end;
        char *after;
        double value = strtod(from, &after);
        end = after;
        if (!decimal || end == from || !isfinite(value) || *end != (axis < 2 ? ',' : '\0'))
            return cli_usage(cli, "--translate: \"%s\" is not of the form X,Y,Z", text);
        a->translations[a->translation_count][axis] = value;
        end += axis < 2;
    }
    a->translation_count += status == 0;
    return status;
}

static int check_number(struct cli *cli, const char *option, uint32_t given, uint32_t inputs)
{
    if (given <= 1 || given == inputs)
        return 0;
    return cli_usage(cli, "%s is given %u times for %u file%s: give it once, or once for each file",
                     option, given, inputs, inputs == 1 ? "" : "s");
}

/* Turns the options into a placement for each file. */
static int make_placements(struct cli *cli, struct voxelize_arguments *a)
{
    int status = check_number(cli, "--scale", a->scale_count, a->input_count);
    if (status == 0)
        status = check_number(cli, "--up", a->up_count, a->input_count);
    if (status == 0)
        status = check_number(cli, "--translate", a->translation_count, a->input_count);
    if (status < 0 || a->scale_count + a->up_count + a->translation_count == 0)
        return status;
    a->placements = calloc(a->input_count, sizeof *a->placements);
    if (!a->placements)
        return cli_usage(cli, "no memory for the arguments");
    for (uint32_t i = 0; i < a->input_count; i++) {
        struct vox_placement *p = &a->placements[i];
        p->scale = a->scale_count ? a->scales[a->scale_count > 1 ? i : 0] : 1.0;
        p->up = a->up_count ? a->ups[a->up_count > 1 ? i : 0] : VOX_UP_KEEP;
        if (a->translation_count)
            memcpy(p->translate, a->translations[a->translation_count > 1 ? i : 0],
                   sizeof p->translate);
    }
    return 0;
}

int voxelize_arguments_map_inputs(struct cli *cli, struct voxelize_arguments *arguments)
{
    const struct cli_table table = {rows, ROWS, arguments, NULL};
    const char **inputs = (const char **)(uintptr_t)arguments->inputs;
    int status = cli_map_inputs(cli, &table);
    if (status < 0)
        return status;
    BSQ_TRY(cli_map_input(cli, &arguments->farm.plan));
    for (uint32_t i = 0; i < arguments->channel_count; i++)
        BSQ_TRY(cli_map_input(cli, &arguments->channels[i].texture_path));
    for (uint32_t i = 0; i < arguments->input_count; i++)
        BSQ_TRY(cli_map_input(cli, &inputs[i]));
done:
    return status;
}

void voxelize_arguments_free(struct voxelize_arguments *arguments)
{
    free(arguments->scales);
    free(arguments->ups);
    free(arguments->translations);
    free(arguments->placements);
    for (uint32_t i = 0; i < arguments->channel_count; i++)
        free((void *)(uintptr_t)arguments->channels[i].name);
    free(arguments->channels);
    free(arguments->channel_list);
}

/* ---- options ---- */

/* Adds a name to the channels that the grid gets. */
static int add_to_list(struct cli *cli, struct voxelize_arguments *arguments, const char *name)
{
    char *old = arguments->channel_list;
    if (asprintf(&arguments->channel_list, "%s%s%s", old ? old : "", old ? "," : "", name) < 0)
        arguments->channel_list = NULL;
    free(old);
    return arguments->channel_list ? 0 : cli_usage(cli, "no memory for the arguments");
}

/* Adds a channel "NAME" or "NAME=FILE". */
static int add_channel(struct cli *cli, struct voxelize_arguments *arguments, const char *word)
{
    char *name = strdup(word), *equals = name ? strchr(name, '=') : NULL;
    struct vox_channel *grown =
        realloc(arguments->channels, (arguments->channel_count + UINT64_C(1)) * sizeof *grown);
    if (grown)
        arguments->channels = grown;
    if (!name || !grown) {
        free(name);
        return cli_usage(cli, "no memory for the arguments");
    }
    if (equals)
        *equals = '\0';
    grown[arguments->channel_count++] = (struct vox_channel){name, equals ? equals + 1 : NULL};
    if (strcmp(name, BSQ_CHANNEL_NORMAL_MAP) != 0 && add_to_list(cli, arguments, name) < 0)
        return BSQ_EUSAGE;
    if (!bsq_is_channel_name(name))
        return cli_usage(cli, "--channels: \"%s\" is not a channel", word);
    if (bsq_is_map_name(name))
        return cli_usage(cli, "--channels: \"%s\": there is a map of this name", word);
    return equals && equals[1] == '\0' ? cli_usage(cli, "--channels: \"%s\" names no file", word)
                                       : 0;
}

/* Parses the names of channels. Paths of images must not have commas. */
static int parse_channels(struct cli *cli, struct voxelize_arguments *arguments, const char *text)
{
    char *list = strdup(text), *rest = list, *word;
    int status = list ? 0 : cli_usage(cli, "no memory for the arguments");
    while (status == 0 && (word = strsep(&rest, ","))) {
        if (strcmp(word, "id") == 0)
            arguments->channel_ids = true;
        else
            status = add_channel(cli, arguments, word);
    }
    free(list);
    return status;
}

static int take_option(struct cli *cli, void *arg, const struct bsq_option *row, const char *text)
{
    struct voxelize_arguments *arguments = arg;
    if (strcmp(row->name, "channels") == 0)
        return parse_channels(cli, arguments, text);
    if (strcmp(row->name, "scale") == 0)
        return parse_scale(cli, arguments, row, text);
    if (strcmp(row->name, "up") == 0)
        return parse_up(cli, arguments, text);
    if (strcmp(row->name, "translate") == 0)
        return parse_translation(cli, arguments, text);
    return cli_tasks_parse_range(cli, &arguments->farm, text);
}

/* Returns the name of an option that was given and has one of these bits in `needs`; 0: of any
 * option. NULL: none was. */
static const char *given_option(const struct voxelize_arguments *arguments, uint32_t needs)
{
    for (unsigned i = 0; i < ROWS; i++)
        if (arguments->given[i] && (needs == 0 || rows[i].needs & needs))
            return rows[i].name;
    return NULL;
}

bool voxelize_keeps_normal_map(const struct voxelize_arguments *arguments)
{
    bool any = false;
    for (uint32_t i = 0; i < arguments->channel_count; i++)
        any |= strcmp(arguments->channels[i].name, BSQ_CHANNEL_NORMAL_MAP) == 0;
    return any;
}

static int check_arguments(struct cli *cli, const struct voxelize_arguments *arguments)
{
    const struct cli_tasks *farm = &arguments->farm;
    if (arguments->input_count == 0 && !farm->plan)
        return cli_usage(cli, "no input file given (see --help)");
    if (cli->verify)
        return 0;
    if (cli_tasks_check(cli, farm, given_option(arguments, 0), (int)arguments->input_count) < 0)
        return BSQ_EUSAGE;
    if (farm->plan)
        return 0;
    if (farm->write_plan && (arguments->parse_only || arguments->sort_only))
        return cli_usage(cli, "a plan is for a grid: leave out %s",
                         arguments->parse_only ? "--parse-only" : "the chunk file as output");
    if (arguments->parse_only && arguments->output)
        return cli_usage(cli, "--parse-only writes nothing: leave out --output");
    if (arguments->parse_only &&
        arguments->scale_count + arguments->up_count + arguments->translation_count > 0)
        return cli_usage(cli, "--parse-only only reads: leave out --scale, --up and --translate");
    if (!arguments->parse_only && !arguments->output)
        return cli_usage(cli, "no output given: add -o FILE.nvdb");
    if (arguments->resolution > 0 && arguments->voxel_size > 0)
        return cli_usage(cli, "--resolution and --voxel-size exclude each other");
    if (arguments->ids != VOX_IDS_NONE && !arguments->channel_ids)
        return cli_usage(cli, "--id needs --channels id");
    if (arguments->scan_normal_map && voxelize_keeps_normal_map(arguments))
        return cli_usage(cli, "--scan-normal-map and --channels " BSQ_CHANNEL_NORMAL_MAP
                              " exclude each other");
    if (arguments->tris && arguments->no_tris)
        return cli_usage(cli, "--tris and --no-tris exclude each other");
    if (arguments->sort_only && given_option(arguments, GRID))
        return cli_usage(cli, "%s: a chunk file is not a grid: leave out --%s", arguments->output,
                         given_option(arguments, GRID));
    if (arguments->resume && (arguments->no_tris || arguments->parse_only))
        return cli_usage(cli, "--resume continues from a chunk file: leave out %s",
                         arguments->no_tris ? "--no-tris" : "--parse-only");
    return 0;
}

int voxelize_arguments_parse(struct cli *cli, struct voxelize_arguments *arguments, int argc,
                             char **argv)
{
    const struct cli_command command = {
        .usage = usage,
        .tables = {{rows, ROWS, arguments, arguments->given},
                   {cli_task_rows, CLI_TASK_ROWS, &arguments->farm, NULL},
                   {cli_rows, sizeof cli_rows / sizeof *cli_rows, cli, NULL}},
        .take = take_option,
        .arguments = arguments,
    };
    bsq_options_defaults(rows, ROWS, arguments);
    int status = cli_parse(cli, &command, argc, argv);
    arguments->inputs = (const char *const *)argv + optind;
    arguments->input_count = (uint32_t)(argc - optind);
    arguments->sort_only = arguments->output && cli_ends_with(arguments->output, ".tris");
    arguments->farm.alone = arguments->sort_only;
    if (status == 0)
        status = check_arguments(cli, arguments);
    if (status == 0 && arguments->input_count > 0)
        status = make_placements(cli, arguments);
    struct vox_voxelize_options defaults;
    vox_voxelize_defaults(&defaults);
    if (status == 0 && arguments->resolution == 0 && arguments->voxel_size == 0)
        arguments->resolution = defaults.resolution;
    return status;
}
