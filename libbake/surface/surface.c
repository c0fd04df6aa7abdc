/* surface.c - opens grids and chunk files, of which several may be one surface.
 *
 * Each of several scans has an index space of its own. Rays are given in the space of the scan with
 * the least origin, which does not depend on the order of scans. */
#include "libbake/surface/surface.h"

#include <math.h>
#include <string.h>

#include "base/channels.h"
#include "formats/file_kind.h"

enum { DETAILS = 2048 /* along the longest side of a scan: the usual resolution of a grid */ };

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

/* ---- several scans ---- */

/* Returns whether the index space of a scan comes before another's. */
static bool comes_first(const struct bake_surface *a, const struct bake_surface *b)
{
    for (int k = 0; k < 3; k++)
        if (a->translation[k] != b->translation[k])
            return a->translation[k] < b->translation[k];
    return a->unit < b->unit;
}

/* Sets what is known of all scans from what is known of each. */
static void join_parts(struct bake_surface *surface)
{
    const struct bake_surface *first = &surface->parts[0];
    surface->has_color = true;
    surface->ids = first->ids;
    for (int k = 0; k < 3; k++) {
        surface->scan_min[k] = INFINITY;
        surface->scan_max[k] = -INFINITY;
    }
    for (uint32_t p = 0; p < surface->part_count; p++) {
        const struct bake_surface *part = &surface->parts[p];
        surface->has_color &= part->has_color;
        if (part->ids != surface->ids)
            surface->ids = BSQ_IDS_NONE;
        surface->detail = fmax(surface->detail, part->detail);
        for (int k = 0; k < 3; k++) {
            surface->scan_min[k] = fmin(surface->scan_min[k], part->scan_min[k]);
            surface->scan_max[k] = fmax(surface->scan_max[k], part->scan_max[k]);
        }
        if (comes_first(part, first))
            first = part;
    }
    memcpy(surface->translation, first->translation, sizeof surface->translation);
    surface->unit = first->unit;
}

static int open_parts(struct bake_surface *surface, const struct bake_options *options)
{
    struct bake_options one = *options;
    const uint32_t count = options->more_scan_count + 1;
    one.more_scan_count = 0;
    int status = bsq_calloc(surface->ctx, "scans", count, sizeof *surface->parts, &surface->parts);
    for (uint32_t p = 0; p < count && status == 0; p++) {
        if (p > 0)
            one.scan_path = options->more_scan_paths[p - 1];
        status = bake_surface_open(surface->ctx, &one, &surface->parts[p]);
        surface->part_count += status == 0;
    }
    if (status < 0)
        bake_surface_close(surface);
    else
        join_parts(surface);
    return status;
}

/* ---- all kinds ---- */

int bake_surface_open(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_surface *out)
{
    memset(out, 0, sizeof *out);
    out->ctx = ctx;
    out->path = options->scan_path;
    int status = options->more_scan_count > 0 ? join_chunk_files(out, options) : 0;
    if (status == 0 && options->more_scan_count > 0 && !out->joined)
        return open_parts(out, options);
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

static void close_parts(struct bake_surface *surface)
{
    for (uint32_t p = 0; p < surface->part_count; p++)
        bake_surface_close(&surface->parts[p]);
    bsq_free(surface->ctx, surface->parts);
}

bool bake_surface_has_triangles(const struct bake_surface *surface)
{
    bool some = surface->exact != NULL;
    for (uint32_t p = 0; p < surface->part_count; p++)
        some |= surface->parts[p].exact != NULL;
    return some;
}

void bake_surface_close(struct bake_surface *surface)
{
    if (surface->parts)
        close_parts(surface);
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
