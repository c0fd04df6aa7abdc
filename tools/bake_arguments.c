/* bake_arguments.c - see bake_arguments.h. */
#include "tools/bake_arguments.h"

#include <stdlib.h>
#include <string.h>

#include "tools/bake_tiles.h"

static const char help_format[] =
    "Usage: bisque-bake [OPTION]... SCAN.nvdb LOW.obj... -o OUT_<MAP>.exr\n"
    "       bisque-bake [OPTION]... SCAN.tris LOW.obj... -o OUT_<MAP>.exr\n"
    "       bisque-bake [OPTION]... SCAN.nvdb LOW.obj -o OUT_<MAP>.exr --tasks N --write-plan PLAN\n"
    "       bisque-bake --plan PLAN --task I\n"
    "       bisque-bake --plan PLAN --merge\n"
    "       bisque-bake --plan PLAN\n"
    "       bisque-bake --list-tiles LOW.obj...\n"
    "       bisque-bake --verify FILE...\n"
    "Bakes the normals and colours of a scan into texture maps of a low-poly mesh: fast from a\n"
    "voxel grid (SCAN.nvdb), or exactly from the scan's own triangles (SCAN.tris).\n"
    "<MAP> in the output's name is replaced by the name of the map, <UDIM> by the number of the tile,\n"
    "<UVTILE> by u1_v1 and so on, <OBJECT> and <MATERIAL> by names in the low-poly meshes, which then\n"
    "have maps of their own. A name that ends in .exr gives OpenEXR files, one that ends in .png PNG\n"
    "files.\n"
    "\n"
    "  -o, --output FILE       the maps; must contain \"<MAP>\" if there are several\n"
    "      --maps LIST         the maps to bake, separated by commas:\n"
    "%s"
    "      --texture NAME=FILE the scan's image for transfer:NAME\n"
    "      --mask-opacity      multiply the mask by the scan's opacity\n"
    "      --size N | WxH      texels (default: 2048); by UDIM tile: 1001=4096,*=2048\n"
    "      --tiles LIST        UDIM tiles to bake, such as 1001-1003,1011 (default: all in use)\n"
    "      --samples N         N x N pairs of rays a texel (default: 2)\n"
    "      --front D           length of the rays outwards, in the mesh's units (default: auto)\n"
    "      --back D            length of the rays inwards (default: auto)\n"
    "      --height-range D    height of white in PNG files (default: the largest of the mesh)\n"
    "      --position-in SHAPE sphere or box around the scan, for PNG files (default: sphere)\n"
    "      --curvature-radius D  distance around a hit for curvature (default: 2 texels)\n"
    "      --curvature-range C   curvature of white in PNG files (default: by the whole mesh)\n"
    "      --cage FILE         start rays at this mesh, with the vertices and faces of LOW.obj\n"
    "      --skew FILE         grey map: white turns rays towards the faces' normals\n"
    "      --match name        objects see only scans with their names: body_low sees body_high.nvdb\n"
    "      --match-suffixes LOW,HIGH\n"
    "                          endings of these names (default: _low,_high)\n"
    "      --ray-directions D  smooth, mesh (its normals) or face (default: smooth)\n"
    "      --max-missed P      exit with 1 if more than P %% of the samples find no surface\n"
    "      --ao-rays N         rays from each hit for ao and bent (default: 64)\n"
    "      --ao-distance D     their length (default: none, they reach everything)\n"
    "      --ao-spread DEG     angle of their cone, to 180 degrees (default: 180)\n"
    "      --ao-falloff MODE   none or linear: far surfaces hide less (default: none)\n"
    "      --ao-coarse N       in grids, voxels hide as a whole from N voxels on (default: 64; none)\n"
    "      --thickness-rays N  rays from each hit for thickness (default: 64)\n"
    "      --thickness-distance D\n"
    "                          their length, white in PNG files (default: the scan's diagonal)\n"
    "      --two-sided         also hit surfaces that face away from the low-poly mesh\n"
    "      --sampling MODE     trilinear or nearest, for grids (default: trilinear)\n"
    "      --scan-normals NAME for triangles without normals: smooth, flat; or smooth ones by\n"
    "                          weight: area, angle or max (default: smooth, which is area)\n"
    "      --scan-normal-map FILE\n"
    "                          add a tangent-space map to the scan's normals, for triangles\n"
    "      --normal-space SPC  tangent (MikkTSpace) or object (default: tangent)\n"
    "      --green DIR         up (OpenGL) or down (Direct3D), for tangent space (default: up)\n"
    "      --padding N         texels to fill around each chart; all: everywhere (default: 16)\n"
    "      --half, --float     type of OpenEXR samples (default: half for most maps)\n"
    "      --exr-tiles N       make OpenEXR files of tiles of N x N texels (default: of lines)\n"
    "      --png-bits N        8 (dithered) or 16 (default: 16)\n"
    "      --preview FILE.png  a picture of the low-poly mesh, the baked mesh and the scan\n"
    "      --preview-views N   views around the mesh (default: 4)\n"
    "      --up AXIS           the preview's vertical axis: y, z or auto (default: auto)\n"
    "      --device NAME       " BAKE_DEVICE_NAMES " (default: auto)\n"
    "      --gpu-memory SIZE   most memory of a GPU to use, e.g. 2G (default: what is free)\n"
    "      --tasks N           with --write-plan: divide the bake into N tasks\n"
    "      --write-plan FILE   write a plan of the tasks, and bake nothing\n"
    "      --plan FILE         take inputs, output and options from a plan\n"
    "                          alone: print how many tasks it has, and what each needs\n"
    "      --task I | I-J      bake task I, or I to J, of the plan, from 0 on, into part files\n"
    "      --merge             write the maps from all parts of the plan\n"
    "      --force             do it again if the part or the maps are there already\n"
    "      --list-devices      print the devices and exit\n"
    "      --list-tiles        print the UDIM tiles of a low-poly mesh and exit\n" CLI_VERIFY_HELP
        CLI_STRICT_HELP CLI_COMMON_HELP;

enum {
    OPT_MAPS = CLI_TASKS_END,
    OPT_TEXTURE,
    OPT_MASK_OPACITY,
    OPT_SIZE,
    OPT_TILES,
    OPT_SAMPLES,
    OPT_FRONT,
    OPT_BACK,
    OPT_HEIGHT_RANGE,
    OPT_POSITION_IN,
    OPT_CURVATURE_RADIUS,
    OPT_CURVATURE_RANGE,
    OPT_CAGE,
    OPT_SKEW,
    OPT_SCAN_NORMAL_MAP,
    OPT_MATCH,
    OPT_MATCH_SUFFIXES,
    OPT_RAY_DIRECTIONS,
    OPT_MAX_MISSED,
    OPT_AO_RAYS,
    OPT_AO_DISTANCE,
    OPT_AO_SPREAD,
    OPT_AO_FALLOFF,
    OPT_AO_COARSE,
    OPT_THICKNESS_RAYS,
    OPT_THICKNESS_DISTANCE,
    OPT_TWO_SIDED,
    OPT_SAMPLING,
    OPT_SCAN_NORMALS,
    OPT_NORMAL_SPACE,
    OPT_GREEN,
    OPT_PADDING,
    OPT_HALF,
    OPT_FLOAT,
    OPT_EXR_TILES,
    OPT_PNG_BITS,
    OPT_PREVIEW,
    OPT_PREVIEW_VIEWS,
    OPT_UP,
    OPT_DEVICE,
    OPT_GPU_MEMORY,
    OPT_LIST_DEVICES,
    OPT_LIST_TILES
};
_Static_assert(OPT_LIST_TILES - CLI_TASKS_END < 64, "a bit of `given` for each option");

static const struct option long_options[] = {
    {"output", required_argument, NULL, 'o'},
    {"maps", required_argument, NULL, OPT_MAPS},
    {"texture", required_argument, NULL, OPT_TEXTURE},
    {"mask-opacity", no_argument, NULL, OPT_MASK_OPACITY},
    {"size", required_argument, NULL, OPT_SIZE},
    {"tiles", required_argument, NULL, OPT_TILES},
    {"samples", required_argument, NULL, OPT_SAMPLES},
    {"front", required_argument, NULL, OPT_FRONT},
    {"back", required_argument, NULL, OPT_BACK},
    {"height-range", required_argument, NULL, OPT_HEIGHT_RANGE},
    {"position-in", required_argument, NULL, OPT_POSITION_IN},
    {"curvature-radius", required_argument, NULL, OPT_CURVATURE_RADIUS},
    {"curvature-range", required_argument, NULL, OPT_CURVATURE_RANGE},
    {"cage", required_argument, NULL, OPT_CAGE},
    {"skew", required_argument, NULL, OPT_SKEW},
    {"match", required_argument, NULL, OPT_MATCH},
    {"match-suffixes", required_argument, NULL, OPT_MATCH_SUFFIXES},
    {"ray-directions", required_argument, NULL, OPT_RAY_DIRECTIONS},
    {"max-missed", required_argument, NULL, OPT_MAX_MISSED},
    {"ao-rays", required_argument, NULL, OPT_AO_RAYS},
    {"ao-distance", required_argument, NULL, OPT_AO_DISTANCE},
    {"ao-spread", required_argument, NULL, OPT_AO_SPREAD},
    {"ao-falloff", required_argument, NULL, OPT_AO_FALLOFF},
    {"ao-coarse", required_argument, NULL, OPT_AO_COARSE},
    {"thickness-rays", required_argument, NULL, OPT_THICKNESS_RAYS},
    {"thickness-distance", required_argument, NULL, OPT_THICKNESS_DISTANCE},
    {"two-sided", no_argument, NULL, OPT_TWO_SIDED},
    {"sampling", required_argument, NULL, OPT_SAMPLING},
    {"scan-normals", required_argument, NULL, OPT_SCAN_NORMALS},
    {"scan-normal-map", required_argument, NULL, OPT_SCAN_NORMAL_MAP},
    {"normal-space", required_argument, NULL, OPT_NORMAL_SPACE},
    {"green", required_argument, NULL, OPT_GREEN},
    {"padding", required_argument, NULL, OPT_PADDING},
    {"half", no_argument, NULL, OPT_HALF},
    {"float", no_argument, NULL, OPT_FLOAT},
    {"exr-tiles", required_argument, NULL, OPT_EXR_TILES},
    {"png-bits", required_argument, NULL, OPT_PNG_BITS},
    {"preview", required_argument, NULL, OPT_PREVIEW},
    {"preview-views", required_argument, NULL, OPT_PREVIEW_VIEWS},
    {"up", required_argument, NULL, OPT_UP},
    {"device", required_argument, NULL, OPT_DEVICE},
    {"gpu-memory", required_argument, NULL, OPT_GPU_MEMORY},
    {"list-devices", no_argument, NULL, OPT_LIST_DEVICES},
    {"list-tiles", no_argument, NULL, OPT_LIST_TILES},
    CLI_TASKS_OPTIONS,
    CLI_VERIFY_OPTION,
    CLI_STRICT_OPTION,
    CLI_COMMON_OPTIONS,
    {NULL, 0, NULL, 0},
};

/* ---- one option ---- */

/* A word of --maps: the name of a map, another name, or "all". */
struct map_word {
    const char *name, *summary;
    uint32_t maps;
};

enum { MOST_MAP_WORDS = 2 * MOST_MAPS + 1 };

static const char transfer_word[] = "transfer:NAME";

/* Lists the words; returns their number. */
static unsigned list_map_words(struct map_word words[MOST_MAP_WORDS])
{
    unsigned count = 0;
    for (unsigned i = 0; bake_map_name(i); i++)
        words[count++] = (struct map_word){bake_map_name(i), bake_map_summary(i), 1u << i};
    for (unsigned i = 0; bake_map_name(i); i++)
        if (bake_map_alias(i))
            words[count++] = (struct map_word){bake_map_alias(i), NULL, 1u << i};
    words[count++] = (struct map_word){"all", "all of these that the scan can give", BAKE_MAPS_ALL};
    return count;
}

static int parse_maps(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    struct map_word words[MOST_MAP_WORDS];
    const char *names[MOST_MAP_WORDS + 2] = {NULL};
    const unsigned count = list_map_words(words);
    for (unsigned i = 0; i < count; i++)
        names[i] = words[i].name;
    names[count] = transfer_word; /* for the message: bake_transfer_name() takes such words */
    char *list = strdup(optarg), *rest = list, *word;
    int status = list ? 0 : cli_usage(cli, "--maps: out of memory");
    bake->maps = 0;
    while (status == 0 && (word = strsep(&rest, ","))) {
        unsigned number = 0;
        const char *transfer = bake_transfer_name(word);
        if (transfer) {
            status = bake_add_transfer(cli, &arguments->transfers, transfer);
            continue;
        }
        status = cli_parse_word(cli, "--maps", word, names, &number);
        bake->maps |= words[number].maps;
    }
    free(list);
    return status;
}

static int parse_count(struct cli *cli, const char *option, const char *text, uint32_t min,
                       uint32_t max, uint32_t *out)
{
    uint64_t value = 0;
    int status = cli_parse_count(cli, option, text, min, max, &value);
    if (status == 0)
        *out = (uint32_t)value;
    return status;
}

/* Parses a length or "auto", which sets a negative number. */
static int parse_length(struct cli *cli, const char *option, bool positive, double *out)
{
    if (strcmp(optarg, "auto") == 0) {
        *out = -1;
        return 0;
    }
    return cli_parse_length(cli, option, optarg, positive, out);
}

static int parse_padding(struct cli *cli, struct bake_options *bake)
{
    if (strcmp(optarg, "all") == 0) {
        bake->padding = UINT32_MAX;
        return 0;
    }
    return parse_count(cli, "--padding", optarg, 0, UINT32_MAX - 1, &bake->padding);
}

static int parse_choice(struct cli *cli, int option, struct bake_options *bake)
{
    static const char *const greens[] = {"up", "down", NULL};
    static const char *const spaces[] = {"tangent", "object", NULL};
    static const char *const shapes[] = {"sphere", "box", NULL};
    static const char *const samplings[] = {"trilinear", "nearest", NULL};
    static const char *const rays[] = {"smooth", "mesh", "face", NULL};
    static const char *const ups[] = {"auto", "y", "z", NULL};
    unsigned choice = 0;
    int status;
    switch (option) {
    case OPT_GREEN:
        if ((status = cli_parse_word(cli, "--green", optarg, greens, &choice)) == 0)
            bake->green_down = choice == 1;
        return status;
    case OPT_POSITION_IN:
        if ((status = cli_parse_word(cli, "--position-in", optarg, shapes, &choice)) == 0)
            bake->position_in = choice == 0 ? BAKE_IN_SPHERE : BAKE_IN_BOX;
        return status;
    case OPT_RAY_DIRECTIONS:
        if ((status = cli_parse_word(cli, "--ray-directions", optarg, rays, &choice)) == 0)
            bake->rays = (enum bake_rays)choice;
        return status;
    case OPT_UP:
        if ((status = cli_parse_word(cli, "--up", optarg, ups, &choice)) == 0)
            bake->preview_up = (enum bake_up)choice;
        return status;
    case OPT_SCAN_NORMALS:
        return cli_parse_scan_normals(cli, optarg, &bake->scan_normals);
    case OPT_NORMAL_SPACE:
        if ((status = cli_parse_word(cli, "--normal-space", optarg, spaces, &choice)) == 0)
            bake->normal_space = choice == 0 ? BAKE_TANGENT_SPACE : BAKE_OBJECT_SPACE;
        return status;
    default:
        if ((status = cli_parse_word(cli, "--sampling", optarg, samplings, &choice)) == 0)
            bake->sampling = choice == 0 ? BAKE_TRILINEAR : BAKE_NEAREST;
        return status;
    }
}

/* Parses an option of rays that start at hits. */
static int parse_rays(struct cli *cli, int option, struct bake_options *bake)
{
    static const char *const falloffs[] = {"none", "linear", NULL};
    unsigned choice = 0;
    int status = 0;
    switch (option) {
    case OPT_AO_RAYS:
        return parse_count(cli, "--ao-rays", optarg, 1, BAKE_MAX_RAYS, &bake->ao_rays);
    case OPT_AO_DISTANCE:
        return cli_parse_length(cli, "--ao-distance", optarg, true, &bake->ao_distance);
    case OPT_AO_SPREAD:
        status = cli_parse_length(cli, "--ao-spread", optarg, true, &bake->ao_spread);
        if (status == 0 && bake->ao_spread > 180)
            status = cli_usage(cli, "--ao-spread: %s is above 180 degrees", optarg);
        return status;
    case OPT_AO_FALLOFF:
        status = cli_parse_word(cli, "--ao-falloff", optarg, falloffs, &choice);
        bake->ao_falloff = choice == 1;
        return status;
    case OPT_AO_COARSE:
        bake->ao_coarse = -1;
        return strcmp(optarg, "none") == 0
                   ? 0
                   : cli_parse_length(cli, "--ao-coarse", optarg, true, &bake->ao_coarse);
    case OPT_THICKNESS_RAYS:
        return parse_count(cli, "--thickness-rays", optarg, 1, BAKE_MAX_RAYS,
                           &bake->thickness_rays);
    default:
        return cli_parse_length(cli, "--thickness-distance", optarg, true,
                                &bake->thickness_distance);
    }
}

static int parse_max_missed(struct cli *cli, double *out)
{
    int status = cli_parse_length(cli, "--max-missed", optarg, false, out);
    if (status == 0 && *out > 100)
        status = cli_usage(cli, "--max-missed: %s is above 100 percent", optarg);
    return status;
}

/* Parses "_low,_high". The texts live as long as the arguments. */
static int parse_suffixes(struct cli *cli, struct bake_arguments *arguments)
{
    char *text = strdup(optarg), *comma = text ? strchr(text, ',') : NULL;
    free(arguments->suffixes);
    arguments->suffixes = text;
    if (!text)
        return cli_usage(cli, "--match-suffixes: out of memory");
    if (!comma || strchr(comma + 1, ','))
        return cli_usage(cli, "--match-suffixes: \"%s\" is not LOW,HIGH", optarg);
    *comma = '\0';
    arguments->bake.low_suffix = text;
    arguments->bake.high_suffix = comma + 1;
    return 0;
}

static int parse_sample_type(struct cli *cli, int option, struct bake_arguments *arguments)
{
    uint64_t bits = 0;
    if (option == OPT_PNG_BITS) {
        int status = cli_parse_count(cli, "--png-bits", optarg, 1, 16, &bits);
        if (status == 0 && bits != 8 && bits != 16)
            status = cli_usage(cli, "--png-bits: \"%s\" is not 8 or 16", optarg);
        if (status != 0)
            return status;
    }
    if (arguments->sample_option && arguments->sample_option != option)
        return cli_usage(cli, "--half, --float and --png-bits exclude each other");
    arguments->sample_option = option;
    arguments->bake.sample_type = option == OPT_HALF    ? BAKE_HALF
                                  : option == OPT_FLOAT ? BAKE_FLOAT
                                  : bits == 8           ? BAKE_UINT8
                                                        : BAKE_UINT16;
    return 0;
}

/* Returns the name of the first of these maps. */
static const char *map_of(uint32_t maps)
{
    return bake_map_name((unsigned)__builtin_ctz(maps));
}

static int common_option(struct cli *cli, int option)
{
    struct map_word words[MOST_MAP_WORDS];
    const unsigned count = list_map_words(words);
    char maps[4096] = "", help[sizeof help_format + sizeof maps], same[64];
    size_t length = 0, width = 13;
    for (unsigned i = 0; i < count; i++)
        if (strlen(words[i].name) > width)
            width = strlen(words[i].name);
    for (unsigned i = 0; i < count && length < sizeof maps; i++) {
        snprintf(same, sizeof same, "another name of %s", map_of(words[i].maps));
        length +=
            (size_t)snprintf(maps + length, sizeof maps - length, "%28s%-*s  %s\n", "", (int)width,
                             words[i].name, words[i].summary ? words[i].summary : same);
    }
    if (length < sizeof maps)
        snprintf(maps + length, sizeof maps - length, "%28s%-*s  %s\n", "", (int)width,
                 transfer_word, "another texture of the scan, such as roughness");
    snprintf(help, sizeof help, help_format, maps);
    return cli_common_option(cli, option, help);
}

static int parse_option(struct cli *cli, void *arg, int option)
{
    struct bake_arguments *arguments = arg;
    struct bake_options *bake = &arguments->bake;
    const int status = cli_tasks_option(cli, &arguments->farm, option);
    if (status <= 0)
        return status;
    const bool with_plan = option == OPT_MAX_MISSED || option == OPT_DEVICE;
    if ((option >= CLI_TASKS_END && !with_plan) || option == 'o')
        arguments->bake_option = option;
    if (option >= CLI_TASKS_END)
        arguments->given |= UINT64_C(1) << (option - CLI_TASKS_END);
    switch (option) {
    case 'o':
        bake->output_path = optarg;
        return 0;
    case OPT_MAPS:
        return parse_maps(cli, arguments);
    case OPT_TEXTURE:
        return bake_parse_texture(cli, &arguments->transfers, optarg);
    case OPT_MASK_OPACITY:
        arguments->transfers.mask_opacity = true;
        return 0;
    case OPT_SIZE:
        return bake_parse_sizes(cli, optarg, bake);
    case OPT_TILES:
        return bake_parse_tiles(cli, optarg, bake);
    case OPT_SAMPLES:
        return parse_count(cli, "--samples", optarg, 1, BAKE_MAX_SAMPLES, &bake->samples);
    case OPT_FRONT:
        return parse_length(cli, "--front", false, &bake->front);
    case OPT_BACK:
        return parse_length(cli, "--back", false, &bake->back);
    case OPT_HEIGHT_RANGE:
        return parse_length(cli, "--height-range", true, &bake->height_range);
    case OPT_CURVATURE_RADIUS:
        return parse_length(cli, "--curvature-radius", true, &bake->curvature_radius);
    case OPT_CURVATURE_RANGE:
        return parse_length(cli, "--curvature-range", true, &bake->curvature_range);
    case OPT_CAGE:
        bake->cage_path = optarg;
        return 0;
    case OPT_SCAN_NORMAL_MAP:
        bake->scan_normal_map = optarg;
        return 0;
    case OPT_SKEW:
        bake->skew_path = optarg;
        return 0;
    case OPT_MATCH: {
        static const char *const kinds[] = {"name", NULL};
        unsigned kind = 0;
        bake->match_names = true;
        return cli_parse_word(cli, "--match", optarg, kinds, &kind);
    }
    case OPT_MATCH_SUFFIXES:
        return parse_suffixes(cli, arguments);
    case OPT_MAX_MISSED:
        return parse_max_missed(cli, &arguments->bake.max_missed);
    case OPT_AO_RAYS:
    case OPT_AO_DISTANCE:
    case OPT_AO_SPREAD:
    case OPT_AO_FALLOFF:
    case OPT_AO_COARSE:
    case OPT_THICKNESS_RAYS:
    case OPT_THICKNESS_DISTANCE:
        return parse_rays(cli, option, bake);
    case OPT_TWO_SIDED:
        bake->two_sided = true;
        return 0;
    case OPT_GREEN:
    case OPT_NORMAL_SPACE:
    case OPT_POSITION_IN:
    case OPT_RAY_DIRECTIONS:
    case OPT_SAMPLING:
    case OPT_SCAN_NORMALS:
    case OPT_UP:
        return parse_choice(cli, option, bake);
    case OPT_PADDING:
        return parse_padding(cli, bake);
    case OPT_HALF:
    case OPT_FLOAT:
    case OPT_PNG_BITS:
        return parse_sample_type(cli, option, arguments);
    case OPT_EXR_TILES:
        return parse_count(cli, "--exr-tiles", optarg, 8, BAKE_MAX_EXR_TILE, &bake->exr_tile_side);
    case OPT_PREVIEW:
        bake->preview_path = optarg;
        return 0;
    case OPT_PREVIEW_VIEWS:
        return parse_count(cli, "--preview-views", optarg, 1, BAKE_MAX_VIEWS, &bake->preview_views);
    case OPT_GPU_MEMORY:
        return cli_parse_size(cli, "--gpu-memory", optarg, &bake->gpu_memory_bytes);
    case OPT_DEVICE:
        bake->device = arguments->task_device = optarg;
        return bake_is_device_name(optarg)
                   ? 0
                   : cli_usage(cli, "--device: \"%s\" is not " BAKE_DEVICE_NAMES, optarg);
    case OPT_LIST_DEVICES:
        arguments->list_devices = true;
        return 0;
    case OPT_LIST_TILES:
        arguments->list_tiles = true;
        return 0;
    default:
        return common_option(cli, option);
    }
}

/* ---- all of them ---- */

/* Returns the long name of an option. */
static const char *name_of(int option)
{
    const struct option *o = long_options;
    while (o->name && o->val != option)
        o++;
    return o->name ? o->name : "";
}

bool bake_arguments_has(const struct bake_arguments *arguments, const char *name)
{
    for (const struct option *o = long_options; o->name; o++)
        if (strcmp(o->name, name) == 0)
            return o->val >= CLI_TASKS_END && arguments->given >> (o->val - CLI_TASKS_END) & 1;
    return false;
}

/* Checks the options of tasks against each other. */
static int check_tasks(struct cli *cli, const struct bake_arguments *arguments, int inputs)
{
    const struct cli_tasks *farm = &arguments->farm;
    const char *option = arguments->bake_option ? name_of(arguments->bake_option) : NULL;
    if (farm->plan && !farm->task_given && arguments->task_device)
        return cli_usage(cli, "--plan has the device of the tasks: give --device to --task only");
    if (farm->plan && !farm->merge && bake_arguments_has(arguments, "max-missed"))
        return cli_usage(cli, "--max-missed is for the bake of all texels: give it to --merge");
    return cli_tasks_check(cli, farm, option, inputs);
}

static int check_arguments(struct cli *cli, struct bake_arguments *arguments, int count,
                           char **inputs)
{
    struct bake_options *bake = &arguments->bake;
    arguments->files = inputs;
    arguments->file_count = count;
    if (cli->verify)
        return 0;
    if (arguments->list_devices)
        return count == 0 ? 0 : cli_usage(cli, "--list-devices takes no files");
    if (arguments->list_tiles)
        return count > 0 ? 0 : cli_usage(cli, "--list-tiles takes files: LOW.obj...");
    if (check_tasks(cli, arguments, count) < 0)
        return BSQ_EUSAGE;
    if (arguments->farm.plan)
        return 0;
    if (count < 2)
        return cli_usage(cli, "%d input file%s given, not two: SCAN.nvdb and LOW.obj (see --help)",
                         count, count == 1 ? "" : "s");
    if (bake->ao_falloff && bake->ao_distance <= 0)
        return cli_usage(cli, "--ao-falloff needs --ao-distance");
    if (!bake->output_path)
        return cli_usage(cli, "no output given: add -o 'OUT_<MAP>.exr'");
    return bake_use_transfers(cli, &arguments->transfers, bake);
}

int bake_arguments_parse(struct cli *cli, struct bake_arguments *arguments, int argc, char **argv)
{
    bake_defaults(&arguments->bake);
    int status = cli_parse_options(cli, argc, argv, long_options, parse_option, arguments);
    return status != 0 ? status : check_arguments(cli, arguments, argc - optind, argv + optind);
}

void bake_arguments_free(struct bake_arguments *arguments)
{
    free(arguments->paths);
    free(arguments->suffixes);
    bake_transfers_free(&arguments->transfers);
    free((void *)(uintptr_t)arguments->bake.tile_sizes);
    free((void *)(uintptr_t)arguments->bake.tile_ranges);
}
