/* tile_bake.c - see tile_bake.h. */
#include "libbake/bake_job.h"

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
    bsq_free(ctx, (void *)(uintptr_t)tile->blocks.slots);
    bake_map_files_discard(tile->files);
    bake_thumbnail_free(ctx, &tile->normal);
    bake_thumbnail_free(ctx, &tile->color);
    bake_thumbnail_free(ctx, &tile->missed);
    free(tile->output_path);
    free(tile->beside);
    memset(tile, 0, sizeof *tile);
}

int bake_tile_rasterise(const struct bake_run *job, struct bake_tile *tile)
{
    const struct bake_options *options = &tile->options;
    tile->tile_size =
        bake_tile_size(job->ctx, options->width, options->height, options->samples, tile->maps);
    while (tile->in_blocks && tile->blocks.side % tile->tile_size != 0)
        tile->tile_size /= 2;
    const struct bake_raster_options raster = {.width = options->width,
                                               .height = options->height,
                                               .samples = options->samples,
                                               .tile_size = tile->tile_size,
                                               .first = tile->place.first,
                                               .count = tile->place.count,
                                               .blocks = tile->in_blocks ? &tile->blocks : NULL,
                                               .skew = tile->skew};
    struct bake_raster_report counts = {0};
    int status = bake_raster_create(job->ctx, &job->mesh, &raster, &counts, &tile->raster);
    if (status < 0)
        return status;
    job->report->degenerate_uv_triangles += counts.degenerate_triangles;
    bake_raster_kernel_triangles(tile->raster, job->surface.translation, job->surface.unit,
                                 job->triangles);
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

int bake_tile_trace(const struct bake_run *job, struct bake_tile *tile, uint64_t memory_bytes)
{
    const bool several = job->surface.scan_count > 1;
    const uint32_t *objects = job->sees && several ? job->mesh.object_of : NULL;
    int status = bake_tile_create_image(job->ctx, tile, memory_bytes);
    if (status < 0)
        return status;
    const struct bake_tiles tiles = {.raster = tile->raster,
                                     .triangles = job->triangles,
                                     .triangle_count = job->triangle_count,
                                     .params = &job->surface.params,
                                     .image = tile->image,
                                     .tile_size = tile->tile_size};
    status = job->device ? bake_trace_grid_tiles(&job->surface, job->device, &tiles, job->report)
                         : bake_trace_ray_tiles(&job->surface, &tiles, objects, job->report);
    if (!job->sees || !(tile->maps & BAKE_MAP_CURVATURE)) {
        bake_raster_free(tile->raster);
        tile->raster = NULL;
    }
    return status;
}

/* ---- objects of texels ---- */

/* A part of a tile's image whose objects are wanted. The raster is filled again for it: objects of
 * all texels would need memory that grows with the map. */
struct window {
    const struct bake_run *job;
    const struct bake_tile *tile;
    uint32_t x, y, width, height; /* texels of the image */
    uint32_t *objects;            /* of its texels, BAKE_NO_OBJECT until one is known */
};

/* Takes the samples of a tile of the raster, if it overlaps the window. */
static int take_samples(const struct window *window, uint32_t index, uint32_t *triangles)
{
    const struct bake_tile *tile = window->tile;
    const uint32_t n = tile->options.samples;
    struct bk_tile place = bake_raster_tile(tile->raster, index);
    uint64_t overlapping;
    if (tile->in_blocks)
        bake_blocks_to_image(&tile->blocks, &place.x, &place.y);
    if (place.x >= window->x + window->width || place.x + place.width <= window->x ||
        place.y >= window->y + window->height || place.y + place.height <= window->y)
        return 0;
    int status = bake_raster_fill(tile->raster, index, triangles, &overlapping);
    for (uint64_t i = 0; i < (uint64_t)place.width * n * place.height * n && status == 0; i++) {
        const uint32_t column = place.x + (uint32_t)(i % (place.width * n)) / n - window->x;
        const uint32_t row = place.y + (uint32_t)(i / (place.width * n)) / n - window->y;
        if (triangles[i] == BK_NO_TRIANGLE || column >= window->width || row >= window->height)
            continue; /* before the window, numbers have wrapped around */
        uint32_t *object = &window->objects[(uint64_t)row * window->width + column];
        if (*object == BAKE_NO_OBJECT)
            *object = window->job->mesh.object_of[triangles[i]];
    }
    return status;
}

int bake_tile_objects(const void *arg, uint32_t x, uint32_t y, uint32_t width, uint32_t height,
                      uint32_t *out)
{
    const struct bake_tile_of_job *of = arg;
    const struct window window = {of->job, of->tile, x, y, width, height, out};
    const uint64_t texels = (uint64_t)of->tile->tile_size * of->tile->tile_size;
    uint32_t *triangles;
    memset(out, 0xff, (size_t)width * height * sizeof *out);
    int status = bsq_alloc(of->job->ctx, "samples of a tile",
                           texels * bake_raster_texel_entries(&of->job->surface.params),
                           sizeof *triangles, &triangles);
    for (uint32_t i = 0; i < bake_raster_tile_count(of->tile->raster) && status == 0; i++)
        status = take_samples(&window, i, triangles);
    bsq_free(of->job->ctx, triangles);
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
