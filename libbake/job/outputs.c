/* outputs.c - writes the maps and the preview of a bake. They get their names together. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "base/context.h"
#include "base/file.h"
#include "formats/material/channels.h"
#include "base/output.h"
#include "base/sort_array.h"
#include "libbake/job/job.h"
#include "libbake/page/items.h"

enum { PREVIEW_TEXTURE = 2048 /* largest side of a texture of the preview, in texels */ };

static bool wants_preview(const struct bake_job *job)
{
    return job->options->preview_path || job->options->page;
}

static const char *sampling_of(const struct bake_job *job)
{
    const struct bake_surface *surface = &job->surface;
    if (!surface->grids)
        return "exact";
    return surface->triangles                       ? "trilinear, exact"
           : job->options->sampling == BAKE_NEAREST ? "nearest"
                                                    : "trilinear";
}

static int compare_names(const void *a, const void *b)
{
    const char *const *x = a, *const *y = b;
    return strcmp(bsq_file_name(*x), bsq_file_name(*y));
}

/* Joins the names of several scans, sorted, so that their order does not show. */
static int name_scans(struct bake_job *job)
{
    const struct bake_options *options = job->options;
    const char **paths = NULL;
    const uint32_t count = options->more_scan_count + 1;
    uint64_t bytes = 1;
    int status = 0;
    BSQ_TRY(bsq_alloc(job->ctx, "names of scans", count, sizeof(void *), &paths));
    for (uint32_t p = 0; p < count; ++p) {
        paths[p] = p == 0 ? options->scan_path : options->more_scan_paths[p - 1];
        bytes += strlen(paths[p]) + 2;
    }
    BSQ_TRY(bsq_calloc(job->ctx, "names of scans", bytes, 1, &job->scan_names));
    bsq_sort(paths, count, sizeof(void *), compare_names);
    char *to = job->scan_names;
    for (uint32_t p = 0; p < count; ++p)
        to = stpcpy(stpcpy(to, p > 0 ? ", " : ""), bsq_file_name(paths[p]));
done:
    bsq_free(job->ctx, paths);
    return status;
}

static struct bake_traced traced_of(const struct bake_job *job)
{
    struct bake_traced traced = {.front = job->report->front,
                                 .back = job->report->back,
                                 .sampling = sampling_of(job),
                                 .scans = job->scan_names,
                                 .ids = fmt_ids_text(job->surface.ids)};
    memcpy(traced.scan_min, job->surface.scan_min, sizeof traced.scan_min);
    memcpy(traced.scan_max, job->surface.scan_max, sizeof traced.scan_max);
    memcpy(traced.image_origin, job->surface.translation, sizeof traced.image_origin);
    return traced;
}

static unsigned file_count(const struct bake_tile *tile)
{
    unsigned count = 0;
    for (unsigned i = 0; i < bake_files_end(&tile->options, tile->maps); ++i)
        count += bake_has_file(&tile->options, tile->maps, i);
    return count;
}

enum { OTHERS = 3 }; /* outputs beside the maps */

/* Checks that an output can be created and is none of the others, which may be NULL. */
static int check_output(struct bsq_ctx *ctx, const char *path, const char *const others[OTHERS])
{
    for (int k = 0; k < OTHERS; ++k)
        if (others[k] && bsq_same_file(path, others[k]))
            return bsq_fail(ctx, BSQ_EUSAGE, "%s: two outputs have this name", path);
    return bsq_output_check(ctx, path);
}

static int check_tile_outputs(struct bsq_ctx *ctx, const struct bake_tile *tile,
                              const char *const others[OTHERS])
{
    int status = 0;
    for (unsigned i = 0; i < bake_files_end(&tile->options, tile->maps) && status == 0; ++i) {
        if (!bake_has_file(&tile->options, tile->maps, i))
            continue;
        char *path = bake_path_of(&tile->options, i);
        status = path ? check_output(ctx, path, others)
                      : bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", tile->output_path);
        free(path);
    }
    return status;
}

static bool ends_with(const char *path, const char *suffix)
{
    const size_t length = strlen(path), end = strlen(suffix);
    return length >= end && strcasecmp(path + length - end, suffix) == 0;
}

int bake_check_outputs(struct bake_job *job)
{
    const char *preview = job->options->preview_path, *glb = job->options->glb_path;
    const char *page = job->options->page_path;
    const char *const others[OTHERS] = {preview, glb, page};
    if (glb)
        BSQ_PASS(check_output(job->ctx, glb, (const char *const[OTHERS]){preview, page}));
    if (preview)
        BSQ_PASS(check_output(job->ctx, preview, (const char *const[OTHERS]){page}));
    if (preview && !ends_with(preview, ".png"))
        return bsq_fail(job->ctx, BSQ_EUSAGE,
                        "%s: the picture is a PNG file: its name must end in .png", preview);
    if (glb && !ends_with(glb, ".glb"))
        return bsq_fail(job->ctx, BSQ_EUSAGE, "%s: its name must end in .glb", glb);
    for (uint32_t i = 0; i < job->udim.count; ++i)
        if (!job->tiles[i].skipped)
            BSQ_PASS(check_tile_outputs(job->ctx, &job->tiles[i], others));
    return 0;
}

/* All outputs stay open until they get their names together. */
static int require_descriptors(const struct bake_job *job)
{
    uint64_t count = wants_preview(job);
    if (job->options->glb_path)
        count += 1 + BAKE_ASSET_IMAGES * (uint64_t)job->udim.count;
    for (uint32_t i = 0; i < job->udim.count; ++i)
        count += job->tiles[i].skipped ? 0 : file_count(&job->tiles[i]);
    return bsq_require_descriptors(job->ctx, job->options->output_path, count);
}

int bake_open_outputs(struct bake_job *job)
{
    if (job->options->more_scan_count > 0)
        BSQ_PASS(name_scans(job));
    BSQ_PASS(require_descriptors(job));
    if (job->options->glb_path)
        BSQ_PASS(bake_asset_open(job->ctx, job->options, job->udim.count, &job->asset));
    return 0;
}

/* Returns the side of thumbnails for the preview, so that those of one map in all tiles take at
 * most an eighth of what is left in the budget. With thousands of tiles, it may be a single texel.
 * So the picture, unlike the maps, can depend on a small budget. */
static uint32_t preview_texture_side(const struct bake_job *job)
{
    const uint64_t share = bsq_memory_left(job->ctx) / 8;
    return bake_thumbnail_side(PREVIEW_TEXTURE, share / job->udim.count);
}

static int create_thumbnail(struct bsq_ctx *ctx, struct bake_tile *tile, enum bake_map map,
                            uint32_t side, struct bake_thumbnail *out)
{
    if (!(tile->maps & (uint32_t)map))
        return 0;
    bake_map_files_set_thumbnail(tile->files, map, out);
    return bake_thumbnail_create(ctx, tile->options.width, tile->options.height, side, out);
}

static int create_thumbnails(struct bsq_ctx *ctx, struct bake_tile *tile, uint32_t side)
{
    BSQ_PASS(create_thumbnail(ctx, tile, BAKE_MAP_NORMAL, side, &tile->normal));
    BSQ_PASS(create_thumbnail(ctx, tile, BAKE_MAP_COLOR, side, &tile->color));
    return bake_thumbnail_of_missed(ctx, tile->image, side, &tile->missed);
}

int bake_tile_create_image(struct bsq_ctx *ctx, struct bake_tile *tile, bool objects,
                           uint64_t memory_bytes)
{
    const struct bake_blocks *blocks = &tile->blocks;
    const struct bake_image_options image = {
        .width = tile->in_blocks ? blocks->side : tile->options.width,
        .height = tile->in_blocks ? blocks->side * blocks->count : tile->options.height,
        .channels = bake_image_channels_for(tile->maps) + objects,
        .memory_bytes = memory_bytes,
        .beside = tile->beside,
        .blocks = tile->in_blocks ? blocks : NULL};
    return bake_image_create(ctx, &image, &tile->image);
}

/* Adds a picture of the charts to the page: red where no surface was found, else green. */
static int show_misses(struct bake_job *job, const struct bake_tile *tile, uint32_t number)
{
    struct bake_page_picture picture = {.texels = tile->missed, .high = {1, 1, 1}};
    return bake_page_add_picture(job->options->page,
                                 json_pack("{s:s, s:i}", "kind", "misses", "tile", (int)number),
                                 &picture);
}

static int filter_tile(struct bake_job *job, const struct bake_tile *tile)
{
    const double start = bsq_seconds_now();
    struct bake_filter filter = {.image = tile->image,
                                 .guide = bake_map_offset(job->maps, BK_MAP_guide),
                                 .texel = bake_udim_texel(job->options, &job->mesh, &job->udim)};
    /* Three times the variance of n rays, which was measured as 0.9 p (1 - p) n^-1.6: directions
     * are spread evenly. The spread of few texels is only an estimate, so it needs room. */
    if (job->maps & BAKE_MAP_AO) {
        filter.noise[0] = 3 * pow(job->options->ao_rays, -1.6);
        filter.offsets[filter.count++] = bake_map_offset(job->maps, BK_MAP_ao);
    }
    if (job->maps & BAKE_MAP_THICKNESS)
        filter.offsets[filter.count++] = bake_map_offset(job->maps, BK_MAP_thickness);
    const int status = bake_filter(job->ctx, &filter);
    job->report->seconds_resolve += bsq_seconds_now() - start;
    return status;
}

/* Encodes and writes the maps of a tile, and frees its image. limited: see bake_map_files_write().
 */
static int write_tile(struct bake_job *job, struct bake_tile *tile, uint32_t side,
                      uint64_t *limited)
{
    const struct bake_traced traced = traced_of(job);
    int status = 0;
    BSQ_TRY(bake_map_files_open(job->ctx, &tile->options, tile->maps, &traced, &tile->files));
    const uint32_t number = (uint32_t)(tile - job->tiles);
    if (job->maps & 1u << BK_MAP_guide)
        BSQ_TRY(filter_tile(job, tile));
    if (wants_preview(job))
        BSQ_TRY(create_thumbnails(job->ctx, tile, side));
    if (job->options->page)
        BSQ_TRY(show_misses(job, tile, number));
    if (job->asset)
        BSQ_TRY(bake_asset_begin_tile(job->asset, number, &tile->options, tile->maps, tile->image,
                                      tile->files));
    BSQ_TRY(bake_map_files_write(tile->files, tile->image, &job->measures, limited, job->report));
    if (job->asset)
        status = bake_asset_end_tile(job->asset, number);
done:
    bake_image_free(tile->image);
    tile->image = NULL;
    return status;
}

int bake_measure_maps(struct bake_job *job)
{
    const double start = bsq_seconds_now();
    int status = 0;
    for (uint32_t i = 0; i < job->udim.count; ++i)
        BSQ_TRY(
            bake_image_measure(job->ctx, job->tiles[i].image, job->maps, job->measures.statistics));
done:
    job->report->seconds_resolve += bsq_seconds_now() - start;
    return status;
}

int bake_write_maps(struct bake_job *job)
{
    const uint32_t side = preview_texture_side(job);
    uint64_t *limited = NULL;
    int status = 0;
    BSQ_TRY(BSQ_CALLOC(job->ctx, "maps", bake_files_end(job->options, job->maps), &limited));
    for (uint32_t i = 0; i < job->udim.count; ++i)
        if (!job->tiles[i].skipped)
            BSQ_TRY(write_tile(job, &job->tiles[i], side, limited));
    BSQ_TRY(bake_warn_limited(job->ctx, job->options, job->maps, limited));
done:
    bsq_free(job->ctx, limited);
    return status;
}

/* Adds the low-poly mesh without maps to the page, which has small ones. */
static int show_mesh(struct bake_job *job)
{
    struct bake_page *page = job->options->page;
    const struct bake_options plain = {.glb_path = page->path};
    const struct bake_preview preview = {.mesh = &job->mesh, .options = job->options};
    struct bake_asset *asset = NULL;
    struct bsq_output *output = NULL;
    int status;
    BSQ_TRY(bake_asset_open(job->ctx, &plain, job->udim.count, &asset));
    BSQ_TRY(bake_asset_write(asset, &job->mesh, &job->udim));
    bake_asset_hand_over(asset, &output);
    asset = NULL;
    status = bake_page_add(page,
                           json_pack("{s:s, s:i, s:i, s:b, s:b}", "kind", "mesh", "up",
                                     bake_preview_up_axis(&preview), "views",
                                     (int)job->options->preview_views, "green_down",
                                     (int)job->options->green_down, "object_space",
                                     job->options->normal_space == BAKE_OBJECT_SPACE),
                           output);
done:
    bake_asset_discard(asset);
    bsq_output_discard(output);
    return status;
}

int bake_write_asset(struct bake_job *job)
{
    if (job->options->page)
        BSQ_PASS(show_mesh(job));
    if (job->asset)
        return bake_asset_write(job->asset, &job->mesh, &job->udim);
    return 0;
}

int bake_write_preview(struct bake_job *job)
{
    if (!wants_preview(job))
        return 0;
    const char *path =
        job->options->preview_path ? job->options->preview_path : job->options->page->path;
    BSQ_PASS(BSQ_CALLOC(job->ctx, "preview", job->udim.count, &job->preview_tiles));
    for (uint32_t i = 0; i < job->udim.count; ++i)
        job->preview_tiles[i] = (struct bake_preview_tile){
            job->udim.tiles[i], &job->tiles[i].normal, &job->tiles[i].color, &job->tiles[i].missed};
    const struct bake_preview preview = {.mesh = &job->mesh,
                                         .surface = &job->surface,
                                         .tiles = job->preview_tiles,
                                         .tile_count = job->udim.count,
                                         .options = job->options};
    job->report->preview_up = bake_preview_up_axis(&preview) == 2 ? BAKE_UP_Z : BAKE_UP_Y;
    return bake_preview_write(job->ctx, path, &preview, &job->preview_views, &job->preview);
}

int bake_commit_outputs(struct bake_job *job)
{
    struct bsq_output_group group = {0};
    int status = 0;
    for (uint32_t i = 0; i < job->udim.count; ++i) {
        struct bake_map_files *files = job->tiles[i].files;
        job->tiles[i].files = NULL;
        if (files)
            BSQ_TRY(bake_map_files_hand_over(files, &group));
    }
    if (job->preview && job->options->page)
        BSQ_TRY(bake_page_add(job->options->page,
                              json_pack("{s:s, s:f, s:f, s:f}", "kind", "preview", "from",
                                        job->preview_views.from, "above", job->preview_views.above,
                                        "step", job->preview_views.step),
                              job->preview));
    if (job->preview && job->options->preview_path) {
        struct bsq_output *preview = job->preview;
        job->preview = NULL;
        BSQ_TRY(bsq_output_group_add(&group, preview));
    }
    if (job->asset) {
        struct bake_asset *asset = job->asset;
        struct bsq_output *output;
        job->asset = NULL;
        bake_asset_hand_over(asset, &output);
        BSQ_TRY(bsq_output_group_add(&group, output));
    }
    BSQ_TRY(bsq_output_group_commit(&group));
done:
    bsq_output_group_discard(&group);
    return status;
}
