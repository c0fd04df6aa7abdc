/* bisque-simplify.c - makes low-poly meshes of a scan, and says how far they are from it. */
#include <errno.h>
#include <float.h>
#include <inttypes.h>
#include <malloc.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/file.h"
#include "libvoxel/voxel.h"
#include "tools/cli.h"

static const char usage[] =
    "Usage: bisque-simplify [OPTION]... SCAN.tris... -o LOW.obj --triangles N\n"
    "       bisque-simplify [OPTION]... SCAN.obj... -o LOW.obj --error D\n"
    "       bisque-simplify [OPTION]... SCAN.tris... -o LOD_<N>.obj --triangles N,N,...\n"
    "Makes a low-poly mesh of a scan of any size by edge collapse, and measures how far it is from\n"
    "all of the scan, both ways. Colours, texture coordinates and materials are left out. Meshes are\n"
    "sorted first; keep the chunk file (bisque-voxelize -o SCAN.tris) to simplify again.\n";

/* A number, or a percentage of what the scan has. */
struct amount {
    double value;
    bool percent;
};

struct arguments {
    struct vox_simplify_options simplify;
    struct amount triangles[VOX_LEVELS_MAX], error, min_component;
    uint32_t min_triangles;
    uint64_t targets[VOX_LEVELS_MAX];
    const char *output;
    const char *paths[VOX_LEVELS_MAX];
    struct cli_scans scans;
};

/* ---- arguments ---- */

#define MEMBER(kind, member) BSQ_MEMBER(kind, struct arguments, member)

static const struct bsq_option rows[] = {
    {BSQ_ROW("output", "FILE",
             "the mesh, .obj, .ply or .glb; with several numbers of triangles its name\n"
             "must contain <N>, which is replaced by them"),
     .letter = 'o', .heading = "Mesh", MEMBER(OUTPUT, output)},
    {BSQ_ROW("triangles", "LIST",
             "triangles of the mesh, or of several meshes: 150000,20000,2000;\n"
             "10%: of those of the scan"),
     BSQ_OWN},
    {BSQ_ROW("error", "D",
             "instead: the smallest mesh that is nowhere farther from the scan\n"
             "than D, nor the scan from it, in the scan's units (default: none);\n"
             "0.1%: of the scan's diagonal"),
     BSQ_OWN},
    {BSQ_ROW("min-component", "P",
             "drop separate pieces smaller than P % of the scan, by diagonals: 5%"),
     BSQ_OWN},
    {BSQ_ROW("min-triangles", "N", "drop separate pieces of fewer triangles of the scan"),
     MEMBER(COUNT, min_triangles), BSQ_RANGE(0, UINT32_MAX, 0)},
    {BSQ_ROW("hard-angle", "DEG", "edges with a larger angle than this look sharp"),
     MEMBER(NUMBER, simplify.hard_angle), BSQ_RANGE(0, 180, 180)},
};
static const struct bsq_option cli_rows[] = {CLI_TMPDIR_ROW, CLI_STRICT_ROW};
enum { ROWS = sizeof rows / sizeof *rows };

static int compare_falling(const void *a, const void *b)
{
    const uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return x < y ? 1 : x > y ? -1 : 0;
}

/* Sorts the numbers of triangles, of which none may be there twice. */
static int order_targets(struct cli *cli, struct arguments *arguments)
{
    const uint32_t count = arguments->simplify.target_count;
    qsort(arguments->targets, count, sizeof *arguments->targets, compare_falling);
    for (uint32_t i = 1; i < count; i++)
        if (arguments->targets[i] == arguments->targets[i - 1])
            return cli_usage(cli, "--triangles: %" PRIu64 " twice", arguments->targets[i]);
    return 0;
}

/* Reads the list of --triangles. */
static int take_triangles(struct cli *cli, struct arguments *arguments, const char *text)
{
    uint32_t count = 0;
    bool shares = false;
    for (const char *at = text;; at++) {
        char *end;
        errno = 0;
        const double share = strtod(at, &end);
        const bool percent = *end == '%';
        const unsigned long long value = percent ? 4 : strtoull(at, &end, 10);
        if (*at < '0' || *at > '9' || errno || value < 4 || (percent && !(share <= 100)) ||
            (end[percent] && end[percent] != ','))
            return cli_usage(cli,
                             "--triangles: \"%s\" is not a list of numbers of 4 or more, or of "
                             "percentages",
                             text);
        if (count == VOX_LEVELS_MAX)
            return cli_usage(cli, "--triangles: more than %d numbers", VOX_LEVELS_MAX);
        arguments->targets[count] = value;
        arguments->triangles[count++] = (struct amount){share, percent};
        shares |= percent;
        at = end + percent;
        if (!*at)
            break;
    }
    arguments->simplify.target_count = count;
    return shares ? 0 : order_targets(cli, arguments);
}

/* Reads a number, or a percentage. */
static int take_amount(struct cli *cli, const char *option, const char *text, double most,
                       struct amount *out)
{
    const struct bsq_option row = {BSQ_MEMBER(NUMBER, struct amount, value), BSQ_RANGE(0, most, 0)};
    const size_t length = strlen(text);
    char number[CLI_TEXT];
    out->percent = length > 0 && text[length - 1] == '%';
    snprintf(number, sizeof number, "%.*s", (int)(length - out->percent), text);
    return cli_parse_value(cli, option, &row, number, out);
}

static int simplify_tool_take_option(struct cli *cli, void *arguments_,
                                     const struct bsq_option *row, const char *text)
{
    struct arguments *arguments = arguments_;
    if (strcmp(row->name, "triangles") == 0)
        return take_triangles(cli, arguments, text);
    if (strcmp(row->name, "min-component") == 0)
        return take_amount(cli, "--min-component", text, 100, &arguments->min_component);
    BSQ_PASS(take_amount(cli, "--error", text, DBL_MAX, &arguments->error));
    return arguments->error.value > 0 ? 0 : cli_usage(cli, "--error: \"%s\" is not above 0", text);
}

/* Turns percentages into numbers of the scan's triangles, and a part of its diagonal. */
static int resolve_amounts(struct cli *cli, struct arguments *arguments)
{
    struct vox_simplify_options *simplify = &arguments->simplify;
    bool shares = arguments->error.percent;
    uint64_t triangles;
    double diagonal;
    for (uint32_t i = 0; i < simplify->target_count; i++)
        shares |= arguments->triangles[i].percent;
    simplify->error = arguments->error.value;
    if (!shares)
        return 0;
    BSQ_PASS(
        vox_scan_size(cli->ctx, simplify->tris_path, simplify->temp_tris, &triangles, &diagonal));
    if (arguments->error.percent)
        simplify->error *= diagonal / 100;
    for (uint32_t i = 0; i < simplify->target_count; i++)
        if (arguments->triangles[i].percent)
            arguments->targets[i] =
                (uint64_t)fmax(4, round(arguments->triangles[i].value / 100 * (double)triangles));
    return order_targets(cli, arguments);
}

/* Makes the name of each output. */
static void name_outputs(struct arguments *arguments)
{
    const uint32_t count =
        arguments->simplify.target_count > 0 ? arguments->simplify.target_count : 1;
    const char *token = strstr(arguments->output, "<N>");
    for (uint32_t i = 0; i < count; i++) {
        const int before =
            token ? (int)(token - arguments->output) : (int)strlen(arguments->output);
        char number[32] = "";
        if (token && arguments->simplify.target_count > 0)
            snprintf(number, sizeof number, "%" PRIu64, arguments->targets[i]);
        arguments->paths[i] =
            cli_keep_text("%.*s%s%s", before, arguments->output, number, token ? token + 3 : "");
    }
    arguments->simplify.output_paths = arguments->paths;
}

static int simplify_tool_parse_arguments(struct cli *cli, struct arguments *arguments, int argc,
                                         char **argv)
{
    const struct cli_command command = {
        .usage = usage,
        .tables = {{rows, ROWS, arguments, NULL},
                   {cli_rows, sizeof cli_rows / sizeof *cli_rows, cli, NULL}},
        .take = simplify_tool_take_option,
        .arguments = arguments};
    vox_simplify_defaults(&arguments->simplify);
    bsq_options_defaults(rows, ROWS, arguments);
    const int status = cli_parse(cli, &command, argc, argv);
    if (status != 0)
        return status;
    arguments->simplify.targets = arguments->targets;
    arguments->simplify.min_component = arguments->min_component.value / 100;
    arguments->simplify.min_triangles = arguments->min_triangles;
    if (argc == optind)
        return cli_usage(cli, "no input file given (see --help)");
    if (!arguments->output)
        return cli_usage(cli, "no output file given: -o LOW.obj");
    if ((arguments->simplify.target_count > 0) == (arguments->error.value > 0))
        return cli_usage(cli, "either --triangles or --error is needed");
    if (arguments->simplify.target_count > 1 && !strstr(arguments->output, "<N>"))
        return cli_usage(cli, "%s: the name of %u meshes must contain <N>", arguments->output,
                         arguments->simplify.target_count);
    return 0;
}

/* ---- the work ---- */

/* Sorts the meshes into a temporary chunk file. */
static int sort_meshes(struct cli *cli, const struct arguments *arguments,
                       struct vox_temp_tris *temp, struct vox_sort_report *report)
{
    struct vox_sort_options options;
    vox_sort_defaults(&options);
    options.scan_paths = arguments->scans.meshes;
    options.scan_count = arguments->scans.mesh_count;
    options.tris_path = arguments->output;
    options.temp_tris = temp;
    options.scan_normals = BSQ_SCAN_NORMALS_FLAT; /* they are not used */
    return vox_sort(cli->ctx, &options, report);
}

/* ---- results ---- */

static void warn_of_targets(struct cli *cli, const struct arguments *arguments,
                            const struct vox_simplify_report *report)
{
    for (uint32_t i = 0; i < report->level_count; i++) {
        const struct vox_simplified *level = &report->levels[i];
        if (level->target > 0 && level->triangles > level->target)
            bsq_warn(cli->ctx,
                     "%s: %" PRIu64 " triangles instead of %" PRIu64
                     ": each edge that is left would close a hole or join pieces",
                     arguments->paths[i], level->triangles, level->target);
    }
}

static void simplify_tool_print_report(const struct cli *cli, const struct arguments *arguments,
                                       const struct vox_simplify_report *report)
{
    cli_print("scan: %s, diagonal %g\n",
              cli_counted(report->triangles, "triangle", "triangles").text, report->diagonal);
    if (report->dropped_pieces > 0)
        cli_print("left out: %s\n",
                  cli_counted(report->dropped_pieces, "small piece", "small pieces").text);
    if (report->cut_handles > 0)
        cli_print("cut: %s\n", cli_counted(report->cut_handles, "narrow handle or neck",
                                           "narrow handles or necks")
                                   .text);
    for (uint32_t i = 0; i < report->level_count; i++) {
        const struct vox_simplified *level = &report->levels[i];
        cli_print("%s: %s, %s\n", arguments->paths[i],
                  cli_counted(level->triangles, "triangle", "triangles").text,
                  cli_counted(level->vertices, "vertex", "vertices").text);
        cli_print_distances("from the scan", &level->from_scan);
        cli_print_distances("to the scan", &level->from_mesh);
    }
    cli_print("seconds: reduce %.2f, collapse %.2f, measure %.2f\n", report->seconds_reduce,
              report->seconds_collapse, report->seconds_measure);
    cli_print_cost(cli);
}

static int simplify_tool_print_json(struct cli *cli, const struct arguments *arguments,
                                    const struct vox_simplify_report *report)
{
    json_t *levels = json_array();
    for (uint32_t i = 0; i < report->level_count; i++) {
        const struct vox_simplified *level = &report->levels[i];
        cli_json_append(&levels,
                        json_pack("{s:o, s:I, s:I, s:I, s:o, s:o}", "path",
                                  cli_json_text(arguments->paths[i]), CLI_COUNT(level, target),
                                  CLI_COUNT(level, triangles), CLI_COUNT(level, vertices),
                                  "from_scan", cli_distances_json(&level->from_scan), "to_scan",
                                  cli_distances_json(&level->from_mesh)));
    }
    return cli_print_json(
        cli, json_pack("{s:I, s:f, s:I, s:I, s:I, s:I, s:o, s:f, s:f, s:f}",
                       CLI_COUNT(report, triangles), CLI_VALUE(report, diagonal),
                       CLI_COUNT(report, dropped_pieces), CLI_COUNT(report, dropped_triangles),
                       CLI_COUNT(report, cut_handles), CLI_COUNT(report, temp_bytes), "meshes",
                       levels, CLI_VALUE(report, seconds_reduce),
                       CLI_VALUE(report, seconds_collapse), CLI_VALUE(report, seconds_measure)));
}

static int simplify_tool_run(struct cli *cli, struct arguments *arguments, const char **inputs,
                             uint32_t input_count)
{
    struct vox_simplify_report report = {.size = sizeof report};
    struct vox_sort_report sorted = {.size = sizeof sorted};
    struct vox_temp_tris *temp = NULL;
    int status = 0;
    BSQ_TRY(cli_create_context(cli));
    BSQ_TRY(cli_recognise_scans(cli, inputs, input_count,
                                "a grid has no triangles; give the scan or its chunk file (.tris)",
                                &arguments->scans));
    if (arguments->scans.mesh_count > 0) {
        BSQ_TRY(vox_temp_tris_create(cli->ctx, &temp));
        BSQ_TRY(sort_meshes(cli, arguments, temp, &sorted));
    }
    const struct vox_join_options how = {.output_path = arguments->output,
                                         .scan_normals = BSQ_SCAN_NORMALS_FLAT};
    BSQ_TRY(cli_join(cli, arguments->scans.chunks, arguments->scans.chunk_count, &how, &temp));
    arguments->simplify.tris_path = arguments->scans.chunks[0];
    arguments->simplify.temp_tris = temp;
    BSQ_TRY(resolve_amounts(cli, arguments));
    name_outputs(arguments);
    BSQ_TRY(vox_simplify(cli->ctx, &arguments->simplify, &report));
    report.temp_bytes = bsq_temp_bytes(cli->ctx);
    warn_of_targets(cli, arguments, &report);
    if (cli->json)
        status = simplify_tool_print_json(cli, arguments, &report);
    else
        simplify_tool_print_report(cli, arguments, &report);
done:
    vox_temp_tris_close(temp);
    return status;
}

/* Each group of chunks allocates arrays of a few megabytes and frees them. Their pages stay in the
 * process: to get them anew each time took 6 % of the processor time. */
enum { LARGEST_ON_HEAP = 8 << 20, MOST_FREE_ON_HEAP = 32 << 20 };

int main(int argc, char **argv)
{
    struct cli cli;
    struct arguments arguments = {0};
    (void)mallopt(M_MMAP_THRESHOLD, LARGEST_ON_HEAP);
    (void)mallopt(M_TRIM_THRESHOLD, MOST_FREE_ON_HEAP);
    cli_begin(&cli, "bisque-simplify", argv);
    int status = simplify_tool_parse_arguments(&cli, &arguments, argc, argv);
    if (status == 0)
        status = simplify_tool_run(&cli, &arguments, (const char **)argv + optind,
                                   (uint32_t)(argc - optind));
    return cli_end(&cli, status);
}
