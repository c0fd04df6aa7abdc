/* map_table.c - the table of maps: how a texel's sums become values, and how files store values. */
#include "libbake/maps/maps.h"

#include <stdlib.h>
#include <string.h>

#include "base/vec.h"

/* ---- the normal map ---- */

static bool resolve_direction(const float *sums, uint32_t channels, float weight, float *value)
{
    struct bsq_vec3 n = bsq_unit3(bsq_v3(sums[0], sums[1], sums[2]));
    (void)channels;
    (void)weight;
    value[0] = n.x;
    value[1] = n.y;
    value[2] = n.z;
    return bsq_dot3(n, n) > 0.0f; /* false: the samples cancel each other */
}

/* A texel without a value points straight up in tangent space, and is zero in object space. */
static void encode_normals(const struct bake_options *options, struct bake_encoding *out)
{
    bool tangent = options->normal_space == BAKE_TANGENT_SPACE;
    for (int c = 0; c < 3; ++c)
        out->scale[c] = out->bias[c] = out->background[c] = 0.5f;
    if (tangent && options->green_down)
        out->scale[1] = -0.5f;
    if (tangent)
        out->background[2] = 1.0f;
}

static void describe_normals(const struct bake_options *options, struct bake_attributes *out)
{
    bool object = options->normal_space == BAKE_OBJECT_SPACE;
    bake_add_attribute(out, "bisque:normalSpace", object ? "object" : "tangent");
    bake_add_attribute(out, "bisque:tangents", object ? "none" : "MikkTSpace");
    bake_add_attribute(out, "bisque:green", options->green_down ? "down" : "up");
    bake_add_attribute(out, "bisque:encoding", "n / 2 + 1/2");
}

/* ---- means ---- */

static bool resolve_mean(const float *sums, uint32_t channels, float weight, float *value)
{
    for (uint32_t c = 0; c < channels; ++c)
        value[c] = sums[c] * weight;
    return true;
}

/* ---- the table ---- */

const struct bake_map_row bake_map_table[] = {
    [BK_MAP_normal] = {.summary = "normals (default)",
                       .channels = 3,
                       .by_default = true,
                       .resolve = resolve_direction,
                       .encode = encode_normals,
                       .describe = describe_normals},
    [BK_MAP_color] = {.summary = "colours (default if the scan has them)",
                      .channels = 3,
                      .by_default = true,
                      .needs_color = true,
                      .color = true,
                      .resolve = resolve_mean},
    [BK_MAP_mask] = {.summary = "share of a texel's samples that found the surface", .channels = 1},
};

_Static_assert(sizeof bake_map_table / sizeof *bake_map_table == BK_MAP_COUNT,
               "the table has a row for each map of BK_MAPS");

#define MAP_NAME(name, sums) #name,
#define MAP_SUMS(name, sums) sums,
const char *const bake_map_names[BK_MAP_COUNT] = {BK_MAPS(MAP_NAME)};
const uint32_t bake_map_sums[BK_MAP_COUNT] = {BK_MAPS(MAP_SUMS)};
_Static_assert(BAKE_MAP_NORMAL == 1 << BK_MAP_normal && BAKE_MAP_COLOR == 1 << BK_MAP_color &&
                   BAKE_MAP_MASK == 1 << BK_MAP_mask,
               "bits of bake.h are rows of BK_MAPS");

/* ---- names and choice ---- */

const char *bake_map_name(unsigned number)
{
    return number < BK_MAP_COUNT ? bake_map_names[number] : NULL;
}

const char *bake_map_summary(unsigned number)
{
    return number < BK_MAP_COUNT ? bake_map_table[number].summary : NULL;
}

uint32_t bake_choose_maps(uint32_t asked, bool has_color)
{
    uint32_t maps = 0;
    for (unsigned i = 0; i < BK_MAP_COUNT; ++i)
        if (bake_map_table[i].by_default && (has_color || !bake_map_table[i].needs_color))
            maps |= 1u << i;
    return asked == BAKE_MAPS_DEFAULT ? maps : asked;
}
