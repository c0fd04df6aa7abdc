/* bake_report.c - see bake_report.h. */
#include "tools/bake_report.h"

/* Hints are given above this percentage of samples that miss, of samples in overlapping charts, or
 * of triangles outside the map. */
enum { HINT_PERCENT = 5 };

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

int bake_report_devices(struct cli *cli)
{
    struct device_list list = {.json = cli->json ? json_array() : NULL};
    int status = bake_list_devices(cli->ctx, list_device, &list);
    if (cli->json && status == 0)
        status = cli_print_json(cli, list.failed ? NULL : json_pack("{s:O}", "devices", list.json));
    json_decref(list.json);
    return status;
}

/* ---- maps ---- */

static double percent(uint64_t part, uint64_t whole)
{
    return whole > 0 ? 100.0 * (double)part / (double)whole : 0;
}

static void hint_at_misses(struct cli *cli, const struct bake_arguments *arguments,
                           const struct bake_report *report)
{
    uint64_t samples = report->hits + report->misses;
    if (percent(report->misses, samples) <= HINT_PERCENT)
        return;
    bsq_warn(cli->ctx,
             "%.1f %% of the samples found no surface within %g in front and %g behind: "
             "try a larger --front and --back%s",
             percent(report->misses, samples), report->front, report->back,
             arguments->bake.two_sided ? ""
                                       : ", or --two-sided if the scan's faces are wound inwards");
}

static void hint_at_overlaps(struct cli *cli, const struct bake_report *report)
{
    if (percent(report->overlapping_samples, report->samples) > HINT_PERCENT)
        bsq_warn(
            cli->ctx,
            "%.1f %% of the samples lie in several triangles, because charts overlap: they show "
            "the first of these triangles in the file",
            percent(report->overlapping_samples, report->samples));
}

static void hint_at_outside(struct cli *cli, const struct bake_report *report)
{
    char triangles[CLI_TEXT];
    if (percent(report->outside_uv_triangles, report->low_triangles) > HINT_PERCENT)
        bsq_warn(
            cli->ctx,
            "texture coordinates of %s reach out of 0..1: parts outside, such as other UDIM tiles, "
            "are not baked",
            cli_counted_text(report->outside_uv_triangles, "triangle", "triangles", triangles));
}

static void print_report(const struct cli *cli, const struct bake_arguments *arguments,
                         const struct bake_report *report, char *const *paths)
{
    const struct bake_options *bake = &arguments->bake;
    char triangles[CLI_TEXT], texels[CLI_TEXT], samples[CLI_TEXT], misses[CLI_TEXT];
    printf("%s: %s, %s of %ux%u texels covered\n", bake->mesh_path,
           cli_counted_text(report->low_triangles, "triangle", "triangles", triangles),
           cli_count_text(report->covered_texels, texels), bake->width, bake->height);
    const char *first = "left out: ";
    const char *next =
        cli_print_count(first, report->degenerate_uv_triangles, "triangle without area in UV space",
                        "triangles without area in UV space");
    next = cli_print_count(next, report->outside_uv_triangles,
                           "triangle reaching out of 0..1 in UV space",
                           "triangles reaching out of 0..1 in UV space");
    next = cli_print_count(next, report->overlapping_samples, "sample of overlapping triangles",
                           "samples of overlapping triangles");
    if (next != first)
        putchar('\n');
    printf("%s: %s, %s without surface (%.2f %%), %g in front, %g behind, on %s\n", bake->scan_path,
           cli_counted_text(report->samples, "sample", "samples", samples),
           cli_count_text(report->misses, misses), percent(report->misses, report->samples),
           report->front, report->back, report->device);
    for (unsigned i = 0; bake_map_name(i); i++)
        if (paths[i])
            printf("%s: %s map\n", paths[i], bake_map_name(i));
    if (bake->preview_path)
        printf("%s: preview\n", bake->preview_path);
    printf("seconds: open %.2f, trace %.2f, padding %.2f, resolve %.2f, write %.2f, preview %.2f\n",
           report->seconds_open, report->seconds_trace, report->seconds_padding,
           report->seconds_resolve, report->seconds_write, report->seconds_preview);
    if (report->kernel_calls > 0)
        printf("device: upload %.2f, kernels %.3f in %s, copies %.3f\n", report->seconds_upload,
               report->seconds_kernels,
               cli_counted_text(report->kernel_calls, "call", "calls", samples),
               report->seconds_copies);
    if (report->passes > 1)
        printf("passes: %s, because the grid is larger than the usable memory of the device\n",
               cli_count_text(report->passes, samples));
    cli_print_cost(cli);
}

static json_t *maps_json(char *const *paths)
{
    json_t *maps = json_object();
    for (unsigned i = 0; maps && bake_map_name(i); i++) {
        if (paths[i] && json_object_set_new(maps, bake_map_name(i), cli_json_text(paths[i])) != 0) {
            json_decref(maps);
            maps = NULL;
        }
    }
    return maps;
}

static int print_json(struct cli *cli, const struct bake_arguments *arguments,
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
        "seconds_copies", report->seconds_copies, "kernel_calls", (json_int_t)report->kernel_calls,
        "passes", (json_int_t)report->passes);
    return cli_print_json(cli, root);
}

int bake_report_print(struct cli *cli, const struct bake_arguments *arguments,
                      const struct bake_report *report, char *const *paths)
{
    hint_at_misses(cli, arguments, report);
    hint_at_overlaps(cli, report);
    hint_at_outside(cli, report);
    if (cli->json)
        return print_json(cli, arguments, report, paths);
    print_report(cli, arguments, report, paths);
    return 0;
}
