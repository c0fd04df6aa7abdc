/* farm_options.c - see farm_options.h.
 *
 * A member that is missing in the table would be lost in tasks; the assertion on the size reminds
 * of it. */
#include "libbake/farm/farm_options.h"

#include <stddef.h>
#include <stdlib.h>

#define MEMBER(kind, name)                                                                         \
    {                                                                                              \
#name, offsetof(struct bake_options, name), FMT_FARM_##kind, 0                             \
    }
#define CHOICE_MEMBER(name, last)                                                                  \
    {                                                                                              \
#name, offsetof(struct bake_options, name), FMT_FARM_CHOICE, last                          \
    }

#define PATHS_MEMBER(name, count)                                                                  \
    {                                                                                              \
#name, offsetof(struct bake_options, name), FMT_FARM_PATHS,                                \
            offsetof(struct bake_options, count)                                                   \
    }

static const struct fmt_farm_member members[] = {
    MEMBER(PATH, scan_path),
    PATHS_MEMBER(more_scan_paths, more_scan_count),
    MEMBER(BOOL, match_names),
    MEMBER(TEXT, low_suffix),
    MEMBER(TEXT, high_suffix),
    MEMBER(PATH, mesh_path),
    PATHS_MEMBER(more_mesh_paths, more_mesh_count),
    MEMBER(U32, maps),
    MEMBER(PATH, output_path),
    CHOICE_MEMBER(sample_type, BAKE_FLOAT),
    MEMBER(U32, width),
    MEMBER(U32, height),
    MEMBER(U32, samples),
    CHOICE_MEMBER(rays, BAKE_RAYS_FACE),
    MEMBER(OPTIONAL, cage_path),
    MEMBER(OPTIONAL, skew_path),
    MEMBER(NUMBER, front),
    MEMBER(NUMBER, back),
    MEMBER(U32, padding),
    MEMBER(BOOL, green_down),
    CHOICE_MEMBER(normal_space, BAKE_OBJECT_SPACE),
    CHOICE_MEMBER(sampling, BAKE_NEAREST),
    CHOICE_MEMBER(scan_normals, BSQ_SCAN_NORMALS_FLAT),
    MEMBER(OPTIONAL, scan_normal_map),
    MEMBER(NUMBER, height_range),
    CHOICE_MEMBER(position_in, BAKE_IN_BOX),
    MEMBER(NUMBER, curvature_range),
    MEMBER(NUMBER, curvature_radius),
    MEMBER(U32, ao_rays),
    MEMBER(NUMBER, ao_distance),
    MEMBER(NUMBER, ao_spread),
    MEMBER(BOOL, ao_falloff),
    MEMBER(NUMBER, ao_coarse),
    MEMBER(U32, thickness_rays),
    MEMBER(NUMBER, thickness_distance),
    MEMBER(BOOL, two_sided),
    MEMBER(NUMBER, max_missed),
    MEMBER(TEXT, device),
    MEMBER(U64, gpu_memory_bytes),
    MEMBER(U32, exr_tile_side),
    MEMBER(OPTIONAL, preview_path),
    MEMBER(U32, preview_views),
    CHOICE_MEMBER(preview_up, BAKE_UP_Z),
};
enum { MEMBERS = sizeof members / sizeof *members };

/* Of a transfer map. */
static const struct fmt_farm_member transfer_members[] = {
    {"name", offsetof(struct bake_transfer, name), FMT_FARM_TEXT, 0},
    {"texture", offsetof(struct bake_transfer, texture_path), FMT_FARM_OPTIONAL, 0},
    {"in_mask", offsetof(struct bake_transfer, in_mask), FMT_FARM_BOOL, 0},
    {"no_file", offsetof(struct bake_transfer, no_file), FMT_FARM_BOOL, 0},
};
enum { TRANSFER_MEMBERS = sizeof transfer_members / sizeof *transfer_members };

/* tile_sizes, tile_ranges and transfers are written by themselves. */
_Static_assert(sizeof(struct bake_options) == 344, "a new option needs a row in `members`");
_Static_assert(sizeof(enum bake_rays) == sizeof(unsigned), "a choice is an unsigned number");

static json_t *tile_sizes_to_json(const struct bake_options *options)
{
    json_t *list = json_array();
    for (uint32_t i = 0; i < options->tile_size_count; i++) {
        const struct bake_tile_size *size = &options->tile_sizes[i];
        json_array_append_new(list, json_pack("[I, I, I]", (json_int_t)size->tile,
                                              (json_int_t)size->width, (json_int_t)size->height));
    }
    return list;
}

static json_t *tile_ranges_to_json(const struct bake_options *options)
{
    json_t *list = json_array();
    for (uint32_t i = 0; i < options->tile_range_count; i++)
        json_array_append_new(list, json_pack("[I, I]", (json_int_t)options->tile_ranges[i].first,
                                              (json_int_t)options->tile_ranges[i].last));
    return list;
}

static json_t *transfers_to_json(const struct bake_options *options, const char *plan_path)
{
    json_t *list = json_array();
    int failed = list == NULL;
    for (uint32_t i = 0; i < options->transfer_count; i++)
        failed |= json_array_append_new(
            list, fmt_farm_options_to_json(transfer_members, TRANSFER_MEMBERS,
                                           &options->transfers[i], plan_path));
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

json_t *bake_farm_options_to_json(const struct bake_options *options, const char *plan_path)
{
    json_t *json = fmt_farm_options_to_json(members, MEMBERS, options, plan_path);
    if (json_object_set_new(json, "tile_sizes", tile_sizes_to_json(options)) == 0 &&
        json_object_set_new(json, "tile_ranges", tile_ranges_to_json(options)) == 0 &&
        json_object_set_new(json, "transfers", transfers_to_json(options, plan_path)) == 0)
        return json;
    json_decref(json);
    return NULL;
}

/* Reads a list of lists of `width` numbers. The caller frees *out. */
static bool read_lists(const json_t *json, size_t width, uint32_t **out, uint32_t *count)
{
    *count = 0;
    *out = calloc(json_array_size(json) * width + 1, sizeof **out);
    if (!json_is_array(json) || !*out || json_array_size(json) > UINT32_MAX)
        return false;
    for (size_t i = 0; i < json_array_size(json); i++)
        for (size_t k = 0; k < width; k++) {
            uint64_t number;
            if (!fmt_farm_is_count(json_array_get(json_array_get(json, i), k), UINT32_MAX, &number))
                return false;
            (*out)[i * width + k] = (uint32_t)number;
        }
    *count = (uint32_t)json_array_size(json);
    return true;
}

static bool read_tiles(const json_t *json, struct bake_options *options)
{
    _Static_assert(sizeof(struct bake_tile_size) == 3 * sizeof(uint32_t), "three numbers");
    _Static_assert(sizeof(struct bake_tile_range) == 2 * sizeof(uint32_t), "two numbers");
    uint32_t *sizes = NULL, *ranges = NULL;
    bool good =
        read_lists(json_object_get(json, "tile_sizes"), 3, &sizes, &options->tile_size_count);
    options->tile_sizes = (const struct bake_tile_size *)sizes;
    good = good &&
           read_lists(json_object_get(json, "tile_ranges"), 2, &ranges, &options->tile_range_count);
    options->tile_ranges = (const struct bake_tile_range *)ranges;
    return good;
}

static int read_transfers(struct bsq_ctx *ctx, const char *plan_path, const json_t *json,
                          struct bake_options *options)
{
    const size_t count = json_array_size(json);
    struct bake_transfer *list = calloc(count + 1, sizeof *list);
    options->transfers = list;
    if (!json_is_array(json) || !list || count > BAKE_MAX_TRANSFERS)
        return fmt_farm_fail_option(ctx, plan_path, "transfers");
    options->transfer_count = (uint32_t)count;
    int status = 0;
    for (size_t i = 0; i < count && status == 0; i++)
        status = fmt_farm_options_from_json(ctx, transfer_members, TRANSFER_MEMBERS, plan_path,
                                            json_array_get(json, i), &list[i]);
    return status;
}

int bake_farm_options_from_json(struct bsq_ctx *ctx, const char *plan_path, const json_t *json,
                                struct bake_options *out)
{
    *out = (struct bake_options){0};
    int status = fmt_farm_options_from_json(ctx, members, MEMBERS, plan_path, json, out);
    if (status == 0 && !read_tiles(json, out))
        status = fmt_farm_fail_option(ctx, plan_path, "tile_sizes or tile_ranges");
    return status == 0 ? read_transfers(ctx, plan_path, json_object_get(json, "transfers"), out)
                       : status;
}

void bake_farm_options_free(struct bake_options *options)
{
    fmt_farm_options_free(members, MEMBERS, options);
    for (uint32_t i = 0; i < options->transfer_count; i++)
        fmt_farm_options_free(transfer_members, TRANSFER_MEMBERS,
                              (void *)(uintptr_t)&options->transfers[i]);
    free((void *)(uintptr_t)options->transfers);
    free((void *)(uintptr_t)options->tile_sizes);
    free((void *)(uintptr_t)options->tile_ranges);
}
