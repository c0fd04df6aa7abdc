/* surface_attributes.c - what hits have besides a position and a normal: colours, ids and the names
 * that they stand for, and further channels, such as roughness, for transfer maps. */
#include <stdlib.h>
#include <string.h>

#include "formats/material/channels.h"
#include "base/context.h"
#include "base/sort_array.h"
#include "formats/shading/shading.h"
#include "libbake/surface/surface.h"

/* ---- further channels ---- */

/* Returns how many of the first `end` scans have a channel. */
static uint32_t scans_with(const struct bake_surface *surface, uint32_t end, const char *name)
{
    uint32_t count = 0;
    for (const struct bake_scan *s = surface->scans; s < surface->scans + end; s++)
        for (uint32_t c = 0, has = 0; c < s->channel_count && !has; c++)
            count += has = strcmp(s->channels[c], name) == 0;
    return count;
}

int bake_surface_list_channels(const struct bake_surface *surface,
                               int (*fn)(void *arg, const char *name), void *arg)
{
    int status = 0;
    for (uint32_t s = 0; s < surface->scan_count; s++)
        for (uint32_t c = 0; c < surface->scans[s].channel_count && status == 0; c++) {
            const char *name = surface->scans[s].channels[c];
            /* A normal map belongs to the scan's normals. */
            if (strcmp(name, FMT_CHANNEL_NORMAL_MAP) == 0 || scans_with(surface, s, name) > 0)
                continue;
            if (scans_with(surface, surface->scan_count, name) == surface->scan_count)
                status = fn(arg, name);
            else
                status = bsq_warn_loss(surface->ctx,
                                       "the scans do not all have the channel %s: no map "
                                       "transfer:%s is baked",
                                       name, name);
        }
    return status;
}

/* ---- use ---- */

/* Finds the channel of a transfer map in a grid. */
static int attributes_find_channel(const struct bake_scan *scan,
                                   const struct bake_transfer *transfer, uint32_t *word)
{
    const struct fmt_nvdb_grid *grid = &scan->grid;
    const char *name = transfer->name, *texture = transfer->texture_path;
    uint32_t first = 0;
    const struct fmt_channel *channel =
        grid->channels
            ? fmt_channel_list_find(grid->channel_list, grid->channel_list_bytes, name, &first)
            : NULL;
    if (texture)
        return bsq_fail(scan->ctx, BSQ_EDATA,
                        "%s is a grid, which cannot use %s: make it with bisque-voxelize "
                        "--channels %s=%s",
                        scan->path, texture, name, texture);
    if (!channel)
        return bsq_fail(scan->ctx, BSQ_EDATA,
                        "%s has no channel %s: make it with bisque-voxelize --channels %s",
                        scan->path, name, name);
    if (first + channel->values > grid->channel_words) /* another process changed it */
        return bsq_fail(scan->ctx, BSQ_EIO, "%s: was changed while it was read", scan->path);
    *word = first << 2 | channel->values;
    return 0;
}

/* Finds the channels of transfer maps, and lets devices leave out what no map needs. */
static int use_grid(struct bake_scan *scan, const struct bake_options *options, uint32_t maps)
{
    struct fmt_nvdb_grid *grid = &scan->grid;
    const uint32_t count = options->transfer_count;
    if (options->scan_normal_map)
        return bsq_fail(scan->ctx, BSQ_EUSAGE,
                        "%s: a grid has no texture coordinates for the normal map %s; bake from "
                        "the chunk file, or give the image to bisque-voxelize",
                        scan->path, options->scan_normal_map);
    if (!(maps & BAKE_MAP_ID))
        grid->ids = NULL;
    if (count == 0)
        grid->channels = NULL;
    if (count > 0)
        BSQ_PASS(BSQ_ALLOC(scan->ctx, "transfer maps", count, &scan->transfer_words));
    for (uint32_t i = 0; i < count; i++)
        BSQ_PASS(attributes_find_channel(scan, &options->transfers[i], &scan->transfer_words[i]));
    grid->transfers = scan->transfer_words;
    grid->transfer_count = count;
    return 0;
}

int bake_surface_use(struct bake_surface *surface, const struct bake_options *options,
                     uint32_t maps)
{
    const uint32_t scans = options->more_scan_count + 1;
    const char *normal_map = options->scan_normal_map;
    for (uint32_t i = 0; i < options->transfer_count && scans > 1; i++)
        if (options->transfers[i].texture_path)
            return bsq_fail(surface->ctx, BSQ_EUSAGE,
                            "%s is a texture of one scan, but there are %u scans",
                            options->transfers[i].texture_path, scans);
    if (normal_map && surface->scan_count > 1)
        return bsq_fail(surface->ctx, BSQ_EUSAGE,
                        "%s is the normal map of one scan, but there are %u scans", normal_map,
                        scans);
    for (uint32_t s = 0; s < surface->scan_count; s++) {
        struct bake_scan *scan = &surface->scans[s];
        BSQ_PASS(scan->exact ? bake_exact_use(scan->exact, options, maps)
                             : use_grid(scan, options, maps));
    }
    return 0;
}

/* ---- names of ids ---- */

/* The report's list while it grows. */
struct id_names {
    struct bsq_ctx *ctx;
    struct bake_report *report;
    uint64_t capacity;
};

/* Makes space for one more entry. */
static bool attributes_reserve(struct id_names *list)
{
    if (list->report->id_count < list->capacity)
        return true;
    const uint64_t capacity = 2 * list->capacity + 16;
    struct bake_id *grown = realloc(list->report->ids, capacity * sizeof *grown);
    if (!grown)
        return false;
    list->report->ids = grown;
    list->capacity = capacity;
    return true;
}

static int attributes_add_name(void *arg, const char *name)
{
    struct id_names *list = arg;
    const uint32_t id = fmt_name_id(name);
    char *copy = attributes_reserve(list) ? strdup(name) : NULL;
    if (!copy)
        return bsq_fail(list->ctx, BSQ_ENOMEM, "no memory for the names of ids");
    list->report->ids[list->report->id_count++] =
        (struct bake_id){copy, {(uint8_t)id, (uint8_t)(id >> 8), (uint8_t)(id >> 16)}};
    return bsq_check(list->ctx);
}

/* Lists the names of one scan, each once. */
static int name_scan(struct id_names *list, const struct bake_scan *scan)
{
    const char **names;
    uint64_t count;
    if (!scan->exact)
        return fmt_nvdb_read_names(list->ctx, &scan->grid, attributes_add_name, list);
    int status = fmt_shading_id_names(list->ctx, bake_exact_header(scan->exact), &names, &count);
    for (uint64_t i = 0; i < count && status == 0; i++)
        status = attributes_add_name(list, names[i]);
    bsq_free(list->ctx, (void *)names);
    return status;
}

static int by_id_name(const void *a, const void *b)
{
    return strcmp(((const struct bake_id *)a)->name, ((const struct bake_id *)b)->name);
}

/* Sorts the names, and keeps each once. */
static void join_names(struct bake_report *report)
{
    uint64_t kept = 0;
    bsq_sort(report->ids, report->id_count, sizeof *report->ids, by_id_name);
    for (uint64_t i = 0; i < report->id_count; i++)
        if (kept > 0 && strcmp(report->ids[kept - 1].name, report->ids[i].name) == 0)
            free(report->ids[i].name);
        else
            report->ids[kept++] = report->ids[i];
    report->id_count = kept;
}

int bake_surface_report_ids(const struct bake_surface *surface, struct bake_report *report)
{
    struct id_names list = {.ctx = surface->ctx, .report = report};
    int status = 0;
    report->id_source = fmt_ids_text(surface->ids);
    if (surface->ids == FMT_IDS_COLOR)
        return 0;
    for (uint32_t s = 0; s < surface->scan_count && status == 0; s++)
        status = name_scan(&list, &surface->scans[s]);
    join_names(report);
    return status;
}
