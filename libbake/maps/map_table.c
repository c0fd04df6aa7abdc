/* map_table.c - the table of maps: how a texel's sums become values, and how files store values. */
#include "libbake/maps/maps.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "formats/material/channels.h"
#include "base/geometry/vec.h"

/* Makes samples from 0 to 1 stand for values from -range to range. */
static void table_set_range(struct bake_encoding *out, double range, float background)
{
    for (int c = 0; c < 3; ++c) {
        out->scale[c] = 2.0 * range;
        out->offset[c] = -range;
        out->background[c] = background;
    }
}

/* ---- the normal map ---- */

static bool resolve_direction(const float *sums, uint32_t channels, float weight, float *value)
{
    struct bsq_vec3 n = bsq_unit3(bsq_load3(sums));
    (void)channels;
    (void)weight;
    value[0] = n.x;
    value[1] = n.y;
    value[2] = n.z;
    return bsq_dot3(n, n) > 0.0f; /* false: the samples cancel each other */
}

/* A texel without a value points straight up in tangent space, and is zero in object space. */
static void encode_normals(const struct bake_encoding_facts *facts, struct bake_encoding *out)
{
    bool tangent = facts->options->normal_space == BAKE_TANGENT_SPACE;
    table_set_range(out, 1.0, 0.5f);
    if (tangent && facts->options->green_down) {
        out->scale[1] = -out->scale[1];
        out->offset[1] = -out->offset[1];
    }
    if (tangent)
        out->background[2] = 1.0f;
}

static void describe_normals(const struct bake_options *options, const struct bake_traced *traced,
                             struct bake_attributes *out)
{
    (void)traced;
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

/* ---- heights ---- */

/* Usual ranges are no smaller than these shares of the diagonal of the scan's bounding box, and of
 * its inverse. Otherwise, heights and curvature of a flat scan would be rounding errors on a large
 * scale. */
#define LEAST_HEIGHT    0x1p-16
#define LEAST_CURVATURE 0.01

static double diagonal_of(const double low[3], const double high[3])
{
    double square = 0;
    for (int k = 0; k < 3; ++k)
        square += (high[k] - low[k]) * (high[k] - low[k]);
    return sqrt(square);
}

static double scan_diagonal(const struct bake_encoding_facts *facts)
{
    return diagonal_of(facts->traced->scan_min, facts->traced->scan_max);
}

static void encode_heights(const struct bake_encoding_facts *facts, struct bake_encoding *out)
{
    const double given = facts->options->height_range;
    const double least = LEAST_HEIGHT * scan_diagonal(facts);
    out->range = given > 0.0 ? given : fmax(facts->statistics.largest, least);
    if (facts->integers)
        table_set_range(out, out->range, 0.5f);
}

/* ---- positions ---- */

/* Positions are whole numbers of float32 steps. With bake_choose_origin(), they are exact to 2^-18
 * of the scan's size in the worst case without an origin, and to 2^-24 with one. */

/* Returns half of the width of the sphere or the box, on the longest axis; sets the halves of all
 * axes. */
static double half_widths(const struct bake_encoding_facts *facts, double half[3])
{
    double square = 0, longest = 0;
    for (int k = 0; k < 3; ++k) {
        half[k] = 0.5 * (facts->traced->scan_max[k] - facts->traced->scan_min[k]);
        square += half[k] * half[k];
        longest = fmax(longest, half[k]);
    }
    if (facts->options->position_in == BAKE_IN_BOX)
        return longest;
    half[0] = half[1] = half[2] = sqrt(square);
    return half[0];
}

/* Bounds are those of the scan, so that all low-poly meshes of a scan share them. */
static void encode_positions(const struct bake_encoding_facts *facts, struct bake_encoding *out)
{
    const struct bake_traced *traced = facts->traced;
    double half[3];
    bake_choose_origin(traced->scan_min, traced->scan_max, out->origin);
    out->range = half_widths(facts, half);
    for (int k = 0; facts->integers && k < 3; ++k) {
        const double centre = 0.5 * (traced->scan_min[k] + traced->scan_max[k]);
        out->scale[k] = 2.0 * half[k];
        out->offset[k] = (centre - out->origin[k]) - half[k];
    }
}

/* The sums of bk_add_position(): three sums, and what rounding added to each. */
static bool resolve_position(const float *sums, uint32_t channels, float weight, float *value)
{
    for (uint32_t c = 0; c < channels; ++c)
        value[c] = (float)(((double)sums[c] - (double)sums[3 + c]) * (double)weight);
    return true;
}

/* ---- curvature ---- */

/* The position of the hits and their mean normal, from the sums of bk_add_curvature(). */
static bool resolve_curvature(const float *sums, uint32_t channels, float weight, float *value)
{
    (void)channels;
    resolve_position(sums, 3, weight, value);
    return resolve_direction(sums + 6, 3, weight, value + 3);
}

/* The same with two further values, for the filter's results. A texel needs no mean normal. */
static bool resolve_guide(const float *sums, uint32_t channels, float weight, float *value)
{
    resolve_curvature(sums, channels, weight, value);
    value[6] = value[7] = 0;
    return true;
}

/* The usual range leaves out the sharpest edges, which would make all else grey. */
static void encode_curvature(const struct bake_encoding_facts *facts, struct bake_encoding *out)
{
    const struct bake_statistics *statistics = &facts->statistics;
    const double given = facts->options->curvature_range;
    const double mean = bake_statistics_mean(statistics);
    const double variance = bake_statistics_mean_square(statistics) - mean * mean;
    out->radius = facts->curvature_radius;
    const double diagonal = scan_diagonal(facts);
    const double least = diagonal > 0 ? LEAST_CURVATURE / diagonal : 0;
    out->range = given > 0.0 ? given : fmax(mean + sqrt(fmax(variance, 0)), least);
    if (facts->integers)
        table_set_range(out, out->range, 0.5f);
}

/* ---- maps of rays that start at hits ---- */

/* White is open. */
static void encode_open(const struct bake_encoding_facts *facts, struct bake_encoding *out)
{
    (void)facts;
    out->background[0] = 1.0f;
}

/* The sum of distances, and their number. */
static bool resolve_thickness(const float *sums, uint32_t channels, float weight, float *value)
{
    (void)channels;
    (void)weight;
    if (!(sums[1] > 0))
        return false;
    value[0] = sums[0] / sums[1];
    return true;
}

double bake_thickness_distance(const struct bake_options *options, const double scan_min[3],
                               const double scan_max[3])
{
    return options->thickness_distance > 0 ? options->thickness_distance
                                           : diagonal_of(scan_min, scan_max);
}

/* The usual range leaves out the thickest parts: most of a figure is much thinner than its size. */
static void encode_thickness(const struct bake_encoding_facts *facts, struct bake_encoding *out)
{
    const struct bake_traced *traced = facts->traced;
    const struct bake_statistics *statistics = &facts->statistics;
    double white = bake_thickness_distance(facts->options, traced->scan_min, traced->scan_max);
    const double mean = bake_statistics_mean(statistics);
    const double variance = bake_statistics_mean_square(statistics) - mean * mean;
    if (facts->options->thickness_range > 0)
        white = facts->options->thickness_range;
    else if (!(facts->options->thickness_distance > 0) && mean > 0)
        white = fmin(statistics->largest, mean + 2 * sqrt(fmax(variance, 0)));
    out->range = 0.5 * white;
    if (facts->integers)
        out->scale[0] = white;
}

/* ---- ids ---- */

/* Takes the id with the most samples from the counts of bk_add_id(); of several, the least number.
 * If all counts cancelled, takes one of the ids. */
static bool resolve_id(const float *sums, uint32_t channels, float weight, float *value)
{
    float most = sums[0], id = sums[1];
    (void)weight;
    for (int i = 1; i < BK_ID_PAIRS; ++i)
        if (sums[2 * i] > most || (sums[2 * i] == most && most > 0.0f && sums[2 * i + 1] < id)) {
            most = sums[2 * i];
            id = sums[2 * i + 1];
        }
    for (uint32_t c = 0; c < channels; ++c)
        value[c] = (float)((uint32_t)id >> 8 * c & 255) / 255.0f;
    return true;
}

static void describe_ids(const struct bake_options *options, const struct bake_traced *traced,
                         struct bake_attributes *out)
{
    (void)options;
    bake_add_attribute(out, "bisque:ids", traced->ids);
}

/* ---- the table ---- */

const struct bake_map_row bake_map_table[] = {
    [BK_MAP_normal] = {.summary = "normals (default)",
                       .channels = 3,
                       .by_default = true,
                       .rounded = true,
                       .resolve = resolve_direction,
                       .encode = encode_normals,
                       .describe = describe_normals},
    [BK_MAP_color] = {.summary = "colours (default if the scan has them)",
                      .alias = "basecolor",
                      .channels = 3,
                      .by_default = true,
                      .needs_color = true,
                      .color = true,
                      .resolve = resolve_mean},
    [BK_MAP_mask] = {.summary = "share of a texel's samples that found the surface",
                     .alias = "opacity",
                     .channels = 1},
    [BK_MAP_height] = {.summary = "distance from the low-poly mesh to the scan",
                       .channels = 1,
                       .usual_type = BAKE_FLOAT,
                       .resolve = resolve_mean,
                       .encode = encode_heights,
                       .measured = true,
                       .unit = "mesh unit"},
    [BK_MAP_position] = {.summary = "positions on the scan",
                         .channels = 3,
                         .usual_type = BAKE_FLOAT,
                         .resolve = resolve_position,
                         .encode = encode_positions,
                         .unit = "mesh unit",
                         .positions = true},
    [BK_MAP_curvature] = {.summary = "mean curvature of the scan, positive where it is convex",
                          .channels = 1,
                          .values = 6,
                          .usual_type = BAKE_FLOAT,
                          .resolve = resolve_curvature,
                          .encode = encode_curvature,
                          .measured = true,
                          .unit = "1 / mesh unit"},
    [BK_MAP_ao] = {.summary = "ambient occlusion: share of the hemisphere that is open",
                   .channels = 1,
                   .resolve = resolve_mean,
                   .encode = encode_open},
    [BK_MAP_bent] = {.summary = "bent normals: mean open directions",
                     .channels = 3,
                     .rounded = true,
                     .resolve = resolve_direction,
                     .encode = encode_normals,
                     .describe = describe_normals},
    [BK_MAP_thickness] = {.summary = "mean distance through the solid",
                          .channels = 1,
                          .usual_type = BAKE_FLOAT,
                          .resolve = resolve_thickness,
                          .encode = encode_thickness,
                          .measured = true,
                          .unit = "mesh unit"},
    [BK_MAP_id] = {.summary = "a colour for each material, object or vertex colour of the scan",
                   .channels = 3,
                   .needs_ids = true,
                   .rounded = true,
                   .usual_type = BAKE_UINT8,
                   .resolve = resolve_id,
                   .describe = describe_ids},
    [BK_MAP_confidence] = {.summary = "how sure the hits are: near, facing, no second layer",
                           .channels = 1,
                           .of_all = true,
                           .resolve = resolve_mean},
    [BK_MAP_guide] = {.channels = 3, .values = BAKE_GUIDE_VALUES, .resolve = resolve_guide},
};

_Static_assert(sizeof bake_map_table / sizeof *bake_map_table == BK_MAP_COUNT,
               "the table has a row for each map of BK_MAPS");

#define MAP_NAME(name, sums) #name,
#define MAP_SUMS(name, sums) sums,
const char *const bake_map_names[BK_MAP_COUNT] = {BK_MAPS(MAP_NAME)};
const uint32_t bake_map_sums[BK_MAP_COUNT] = {BK_MAPS(MAP_SUMS)};
_Static_assert(BAKE_MAP_NORMAL == 1 << BK_MAP_normal && BAKE_MAP_COLOR == 1 << BK_MAP_color &&
                   BAKE_MAP_MASK == 1 << BK_MAP_mask && BAKE_MAP_HEIGHT == 1 << BK_MAP_height &&
                   BAKE_MAP_POSITION == 1 << BK_MAP_position &&
                   BAKE_MAP_CURVATURE == 1 << BK_MAP_curvature && BAKE_MAP_AO == 1 << BK_MAP_ao &&
                   BAKE_MAP_BENT == 1 << BK_MAP_bent &&
                   BAKE_MAP_THICKNESS == 1 << BK_MAP_thickness && BAKE_MAP_ID == 1 << BK_MAP_id &&
                   BAKE_MAP_CONFIDENCE == 1 << BK_MAP_confidence,
               "bits of bake.h are rows of BK_MAPS");
_Static_assert((int)BK_MAP_COUNT < (int)BAKE_MAX_MAPS && (int)BAKE_MAX_MAPS == BK_TRANSFER_SHIFT &&
                   (unsigned)BAKE_MAX_TRANSFERS == BK_TRANSFER_MASK,
               "every map has a bit, and the number of transfer maps has bits of its own");

/* ---- transfer maps ---- */

/* Encodings of channels of the scan, by whether they are colours and have three values. */
static const struct bake_map_row transfer_rows[2][2] = {
    {{.channels = 1, .resolve = resolve_mean}, {.channels = 3, .resolve = resolve_mean}},
    {{.channels = 1, .color = true, .resolve = resolve_mean},
     {.channels = 3, .color = true, .resolve = resolve_mean}},
};

uint32_t bake_selection(const struct bake_options *options)
{
    const uint32_t maps = options->maps & ~(uint32_t)(BAKE_MAPS_ALL | BAKE_MAPS_USUAL);
    const bool guided = options->filter_rays && maps & (BAKE_MAP_AO | BAKE_MAP_THICKNESS);
    return maps | (uint32_t)guided << BK_MAP_guide | options->transfer_count << BK_TRANSFER_SHIFT;
}

/* ---- packs ---- */

/* Returns the number of the map of a word, or BAKE_UNPACKED. */
static uint32_t find_map(const struct bake_options *options, const char *word, size_t length)
{
    for (uint32_t i = 0; i < BK_MAP_COUNT + options->transfer_count; ++i) {
        const char *name = bake_name_of(options, i);
        if (i == BK_MAP_guide)
            continue;
        if (strncmp(name, word, length) == 0 && name[length] == '\0')
            return i;
    }
    return BAKE_UNPACKED;
}

unsigned bake_unpack(const struct bake_options *options, const struct bake_pack *pack,
                     struct bake_packed out[BAKE_MAX_PACKED])
{
    unsigned count = 0;
    assert(pack);
    for (const char *word = pack->maps; word; count++) {
        const char *end = strchrnul(word, ',');
        const bool inverted = strncmp(word, "1-", 2) == 0;
        if (count == BAKE_MAX_PACKED || end == word)
            return 0;
        struct bake_packed *to = &out[count];
        *to = (struct bake_packed){.word = word, .length = (size_t)(end - word), .scale = 1};
        if (to->length == 1 && (*word == '0' || *word == '1')) {
            to->number = BAKE_CONSTANT;
            to->scale = 0;
            to->bias = (float)(*word - '0');
        } else {
            word += inverted ? 2 : 0;
            to->number = find_map(options, word, (size_t)(end - word));
            to->scale = inverted ? -1 : 1;
            to->bias = inverted ? 1 : 0;
        }
        word = *end ? end + 1 : NULL;
    }
    return count;
}

/* Returns the pack with the number of a file; NULL: it is a map. */
static const struct bake_pack *pack_of(const struct bake_options *options, unsigned number)
{
    const unsigned first = BK_MAP_COUNT + options->transfer_count;
    return number < first ? NULL : &options->packs[number - first];
}

static bool is_packed(const struct bake_options *options, unsigned number)
{
    struct bake_packed packed[BAKE_MAX_PACKED];
    for (uint32_t p = 0; p < options->pack_count; ++p)
        for (unsigned i = bake_unpack(options, &options->packs[p], packed); i-- > 0;)
            if (packed[i].number == number)
                return true;
    return false;
}

bool bake_has_file(const struct bake_options *options, uint32_t maps, unsigned number)
{
    if (pack_of(options, number))
        return true;
    if (number == BK_MAP_guide)
        return false;
    return bake_is_selected(maps, number) && !is_packed(options, number) &&
           (number < BK_MAP_COUNT || !options->transfers[number - BK_MAP_COUNT].no_file);
}

const struct bake_map_row *bake_row_of(const struct bake_options *options, unsigned number)
{
    static const struct bake_map_row pack_rows[] = {{.channels = 3}, {.channels = 4}};
    struct bake_packed packed[BAKE_MAX_PACKED];
    if (number < BK_MAP_COUNT)
        return &bake_map_table[number];
    if (pack_of(options, number))
        return &pack_rows[bake_unpack(options, pack_of(options, number), packed) == 4];
    const struct fmt_channel *channel =
        fmt_channel_find(options->transfers[number - BK_MAP_COUNT].name);
    return &transfer_rows[channel->color][channel->values == 3];
}

const char *bake_name_of(const struct bake_options *options, unsigned number)
{
    return number < BK_MAP_COUNT      ? bake_map_names[number]
           : pack_of(options, number) ? pack_of(options, number)->name
                                      : options->transfers[number - BK_MAP_COUNT].name;
}

/* What engines call maps in the names of files, by presets: Epic's recommended names, those of
 * Unity's lit shaders, and of glTF's textures. Other maps keep their names. */
static const struct {
    const char *name, *engines[4]; /* unreal, unity, blender, gltf */
} engine_names[] = {
    {"normal", {"N", "Normal", NULL, "normal"}},
    {"color", {"BC", "BaseMap", NULL, "baseColor"}},
    {"ao", {"AO", "Occlusion", NULL, "occlusion"}},
    {"height", {"H", "Height", NULL, NULL}},
    {"roughness", {"R", NULL, NULL, NULL}},
    {"emission", {"E", "Emission", NULL, "emissive"}},
    {"orm", {"ORM", NULL, NULL, "occlusionRoughnessMetallic"}},
    {"mask_map", {NULL, "MaskMap", NULL, NULL}},
};

/* Returns what "<MAP>" stands for in the name of a map's file. */
static const char *file_word_of(const struct bake_options *options, unsigned number)
{
    const char *name = bake_name_of(options, number);
    for (size_t i = 0; i < sizeof engine_names / sizeof *engine_names; i++)
        if (options->engine_names && options->preset >= 1 && options->preset <= 4 &&
            strcmp(engine_names[i].name, name) == 0 && engine_names[i].engines[options->preset - 1])
            return engine_names[i].engines[options->preset - 1];
    return name;
}

char *bake_path_of(const struct bake_options *options, unsigned number)
{
    return bake_map_path(options->output_path, file_word_of(options, number));
}

int bake_list_files(struct bsq_ctx *ctx, const struct bake_options *options,
                    const struct bake_baked_tile *tile,
                    int (*fn)(void *arg, const struct bake_file *file), void *arg)
{
    const uint32_t maps = bake_selection(options);
    char *named = tile ? bake_object_path(options->output_path, tile->object, tile->material)
                       : strdup(options->output_path);
    char *path = tile && named ? bake_tile_path(named, tile->tile) : named;
    int status = path ? 0 : BSQ_ENOMEM;
    for (unsigned i = 0; status == 0 && i < bake_files_end(options, maps); ++i) {
        const char *name = bake_name_of(options, i);
        if (!bake_has_file(options, maps, i))
            continue;
        char *file = bake_map_path(path, file_word_of(options, i));
        const unsigned number = i < BK_MAP_COUNT ? i : BAKE_MAX_MAPS;
        status = file ? fn(arg, &(struct bake_file){file, name, number}) : BSQ_ENOMEM;
        free(file);
    }
    if (status == BSQ_ENOMEM)
        status = bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", options->output_path);
    if (path != named)
        free(path);
    free(named);
    return status;
}

unsigned bake_first_of(uint32_t maps)
{
    unsigned number = 0;
    while (number < BK_MAP_COUNT && !bake_is_selected(maps, number))
        number++;
    return number;
}

uint32_t bake_map_offset(uint32_t maps, unsigned number)
{
    const uint32_t rows = maps & ((1u << BK_MAP_COUNT) - 1u);
    if (number < BK_MAP_COUNT)
        return bake_image_channels_for(rows & ((1u << number) - 1u));
    return bake_image_channels_for(rows) + BK_TRANSFER_VALUES * (number - BK_MAP_COUNT);
}

/* ---- names and choice ---- */

uint32_t bake_map_values(unsigned i)
{
    const struct bake_map_row *row = &bake_map_table[i];
    return !row->resolve ? 0 : row->values ? row->values : row->channels;
}

const char *bake_map_name(unsigned number)
{
    return number < BAKE_NAMED_MAPS ? bake_map_names[number] : NULL;
}

const char *bake_map_alias(unsigned number)
{
    return number < BAKE_NAMED_MAPS ? bake_map_table[number].alias : NULL;
}

const char *bake_map_summary(unsigned number)
{
    return number < BAKE_NAMED_MAPS ? bake_map_table[number].summary : NULL;
}

uint32_t bake_choose_maps(uint32_t asked, bool has_color, bool has_ids)
{
    const bool all = asked & BAKE_MAPS_ALL;
    const bool usual = asked == BAKE_MAPS_DEFAULT || asked & BAKE_MAPS_USUAL;
    uint32_t maps = asked & ~(uint32_t)(BAKE_MAPS_ALL | BAKE_MAPS_USUAL);
    for (unsigned i = 0; i < BAKE_NAMED_MAPS; ++i)
        if ((all || (usual && bake_map_table[i].by_default)) &&
            (has_color || !bake_map_table[i].needs_color) &&
            (has_ids || !bake_map_table[i].needs_ids))
            maps |= 1u << i;
    return maps;
}
