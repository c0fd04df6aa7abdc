/* bisque-compare.c - measures how far apart two maps are, and checks the figures against limits. */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include "formats/file_kind.h"
#include "libvoxel/voxel.h"
#include "tools/page.h"

static const char usage[] =
    "Usage: bisque-compare [OPTION]... A B\n"
    "       bisque-compare [OPTION]... LOW.obj SCAN.tris...\n"
    "Measures how far map A is from the reference B, as OpenEXR or PNG files: the angle between\n"
    "normals in degrees, the CIEDE2000 difference and PSNR of colours, absolute and relative\n"
    "differences of other maps.\n"
    "Of a mesh and a scan, measures the distance between both surfaces, both ways.\n"
    "Exits with 0 if all limits hold, with 1 if one does not.\n";

enum limit { MAX_MEAN, MAX_MEDIAN, MAX_P95, MAX_P99, MAX_ERROR, MIN_PSNR, MIN_AGREEMENT, LIMITS };

#define FIGURE(member) offsetof(struct bake_compare_report, member)

static const struct {
    const char *option, *name;
    size_t figure; /* place of a double in the report */
    bool smallest; /* a lower limit */
} limit_rows[LIMITS] = {
    [MAX_MEAN] = {"--max-mean", "mean", FIGURE(mean), false},
    [MAX_MEDIAN] = {"--max-median", "median", FIGURE(median), false},
    [MAX_P95] = {"--max-p95", "95th percentile", FIGURE(p95), false},
    [MAX_P99] = {"--max-p99", "99th percentile", FIGURE(p99), false},
    [MAX_ERROR] = {"--max-error", "maximum", FIGURE(max), false},
    [MIN_PSNR] = {"--min-psnr", "PSNR", FIGURE(psnr), true},
    [MIN_AGREEMENT] = {"--min-agreement", "hit agreement", FIGURE(agreement), true},
};

struct arguments {
    struct bake_compare_options compare;
    const char *mask;      /* of both maps, unless they have their own */
    const char *report;    /* a page, or NULL */
    double limits[LIMITS]; /* NAN: not given */
    const char **inputs;   /* two maps, or a mesh and the chunk files of a scan */
    uint32_t input_count;
};

/* Checks that each map has a mask of its own; without them there is no hit agreement. */
static bool has_agreement(const struct bake_compare_options *compare)
{
    return compare->a_mask_path && compare->b_mask_path &&
           compare->a_mask_path != compare->b_mask_path;
}

/* ---- arguments ---- */

#define MEMBER(kind, member) BSQ_MEMBER(kind, struct arguments, member)
#define LIMIT(limit)         MEMBER(NUMBER, limits[limit]), BSQ_RANGE(0, DBL_MAX, NAN)

static const struct bsq_option rows[] = {
    {BSQ_ROW("type", "KIND", "auto, normal, color or data"), .heading = "Comparison",
     MEMBER(CHOICE, compare.kind), .words = "auto normal color data"},
    {BSQ_ROW("mask", "FILE", "compare only texels where this mask is above 0"),
     MEMBER(INPUT, mask)},
    {BSQ_ROW("mask-a", "FILE", "mask of the texels that A covers"),
     MEMBER(INPUT, compare.a_mask_path)},
    {BSQ_ROW("mask-b", "FILE",
             "mask of the texels that B covers; with both, hit agreement is\n"
             "reported"),
     MEMBER(INPUT, compare.b_mask_path)},
    {BSQ_ROW("force", NULL, "compare maps although their attributes disagree"),
     MEMBER(FLAG, compare.force)},
    {BSQ_ROW("ignore-nan", NULL,
             "leave NaN and infinite values out; otherwise they are outside of\n"
             "every limit"),
     MEMBER(FLAG, compare.ignore_nan)},
    {BSQ_ROW("heatmap", "FILE.png", "write a picture of the error of each texel"),
     .heading = "Pictures", MEMBER(OUTPUT, compare.heatmap_path)},
    {BSQ_ROW("report", "FILE.html", "write a page with both maps side by side and their errors"),
     MEMBER(OUTPUT, report)},
    {BSQ_ROW("scale", "E", "error at the top of its scale (default: the 99th percentile)"),
     MEMBER(NUMBER, compare.scale), BSQ_RANGE(0, DBL_MAX, 0), .positive = true},
    {BSQ_ROW("max-mean", "E", "the largest mean that passes (default: none)"), .heading = "Limits",
     LIMIT(MAX_MEAN)},
    {BSQ_ROW("max-median", "E", "the largest median (default: none)"), LIMIT(MAX_MEDIAN)},
    {BSQ_ROW("max-p95", "E", "the largest 95th percentile (default: none)"), LIMIT(MAX_P95)},
    {BSQ_ROW("max-p99", "E", "the largest 99th percentile (default: none)"), LIMIT(MAX_P99)},
    {BSQ_ROW("max-error", "E", "the largest maximum (default: none)"), LIMIT(MAX_ERROR)},
    {BSQ_ROW("min-psnr", "DB", "the smallest PSNR, for colours (default: none)"), LIMIT(MIN_PSNR)},
    {BSQ_ROW("min-agreement", "S", "the smallest hit agreement, 0 to 1 (default: none)"),
     LIMIT(MIN_AGREEMENT)},
};
enum { ROWS = sizeof rows / sizeof *rows };

static int compare_tool_parse_arguments(struct cli *cli, struct arguments *arguments, int argc,
                                        char **argv)
{
    const struct cli_command command = {.usage = usage, .tables = {{rows, ROWS, arguments, NULL}}};
    bake_compare_defaults(&arguments->compare);
    bsq_options_defaults(rows, ROWS, arguments);
    int status = cli_parse(cli, &command, argc, argv);
    if (status != 0)
        return status;
    if (argc - optind < 2)
        return cli_usage(cli, "two maps, or a mesh and a scan, are needed (see --help)");
    arguments->inputs = (const char **)argv + optind;
    arguments->input_count = (uint32_t)(argc - optind);
    arguments->compare.a_path = argv[optind];
    arguments->compare.b_path = argv[optind + 1];
    double agreement = arguments->limits[MIN_AGREEMENT];
    if (agreement > 1)
        return cli_usage(cli, "--min-agreement: %g is not a share from 0 to 1", agreement);
    if (!isnan(agreement) && !has_agreement(&arguments->compare))
        return cli_usage(cli, "--min-agreement needs --mask-a and --mask-b");
    if (!arguments->compare.a_mask_path)
        arguments->compare.a_mask_path = arguments->mask;
    if (!arguments->compare.b_mask_path)
        arguments->compare.b_mask_path = arguments->mask;
    return 0;
}

static int compare_tool_check_outputs(struct cli *cli, const struct bake_compare_options *compare)
{
    const char *inputs[] = {compare->a_path, compare->b_path, compare->a_mask_path,
                            compare->b_mask_path};
    for (int i = 0; i < 4; i++)
        if (inputs[i])
            BSQ_PASS(bsq_note_input(cli->ctx, inputs[i], i < 2 ? "a map" : "a mask"));
    BSQ_PASS(cli_check_outputs(cli, &compare->heatmap_path, 1));
    if (compare->heatmap_path && !cli_ends_with(compare->heatmap_path, ".png"))
        return cli_usage(cli, "%s: the picture is a PNG file: its name must end in .png",
                         compare->heatmap_path);
    return 0;
}

/* ---- results ---- */

/* Reports the limits that do not hold on standard error; returns their number. */
static int count_failures(struct cli *cli, const struct arguments *arguments,
                          const struct bake_compare_report *report)
{
    const bool spoiled = report->not_finite > 0 && !arguments->compare.ignore_nan;
    int failures = 0;
    for (int i = 0; i < LIMITS; i++) {
        double limit = arguments->limits[i], value;
        memcpy(&value, (const char *)report + limit_rows[i].figure, sizeof value);
        bool holds = limit_rows[i].smallest ? value >= limit : value <= limit;
        failures += !isnan(limit) && (spoiled || !holds);
        if (isnan(limit) || holds)
            continue;
        fprintf(stderr, "%s: %s %.6g is %s %s %g\n", cli->program, limit_rows[i].name, value,
                limit_rows[i].smallest ? "below" : "above", limit_rows[i].option, limit);
    }
    if (spoiled && failures > 0)
        fprintf(stderr, "%s: %s NaN or infinite: outside of every limit\n", cli->program,
                cli_counted(report->not_finite, "texel is", "texels are").text);
    return failures;
}

static void compare_tool_print_report(const struct arguments *arguments,
                                      const struct bake_compare_report *report)
{
    const char *unit = bake_compare_unit(report->kind);
    cli_print("%s against %s: %s of %ux%u compared as %s\n", arguments->compare.a_path,
              arguments->compare.b_path, cli_counted(report->compared, "texel", "texels").text,
              report->width, report->height, page_kind_name(report->kind));
    cli_print("%s: mean %.4g, rms %.4g, median %.4g, p95 %.4g, p99 %.4g, max %.4g at %u,%u\n", unit,
              report->mean, report->rms, report->median, report->p95, report->p99, report->max,
              report->max_x, report->max_y);
    if (report->kind != BAKE_COMPARE_DATA)
        cli_print("share above 1: %.4g %%, above 5: %.4g %%\n", 100 * report->above_1,
                  100 * report->above_5);
    if (report->kind == BAKE_COMPARE_COLOR)
        cli_print("PSNR: %.2f dB\n", report->psnr);
    if (report->kind == BAKE_COMPARE_DATA)
        cli_print("relative: mean %.4g, max %.4g\n", report->relative_mean, report->relative_max);
    if (report->not_finite > 0)
        cli_print("NaN or infinite: %s (%llu in A, %llu in B)\n",
                  cli_counted(report->not_finite, "texel", "texels").text,
                  (unsigned long long)report->not_finite_a,
                  (unsigned long long)report->not_finite_b);
    if (has_agreement(&arguments->compare))
        cli_print("hit agreement: %.4f %% (only A %llu, only B %llu)\n", 100 * report->agreement,
                  (unsigned long long)report->only_a, (unsigned long long)report->only_b);
    if (arguments->compare.heatmap_path)
        cli_print("%s: from black, 0, to light yellow, %.4g %s and more\n",
                  arguments->compare.heatmap_path, report->scale, unit);
}

static json_t *compare_tool_report_json(const struct arguments *arguments,
                                        const struct bake_compare_report *report, int failures)
{
    json_t *root = page_comparison_json(&arguments->compare, report);
    if (root)
        json_object_set_new(root, "within_limits", json_boolean(failures == 0));
    return root;
}

static int compare_maps(struct cli *cli, struct arguments *arguments, int *failures)
{
    struct bake_compare_report report = {.size = sizeof report};
    int status;
    BSQ_TRY(compare_tool_check_outputs(cli, &arguments->compare));
    if (arguments->report)
        BSQ_TRY(bake_page_open(cli->ctx, arguments->report, &arguments->compare.page));
    BSQ_TRY(bake_compare(cli->ctx, &arguments->compare, &report));
    if (!isnan(arguments->limits[MIN_PSNR]) && report.kind != BAKE_COMPARE_COLOR)
        BSQ_TRY(cli_usage(cli, "--min-psnr is for colours, these maps were compared as %s",
                          page_kind_name(report.kind)));
    *failures = count_failures(cli, arguments, &report);
    if (arguments->compare.page)
        BSQ_TRY(page_end(cli, arguments->compare.page,
                         compare_tool_report_json(arguments, &report, *failures),
                         &(struct cli_table){rows, ROWS, arguments, NULL}));
    if (cli->json)
        status = cli_print_json(cli, compare_tool_report_json(arguments, &report, *failures));
    else
        compare_tool_print_report(arguments, &report);
done:
    bake_page_close(arguments->compare.page);
    return status;
}

/* ---- a mesh and a scan ---- */

/* Measures the distances between the surfaces. */
static int compare_tool_measure(struct cli *cli, const struct arguments *arguments,
                                struct vox_distances *from_scan, struct vox_distances *from_mesh)
{
    const char *const *inputs = arguments->inputs;
    const uint32_t count = arguments->input_count;
    struct vox_temp_tris *mesh = NULL, *scan = NULL;
    struct vox_sort_options options;
    struct vox_sort_report report = {.size = sizeof report};
    int status = 0;
    for (uint32_t i = 0; i < count; i++)
        BSQ_TRY(bsq_note_input(cli->ctx, inputs[i], i == 0 ? "the mesh" : "the scan"));
    BSQ_TRY(vox_temp_tris_create(cli->ctx, &mesh));
    vox_sort_defaults(&options);
    options.scan_paths = inputs;
    options.scan_count = 1;
    options.tris_path = inputs[0];
    options.temp_tris = mesh;
    options.scan_normals = BSQ_SCAN_NORMALS_FLAT; /* they are not used */
    BSQ_TRY(vox_sort(cli->ctx, &options, &report));
    const struct vox_join_options how = {.output_path = inputs[0],
                                         .scan_normals = BSQ_SCAN_NORMALS_FLAT};
    BSQ_TRY(cli_join(cli, inputs + 1, count - 1, &how, &scan));
    status = vox_measure_mesh(cli->ctx, inputs[1], scan, mesh, NULL, 0, from_scan, from_mesh);
done:
    vox_temp_tris_close(scan);
    vox_temp_tris_close(mesh);
    return status;
}

/* Compares a mesh with a scan; limits are about the larger figure of both directions. */
static int compare_surfaces(struct cli *cli, const struct arguments *arguments, int *failures)
{
    struct vox_distances a, b; /* from the scan; from the mesh */
    for (int i = 0; i < LIMITS; i++)
        if (!isnan(arguments->limits[i]) && i != MAX_MEAN && i != MAX_P99 && i != MAX_ERROR)
            return cli_usage(cli, "%s is for maps, not for a mesh and a scan",
                             limit_rows[i].option);
    if (arguments->report)
        return cli_usage(cli, "--report is for maps, not for a mesh and a scan");
    BSQ_PASS(compare_tool_measure(cli, arguments, &a, &b));
    *failures = count_failures(cli, arguments,
                               &(struct bake_compare_report){.mean = fmax(a.mean, b.mean),
                                                             .p99 = fmax(a.p99, b.p99),
                                                             .max = fmax(a.max, b.max)});
    if (cli->json)
        return cli_print_json(
            cli, json_pack("{s:o, s:o, s:o, s:o, s:b}", "mesh_path",
                           cli_json_text(arguments->inputs[0]), "scan_path",
                           cli_json_text(arguments->inputs[1]), "from_scan", cli_distances_json(&a),
                           "to_scan", cli_distances_json(&b), "within_limits", *failures == 0));
    cli_print("%s against the scan %s\n", arguments->inputs[0], arguments->inputs[1]);
    cli_print_distances("from the scan", &a);
    cli_print_distances("to the scan", &b);
    return 0;
}

/* Says how a mesh is compared with a scan, if that is what is meant. */
static int refuse_meshes(struct cli *cli, const struct arguments *arguments)
{
    const char *const *inputs = arguments->inputs;
    enum fmt_kind first = FMT_KIND_OTHER, last = FMT_KIND_OTHER;
    BSQ_PASS(fmt_recognise(cli->ctx, inputs[0], &first));
    BSQ_PASS(fmt_recognise(cli->ctx, inputs[arguments->input_count - 1], &last));
    if (first == FMT_KIND_TRIS && last == FMT_KIND_MESH)
        return cli_usage(cli, "%s is the scan, and %s the mesh: swap them", inputs[0],
                         inputs[arguments->input_count - 1]);
    if (first == FMT_KIND_MESH && last == FMT_KIND_MESH)
        return cli_usage(cli,
                         "%s: a mesh is compared with a scan in chunks, which bisque-voxelize %s "
                         "-o scan.tris makes",
                         inputs[arguments->input_count - 1], inputs[arguments->input_count - 1]);
    return 0;
}

static int compare(struct cli *cli, struct arguments *arguments, int *failures)
{
    bool surfaces = true; /* all inputs but the first are chunk files */
    for (uint32_t i = 1; i < arguments->input_count && surfaces; i++) {
        enum fmt_kind kind = FMT_KIND_MESH;
        BSQ_PASS(fmt_recognise(cli->ctx, arguments->inputs[i], &kind));
        surfaces = kind == FMT_KIND_TRIS;
    }
    if (!surfaces)
        BSQ_PASS(refuse_meshes(cli, arguments));
    if (surfaces)
        return compare_surfaces(cli, arguments, failures);
    if (arguments->input_count > 2)
        return cli_usage(cli, "%u files: two maps, or a mesh and chunk files, are needed",
                         arguments->input_count);
    return compare_maps(cli, arguments, failures);
}

int main(int argc, char **argv)
{
    struct cli cli;
    struct arguments arguments = {0};
    int failures = 0;
    cli_begin(&cli, "bisque-compare", argv);
    int status = compare_tool_parse_arguments(&cli, &arguments, argc, argv);
    if (status == 0)
        status = cli_create_context(&cli);
    if (status == 0)
        status = compare(&cli, &arguments, &failures);
    int code = cli_end(&cli, status);
    return code ? code : failures > 0;
}
