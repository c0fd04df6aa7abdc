/* voxelize_arguments.c - see voxelize_arguments.h. */
#include "tools/voxelize_arguments.h"

#include "base/channels.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const char help[] =
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
    "file (SCAN.tris), which makes grids of other resolutions without reading them again.\n"
    "\n"
    "  -o, --output FILE       the grid, a NanoVDB file; a name that ends in .tris sorts only\n"
    "      --resolution N      voxels along the scan's longest side (default: 2048)\n"
    "      --voxel-size X      edge of a voxel in the scan's units, instead of a resolution\n"
    "      --grid-type TYPE    mask or onindex (NanoVDB 32.6 and later) (default: mask)\n"
    "      --scan-normals NAME for a scan without normals: smooth, flat; or smooth ones by weight:\n"
    "                          area, angle or max (default: smooth, which is area)\n"
    "      --channels LIST     what else to keep in chunks and grid: id; and for maps\n"
    "                          transfer:NAME, NAME of the materials or NAME=FILE\n"
    "      --scan-normal-map FILE\n"
    "                          the scan's own normal map in tangent space, added to its normals\n"
    "      --id KIND           what ids tell apart: material, object or color (default: material)\n"
    "      --vdb FILE          also write the grid as an OpenVDB file\n"
    "      --texture FILE      colours for a scan with texture coordinates but no MTL file\n"
    "      --scale X           multiply the scan's positions by X\n"
    "      --up AXIS           turn the scan so that y or z points upwards\n"
    "      --translate X,Y,Z   then shift the scan; these three options, given once, are for all\n"
    "                          files; given once for each file, they are for the files in order\n"
    "      --tris FILE         name of the chunk file (default: the output's, ending in .tris)\n"
    "      --no-tris           do not keep the chunk file\n"
    "      --parse-only        only read the mesh files, to measure the reader\n"
    "      --tasks N           with --write-plan: divide the grid into N tasks\n"
    "      --write-plan FILE   write a plan of the tasks, and make no grid\n"
    "      --plan FILE         take inputs, output and options from a plan\n"
    "                          alone: print how many tasks it has, and what each needs\n"
    "      --task I | I-J      make the voxels of task I, or I to J, from 0 on, into part files\n"
    "      --merge             write the grid from all parts of the plan\n"
    "      --force             do it again if the part, the grid or the sorted scan is there already\n"
    "      --resume            continue the same job from its chunk file, if that is complete\n"
    "      --tmpdir DIR        directory for temporary files (default: $TMPDIR, else the output's)\n" CLI_VERIFY_HELP
        CLI_STRICT_HELP CLI_COMMON_HELP;

enum {
    OPT_RESOLUTION = CLI_TASKS_END,
    OPT_VOXEL_SIZE,
    OPT_GRID_TYPE,
    OPT_SCAN_NORMALS,
    OPT_CHANNELS,
    OPT_SCAN_NORMAL_MAP,
    OPT_ID,
    OPT_VDB,
    OPT_TEXTURE,
    OPT_TRIS,
    OPT_NO_TRIS,
    OPT_PARSE_ONLY,
    OPT_RESUME,
    OPT_SCALE,
    OPT_UP,
    OPT_TRANSLATE
};

static const struct option long_options[] = {
    {"output", required_argument, NULL, 'o'},
    {"resolution", required_argument, NULL, OPT_RESOLUTION},
    {"voxel-size", required_argument, NULL, OPT_VOXEL_SIZE},
    {"grid-type", required_argument, NULL, OPT_GRID_TYPE},
    {"scan-normals", required_argument, NULL, OPT_SCAN_NORMALS},
    {"channels", required_argument, NULL, OPT_CHANNELS},
    {"scan-normal-map", required_argument, NULL, OPT_SCAN_NORMAL_MAP},
    {"id", required_argument, NULL, OPT_ID},
    {"vdb", required_argument, NULL, OPT_VDB},
    {"texture", required_argument, NULL, OPT_TEXTURE},
    {"tris", required_argument, NULL, OPT_TRIS},
    {"no-tris", no_argument, NULL, OPT_NO_TRIS},
    {"parse-only", no_argument, NULL, OPT_PARSE_ONLY},
    CLI_TMPDIR_OPTION,
    {"resume", no_argument, NULL, OPT_RESUME},
    {"scale", required_argument, NULL, OPT_SCALE},
    {"up", required_argument, NULL, OPT_UP},
    {"translate", required_argument, NULL, OPT_TRANSLATE},
    CLI_TASKS_OPTIONS,
    CLI_VERIFY_OPTION,
    CLI_STRICT_OPTION,
    CLI_COMMON_OPTIONS,
    {NULL, 0, NULL, 0},
};

static int parse_grid_type(struct cli *cli, struct voxelize_arguments *arguments)
{
    static const char *const words[] = {"mask", "onindex", NULL};
    unsigned type = 0;
    int status = cli_parse_word(cli, "--grid-type", optarg, words, &type);
    if (status == 0)
        arguments->grid_type = type == 0 ? VOX_GRID_MASK : VOX_GRID_ONINDEX;
    return status;
}

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

static int parse_scale(struct cli *cli, struct voxelize_arguments *a)
{
    int status = add_element(cli, &a->scales, a->scale_count, sizeof *a->scales);
    return status ? status
                  : cli_parse_length(cli, "--scale", optarg, true, &a->scales[a->scale_count++]);
}

static int parse_up(struct cli *cli, struct voxelize_arguments *a)
{
    static const char *const words[] = {"y", "z", NULL};
    unsigned axis = 0;
    int status = add_element(cli, &a->ups, a->up_count, sizeof *a->ups);
    if (status == 0)
        status = cli_parse_word(cli, "--up", optarg, words, &axis);
    if (status == 0)
        a->ups[a->up_count++] = axis == 0 ? VOX_UP_Y : VOX_UP_Z;
    return status;
}

static int parse_translation(struct cli *cli, struct voxelize_arguments *a)
{
    int status = add_element(cli, &a->translations, a->translation_count, sizeof *a->translations);
    char *end = optarg;
    const bool decimal = strspn(optarg, "0123456789.eE+-,") == strlen(optarg);
    for (int axis = 0; axis < 3 && status == 0; axis++) {
        const char *from = end;
        double value = strtod(from, &end);
        if (!decimal || end == from || !isfinite(value) || *end != (axis < 2 ? ',' : '\0'))
            return cli_usage(cli, "--translate: \"%s\" is not of the form X,Y,Z", optarg);
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
static int parse_channels(struct cli *cli, struct voxelize_arguments *arguments)
{
    char *list = strdup(optarg), *rest = list, *word;
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

static int parse_ids(struct cli *cli, struct voxelize_arguments *arguments)
{
    static const char *const words[] = {"material", "object", "color", NULL};
    unsigned kind = 0;
    int status = cli_parse_word(cli, "--id", optarg, words, &kind);
    if (status == 0)
        arguments->ids = (enum vox_ids)(VOX_IDS_MATERIAL + kind);
    return status;
}

/* Returns whether an option does nothing if no grid is made. */
static bool is_of_grid(int option)
{
    return option == OPT_RESOLUTION || option == OPT_VOXEL_SIZE || option == OPT_GRID_TYPE ||
           option == OPT_SCAN_NORMALS || option == OPT_VDB || option == OPT_TRIS ||
           option == OPT_NO_TRIS;
}

/* Returns the name of an option without its dashes. */
static const char *name_of(int option)
{
    const struct option *o = long_options;
    while (o->name && o->val != option)
        o++;
    return o->name ? o->name : "";
}

static int parse_option(struct cli *cli, void *arg, int option)
{
    struct voxelize_arguments *arguments = arg;
    const int status = cli_tasks_option(cli, &arguments->farm, option);
    if (status <= 0)
        return status;
    if (option >= CLI_TASKS_END || option == 'o')
        arguments->work_option = name_of(option);
    if (is_of_grid(option))
        arguments->grid_option = name_of(option);
    switch (option) {
    case 'o':
        arguments->output = optarg;
        return 0;
    case OPT_RESOLUTION:
        return cli_parse_count(cli, "--resolution", optarg, 1, VOX_RESOLUTION_MAX,
                               &arguments->resolution);
    case OPT_VOXEL_SIZE:
        return cli_parse_length(cli, "--voxel-size", optarg, true, &arguments->voxel_size);
    case OPT_GRID_TYPE:
        return parse_grid_type(cli, arguments);
    case OPT_SCAN_NORMALS:
        return cli_parse_scan_normals(cli, optarg, &arguments->scan_normals);
    case OPT_CHANNELS:
        return parse_channels(cli, arguments);
    case OPT_SCAN_NORMAL_MAP:
        arguments->scan_normal_map = optarg;
        return 0;
    case OPT_ID:
        return parse_ids(cli, arguments);
    case OPT_VDB:
        arguments->vdb = optarg;
        return 0;
    case OPT_TEXTURE:
        arguments->texture = optarg;
        return 0;
    case OPT_TRIS:
        arguments->tris = optarg;
        return 0;
    case OPT_NO_TRIS:
        arguments->no_tris = true;
        return 0;
    case OPT_PARSE_ONLY:
        arguments->parse_only = true;
        return 0;
    case OPT_SCALE:
        return parse_scale(cli, arguments);
    case OPT_UP:
        return parse_up(cli, arguments);
    case OPT_TRANSLATE:
        return parse_translation(cli, arguments);
    case OPT_RESUME:
        arguments->resume = true;
        return 0;
    default:
        return cli_common_option(cli, option, help);
    }
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
    if (cli_tasks_check(cli, farm, arguments->work_option, (int)arguments->input_count) < 0)
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
    if (arguments->sort_only && arguments->grid_option)
        return cli_usage(cli, "%s: a chunk file is not a grid: leave out --%s", arguments->output,
                         arguments->grid_option);
    if (arguments->resume && (arguments->no_tris || arguments->parse_only))
        return cli_usage(cli, "--resume continues from a chunk file: leave out %s",
                         arguments->no_tris ? "--no-tris" : "--parse-only");
    return 0;
}

int voxelize_arguments_parse(struct cli *cli, struct voxelize_arguments *arguments, int argc,
                             char **argv)
{
    int status = cli_parse_options(cli, argc, argv, long_options, parse_option, arguments);
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
