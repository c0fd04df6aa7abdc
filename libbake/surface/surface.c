/* surface.c - opens grids and chunk files, and traces rays against either. */
#include "libbake/surface/surface.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "base/channels.h"
#include "formats/file_kind.h"
#include "libbake/surface/surface_parts.h"

enum {
    RAYS_A_TASK = 256,
    DETAILS = 2048, /* along the longest side of a scan: the usual resolution of a grid */
    MAX_GRID_RAYS = 1 << 18
};

static int open_grid(struct bake_surface *surface, const struct bake_options *options)
{
    if (options->scan_normals != BSQ_SCAN_NORMALS_SMOOTH)
        return bsq_fail(surface->ctx, BSQ_EUSAGE,
                        "%s: a grid has its own normals; choose them for triangles only",
                        options->scan_path);
    int status = fmt_nvdb_open(surface->ctx, options->scan_path, &surface->grid);
    if (status < 0)
        return status;
    status = bake_check_grid(surface->ctx, &surface->grid);
    if (status < 0) {
        fmt_nvdb_close(surface->ctx, &surface->grid);
        return status;
    }
    const struct fmt_nvdb_info *info = &surface->grid.info;
    surface->has_color = info->has_color;
    surface->ids = info->ids;
    memcpy(surface->scan_min, info->scan_min, sizeof surface->scan_min);
    memcpy(surface->scan_max, info->scan_max, sizeof surface->scan_max);
    memcpy(surface->translation, info->translation, sizeof surface->translation);
    surface->unit = surface->detail = info->voxel_size;
    return 0;
}

static int check_exact(struct bsq_ctx *ctx, const struct bake_options *options)
{
    const char *device = options->device ? options->device : "auto";
    if (options->sampling == BAKE_NEAREST)
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "%s has triangles: nearest-voxel sampling needs a voxel grid",
                        options->scan_path);
    if (strcmp(device, "auto") != 0 && strcmp(device, "cpu") != 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: triangles are traced on the cpu, not on %s",
                        options->scan_path, device);
    return 0;
}

/* Opens a chunk file, or surface->joined. */
static int open_exact(struct bake_surface *surface, const struct bake_options *options)
{
    const struct bake_exact_options exact = {
        .paths = surface->joined ? surface->joined : &surface->path,
        .path_count = surface->joined ? options->more_scan_count + 1 : 1,
        .normals = options->scan_normals,
        .two_sided = options->two_sided};
    int status = check_exact(surface->ctx, options);
    if (status == 0)
        status = bake_exact_open(surface->ctx, &exact, &surface->exact);
    if (status < 0)
        return status;
    const struct bake_exact_info *info = bake_exact_get_info(surface->exact);
    double side = 0;
    for (int k = 0; k < 3; k++)
        side = fmax(side, info->scan_max[k] - info->scan_min[k]);
    surface->has_color = info->has_color;
    surface->ids = info->ids;
    memcpy(surface->scan_min, info->scan_min, sizeof surface->scan_min);
    memcpy(surface->scan_max, info->scan_max, sizeof surface->scan_max);
    memcpy(surface->translation, info->origin, sizeof surface->translation);
    surface->unit = 1.0;
    surface->detail = side / DETAILS;
    return 0;
}

/* Sets surface->joined to the paths of all scans if they are chunk files that are parts of one
 * scan. Objects that see some scans only need separate scans. */
static int join_chunk_files(struct bake_surface *surface, const struct bake_options *options)
{
    const uint32_t count = options->more_scan_count + 1;
    const char **paths;
    bool one = !options->match_names;
    int status = bsq_alloc(surface->ctx, "scans", count, sizeof *paths, &paths);
    for (uint32_t i = 0; i < count && status == 0 && one; i++) {
        enum fmt_kind kind;
        paths[i] = i == 0 ? options->scan_path : options->more_scan_paths[i - 1];
        status = fmt_recognise_scan(surface->ctx, paths[i], &kind);
        one = kind == FMT_KIND_TRIS;
    }
    if (status == 0 && one)
        status = bake_exact_can_join(surface->ctx, paths, count, &one);
    if (status == 0 && one)
        surface->joined = paths;
    else
        bsq_free(surface->ctx, paths);
    return status;
}

int bake_surface_open(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_surface *out)
{
    memset(out, 0, sizeof *out);
    out->ctx = ctx;
    out->path = options->scan_path;
    int status = options->more_scan_count > 0 ? join_chunk_files(out, options) : 0;
    if (status == 0 && options->more_scan_count > 0 && !out->joined)
        return bake_surface_open_parts(out, options);
    enum fmt_kind kind = FMT_KIND_TRIS;
    if (status == 0 && !out->joined)
        status = fmt_recognise_scan(ctx, options->scan_path, &kind);
    if (status == 0)
        status = kind == FMT_KIND_TRIS ? open_exact(out, options) : open_grid(out, options);
    if (status < 0) {
        bsq_free(ctx, out->joined);
        memset(out, 0, sizeof *out);
    }
    return status;
}

void bake_surface_close(struct bake_surface *surface)
{
    if (surface->parts)
        bake_surface_close_parts(surface);
    else if (surface->exact)
        bake_exact_close(surface->exact);
    else if (surface->ctx) {
        bsq_free(surface->ctx, surface->transfer_words);
        fmt_nvdb_close(surface->ctx, &surface->grid);
    }
    if (surface->joined)
        bsq_free(surface->ctx, surface->joined);
    memset(surface, 0, sizeof *surface);
}

int bake_surface_check(const struct bake_surface *surface)
{
    int status = 0;
    for (uint32_t p = 0; p < surface->part_count && status == 0; p++)
        status = bake_surface_check(&surface->parts[p]);
    return surface->parts || surface->exact ? status
                                            : bsq_map_check(surface->ctx, &surface->grid.map);
}

int bake_surface_explain(const struct bake_surface *surface, int status)
{
    for (uint32_t p = 0; p < surface->part_count; p++)
        status = bake_surface_explain(&surface->parts[p], status);
    return surface->parts || surface->exact || !surface->ctx
               ? status
               : bsq_map_explain(surface->ctx, &surface->grid.map, status);
}

int bake_surface_use_color(struct bake_surface *surface)
{
    int status = 0;
    for (uint32_t p = 0; p < surface->part_count && status == 0; p++)
        status = bake_surface_use_color(&surface->parts[p]);
    return surface->exact && surface->has_color ? bake_exact_use_color(surface->exact) : status;
}

int bake_surface_use_normal_map(struct bake_surface *surface, const struct bake_options *options)
{
    const char *path = options->scan_normal_map;
    int status = 0;
    if (path && surface->parts)
        return bsq_fail(surface->ctx, BSQ_EUSAGE,
                        "%s is the normal map of one scan, but there are %u scans", path,
                        options->more_scan_count + 1);
    for (uint32_t p = 0; p < surface->part_count && status == 0; p++)
        status = bake_surface_use_normal_map(&surface->parts[p], options);
    if (surface->exact)
        return bake_exact_use_normal_map(surface->exact, path);
    if (path && !surface->parts)
        return bsq_fail(surface->ctx, BSQ_EUSAGE,
                        "%s: a grid has no texture coordinates for the normal map %s; bake from "
                        "the chunk file, or give the image to bisque-voxelize",
                        surface->path, path);
    return status;
}

struct bake_scan_facts bake_surface_facts(const struct bake_surface *surface)
{
    return (struct bake_scan_facts){.has_color = surface->has_color,
                                    .has_ids = surface->ids != BSQ_IDS_NONE};
}

int bake_inspect_scan(struct bsq_ctx *ctx, const char *path, struct bake_scan_info *out)
{
    struct bake_options options;
    struct bake_surface surface;
    bake_defaults(&options);
    options.scan_path = path;
    int status = bake_surface_open(ctx, &options, &surface);
    if (status < 0)
        return status;
    *out = (struct bake_scan_info){.is_grid = !surface.exact,
                                   .has_normals = !surface.exact ||
                                                  bake_exact_get_info(surface.exact)->has_normals,
                                   .has_color = surface.has_color};
    bake_surface_close(&surface);
    return 0;
}

/* ---- rays ---- */

struct grid_trace {
    const struct bake_surface *surface;
    const struct bk_params *params;
    const struct bake_surface_rays *rays;
};

_Static_assert(sizeof(struct bake_exact_ray) == 6 * sizeof(float), "rays are read as floats");

static int trace_grid_rays(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    const struct grid_trace *trace = arg;
    const struct bake_surface_rays *rays = trace->rays;
    const double unit = trace->surface->unit;
    const uint64_t begin = task * RAYS_A_TASK, left = rays->count - begin;
    struct bake_ray_batch lines = {
        .rays = (const float(*)[6])(const void *)(rays->rays + begin),
        .count = left < RAYS_A_TASK ? left : RAYS_A_TASK,
        .t_min = (float)(rays->t_min / unit),
        .t_max = (float)(rays->t_max / unit),
        .facing = rays->facing_origin ? -1.0f : 1.0f,
    };
    float starts[RAYS_A_TASK];
    struct bk_hit hits[RAYS_A_TASK];
    if (rays->starts) {
        for (uint64_t i = 0; i < lines.count; i++)
            starts[i] = (float)((double)rays->starts[begin + i] / unit);
        lines.starts = starts;
    }
    bake_trace_rays(&trace->surface->grid, trace->params, &lines, hits);
    for (uint64_t i = 0; i < lines.count; i++) {
        struct bake_exact_hit *out = &rays->hits[begin + i];
        *out = (struct bake_exact_hit){.triangle = hits[i].found ? 0 : BAKE_EXACT_NONE,
                                       .t = (double)hits[i].t * unit};
        memcpy(out->normal, hits[i].normal, sizeof out->normal);
        memcpy(out->color, hits[i].color, sizeof out->color);
    }
    return 0;
}

static int trace_exact(const struct bake_surface *surface, const struct bake_surface_rays *rays)
{
    int status = 0;
    for (uint64_t at = 0; status == 0 && at < rays->count;) {
        const uint64_t most = bake_exact_capacity(surface->exact, 0), left = rays->count - at;
        const struct bake_exact_batch batch = {.rays = rays->rays + at,
                                               .hits = rays->hits + at,
                                               .count = left < most ? left : most,
                                               .t_min = rays->t_min,
                                               .t_max = rays->t_max,
                                               .distances_only = rays->distances_only,
                                               .facing_origin = rays->facing_origin};
        status = bake_exact_trace(surface->exact, &batch);
        at += batch.count;
    }
    return status;
}

int bake_surface_trace(const struct bake_surface *surface, const struct bk_params *params,
                       const struct bake_surface_rays *rays)
{
    struct grid_trace trace = {surface, params, rays};
    if (surface->parts)
        return bake_surface_trace_parts(surface, params, rays);
    if (surface->exact)
        return trace_exact(surface, rays);
    return bsq_parallel_for(surface->ctx, (rays->count + RAYS_A_TASK - 1) / RAYS_A_TASK,
                            trace_grid_rays, &trace);
}

uint64_t bake_surface_capacity(const struct bake_surface *surface)
{
    if (surface->parts)
        return bake_surface_parts_capacity(surface);
    if (surface->exact)
        return bake_exact_capacity(surface->exact, 0);
    const uint64_t ray = sizeof(struct bake_exact_ray) + sizeof(struct bake_exact_hit);
    const uint64_t most = bsq_memory_left(surface->ctx) / 8 / ray;
    return most < 1 ? 1 : most > MAX_GRID_RAYS ? MAX_GRID_RAYS : most;
}
