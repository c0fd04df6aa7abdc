/* tile_bake.c - see tile_bake.h. */
#include "libbake/tile_bake.h"

#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "base/file.h"
#include "base/output.h"

int bake_tile_begin(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps,
                    const struct bake_low_set *set, const struct bake_udim_tile *place,
                    struct bake_tile *out)
{
    *out = (struct bake_tile){.place = *place,
                              .options = *options,
                              .maps = maps,
                              .object = set ? set->object : NULL,
                              .material = set ? set->material : NULL};
    bake_tile_size_of(options, place->number, &out->options.width, &out->options.height);
    char *path = bake_object_path(options->output_path, out->object, out->material);
    out->output_path = path ? bake_tile_path(path, place->number) : NULL;
    free(path);
    out->options.output_path = out->output_path;
    if (out->output_path)
        out->beside = bake_path_of(&out->options, bake_first_of(maps));
    return out->beside ? 0 : bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", options->output_path);
}

void bake_tile_end(struct bsq_ctx *ctx, struct bake_tile *tile)
{
    bake_raster_free(tile->raster);
    bake_image_free(tile->image);
    bsq_free(ctx, (void *)(uintptr_t)tile->blocks.slots); /* sample_blocks has the same */
    bake_map_files_discard(tile->files);
    bake_thumbnail_free(ctx, &tile->normal);
    bake_thumbnail_free(ctx, &tile->color);
    bake_thumbnail_free(ctx, &tile->missed);
    free(tile->output_path);
    free(tile->beside);
    memset(tile, 0, sizeof *tile);
}

int bake_tile_rasterise(const struct bake_tile_scene *scene, struct bake_tile *tile,
                        struct bake_report *report)
{
    const struct bake_options *options = &tile->options;
    /* On several scans, a sample of a texel is a texel of the raster. */
    const uint32_t n = scene->surface->part_count > 0 ? options->samples : 1;
    const uint32_t width = options->width * n, height = options->height * n;
    const uint32_t samples = options->samples / n;
    if (width / n != options->width || height / n != options->height)
        return bsq_fail(
            scene->ctx, BSQ_EUSAGE,
            "a map of %u x %u texels is too large for %u x %u samples a texel of several scans",
            options->width, options->height, n, n);
    if (tile->in_blocks && tile->blocks.count > UINT32_MAX / n / tile->blocks.side)
        return bsq_fail(scene->ctx, BSQ_EUSAGE,
                        "a task has too many texels for %u x %u samples of several scans: make a "
                        "plan of more tasks",
                        n, n);
    tile->tile_size = bake_tile_size(scene->ctx, width, height, samples, tile->maps);
    tile->sample_blocks = tile->blocks;
    tile->sample_blocks.side *= n;
    while (tile->in_blocks && tile->sample_blocks.side % tile->tile_size != 0)
        tile->tile_size /= 2;
    const struct bake_raster_options raster = {.width = width,
                                               .height = height,
                                               .samples = samples,
                                               .tile_size = tile->tile_size,
                                               .first = tile->place.first,
                                               .count = tile->place.count,
                                               .blocks =
                                                   tile->in_blocks ? &tile->sample_blocks : NULL,
                                               .skew = tile->skew};
    struct bake_raster_report counts = {0};
    int status = bake_raster_create(scene->ctx, scene->mesh, &raster, &counts, &tile->raster);
    if (status < 0)
        return status;
    report->degenerate_uv_triangles += counts.degenerate_triangles;
    bake_raster_kernel_triangles(tile->raster, scene->surface->translation, scene->surface->unit,
                                 scene->triangles);
    return 0;
}

/* ---- tracing ---- */

int bake_tile_create_image(struct bsq_ctx *ctx, struct bake_tile *tile, uint64_t memory_bytes)
{
    const struct bake_blocks *blocks = &tile->blocks;
    const struct bake_image_options image = {
        .width = tile->in_blocks ? blocks->side : tile->options.width,
        .height = tile->in_blocks ? blocks->side * blocks->count : tile->options.height,
        .channels = bake_image_channels_for(tile->maps),
        .memory_bytes = memory_bytes,
        .beside = tile->beside,
        .blocks = tile->in_blocks ? blocks : NULL};
    return bake_image_create(ctx, &image, &tile->image);
}

static int trace_exact(const struct bake_tile_scene *scene, const struct bake_tiles *tiles,
                       struct bake_report *report)
{
    const struct bake_exact_tiles exact = {.tiles = *tiles,
                                           .exact = scene->surface->exact,
                                           .front = report->front,
                                           .back = report->back};
    return bake_exact_trace_tiles(scene->ctx, &exact, report);
}

int bake_tile_trace_grid(struct bsq_ctx *ctx, struct bake_device *device,
                         const struct bake_surface *surface, const struct bake_tiles *tiles,
                         struct bake_report *report)
{
    struct bake_plan plan;
    int status = bake_device_plan(device, tiles->raster, &plan);
    const struct bake_grid_tiles grid = {.tiles = *tiles,
                                         .device = device,
                                         .surface = surface,
                                         .plan = plan.pass_count > 0 ? &plan : NULL};
    const uint64_t passes = plan.pass_count > 0 ? plan.pass_count : 1;
    if (passes > report->passes)
        report->passes = passes;
    if (status == 0)
        status = bake_trace_grid_tiles(ctx, &grid, report);
    bake_plan_free(ctx, &plan);
    return status;
}

int bake_tile_trace(const struct bake_tile_scene *scene, struct bake_tile *tile,
                    uint64_t memory_bytes, struct bake_report *report)
{
    const bool several = scene->surface->part_count > 0;
    int status =
        bake_tile_create_image(scene->ctx, tile, several ? memory_bytes / 2 : memory_bytes);
    if (status < 0)
        return status;
    const struct bake_tiles tiles = {.raster = tile->raster,
                                     .triangles = scene->triangles,
                                     .triangle_count = scene->triangle_count,
                                     .params = scene->params,
                                     .image = tile->image,
                                     .tile_size = tile->tile_size};
    if (several)
        status = bake_tile_trace_scans(scene, tile, memory_bytes / 2, report);
    else
        status = scene->device ? bake_tile_trace_grid(scene->ctx, scene->device, scene->surface,
                                                      &tiles, report)
                               : trace_exact(scene, &tiles, report);
    if (!several || !scene->sees || !(tile->maps & BAKE_MAP_CURVATURE)) {
        bake_raster_free(tile->raster);
        tile->raster = NULL;
    }
    return status;
}

/* ---- files ---- */

int bake_tile_open_files(struct bsq_ctx *ctx, struct bake_tile *tile,
                         const struct bake_traced *traced)
{
    return tile->files ? 0
                       : bake_map_files_open(ctx, &tile->options, tile->maps, traced, &tile->files);
}

static int create_thumbnail(struct bsq_ctx *ctx, struct bake_tile *tile, enum bake_map map,
                            uint32_t side, struct bake_thumbnail *out)
{
    if (!(tile->maps & (uint32_t)map))
        return 0;
    bake_map_files_set_thumbnail(tile->files, map, out);
    return bake_thumbnail_create(ctx, tile->options.width, tile->options.height, side, out);
}

int bake_tile_create_thumbnails(struct bsq_ctx *ctx, struct bake_tile *tile, uint32_t side)
{
    int status = 0;
    BSQ_TRY(create_thumbnail(ctx, tile, BAKE_MAP_NORMAL, side, &tile->normal));
    BSQ_TRY(create_thumbnail(ctx, tile, BAKE_MAP_COLOR, side, &tile->color));
    BSQ_TRY(bake_thumbnail_of_missed(ctx, tile->image, side, &tile->missed));
done:
    return status;
}

/* Returns whether two paths have the same name in the same directory. */
static bool is_same_path(const char *a, const char *b)
{
    const char *const paths[] = {a, b}, *const names[] = {bsq_file_name(a), bsq_file_name(b)};
    struct stat info[2];
    if (strcmp(names[0], names[1]) != 0)
        return false;
    for (int i = 0; i < 2; ++i) {
        const size_t length = (size_t)(names[i] - paths[i]);
        char *directory = length > 0 ? strndup(paths[i], length) : NULL;
        int result = stat(directory ? directory : ".", &info[i]);
        free(directory);
        if (result != 0)
            return false;
    }
    return info[0].st_dev == info[1].st_dev && info[0].st_ino == info[1].st_ino;
}

unsigned bake_tile_file_count(const struct bake_tile *tile)
{
    unsigned count = 0;
    for (unsigned i = 0; i < bake_selection_end(tile->maps); ++i)
        count += bake_has_file(&tile->options, tile->maps, i);
    return count;
}

int bake_tile_check_files(struct bsq_ctx *ctx, const struct bake_tile *tile, const char *other)
{
    const char *preview = tile->options.preview_path;
    int status = 0;
    for (unsigned i = 0; i < bake_selection_end(tile->maps) && status == 0; ++i) {
        if (!bake_has_file(&tile->options, tile->maps, i))
            continue;
        char *path = bake_path_of(&tile->options, i);
        if (!path)
            return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", tile->output_path);
        if ((preview && is_same_path(path, preview)) || (other && is_same_path(path, other)))
            status = bsq_fail(ctx, BSQ_EUSAGE, "%s: two outputs have this name", path);
        if (status == 0)
            status = bsq_output_check(ctx, path);
        free(path);
    }
    return status;
}
