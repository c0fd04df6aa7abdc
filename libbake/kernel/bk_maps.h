/* bk_maps.h - the maps, and what a hit adds to a texel of each.
 *
 * In: hits of a texel's samples, with lengths in the units of both meshes. Out: the texel's floats:
 * the number of samples inside a chart, the number of those that hit, and the sums of each selected
 * map, in the order of BK_MAPS. The host resolves them, see libbake/maps/map_table.c.
 *
 * A new map takes a row of BK_MAPS and its function bk_add_NAME() here, and a row of
 * bake_map_table[] in libbake/maps/map_table.c. */
#ifndef BAKE_KERNEL_BK_MAPS_H
#define BAKE_KERNEL_BK_MAPS_H

#include "bk_types.h"

/* Different ids that a texel counts. */
#define BK_ID_PAIRS 4

/* X(name, sums): each map, and how many floats bk_add_NAME() sums. The first map is bit 0 of
 * bk_params.maps and of enum bake_map. */
#define BK_MAPS(X)                                                                                 \
    X(normal, 3)                                                                                   \
    X(color, 3)                                                                                    \
    X(mask, 0)                                                                                     \
    X(height, 1)                                                                                   \
    X(position, 6)                                                                                 \
    X(curvature, 9)                                                                                \
    X(ao, 1)                                                                                       \
    X(bent, 3)                                                                                     \
    X(thickness, 2)                                                                                \
    X(id, 2 * BK_ID_PAIRS)                                                                         \
    X(confidence, 1)                                                                               \
    X(guide, 9)

#define BK_MAP_NUMBER(name, sums) BK_MAP_##name,
enum { BK_MAPS(BK_MAP_NUMBER) BK_MAP_COUNT };

/* Transfer maps show further channels of the scan. A selection of maps has the bits of BK_MAPS and,
 * from bit BK_TRANSFER_SHIFT on, the number of transfer maps. Each has three sums, after those of
 * all other maps. */
#define BK_TRANSFER_SHIFT  16
#define BK_TRANSFER_MASK   0x3fffu
#define BK_TRANSFER_VALUES 3u

BK_FN bk_uint bk_transfers(bk_uint maps)
{
    return maps >> BK_TRANSFER_SHIFT & BK_TRANSFER_MASK;
}

/* Floats of a texel. The counts are whole numbers below 2^24, which floats hold exactly. */
enum { BK_COVERED, BK_HITS, BK_SUMS };

/* A hit of one sample's ray. */
typedef struct bk_map_hit {
    float t;             /* signed distance along the ray from the low-poly mesh; outwards: > 0 */
    float position[3];   /* relative to the origin of the grid or of the chunk file */
    float normal[3];     /* of the scan: unit, object space */
    float map_normal[3]; /* the same in the space of the normal map */
    float color[3];      /* linear RGB, 0 to 1 */
    bk_uint id;          /* of the region: a colour, red in bits 0-7, green 8-15, blue 16-23 */
    /* For maps that need them: */
    float open;      /* share of the hemisphere that is open */
    float bent[3];   /* mean open direction in the space of the normal map, with its weight */
    float thickness; /* sum of distances through the solid */
    float solids;    /* their number */
    float confidence;
} bk_map_hit;

BK_FN void bk_add3(BK_GLOBAL float *sums, const float v[3])
{
    sums[0] += v[0];
    sums[1] += v[1];
    sums[2] += v[2];
}

BK_FN void bk_add_normal(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    bk_add3(sums, hit->map_normal);
}

BK_FN void bk_add_color(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    bk_add3(sums, hit->color);
}

/* Adds nothing: BK_HITS and BK_COVERED are enough for the share of samples that hit. */
BK_FN void bk_add_mask(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    (void)hit;
    (void)sums;
}

BK_FN void bk_add_height(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    sums[0] += hit->t;
}

/* Sums three values and, after them, what rounding added to their sums (Kahan, "Further Remarks on
 * Reducing Truncation Errors", 1965). The mean of many positions is then as exact as one of them.
 */
BK_FN void bk_add_position(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    bk_uint k;

    for (k = 0; k < 3; k++) {
        const float before = sums[k], term = hit->position[k] - sums[3 + k];
        const float after = before + term;

        sums[3 + k] = (after - before) - term;
        sums[k] = after;
    }
}

/* Sums where the hits are and how they are oriented; libbake/curvature/ looks around them. */
BK_FN void bk_add_curvature(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    bk_add_position(hit, sums);
    bk_add3(sums + 6, hit->normal);
}

BK_FN void bk_add_ao(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    sums[0] += hit->open;
}

BK_FN void bk_add_bent(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    bk_add3(sums, hit->bent);
}

BK_FN void bk_add_thickness(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    sums[0] += hit->thickness;
    sums[1] += hit->solids;
}

/* Counts the samples of each id: a pair is a count and an id. If a sample finds all pairs taken by
 * other ids, all counts and the sample are dropped once (Misra & Gries, "Finding repeated
 * elements", 1982). So counts are exact for up to BK_ID_PAIRS ids in a texel. */
BK_FN void bk_add_id(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    const float id = (float)(bk_int)(hit->id & 0xffffffu);
    bk_uint i, empty = BK_ID_PAIRS;

    for (i = 0; i < BK_ID_PAIRS; i++) {
        if (sums[2 * i] > 0.0f && sums[2 * i + 1] == id) {
            sums[2 * i] += 1.0f;
            return;
        }
        if (empty == BK_ID_PAIRS && sums[2 * i] == 0.0f)
            empty = i;
    }
    if (empty < BK_ID_PAIRS) {
        sums[2 * empty] = 1.0f;
        sums[2 * empty + 1] = id;
        return;
    }
    for (i = 0; i < BK_ID_PAIRS; i++)
        sums[2 * i] -= 1.0f;
}

BK_FN void bk_add_confidence(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    sums[0] += hit->confidence;
}

/* Sums the position and the normal, for libbake/filter/. */
BK_FN void bk_add_guide(const bk_map_hit *hit, BK_GLOBAL float *sums)
{
    bk_add_curvature(hit, sums);
}

/* Floats of a texel with these maps. */
BK_FN bk_uint bk_texel_floats(bk_uint maps)
{
    bk_uint count = BK_SUMS;

#define BK_MAP_FLOATS(name, sums) count += maps >> BK_MAP_##name & 1u ? (bk_uint)(sums) : 0u;
    BK_MAPS(BK_MAP_FLOATS)
    return count + BK_TRANSFER_VALUES * bk_transfers(maps);
}

/* Returns the place of the transfer maps' sums in a texel. */
BK_FN bk_uint bk_transfer_sums(bk_uint maps)
{
    return bk_texel_floats(maps) - BK_TRANSFER_VALUES * bk_transfers(maps);
}

/* Maps that need open rays. */
#define BK_OPEN_MAPS (1u << BK_MAP_ao | 1u << BK_MAP_bent)

/* Return the number of open rays, and of rays into the solid, that maps need from a hit. */
BK_FN bk_uint bk_open_rays(const bk_params *params)
{
    return params->maps & BK_OPEN_MAPS ? params->open_rays : 0;
}

BK_FN bk_uint bk_solid_rays(const bk_params *params)
{
    return params->maps & 1u << BK_MAP_thickness ? params->thickness_rays : 0;
}

BK_FN bk_uint bk_ray_count(const bk_params *params)
{
    return bk_open_rays(params) + bk_solid_rays(params);
}

BK_FN void bk_clear_texel(bk_uint maps, BK_GLOBAL float *texel)
{
    const bk_uint count = bk_texel_floats(maps);
    bk_uint i;

    for (i = 0; i < count; i++)
        texel[i] = 0.0f;
}

/* Adds a hit to the counts and to the selected maps' sums. */
BK_FN void bk_add_to_maps(bk_uint maps, const bk_map_hit *hit, BK_GLOBAL float *texel)
{
    BK_GLOBAL float *sums = texel + BK_SUMS;

    texel[BK_HITS] += 1.0f;
#define BK_MAP_ADD(name, count)                                                                    \
    if (maps >> BK_MAP_##name & 1u) {                                                              \
        bk_add_##name(hit, sums);                                                                  \
        sums += count;                                                                             \
    }
    BK_MAPS(BK_MAP_ADD)
}

/* Adds the values of a hit's channels, three for each transfer map. */
BK_FN void bk_add_transfers(bk_uint maps, const float *values, BK_GLOBAL float *texel)
{
    const bk_uint count = BK_TRANSFER_VALUES * bk_transfers(maps);
    BK_GLOBAL float *sums = texel + bk_transfer_sums(maps);
    bk_uint i;

    for (i = 0; i < count; i++)
        sums[i] += values[i];
}

#endif
