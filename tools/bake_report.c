/* bake_report.c - see bake_report.h. */
#include "tools/bake_report.h"

#include <dirent.h>
#include <errno.h>
#include <limits.h>
#include <math.h>
#include <string.h>
#include <unistd.h>

#include "base/file.h"
#include "tools/page.h"

/* Hints are given above this percentage of samples that miss or lie in overlapping charts. */
enum { HINT_PERCENT = 5 };

/* ---- devices and tiles ---- */

/* Prints a list that callbacks filled as JSON under `name`; NULL: as lines, which they printed. */
static int end_listing(struct cli *cli, json_t *list, int status, const char *name)
{
    if (cli->json && status == 0)
        return cli_print_json(cli, json_pack("{s:o}", name, list));
    json_decref(list);
    return status;
}

struct listing {
    const struct cli *cli;
    json_t *json;
};

static void list_device(void *arg, const struct bake_device_info *device)
{
    struct listing *list = arg;
    if (list->cli->json)
        cli_json_append(&list->json,
                        json_pack("{s:o, s:o, s:I, s:b}", "id", cli_json_text(device->id), "name",
                                  cli_json_text(device->name), CLI_COUNT(device, memory_bytes),
                                  "is_gpu", (int)device->is_gpu));
    else
        cli_print("%-10s  %s, %s\n", device->id, device->name, cli_size(device->memory_bytes).text);
}

int bake_report_devices(struct cli *cli)
{
    struct listing list = {cli, cli->json ? json_array() : NULL};
    int status = bake_list_devices(cli->ctx, list_device, &list);
    return end_listing(cli, list.json, status, "devices");
}

static void list_tile(void *arg, const struct bake_tile_info *tile)
{
    struct listing *list = arg;
    if (list->cli->json)
        cli_json_append(&list->json, json_pack("{s:i, s:i, s:i, s:I}", "tile", (int)tile->tile,
                                               "width", (int)tile->width, "height",
                                               (int)tile->height, CLI_COUNT(tile, triangles)));
    else
        cli_print("%u\n", tile->tile);
}

int bake_report_tiles(struct cli *cli, const struct bake_options *options)
{
    struct listing list = {cli, cli->json ? json_array() : NULL};
    int status = bake_list_tiles(cli->ctx, options, list_tile, &list);
    return end_listing(cli, list.json, status, "tiles");
}

/* ---- maps ---- */

static double percent(uint64_t part, uint64_t whole)
{
    return whole > 0 ? 100.0 * (double)part / (double)whole : 0;
}

static void hint_at_misses(struct cli *cli, const struct bake_arguments *arguments,
                           const struct bake_report *report)
{
    const uint64_t samples = report->hits + report->misses;
    const struct bake_options *bake = &arguments->bake;
    const bool cage = bake->cage_path || bake->extrude > 0;
    const bool measured = bake->front < 0 && bake->back < 0 && !cage;
    if (percent(report->misses, samples) <= HINT_PERCENT)
        return;
    bsq_warn(cli->ctx,
             "%.1f %% of the samples found no surface within %g in front and %g behind%s: "
             "try a larger %s%s",
             percent(report->misses, samples), report->front, report->back,
             measured ? ", measured within a tenth of the scan's diagonal" : "",
             bake->cage_path     ? "cage or --back"
             : bake->extrude > 0 ? "--extrude or --back"
                                 : "--front and --back",
             bake->two_sided ? "" : ", or --two-sided if the scan's faces are wound inwards");
}

static void hint_at_overlaps(struct cli *cli, const struct bake_arguments *arguments,
                             const struct bake_report *report)
{
    const bool by_object = strstr(arguments->bake.output_path, BAKE_OBJECT_TOKEN) != NULL;
    if (percent(report->overlapping_samples, report->samples) > HINT_PERCENT)
        bsq_warn(
            cli->ctx,
            "%.1f %% of the samples lie in several triangles, because charts overlap: they show "
            "the first of these triangles in the file%s",
            percent(report->overlapping_samples, report->samples),
            by_object ? ""
                      : "; " BAKE_OBJECT_TOKEN
                        " in the output's name gives objects maps of their own");
}

/* Returns whether objects or materials have maps of their own. */
static bool has_sets(const struct bake_report *report)
{
    return report->tile_count > 0 && (report->tiles[0].object || report->tiles[0].material);
}

static void print_coverage(const struct bake_arguments *arguments, const struct bake_report *report)
{
    const bool sets = has_sets(report);
    const struct cli_text texels = cli_count(report->covered_texels);
    cli_print("%s", arguments->bake.mesh_path);
    if (arguments->bake.more_mesh_count > 0)
        cli_print(" and %u more", arguments->bake.more_mesh_count);
    cli_print(": %s, ", cli_counted(report->low_triangles, "triangle", "triangles").text);
    if (report->tile_count == 1)
        cli_print("%s of %ux%u texels covered\n", texels.text, report->tiles[0].width,
                  report->tiles[0].height);
    else
        cli_print("%s texels covered in %s\n", texels.text,
                  cli_counted(report->tile_count, sets ? "file of a map" : "tile",
                              sets ? "files of a map" : "tiles")
                      .text);
    if (report->low_polygons > 0)
        cli_print("%s became triangles: cut them before export, so that others cut them alike\n",
                  cli_counted(report->low_polygons, "polygon", "polygons").text);
}

/* Prints how large voxels are on the map, and which would keep all of its detail. */
static void print_voxels(const struct bake_report *report)
{
    const double matching = 0.5 * report->texel;
    if (!(report->voxel > 0 && report->texel > 0))
        return;
    cli_print("a voxel is %.2g texels", report->voxel / report->texel);
    if (report->voxel > 1.1 * matching)
        cli_print("; one of half a texel would match: --voxel-size %.3g", matching);
    putchar('\n');
}

static int print_map(void *arg, const struct bake_file *file)
{
    const struct bake_report *report = (const struct bake_report *)arg;
    cli_print("%s: %s map", file->path, file->map);
    if (file->number < BAKE_MAX_MAPS && report->encodings[file->number].unit)
        cli_print(", range %g (%s)", report->encodings[file->number].range,
                  report->encodings[file->number].unit);
    putchar('\n');
    return 0;
}

static int bake_report_text(const struct cli *cli, const struct bake_arguments *arguments,
                            struct bake_report *report)
{
    const struct bake_options *bake = &arguments->bake;
    print_coverage(arguments, report);
    const char *first = "left out: ";
    const char *next =
        cli_print_count(first, report->degenerate_uv_triangles, "triangle without area in UV space",
                        "triangles without area in UV space");
    next = cli_print_count(next, report->outside_uv_triangles,
                           "triangle reaching out of the baked tiles",
                           "triangles reaching out of the baked tiles");
    next = cli_print_count(next, report->overlapping_samples, "sample of overlapping triangles",
                           "samples of overlapping triangles");
    if (next != first)
        putchar('\n');
    cli_print("%s", bake->scan_path);
    if (bake->more_scan_count > 0)
        cli_print(" and %u more", bake->more_scan_count);
    cli_print(": %s, %s without surface (%.2f %%), %g in front, %g behind, on %s\n",
              cli_counted(report->samples, "sample", "samples").text,
              cli_count(report->misses).text, percent(report->misses, report->samples),
              report->front, report->back, report->device);
    print_voxels(report);
    for (uint32_t i = 0; i < report->tile_count; i++)
        BSQ_PASS(bake_list_files(cli->ctx, bake, &report->tiles[i], print_map, report));
    if (bake->preview_path)
        cli_print("%s: preview\n", bake->preview_path);
    if (bake->glb_path)
        cli_print("%s: low-poly mesh with its maps\n", bake->glb_path);
    if (bake->page)
        cli_print("%s: report\n", bake->page_path);
    cli_print(
        "seconds: open %.2f, trace %.2f, padding %.2f, resolve %.2f, write %.2f, preview %.2f\n",
        report->seconds_open, report->seconds_trace, report->seconds_padding,
        report->seconds_resolve, report->seconds_write, report->seconds_preview);
    if (report->kernel_calls > 0)
        cli_print("device: upload %.2f, kernels %.3f in %s, copies %.3f\n", report->seconds_upload,
                  report->seconds_kernels, cli_counted(report->kernel_calls, "call", "calls").text,
                  report->seconds_copies);
    if (report->chunk_loads > 0)
        cli_print("scan: %s\n",
                  cli_counted(report->chunk_loads, "chunk loaded", "chunks loaded").text);
    cli_print_cost(cli);
    return 0;
}

static int add_path(void *arg, const struct bake_file *file)
{
    cli_json_set(arg, file->map, cli_json_text(file->path));
    return 0;
}

/* Returns an object with the file of each map; without a tile, the names keep all tokens but the
 * map's. NULL: no memory. */
static json_t *maps_json(const struct cli *cli, const struct bake_options *bake,
                         const struct bake_baked_tile *tile)
{
    json_t *maps = json_object();
    if (bake_list_files(cli->ctx, bake, tile, add_path, &maps) == 0)
        return maps;
    json_decref(maps);
    return NULL;
}

static json_t *tiles_json(const struct cli *cli, const struct bake_options *bake,
                          const struct bake_report *report)
{
    json_t *tiles = json_array();
    for (uint32_t i = 0; i < report->tile_count; i++) {
        const struct bake_baked_tile *tile = &report->tiles[i];
        cli_json_append(&tiles, json_pack("{s:i, s:i, s:i, s:o, s:o, s:o}", "tile", (int)tile->tile,
                                          "width", (int)tile->width, "height", (int)tile->height,
                                          "object", cli_json_text(tile->object), "material",
                                          cli_json_text(tile->material), "maps",
                                          maps_json(cli, bake, tile)));
    }
    return tiles;
}

static json_t *numbers_json(const double numbers[3], uint32_t count)
{
    return count == 1 ? json_pack("[f]", numbers[0])
                      : json_pack("[f, f, f]", numbers[0], numbers[1], numbers[2]);
}

static json_t *encoding_json(const struct bake_value_encoding *encoding)
{
    return json_pack("{s:s, s:f, s:f, s:o, s:o, s:o}", "unit", encoding->unit, "radius",
                     encoding->radius, "range", encoding->range, "scale",
                     numbers_json(encoding->scale, encoding->channels), "offset",
                     numbers_json(encoding->offset, encoding->channels), "origin",
                     numbers_json(encoding->origin, encoding->channels));
}

/* Returns how the values of the maps that have a unit are stored. */
static json_t *encodings_json(const struct bake_report *report)
{
    json_t *encodings = json_object();
    for (unsigned i = 0; bake_map_name(i); i++)
        if (report->encodings[i].unit)
            cli_json_set(&encodings, bake_map_name(i), encoding_json(&report->encodings[i]));
    return encodings;
}

/* Returns an array of paths; `first` comes before the others. NULL: no memory. */
static json_t *paths_json(const char *first, const char *const *more, uint32_t count)
{
    json_t *paths = json_array();
    for (uint32_t i = 0; i <= count; i++)
        cli_json_append(&paths, cli_json_text(i ? more[i - 1] : first));
    return paths;
}

/* Returns what ids tell apart, and each name with its colour; null without ids. */
static json_t *ids_json(const struct bake_report *report)
{
    json_t *names = json_array();
    for (uint64_t i = 0; i < report->id_count; i++) {
        const struct bake_id *id = &report->ids[i];
        char color[8];
        snprintf(color, sizeof color, "#%02x%02x%02x", id->color[0], id->color[1], id->color[2]);
        cli_json_append(&names,
                        json_pack("{s:o, s:s}", "name", cli_json_text(id->name), "color", color));
    }
    if (report->id_source)
        return json_pack("{s:s, s:o}", "source", report->id_source, "names", names);
    json_decref(names);
    return json_null();
}

static json_t *bake_report_json(const struct cli *cli, const struct bake_arguments *arguments,
                                const struct bake_report *report)
{
    static const char *const up_words[] = {NULL, "y", "z"};
    const struct bake_options *bake = &arguments->bake;
    return json_pack(
        "{s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:s*, s:i, s:i, s:i, s:o, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:f, s:f,"
        " s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:I, s:I, s:f, s:f}",
        "scan_path", cli_json_text(bake->scan_path), "scan_paths",
        paths_json(bake->scan_path, bake->more_scan_paths, bake->more_scan_count), "mesh_path",
        cli_json_text(bake->mesh_path), "mesh_paths",
        paths_json(bake->mesh_path, bake->more_mesh_paths, bake->more_mesh_count), "maps",
        maps_json(cli, bake, NULL), "tiles", tiles_json(cli, bake, report), "encodings",
        encodings_json(report), "ids", ids_json(report), "glb_path", cli_json_text(bake->glb_path),
        "preview_path", cli_json_text(bake->preview_path), "preview_up",
        up_words[report->preview_up], "width", (int)bake->width, "height", (int)bake->height,
        "samples_per_axis", (int)bake->samples, "device", cli_json_text(report->device),
        CLI_COUNT(report, low_triangles), CLI_COUNT(report, low_polygons),
        CLI_COUNT(report, degenerate_uv_triangles), CLI_COUNT(report, outside_uv_triangles),
        CLI_COUNT(report, covered_texels), CLI_COUNT(report, samples), CLI_COUNT(report, hits),
        CLI_COUNT(report, misses), CLI_COUNT(report, overlapping_samples), CLI_VALUE(report, front),
        CLI_VALUE(report, back), CLI_VALUE(report, seconds_open), CLI_VALUE(report, seconds_trace),
        CLI_VALUE(report, seconds_padding), CLI_VALUE(report, seconds_resolve),
        CLI_VALUE(report, seconds_write), CLI_VALUE(report, seconds_preview),
        CLI_VALUE(report, seconds_upload), CLI_VALUE(report, seconds_kernels),
        CLI_VALUE(report, seconds_copies), CLI_COUNT(report, kernel_calls),
        CLI_COUNT(report, chunk_loads), CLI_VALUE(report, texel), CLI_VALUE(report, voxel));
}

/* ---- comparisons with a reference ---- */

int bake_report_note_references(struct cli *cli, const char *folder)
{
    DIR *directory = opendir(folder);
    int status = 0;
    if (!directory)
        return bsq_fail(cli->ctx, BSQ_ENOINPUT, "%s: %s", folder, strerror(errno));
    for (struct dirent *entry; status == 0 && (entry = readdir(directory));) {
        char path[PATH_MAX];
        if (snprintf(path, sizeof path, "%s/%s", folder, entry->d_name) < PATH_MAX)
            status = bsq_note_input(cli->ctx, path, "a reference");
    }
    closedir(directory);
    return status;
}

struct references {
    struct cli *cli;
    const char *folder;
    struct bake_page *page;
    bool seeks_masks;        /* only finds those of a UDIM tile */
    char masks[2][PATH_MAX]; /* of the maps and of the references; "": none */
    json_t *comparisons;
};

/* Compares a map with its reference, if it has one; prints the figures and shows both on the page.
 */
static int compare_map(void *arg, const struct bake_file *file)
{
    struct references *r = arg;
    const bool is_mask = strcmp(file->map, "mask") == 0, masked = !is_mask && r->masks[0][0];
    struct bake_compare_options options;
    struct bake_compare_report report = {.size = sizeof report};
    char path[PATH_MAX];
    const int length = snprintf(path, sizeof path, "%s/%s", r->folder, bsq_file_name(file->path));
    if (length >= PATH_MAX || access(path, R_OK) != 0 || (r->seeks_masks && !is_mask))
        return 0;
    if (r->seeks_masks) {
        snprintf(r->masks[0], PATH_MAX, "%s", file->path);
        memcpy(r->masks[1], path, sizeof path);
        return 0;
    }
    bake_compare_defaults(&options);
    options.a_path = file->path;
    options.b_path = path;
    options.a_mask_path = masked ? r->masks[0] : NULL;
    options.b_mask_path = masked ? r->masks[1] : NULL;
    options.page = r->page;
    BSQ_PASS(bake_compare(r->cli->ctx, &options, &report));
    cli_json_append(&r->comparisons, page_comparison_json(&options, &report));
    if (!r->cli->json)
        cli_print("%s against %s: mean %.4g, p99 %.4g, max %.4g (%s)\n", file->path, path,
                  report.mean, report.p99, report.max, bake_compare_unit(report.kind));
    return 0;
}

/* Compares all maps that have a reference. Sets *comparisons to a list, or NULL without memory. */
static int bake_report_compare_maps(struct cli *cli, const struct bake_options *bake,
                                    const struct bake_report *report, json_t **comparisons)
{
    struct references r = {cli, bake->reference_path, bake->page, false, {"", ""}, json_array()};
    int status = 0;
    for (uint32_t i = 0; r.folder && i < 2 * report->tile_count && status == 0; i++) {
        r.seeks_masks = i % 2 == 0;
        if (r.seeks_masks)
            r.masks[0][0] = '\0';
        status = bake_list_files(cli->ctx, bake, &report->tiles[i / 2], compare_map, &r);
    }
    *comparisons = r.comparisons;
    return status;
}

int bake_report_print(struct cli *cli, const struct bake_arguments *arguments,
                      struct bake_report *report)
{
    const struct bake_options *bake = &arguments->bake;
    const struct cli_table table = bake_arguments_table(arguments);
    json_t *root = NULL, *comparisons = NULL;
    int status = 0;
    hint_at_misses(cli, arguments, report);
    hint_at_overlaps(cli, arguments, report);
    BSQ_TRY(bake_report_compare_maps(cli, bake, report, &comparisons));
    root = bake_report_json(cli, arguments, report);
    cli_json_set(&root, "comparisons", json_incref(comparisons));
    if (bake->page)
        BSQ_TRY(page_end(cli, bake->page, json_incref(root), &table));
    status = cli->json ? cli_print_json(cli, json_incref(root))
                       : bake_report_text(cli, arguments, report);
done:
    json_decref(comparisons);
    json_decref(root);
    return status;
}

int bake_report_print_part(struct cli *cli, const struct bake_arguments *arguments,
                           const struct bake_report *report)
{
    const struct bake_options *bake = &arguments->bake;
    char part[CLI_TEXT];
    snprintf(part, sizeof part, "part %u/%u", bake->part, bake->parts);
    if (report->done)
        return cli_say_kept(cli, bake->output_path, part);
    if (cli->json)
        return cli_print_json(
            cli, json_pack("{s:o, s:b, s:i, s:i, s:o, s:I, s:I, s:I, s:I, s:f, s:f}", "path",
                           cli_json_text(bake->output_path), "kept", 0, "part", (int)bake->part,
                           "parts", (int)bake->parts, "device", cli_json_text(report->device),
                           CLI_COUNT(report, covered_texels), CLI_COUNT(report, samples),
                           CLI_COUNT(report, hits), CLI_COUNT(report, misses),
                           CLI_VALUE(report, front), CLI_VALUE(report, back)));
    cli_print("%s: %s, %s, %s without surface", bake->output_path, part,
              cli_counted(report->samples, "sample", "samples").text,
              cli_count(report->misses).text);
    if (report->device[0])
        cli_print(", on %s", report->device);
    putchar('\n');
    cli_print_cost(cli);
    return 0;
}

bool bake_report_too_many_missed(const struct cli *cli, const struct bake_arguments *arguments,
                                 const struct bake_report *report)
{
    const double missed = percent(report->misses, report->samples);
    if (missed <= arguments->bake.max_missed)
        return false;
    fprintf(stderr, "%s: %g %% of the samples found no surface, more than --max-missed %g\n",
            cli->program, missed, arguments->bake.max_missed);
    return true;
}

/* Says before tracing how long a bake is expected to take, if that is long. */
static void say_expected(struct cli *cli, const char *stage)
{
    enum { LEAST_SECONDS = 5 };
    const struct bake_report *report = (const struct bake_report *)cli->watched;
    const unsigned threads = bsq_threads(cli->ctx);
    const double seconds = report->expected_seconds / threads;
    if (strcmp(stage, "tracing") != 0 || seconds < LEAST_SECONDS)
        return;
    cli->on_stage = NULL; /* once, not for each UDIM tile */
    cli_clear_bar(cli);
    fprintf(stderr, "%s: %s, about %.0f:%02.0f with %s\n", cli->program,
            cli_counted(report->expected_rays, "ray", "rays").text, floor(seconds / 60),
            floor(fmod(seconds, 60)), cli_counted(threads, "thread", "threads").text);
}

void bake_report_watch(struct cli *cli, const struct bake_report *report)
{
    cli->watched = report;
    cli->on_stage = report ? say_expected : NULL;
    cli->stage_counts[CLI_EACH_TILE] = report ? &report->tile_count : NULL;
    cli->stage_counts[CLI_EACH_TRACED_TILE] = report ? &report->traced_tiles : NULL;
}
