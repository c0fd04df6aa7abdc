/* bake_options.c - defaults and checks of a bake's options. */
#include "libbake/bake_options.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "base/channels.h"

void bake_defaults(struct bake_options *options)
{
    *options = (struct bake_options){
        .maps = BAKE_MAPS_DEFAULT,
        .width = 2048,
        .height = 2048,
        .samples = 2,
        .front = -1.0,
        .back = -1.0,
        .height_range = -1.0,
        .curvature_range = -1.0,
        .curvature_radius = -1.0,
        .ao_rays = 64,
        .ao_distance = -1.0,
        .ao_spread = 180.0,
        .ao_coarse = BAKE_AO_COARSE,
        .thickness_rays = 64,
        .thickness_distance = -1.0,
        .padding = 16,
        .normal_space = BAKE_TANGENT_SPACE,
        .sampling = BAKE_TRILINEAR,
        .device = "auto",
        .max_missed = 100.0,
        .low_suffix = "_low",
        .high_suffix = "_high",
        .preview_views = 4,
    };
}

static bool is_tile(uint32_t number)
{
    return number >= BAKE_FIRST_TILE && number <= BAKE_LAST_TILE;
}

int bake_check_tile_numbers(struct bsq_ctx *ctx, const struct bake_options *options)
{
    for (uint32_t i = 0; i < options->tile_range_count; ++i) {
        const struct bake_tile_range *range = &options->tile_ranges[i];
        if (!is_tile(range->first) || !is_tile(range->last) || range->first > range->last)
            return bsq_fail(ctx, BSQ_EUSAGE, "tiles %u to %u: UDIM tiles are %d to %d",
                            range->first, range->last, BAKE_FIRST_TILE, BAKE_LAST_TILE);
    }
    for (uint32_t i = 0; i < options->tile_size_count; ++i)
        if (!is_tile(options->tile_sizes[i].tile))
            return bsq_fail(ctx, BSQ_EUSAGE, "a size for tile %u: UDIM tiles are %d to %d",
                            options->tile_sizes[i].tile, BAKE_FIRST_TILE, BAKE_LAST_TILE);
    return 0;
}

int bake_check_maps(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps)
{
    int status = bake_map_files_check(ctx, options, maps);
    for (uint32_t i = 0; i < options->tile_size_count && status == 0; ++i) {
        struct bake_options tile = *options;
        tile.width = options->tile_sizes[i].width;
        tile.height = options->tile_sizes[i].height;
        status = bake_map_files_check(ctx, &tile, maps);
    }
    return status;
}

/* Returns whether a length, and small multiples of it, can be a float. */
static bool is_float(double value)
{
    return fabs(value) <= (double)FLT_MAX / 4;
}

/* Checks the rays that start at hits. */
static int check_rays(struct bsq_ctx *ctx, const struct bake_options *options)
{
    const uint32_t rays[] = {options->ao_rays, options->thickness_rays};
    for (int i = 0; i < 2; ++i)
        if (rays[i] < 1 || rays[i] > BAKE_MAX_RAYS)
            return bsq_fail(ctx, BSQ_EUSAGE, "%u rays from a hit: must be 1 to %d", rays[i],
                            BAKE_MAX_RAYS);
    if (!(options->ao_spread > 0 && options->ao_spread <= 180))
        return bsq_fail(ctx, BSQ_EUSAGE, "a spread of %g degrees is not above 0 and at most 180",
                        options->ao_spread);
    if (!is_float(options->ao_distance) || !is_float(options->thickness_distance) ||
        !is_float(options->ao_coarse))
        return bsq_fail(ctx, BSQ_EUSAGE, "distances of secondary rays must be finite floats");
    if (options->ao_falloff && options->ao_distance <= 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "a falloff of ambient occlusion needs its distance");
    return 0;
}

/* Checks that choices have one of their values. */
static int check_choices(struct bsq_ctx *ctx, const struct bake_options *options)
{
    const struct {
        const char *what;
        unsigned value, last;
    } choices[] = {
        {"type of samples", options->sample_type, BAKE_FLOAT},
        {"direction of rays", options->rays, BAKE_RAYS_FACE},
        {"space of normals", options->normal_space, BAKE_OBJECT_SPACE},
        {"sampling", options->sampling, BAKE_NEAREST},
        {"kind of the scan's normals", options->scan_normals, BSQ_SCAN_NORMALS_FLAT},
        {"range of positions", options->position_in, BAKE_IN_BOX},
        {"vertical axis", options->preview_up, BAKE_UP_Z},
    };
    for (size_t i = 0; i < sizeof choices / sizeof *choices; ++i)
        if (choices[i].value > choices[i].last)
            return bsq_fail(ctx, BSQ_EUSAGE, "unknown %s: %u", choices[i].what, choices[i].value);
    return 0;
}

/* Checks the transfer maps that the mask is multiplied by. */
static int check_mask(struct bsq_ctx *ctx, const struct bake_options *options)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < options->transfer_count; ++i) {
        const struct bake_transfer *transfer = &options->transfers[i];
        count += transfer->in_mask;
        if (transfer->in_mask && bsq_channel_find(transfer->name)->values != 1)
            return bsq_fail(ctx, BSQ_EUSAGE, "the mask needs one value of %s, which has three",
                            transfer->name);
    }
    if (count > 1)
        return bsq_fail(ctx, BSQ_EUSAGE, "the mask can be multiplied by one channel, not %u",
                        count);
    if (count == 1 && !(options->maps & (BAKE_MAP_MASK | BAKE_MAPS_ALL)))
        return bsq_fail(ctx, BSQ_EUSAGE, "opacity is part of the mask, which is not baked");
    return 0;
}

static int check_transfers(struct bsq_ctx *ctx, const struct bake_options *options)
{
    if (options->transfer_count > BAKE_MAX_TRANSFERS)
        return bsq_fail(ctx, BSQ_EUSAGE, "%u transfer maps: must be at most %d",
                        options->transfer_count, BAKE_MAX_TRANSFERS);
    for (uint32_t i = 0; i < options->transfer_count; ++i) {
        const struct bake_transfer *transfer = &options->transfers[i];
        if (!bsq_is_channel_name(transfer->name))
            return bsq_fail(ctx, BSQ_EUSAGE,
                            "\"%s\" cannot be a transfer map: names have lower-case letters, "
                            "digits and _, with a letter first",
                            transfer->name);
        if (strcmp(transfer->name, BSQ_CHANNEL_NORMAL_MAP) == 0)
            return bsq_fail(
                ctx, BSQ_EUSAGE,
                "transfer map %s: directions in tangent space cannot be transferred; the "
                "map normal contains them",
                transfer->name);
        if (bsq_is_map_name(transfer->name))
            return bsq_fail(ctx, BSQ_EUSAGE, "transfer map %s: there is another map of this name",
                            transfer->name);
        for (uint32_t j = 0; j < i; ++j)
            if (strcmp(options->transfers[j].name, transfer->name) == 0)
                return bsq_fail(ctx, BSQ_EUSAGE, "transfer map %s is named twice", transfer->name);
    }
    return check_mask(ctx, options);
}

/* Returns whether samples from -range to range can be scaled as floats. Negative: it is not given.
 */
static bool is_range(double range)
{
    return range < 0.0 || (range > 0.0 && is_float(range));
}

int bake_check_options(struct bsq_ctx *ctx, const struct bake_options *options)
{
    if (!options->scan_path || !options->mesh_path || !options->output_path)
        return bsq_fail(ctx, BSQ_EUSAGE, "a scan, a low-poly mesh and an output are needed");
    if (options->match_names && (!options->low_suffix || !options->high_suffix))
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "names are matched without their suffixes, which are missing");
    if (options->cage_path && options->more_mesh_count > 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: a cage needs a single low-poly file, not %u of them",
                        options->cage_path, options->more_mesh_count + 1);
    if ((options->maps & ~(uint32_t)BAKE_MAPS_ALL) >= 1u << BK_MAP_COUNT)
        return bsq_fail(ctx, BSQ_EUSAGE, "unknown maps: %#x", options->maps);
    if (options->samples < 1 || options->samples > BAKE_MAX_SAMPLES)
        return bsq_fail(ctx, BSQ_EUSAGE, "%u x %u samples a texel: must be 1 to %d",
                        options->samples, options->samples, BAKE_MAX_SAMPLES);
    if (options->preview_views < 1 || options->preview_views > BAKE_MAX_VIEWS)
        return bsq_fail(ctx, BSQ_EUSAGE, "%u views of a preview: must be 1 to %d",
                        options->preview_views, BAKE_MAX_VIEWS);
    if (isnan(options->front) || isnan(options->back) || isinf(options->front) ||
        isinf(options->back))
        return bsq_fail(ctx, BSQ_EUSAGE, "ray lengths %g and %g are not numbers", options->front,
                        options->back);
    if (options->front == 0.0 && options->back == 0.0)
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "rays of length 0 find nothing: front and back must not both be 0");
    if (!is_range(options->height_range))
        return bsq_fail(ctx, BSQ_EUSAGE, "a range of heights of %g holds no heights, or no floats",
                        options->height_range);
    if (!is_range(options->curvature_range))
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "a range of curvature of %g holds no curvature, or no floats",
                        options->curvature_range);
    if (!isfinite(options->curvature_radius) || options->curvature_radius == 0.0)
        return bsq_fail(ctx, BSQ_EUSAGE, "curvature cannot be measured within %g",
                        options->curvature_radius);
    if (options->cage_path && (options->front >= 0 || options->rays != BAKE_RAYS_SMOOTH))
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "a cage gives the rays' directions and their length in front");
    if (options->skew_path && options->rays == BAKE_RAYS_FACE)
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "%s: a skew map changes nothing if rays run along the faces' normals",
                        options->skew_path);
    if (options->normal_space == BAKE_OBJECT_SPACE && options->green_down)
        return bsq_fail(ctx, BSQ_EUSAGE, "an object-space map has no green direction to flip");
    int status = check_choices(ctx, options);
    if (status == 0)
        status = check_rays(ctx, options);
    if (status == 0)
        status = bake_check_tile_numbers(ctx, options);
    if (status == 0)
        status = check_transfers(ctx, options);
    if (status < 0)
        return status;
    /* The default maps depend on the scan; they are checked again after it was opened. */
    struct bake_options chosen = *options;
    if (options->transfer_count == 0 || options->maps != BAKE_MAPS_DEFAULT)
        chosen.maps = bake_choose_maps(options->maps, &(struct bake_scan_facts){0});
    return bake_check_maps(ctx, options, bake_selection(&chosen));
}
