/* surface.c - opens the scans of a bake, and sets the parameters of rays.
 *
 * Each of several scans has an index space of its own. Rays are given in the space of the scan with
 * the least origin, which does not depend on the order of scans. */
#include "libbake/surface/surface.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "formats/material/channels.h"
#include "formats/file_kind.h"

enum { DETAILS = 2048 /* along the longest side of a scan: the usual resolution of a grid */ };

/* Returns whether the options leave tracing to the processor. */
static bool on_processor(const struct bake_options *options)
{
    const char *device = options->device;
    return !device || !*device || strcmp(device, "auto") == 0 || strcmp(device, "cpu") == 0;
}

static int open_grid(struct bake_scan *scan, const struct bake_options *options)
{
    if (options->scan_normals != BSQ_SCAN_NORMALS_AUTO)
        return bsq_fail(scan->ctx, BSQ_EUSAGE,
                        "%s: a grid has its own normals; choose them for triangles only",
                        scan->path);
    BSQ_PASS(fmt_nvdb_open(scan->ctx, scan->path, &scan->grid));
    int status = bake_check_grid(scan->ctx, &scan->grid);
    if (status == 0 && scan->grid.channels)
        status = fmt_channel_list_split(scan->ctx, scan->grid.channel_list,
                                        scan->grid.channel_list_bytes, &scan->own_channels,
                                        &scan->channel_count);
    if (status < 0) {
        fmt_nvdb_close(scan->ctx, &scan->grid);
        return status;
    }
    const struct fmt_nvdb_info *info = &scan->grid.info;
    scan->has_color = info->has_color;
    scan->ids = info->ids;
    memcpy(scan->scan_min, info->scan_min, sizeof scan->scan_min);
    memcpy(scan->scan_max, info->scan_max, sizeof scan->scan_max);
    memcpy(scan->translation, info->translation, sizeof scan->translation);
    scan->unit = scan->detail = info->voxel_size;
    scan->channels = scan->own_channels;
    return 0;
}

/* Checks options for triangles. */
static int check_exact(const struct bake_scan *scan, const struct bake_options *options)
{
    if (options->sampling == BAKE_NEAREST)
        return bsq_fail(scan->ctx, BSQ_EUSAGE,
                        "%s has triangles: nearest-voxel sampling needs a voxel grid", scan->path);
    return 0;
}

/* Opens a chunk file. */
static int open_exact(struct bake_scan *scan, const struct bake_options *options)
{
    BSQ_PASS(check_exact(scan, options));
    BSQ_PASS(bake_exact_open(scan->ctx, scan->path, options, &scan->exact));
    const struct fmt_tris_header *header = bake_exact_header(scan->exact);
    double side = 0;
    for (int k = 0; k < 3; k++) {
        scan->translation[k] = header->origin[k];
        scan->scan_min[k] = header->origin[k] + (double)header->bounds_min[k];
        scan->scan_max[k] = header->origin[k] + (double)header->bounds_max[k];
        side = fmax(side, scan->scan_max[k] - scan->scan_min[k]);
    }
    scan->has_color = fmt_tris_has_color(header);
    scan->ids = header->ids;
    scan->unit = 1.0;
    scan->channels = header->channels;
    scan->channel_count = header->channel_count;
    scan->detail = side / DETAILS;
    return 0;
}

static const char *scan_path(const struct bake_options *options, uint32_t index)
{
    return index == 0 ? options->scan_path : options->more_scan_paths[index - 1];
}

/* ---- all scans ---- */

/* Returns whether the index space of a scan comes before another's. */
static bool comes_first(const struct bake_scan *a, const struct bake_scan *b)
{
    for (int k = 0; k < 3; k++)
        if (a->translation[k] != b->translation[k])
            return a->translation[k] < b->translation[k];
    return a->unit < b->unit;
}

/* Sets what is known of all scans from what is known of each. */
static void join_scans(struct bake_surface *surface)
{
    const struct bake_scan *first = &surface->scans[0];
    surface->has_color = true;
    surface->ids = first->ids;
    for (int k = 0; k < 3; k++) {
        surface->scan_min[k] = INFINITY;
        surface->scan_max[k] = -INFINITY;
    }
    for (uint32_t s = 0; s < surface->scan_count; s++) {
        const struct bake_scan *scan = &surface->scans[s];
        surface->grids |= scan->exact == NULL;
        surface->triangles |= scan->exact != NULL;
        surface->has_color &= scan->has_color;
        if (scan->ids != surface->ids)
            surface->ids = FMT_IDS_NONE;
        surface->detail = fmax(surface->detail, scan->detail);
        for (int k = 0; k < 3; k++) {
            surface->scan_min[k] = fmin(surface->scan_min[k], scan->scan_min[k]);
            surface->scan_max[k] = fmax(surface->scan_max[k], scan->scan_max[k]);
        }
        if (comes_first(scan, first))
            first = scan;
    }
    memcpy(surface->translation, first->translation, sizeof surface->translation);
    surface->unit = first->unit;
}

/* Opens scan number `index` of the options. */
static int surface_open_scan(struct bake_surface *surface, const struct bake_options *options,
                             uint32_t index)
{
    struct bake_scan *scan = &surface->scans[index];
    enum fmt_kind kind = FMT_KIND_TRIS;
    *scan = (struct bake_scan){.ctx = surface->ctx, .path = scan_path(options, index)};
    BSQ_PASS(fmt_recognise_scan(surface->ctx, scan->path, &kind));
    return kind == FMT_KIND_TRIS ? open_exact(scan, options) : open_grid(scan, options);
}

int bake_surface_open(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_surface *out)
{
    int status = 0;
    *out = (struct bake_surface){.ctx = ctx};
    const uint32_t count = options->more_scan_count + 1;
    BSQ_TRY(BSQ_CALLOC(ctx, "scans", count, &out->scans));
    for (; out->scan_count < count; out->scan_count++)
        BSQ_TRY(surface_open_scan(out, options, out->scan_count));
    join_scans(out);
    if (count > 1 && out->grids && !on_processor(options))
        BSQ_TRY(bsq_fail(ctx, BSQ_EUSAGE,
                         "several scans, of which some are grids, are traced on the cpu, not on %s",
                         options->device));
done:
    if (status < 0)
        bake_surface_close(out);
    return status;
}

void bake_surface_close(struct bake_surface *surface)
{
    for (uint32_t s = 0; s < surface->scan_count; s++) {
        struct bake_scan *scan = &surface->scans[s];
        BSQ_FREE(surface->ctx, scan->transfer_words, scan->own_channels);
        if (scan->exact)
            bake_exact_close(scan->exact);
        else
            fmt_nvdb_close(surface->ctx, &scan->grid);
    }
    if (surface->ctx) {
        bsq_free(surface->ctx, surface->scans);
    }
    memset(surface, 0, sizeof *surface);
}

uint64_t bake_surface_loads(const struct bake_surface *surface)
{
    uint64_t loads = 0;
    for (uint32_t s = 0; s < surface->scan_count; s++)
        if (surface->scans[s].exact)
            loads += bake_exact_loads(surface->scans[s].exact);
    return loads;
}

int bake_surface_check(const struct bake_surface *surface)
{
    int status = 0;
    for (uint32_t s = 0; s < surface->scan_count && status == 0; s++)
        if (!surface->scans[s].exact)
            status = bsq_map_check(surface->ctx, &surface->scans[s].grid.map);
    return status;
}

int bake_surface_explain(const struct bake_surface *surface, int status)
{
    for (uint32_t s = 0; s < surface->scan_count; s++)
        if (!surface->scans[s].exact)
            status = bsq_map_explain(surface->ctx, &surface->scans[s].grid.map, status);
    return status;
}

/* ---- parameters ---- */

/* Sets the parameters of secondary rays. thickness: their length into the solid, world units; far:
 * the longest, in the scan's index space. */
static void set_secondary(const struct bake_options *options, double unit, double thickness,
                          float far, struct bk_params *params)
{
    const double half = 0.5 * options->ao_spread * 0.017453292519943295;
    params->open_rays = bake_sample_rays(options, options->ao_rays);
    params->thickness_rays = bake_sample_rays(options, options->thickness_rays);
    params->open_limit = far;
    if (options->ao_distance > 0)
        params->open_limit = fminf((float)(options->ao_distance / unit), far);
    params->coarse = options->ao_coarse > 0 ? fminf((float)options->ao_coarse, far) : far;
    params->thickness_limit = fminf((float)(thickness / unit), far);
    params->open_sine2 = (float)(sin(half) * sin(half));
    if (options->ao_falloff)
        params->flags |= BK_OPEN_FALLOFF;
}

static void set_params(const struct bake_options *options, uint32_t maps, double unit,
                       struct bk_params *params)
{
    params->maps = maps;
    params->samples = options->samples;
    params->unit = (float)unit;
    if (options->normal_space == BAKE_OBJECT_SPACE)
        params->flags |= BK_OBJECT_SPACE;
    if (options->sampling == BAKE_NEAREST)
        params->flags |= BK_NEAREST;
    if (options->two_sided)
        params->flags |= BK_TWO_SIDED;
    if (bake_has_cage(options))
        params->flags |= BK_CAGE;
    if (options->skew_path)
        params->flags |= BK_SKEW;
}

void bake_surface_set_params(struct bake_surface *surface, const struct bake_options *options,
                             uint32_t maps)
{
    const double thickness = bake_thickness_distance(options, surface->scan_min, surface->scan_max);
    for (uint32_t s = 0; s < surface->scan_count; s++) {
        struct bake_scan *scan = &surface->scans[s];
        if (!scan->exact)
            bake_params_from_grid(&scan->grid, &scan->params);
        set_params(options, maps, scan->unit, &scan->params);
        set_secondary(options, scan->unit, thickness, scan->exact ? FLT_MAX : BK_FAR,
                      &scan->params);
    }
    if (surface->scan_count == 1) {
        surface->params = surface->scans[0].params;
    } else {
        set_params(options, maps, surface->unit, &surface->params);
        set_secondary(options, surface->unit, thickness, BK_FAR, &surface->params);
    }
}

void bake_surface_set_lengths(struct bake_surface *surface, double front, double back)
{
    surface->front = front;
    surface->back = back;
    surface->params.front = (float)(front / surface->unit);
    surface->params.back = (float)(back / surface->unit);
}
