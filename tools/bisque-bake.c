/* bake.c - bisque-bake: a low mesh and a scan become texture maps. */
#include <stdlib.h>
#include <string.h>

#include "libbake/bake.h"
#include "tools/cli.h"

static const char help[] =
    "Usage: bisque-bake [OPTION]... SCAN.nvdb LOW.obj -o OUT_<MAP>.exr\n"
    "       bisque-bake [OPTION]... SCAN.tris LOW.obj -o OUT_<MAP>.exr\n"
    "       bisque-bake --verify FILE...\n"
    "Bakes the normals and colours of a scan into texture maps of a low-polygon mesh: fast from a\n"
    "voxel grid (SCAN.nvdb), or exact from the scan's own triangles (SCAN.tris).\n"
    "<MAP> in the output's name is replaced by normal, color or mask. A name that ends in .exr gives\n"
    "OpenEXR files, one that ends in .png PNG files.\n"
    "\n"
    "  -o, --output FILE       the maps; \"<MAP>\" must be in it where there are several\n"
    "      --maps LIST         of normal, color, mask (default: normal, and color where the scan\n"
    "                          has it)\n"
    "      --size N | WxH      texels (default: 2048)\n"
    "      --samples N         N x N pairs of rays a texel (default: 2)\n"
    "      --front D           length of the rays outwards, in the mesh's units (default: auto)\n"
    "      --back D            length of the rays inwards (default: auto)\n"
    "      --two-sided         also hit surfaces that face away from the low mesh\n"
    "      --sampling MODE     trilinear or nearest, of a grid (default: trilinear)\n"
    "      --scan-normals MODE smooth or flat: of triangles that have none (default: smooth)\n"
    "      --normal-space SPC  tangent (MikkTSpace) or object (default: tangent)\n"
    "      --green DIR         up (OpenGL) or down (Direct3D), for tangent space (default: up)\n"
    "      --padding N         texels around each chart; all: everywhere (default: 16)\n"
    "      --half, --float     type of OpenEXR samples (default: half)\n"
    "      --png-bits N        8 (dithered) or 16 (default: 16)\n"
    "      --preview FILE.png  a picture of the low mesh, the baked mesh and the scan\n"
    "      --device NAME       auto, cpu, cuda, cuda:N, opencl or opencl:N (default: auto)\n"
    "      --gpu-memory SIZE   most memory to use of a GPU, e.g. 2G (default: what is free)\n"
    "      --list-devices      print the devices and end\n"
    "      --verify            check FILES (.tris, .nvdb) and print a line on each, nothing else\n" CLI_COMMON_HELP;

enum {
    OPT_MAPS = CLI_OWN,
    OPT_SIZE,
    OPT_SAMPLES,
    OPT_FRONT,
    OPT_BACK,
    OPT_TWO_SIDED,
    OPT_SAMPLING,
    OPT_SCAN_NORMALS,
    OPT_NORMAL_SPACE,
    OPT_GREEN,
    OPT_PADDING,
    OPT_HALF,
    OPT_FLOAT,
    OPT_PNG_BITS,
    OPT_PREVIEW,
    OPT_DEVICE,
    OPT_GPU_MEMORY,
    OPT_LIST_DEVICES,
    OPT_VERIFY
};

static const struct option long_options[] = {
    {"output", required_argument, NULL, 'o'},
    {"maps", required_argument, NULL, OPT_MAPS},
    {"size", required_argument, NULL, OPT_SIZE},
    {"samples", required_argument, NULL, OPT_SAMPLES},
    {"front", required_argument, NULL, OPT_FRONT},
    {"back", required_argument, NULL, OPT_BACK},
    {"two-sided", no_argument, NULL, OPT_TWO_SIDED},
    {"sampling", required_argument, NULL, OPT_SAMPLING},
    {"scan-normals", required_argument, NULL, OPT_SCAN_NORMALS},
    {"normal-space", required_argument, NULL, OPT_NORMAL_SPACE},
    {"green", required_argument, NULL, OPT_GREEN},
    {"padding", required_argument, NULL, OPT_PADDING},
    {"half", no_argument, NULL, OPT_HALF},
    {"float", no_argument, NULL, OPT_FLOAT},
    {"png-bits", required_argument, NULL, OPT_PNG_BITS},
    {"preview", required_argument, NULL, OPT_PREVIEW},
    {"device", required_argument, NULL, OPT_DEVICE},
    {"gpu-memory", required_argument, NULL, OPT_GPU_MEMORY},
    {"list-devices", no_argument, NULL, OPT_LIST_DEVICES},
    {"verify", no_argument, NULL, OPT_VERIFY},
    CLI_COMMON_OPTIONS,
    {NULL, 0, NULL, 0},
};

enum { MAX_SIZE = 1 << 20, MAX_SAMPLES = 64 };

/* More misses than this in a hundred rays are worth a hint. */
enum { MISSES_PERCENT = 5 };

static const struct {
    enum bake_map map;
    const char *name;
} map_names[] = {
    {BAKE_MAP_NORMAL, "normal"},
    {BAKE_MAP_COLOR, "color"},
    {BAKE_MAP_MASK, "mask"},
};
enum { MAP_KINDS = sizeof map_names / sizeof map_names[0] };

struct arguments {
    struct bake_options bake;
    bool exr_type_given, list_devices, verify;
    const char *job_option; /* name of one that is of no use to --verify, NULL: none given */
    char **files;           /* to verify */
    int file_count;
    uint64_t png_bits; /* 0: not given */
};

/* ---- arguments ---- */

static int parse_maps(struct cli *cli, struct bake_options *bake)
{
    uint32_t maps = 0;
    for (const char *word = optarg;; word++) {
        size_t length = strcspn(word, ",");
        uint32_t map = 0;
        for (unsigned i = 0; i < MAP_KINDS; i++) {
            if (strlen(map_names[i].name) == length && !memcmp(word, map_names[i].name, length))
                map = map_names[i].map;
        }
        if (map == 0)
            return cli_usage(cli, "--maps: \"%.*s\" is not normal, color or mask", (int)length,
                             word);
        maps |= map;
        word += length;
        if (*word == '\0')
            break;
    }
    bake->maps = maps;
    return 0;
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

static bool parse_side(const char **text, uint32_t *out)
{
    char *end;
    bool digit = **text >= '0' && **text <= '9';
    unsigned long long value = strtoull(*text, &end, 10);
    *text = end;
    *out = (uint32_t)value;
    return digit && value >= 1 && value <= MAX_SIZE;
}

/* "2048" or "4096x2048". */
static int parse_size(struct cli *cli, struct bake_options *bake)
{
    const char *at = optarg;
    bool good = parse_side(&at, &bake->width);
    bake->height = bake->width;
    if (good && *at == 'x') {
        at++;
        good = parse_side(&at, &bake->height);
    }
    if (!good || *at != '\0')
        return cli_usage(cli, "--size: \"%s\" is not N or WxH with numbers from 1 to %d", optarg, MAX_SIZE);
    return 0;
}

static int parse_distance(struct cli *cli, const char *option, double *out)
{
    if (strcmp(optarg, "auto") == 0) {
        *out = -1;
        return 0;
    }
    return cli_parse_length(cli, option, optarg, false, out);
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
    static const char *const samplings[] = {"trilinear", "nearest", NULL};
    static const char *const normals[] = {"smooth", "flat", NULL};
    unsigned choice = 0;
    int status;
    switch (option) {
    case OPT_GREEN:
        if ((status = cli_parse_word(cli, "--green", optarg, greens, &choice)) == 0)
            bake->green_down = choice == 1;
        return status;
    case OPT_SCAN_NORMALS:
        if ((status = cli_parse_word(cli, "--scan-normals", optarg, normals, &choice)) == 0)
            bake->scan_normals =
                choice == 0 ? BAKE_SCAN_NORMALS_SMOOTH : BAKE_SCAN_NORMALS_FLAT;
        return status;
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

/* Options that only affect the kind of file. */
static int parse_format(struct cli *cli, int option, struct arguments *arguments)
{
    if (option == OPT_PNG_BITS) {
        int status = cli_parse_count(cli, "--png-bits", optarg, 1, 16, &arguments->png_bits);
        if (status == 0 && arguments->png_bits != 8 && arguments->png_bits != 16)
            status = cli_usage(cli, "--png-bits: \"%s\" is not 8 or 16", optarg);
        return status;
    }
    enum bake_format format = option == OPT_HALF ? BAKE_EXR_HALF : BAKE_EXR_FLOAT;
    if (arguments->exr_type_given && arguments->bake.format != format)
        return cli_usage(cli, "--half and --float exclude each other");
    arguments->bake.format = format;
    arguments->exr_type_given = true;
    return 0;
}

static int parse_option(struct cli *cli, struct arguments *arguments, int option)
{
    struct bake_options *bake = &arguments->bake;
    switch (option) {
    case 'o':
        bake->output_path = optarg;
        return 0;
    case OPT_MAPS:
        return parse_maps(cli, bake);
    case OPT_SIZE:
        return parse_size(cli, bake);
    case OPT_SAMPLES:
        return parse_count(cli, "--samples", optarg, 1, MAX_SAMPLES, &bake->samples);
    case OPT_FRONT:
        return parse_distance(cli, "--front", &bake->front);
    case OPT_BACK:
        return parse_distance(cli, "--back", &bake->back);
    case OPT_TWO_SIDED:
        bake->two_sided = true;
        return 0;
    case OPT_GREEN:
    case OPT_NORMAL_SPACE:
    case OPT_SAMPLING:
    case OPT_SCAN_NORMALS:
        return parse_choice(cli, option, bake);
    case OPT_PADDING:
        return parse_padding(cli, bake);
    case OPT_HALF:
    case OPT_FLOAT:
    case OPT_PNG_BITS:
        return parse_format(cli, option, arguments);
    case OPT_PREVIEW:
        bake->preview_path = optarg;
        return 0;
    case OPT_GPU_MEMORY:
        return cli_parse_size(cli, "--gpu-memory", optarg, &bake->gpu_memory_bytes);
    case OPT_DEVICE:
        bake->device = optarg;
        return 0;
    case OPT_LIST_DEVICES:
        arguments->list_devices = true;
        return 0;
    case OPT_VERIFY:
        arguments->verify = true;
        return 0;
    default:
        return cli_common_option(cli, option, help);
    }
}

static int choose_format(struct cli *cli, struct arguments *arguments)
{
    bool png = cli_ends_with(arguments->bake.output_path, ".png");
    if (png && arguments->exr_type_given)
        return cli_usage(cli, "--half and --float are for OpenEXR, not for %s",
                         arguments->bake.output_path);
    if (!png && arguments->png_bits > 0)
        return cli_usage(cli, "--png-bits is for PNG, not for %s", arguments->bake.output_path);
    if (png)
        arguments->bake.format = arguments->png_bits == 8 ? BAKE_PNG8 : BAKE_PNG16;
    return 0;
}

static int check_arguments(struct cli *cli, struct arguments *arguments, int count, char **inputs)
{
    struct bake_options *bake = &arguments->bake;
    arguments->files = inputs;
    arguments->file_count = count;
    if (arguments->verify && arguments->job_option)
        return cli_usage(cli, "--verify only checks files: leave out --%s", arguments->job_option);
    if (arguments->verify)
        return count > 0 ? 0 : cli_usage(cli, "no input file given (see --help)");
    if (arguments->list_devices)
        return count == 0 ? 0 : cli_usage(cli, "--list-devices takes no files");
    if (count != 2)
        return cli_usage(cli, "%d input file%s given, not two: SCAN.nvdb and LOW.obj (see --help)",
                         count, count == 1 ? "" : "s");
    bake->scan_path = inputs[0];
    bake->mesh_path = inputs[1];
    if (!bake->output_path)
        return cli_usage(cli, "no output given: add -o 'OUT_<MAP>.exr'");
    if (bake->normal_space == BAKE_OBJECT_SPACE && bake->green_down)
        return cli_usage(cli, "--green down is for tangent space");
    return choose_format(cli, arguments);
}

static int parse_arguments(struct cli *cli, struct arguments *arguments, int argc, char **argv)
{
    int option;
    bake_defaults(&arguments->bake);
    while ((option = getopt_long(argc, argv, "o:", long_options, NULL)) != -1) {
        int status = parse_option(cli, arguments, option);
        if (status != 0)
            return status;
        if (option >= CLI_OWN || option == 'o')
            arguments->job_option = option == OPT_VERIFY ? arguments->job_option : cli_option_name(long_options, option);
    }
    return check_arguments(cli, arguments, argc - optind, argv + optind);
}

/* ---- devices ---- */

struct device_list {
    json_t *json; /* NULL: print lines */
    bool failed;
};

static void list_device(void *arg, const struct bake_device_info *device)
{
    struct device_list *list = arg;
    char memory[CLI_TEXT];
    if (!list->json) {
        printf("%-10s  %s, %s\n", device->id, device->name,
               cli_size_text(device->memory_bytes, memory));
        return;
    }
    json_t *entry = json_pack("{s:o, s:o, s:I, s:b}", "id", cli_json_text(device->id), "name",
                              cli_json_text(device->name), "memory_bytes",
                              (json_int_t)device->memory_bytes, "is_gpu", (int)device->is_gpu);
    if (!entry || json_array_append_new(list->json, entry) != 0)
        list->failed = true;
}

static int list_devices(struct cli *cli)
{
    struct device_list list = {.json = cli->json ? json_array() : NULL};
    int status = bake_list_devices(cli->ctx, list_device, &list);
    if (cli->json && status == 0)
        status = cli_print_json(cli, list.failed ? NULL : json_pack("{s:O}", "devices", list.json));
    json_decref(list.json);
    return status;
}

/* ---- outputs ---- */

/* Names of all outputs, `paths` of MAP_KINDS; those of maps that are not asked for are NULL. */
static int name_outputs(struct cli *cli, const struct bake_options *bake, char **paths)
{
    for (unsigned i = 0; i < MAP_KINDS; i++) {
        if (!(bake->maps & map_names[i].map))
            continue;
        paths[i] = bake_map_path(bake->output_path, map_names[i].map);
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
    for (unsigned i = 0; i < MAP_KINDS && status == 0; i++) {
        if (!paths[i])
            continue;
        if (bake->preview_path && cli_same_file(bake->preview_path, paths[i]))
            return cli_usage(cli, "%s: two outputs have this name", paths[i]);
        status = cli_check_output(cli, paths[i], inputs, 2);
    }
    if (status == 0 && !cli_ends_with(bake->output_path, ".exr") && !cli_ends_with(bake->output_path, ".png"))
        status = cli_usage(cli, "%s: maps are OpenEXR or PNG files: let the name end in .exr or .png", bake->output_path);
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

/* ---- reports ---- */

static double percent(uint64_t part, uint64_t whole)
{
    return whole > 0 ? 100.0 * (double)part / (double)whole : 0;
}

static void hint_at_misses(struct cli *cli, const struct arguments *arguments,
                           const struct bake_report *report)
{
    uint64_t samples = report->hits + report->misses;
    if (percent(report->misses, samples) <= MISSES_PERCENT)
        return;
    bsq_warn(cli->ctx,
             "%.1f %% of the samples found no surface within %g in front and %g behind: "
             "try a larger --front and --back%s",
             percent(report->misses, samples), report->front, report->back,
             arguments->bake.two_sided
                 ? ""
                 : ", or --two-sided where the scan's faces are wound inwards");
}

static void print_report(const struct cli *cli, const struct arguments *arguments,
                         const struct bake_report *report, char *const *paths)
{
    const struct bake_options *bake = &arguments->bake;
    char triangles[CLI_TEXT], texels[CLI_TEXT], samples[CLI_TEXT], misses[CLI_TEXT];
    printf("%s: %s, %s of %ux%u texels covered\n", bake->mesh_path,
           cli_things_text(report->low_triangles, "triangle", "triangles", triangles),
           cli_count_text(report->covered_texels, texels), bake->width, bake->height);
    const char *first = "left out: ";
    const char *next =
        cli_print_count(first, report->degenerate_uv_triangles, "triangle without area in UV space",
                        "triangles without area in UV space");
    next =
        cli_print_count(next, report->outside_uv_triangles, "triangle reaching out of 0..1 in UV space",
                        "triangles reaching out of 0..1 in UV space");
    next = cli_print_count(next, report->overlapping_samples, "sample of overlapping triangles",
                           "samples of overlapping triangles");
    if (next != first)
        putchar('\n');
    printf("%s: %s, %s without surface (%.2f %%), %g in front, %g behind, on %s\n",
           bake->scan_path, cli_things_text(report->samples, "sample", "samples", samples),
           cli_count_text(report->misses, misses), percent(report->misses, report->samples),
           report->front, report->back, report->device);
    for (unsigned i = 0; i < MAP_KINDS; i++) {
        if (paths[i])
            printf("%s: %s map\n", paths[i], map_names[i].name);
    }
    if (bake->preview_path)
        printf("%s: preview\n", bake->preview_path);
    printf("seconds: open %.2f, trace %.2f, padding %.2f, resolve %.2f, write %.2f, preview %.2f\n",
           report->seconds_open, report->seconds_trace, report->seconds_padding,
           report->seconds_resolve, report->seconds_write, report->seconds_preview);
    if (report->kernel_calls > 0)
        printf("device: upload %.2f, kernels %.3f in %s, copies %.3f\n",
               report->seconds_upload, report->seconds_kernels,
               cli_things_text(report->kernel_calls, "call", "calls", samples), report->seconds_copies);
    if (report->passes > 1)
        printf("passes: %s, the grid is larger than what may be used of the device's memory\n",
               cli_count_text(report->passes, samples));
    cli_print_cost(cli);
}

static json_t *maps_json(char *const *paths)
{
    json_t *maps = json_object();
    for (unsigned i = 0; maps && i < MAP_KINDS; i++) {
        if (paths[i] &&
            json_object_set_new(maps, map_names[i].name, cli_json_text(paths[i])) != 0) {
            json_decref(maps);
            maps = NULL;
        }
    }
    return maps;
}

static int print_json(struct cli *cli, const struct arguments *arguments,
                      const struct bake_report *report, char *const *paths)
{
    const struct bake_options *bake = &arguments->bake;
    json_t *root = json_pack(
        "{s:o, s:o, s:o, s:o, s:i, s:i, s:i, s:o, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:f, s:f,"
        " s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:I, s:I}",
        "scan_path", cli_json_text(bake->scan_path), "mesh_path", cli_json_text(bake->mesh_path),
        "maps", maps_json(paths), "preview_path", cli_json_text(bake->preview_path), "width",
        (int)bake->width, "height", (int)bake->height, "samples_per_axis", (int)bake->samples,
        "device", cli_json_text(report->device), "low_triangles", (json_int_t)report->low_triangles,
        "degenerate_uv_triangles", (json_int_t)report->degenerate_uv_triangles,
        "outside_uv_triangles", (json_int_t)report->outside_uv_triangles, "covered_texels",
        (json_int_t)report->covered_texels, "samples", (json_int_t)report->samples, "hits",
        (json_int_t)report->hits, "misses", (json_int_t)report->misses, "overlapping_samples",
        (json_int_t)report->overlapping_samples, "front", report->front, "back", report->back,
        "seconds_open", report->seconds_open, "seconds_trace", report->seconds_trace,
        "seconds_padding", report->seconds_padding, "seconds_resolve", report->seconds_resolve,
        "seconds_write", report->seconds_write, "seconds_preview", report->seconds_preview,
        "seconds_upload", report->seconds_upload, "seconds_kernels", report->seconds_kernels,
        "seconds_copies", report->seconds_copies, "kernel_calls",
        (json_int_t)report->kernel_calls, "passes", (json_int_t)report->passes);
    return cli_print_json(cli, root);
}

/* ---- the work ---- */

static int bake_maps(struct cli *cli, struct arguments *arguments)
{
    char *paths[MAP_KINDS] = {NULL};
    struct bake_report report = {0};
    int status = choose_maps(cli, &arguments->bake);
    if (status == 0)
        status = name_outputs(cli, &arguments->bake, paths);
    if (status == 0)
        status = check_outputs(cli, &arguments->bake, paths);
    if (status == 0)
        status = bake_run(cli->ctx, &arguments->bake, &report);
    if (status == 0) {
        hint_at_misses(cli, arguments, &report);
        if (cli->json)
            status = print_json(cli, arguments, &report, paths);
        else
            print_report(cli, arguments, &report, paths);
    }
    for (unsigned i = 0; i < MAP_KINDS; i++)
        free(paths[i]);
    return status;
}

int main(int argc, char **argv)
{
    struct cli cli;
    struct arguments arguments = {0};
    cli_begin(&cli, "bisque-bake", argv);
    int status = parse_arguments(&cli, &arguments, argc, argv);
    if (status == 0)
        status = cli_create_context(&cli);
    if (status == 0 && arguments.verify)
        status = cli_verify(&cli, arguments.files, arguments.file_count);
    else if (status == 0)
        status = arguments.list_devices ? list_devices(&cli) : bake_maps(&cli, &arguments);
    return cli_end(&cli, status);
}
