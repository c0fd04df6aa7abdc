/* bake_inputs.c - opens the inputs of a bake, and sets the parameters of its rays. */
#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "libbake/bake_job.h"
#include "libbake/bake_options.h"

int bake_find_maps(struct bsq_ctx *ctx, const char *scan_path, uint32_t asked, uint32_t *out)
{
    bool has_color = false;
    int status = 0;
    if (asked == BAKE_MAPS_DEFAULT || asked & BAKE_MAPS_ALL)
        status = bake_scan_has_color(ctx, scan_path, &has_color);
    *out = status == 0 ? bake_choose_maps(asked, has_color) : asked;
    return status;
}

/* Chooses the maps, after the scan was opened. Errors: BSQ_EDATA if it lacks colours. */
static int choose_maps(struct bake_run *job)
{
    bool has_color = job->surface.has_color;
    job->maps = bake_choose_maps(job->options->maps, has_color);
    for (unsigned i = 0; i < BK_MAP_COUNT; ++i)
        if (job->maps & 1u << i && bake_map_table[i].needs_color && !has_color)
            return bsq_fail(job->ctx, BSQ_EDATA, "%s has no colour; leave %s out of --maps",
                            job->options->scan_path, bake_map_names[i]);
    return bake_check_maps(job->ctx, job->options, job->maps);
}

/* Notes the tiles and their sizes in the report. */
static int report_tiles(struct bake_run *job)
{
    struct bake_report *report = job->report;
    assert(job->udim.count > 0);
    report->tiles = calloc(job->udim.count, sizeof *report->tiles);
    if (!report->tiles)
        return bsq_fail(job->ctx, BSQ_ENOMEM, "out of memory");
    report->tile_count = job->udim.count;
    for (uint32_t i = 0; i < job->udim.count; ++i)
        report->tiles[i] = (struct bake_tile_size){.tile = job->tiles[i].place.number,
                                                   .width = job->tiles[i].options.width,
                                                   .height = job->tiles[i].options.height};
    return 0;
}

static int begin_tiles(struct bake_run *job)
{
    int status = bake_udim_find(job->ctx, job->options, &job->mesh, &job->udim);
    if (status == 0)
        status = bsq_calloc(job->ctx, "tiles", job->udim.count, sizeof *job->tiles, &job->tiles);
    for (uint32_t i = 0; i < job->udim.count && status == 0; ++i)
        status =
            bake_tile_begin(job->ctx, job->options, job->maps, &job->udim.tiles[i], &job->tiles[i]);
    job->report->outside_uv_triangles = job->udim.outside_triangles;
    return status < 0 ? status : report_tiles(job);
}

int bake_open_inputs(struct bake_run *job)
{
    int status = bake_check_options(job->ctx, job->options);
    if (status < 0)
        return status;
    status = bake_surface_open(job->ctx, job->options, &job->surface);
    if (status < 0)
        return status;
    status = choose_maps(job);
    if (status == 0 && job->maps & BAKE_MAP_COLOR)
        status = bake_surface_use_color(&job->surface);
    if (status < 0)
        return status;
    const struct bake_lowmesh_options low = {.path = job->options->mesh_path,
                                             .cage_path = job->options->cage_path,
                                             .rays = job->options->rays};
    status = bake_lowmesh_load(job->ctx, &low, &job->mesh);
    if (status < 0)
        return status;
    job->report->low_triangles = job->mesh.triangle_count;
    return begin_tiles(job);
}

/* ---- parameters ---- */

static int choose_distances(struct bake_run *job)
{
    const struct bake_options *options = job->options;
    struct bk_params *params = &job->traced.params;
    double front = options->front, back = options->back;
    if ((front < 0 && !options->cage_path) || back < 0) {
        int status = bake_measure_distances(&job->surface, params, &job->mesh, &front, &back);
        if (status < 0)
            return status;
        if (options->front >= 0)
            front = options->front;
        if (options->back >= 0)
            back = options->back;
    }
    if (options->cage_path)
        front = job->mesh.cage_distance;
    job->report->front = front;
    job->report->back = back;
    params->front = (float)(front / job->surface.unit);
    params->back = (float)(back / job->surface.unit);
    return 0;
}

/* Sets what rays from hits have in common, in index space. */
static void set_rays(const struct bake_run *job, struct bk_params *params)
{
    const struct bake_options *options = job->options;
    const struct bake_surface *surface = &job->surface;
    const double half = 0.5 * options->ao_spread * 0.017453292519943295;
    const double thickness = bake_thickness_distance(options, surface->scan_min, surface->scan_max);
    const float far = surface->exact ? FLT_MAX : BK_FAR;
    params->open_rays = options->ao_rays;
    params->thickness_rays = options->thickness_rays;
    params->open_limit = far;
    if (options->ao_distance > 0)
        params->open_limit = fminf((float)(options->ao_distance / surface->unit), far);
    params->thickness_limit = fminf((float)(thickness / surface->unit), far);
    params->open_sine2 = (float)(sin(half) * sin(half));
    if (options->ao_falloff)
        params->flags |= BK_OPEN_FALLOFF;
}

int bake_set_params(struct bake_run *job)
{
    const struct bake_options *options = job->options;
    struct bk_params *params = &job->traced.params;
    if (!job->surface.exact)
        bake_params_from_grid(&job->surface.grid, params);
    params->maps = job->maps;
    params->samples = options->samples;
    params->unit = (float)job->surface.unit;
    if (options->normal_space == BAKE_OBJECT_SPACE)
        params->flags |= BK_OBJECT_SPACE;
    if (options->sampling == BAKE_NEAREST)
        params->flags |= BK_NEAREST;
    if (options->two_sided)
        params->flags |= BK_TWO_SIDED;
    if (options->cage_path)
        params->flags |= BK_CAGE;
    set_rays(job, params);
    return choose_distances(job);
}
