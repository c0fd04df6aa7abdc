/* bk_secondary.h - rays from the scan's surface: which part of the hemisphere above a hit is open,
 * and how far it is through the solid below.
 *
 * In: hits of a texel's samples. Out: the same hits with `open`, `bent` and `thickness`.
 *
 * Directions are cosine-weighted: points spread evenly over a disc, raised onto the hemisphere
 * (Malley's method; Pharr, Jakob and Humphreys, "Physically Based Rendering", 13.6.3). Ray i of n
 * has the squared radius (i + a) / n and the angle i / phi + b, a turn being 1 and phi the golden
 * ratio. a and b are hashes of the sample's place in the map, so neighbours use other directions
 * and nothing depends on tiles, threads or lanes.
 *
 * Open rays start one voxel above the hit: planes of neighbouring voxels do not meet exactly, and a
 * surface must not hide itself. So gaps of less than about a voxel look open. They end at any
 * surface, on either side. Rays into the solid start at the hit and end where they leave the solid,
 * at a surface that faces along them; the surface they start on faces against them. Rays that leave
 * the grid inside the solid are not counted: the scan has a hole, or they touched it only. */
#ifndef BAKE_KERNEL_BK_SECONDARY_H
#define BAKE_KERNEL_BK_SECONDARY_H

#include "bk_maps.h"
#include "bk_trace.h"

/* Distance above the hit at which open rays start, in voxels. It is larger than the margin of any
 * record, see bk_margin(). */
#define BK_LIFT 1.0f

/* Weight of the direction of a hit without open rays; each open ray has up to 1. */
#define BK_HIDDEN_WEIGHT 1.0e-3f

#define BK_OPEN_MAPS      (1u << BK_MAP_ao | 1u << BK_MAP_bent)
#define BK_SECONDARY_MAPS (BK_OPEN_MAPS | 1u << BK_MAP_thickness)

/* What the rays of one hit found. */
typedef struct bk_surroundings {
    float open;      /* mean of the rays' shares: 1 if a ray meets nothing */
    bk_vec3 bent;    /* sum of their directions with these weights, object space */
    float thickness; /* mean distance through the solid, in voxels */
} bk_surroundings;

/* A point on the surface, and what its rays have in common. */
typedef struct bk_place_on_scan {
    bk_vec3 position, normal; /* index space; unit, away from the solid */
    float side;               /* 1, or -1 if the scan's own normal points into the solid */
    bk_uint seed;
} bk_place_on_scan;

/* Hashes an integer (Appleby, MurmurHash3, the finaliser of 32 bits). */
BK_FN bk_uint bk_hash(bk_uint h)
{
    h = (h ^ h >> 16) * 0x85ebca6bu;
    h = (h ^ h >> 13) * 0xc2b2ae35u;
    return h ^ h >> 16;
}

/* Returns a number in [0, 1) from the upper 24 bits of a word. */
BK_FN float bk_fraction(bk_uint word)
{
    return (float)(bk_int)(word >> 8) * (1.0f / 16777216.0f);
}

/* Returns the sine and cosine of u turns, u in [0, 1], to about 3e-7: Taylor's polynomials around
 * the nearest quarter turn. Functions of a device's library would give other bits. */
BK_FN void bk_turn_sine(bk_fw u, bk_fw *sine, bk_fw *cosine)
{
    const bk_fw quarter = bk_floorw(4.0f * u + 0.5f);
    const bk_iw q = bk_to_iw(quarter);
    const bk_fw x = (u - 0.25f * quarter) * 6.2831853f, xx = x * x;
    const bk_fw s =
        x * (1.0f + xx * (-1.0f / 6.0f + xx * (1.0f / 120.0f + xx * (-1.0f / 5040.0f))));
    const bk_fw c =
        1.0f + xx * (-0.5f + xx * (1.0f / 24.0f + xx * (-1.0f / 720.0f + xx * (1.0f / 40320.0f))));
    const bk_mask odd = (q & 1) != 0;
    const bk_fw a = bk_select(odd, c, s), b = bk_select(odd, s, c);

    *sine = bk_select((q & 2) != 0, 0.0f - a, a);
    *cosine = bk_select(((q + 1) & 2) != 0, 0.0f - b, b);
}

/* Returns unit directions around the z axis: those of rays `first` and following ones, of `count`
 * in a cone whose half angle has the squared sine sine2. */
BK_FN bk_vec3w bk_cone_directions(bk_uint seed, bk_uint first, bk_uint count, float sine2)
{
    const float shift = bk_fraction(bk_hash(seed ^ 1u));
    const bk_uint angle = bk_hash(seed ^ 2u);
    bk_int number[BK_WIDTH], turn[BK_WIDTH];
    bk_fw square, radius, sine, cosine;
    bk_uint lane;

    for (lane = 0; lane < BK_WIDTH; lane++) {
        const bk_uint i = first + lane;
        number[lane] = (bk_int)i;
        turn[lane] = (bk_int)((i * 2654435769u + angle) >> 8); /* 2^32 / phi */
    }
    square = (bk_to_fw(bk_load_lanes(number)) + shift) * (sine2 / (float)(bk_int)count);
    square = bk_minw(square, bk_splat(1.0f));
    radius = bk_sqrtw(square);
    bk_turn_sine(bk_to_fw(bk_load_lanes(turn)) * (1.0f / 16777216.0f), &sine, &cosine);
    return bk_v3w(radius * cosine, radius * sine, bk_sqrtw(1.0f - square));
}

/* Turns directions around the z axis into directions around a unit vector (Duff et al., "Building
 * an Orthonormal Basis, Revisited", JCGT 6(1), 2017). */
BK_FN bk_vec3w bk_around(bk_vec3w cone, bk_vec3 n)
{
    const float sign = n.z < 0.0f ? -1.0f : 1.0f, a = -1.0f / (sign + n.z), b = n.x * n.y * a;
    const bk_vec3 s = bk_v3(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
    const bk_vec3 t = bk_v3(b, sign + n.y * n.y * a, -n.y);

    return bk_v3w((cone.x * s.x + cone.y * t.x) + cone.z * n.x,
                  (cone.x * s.y + cone.y * t.y) + cone.z * n.y,
                  (cone.x * s.z + cone.y * t.z) + cone.z * n.z);
}

/* Walks rays from one point to the first surface within `limit` voxels. Surfaces that face against
 * `facing` count only if both_sides is set. Returns the t at which rays leave the grid. */
BK_FN bk_fw bk_walk_from(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                         bk_vec3 origin, bk_vec3w direction, bk_vec3w facing, bk_uint count,
                         bk_uint both_sides, float limit, bk_walk *walk)
{
    const bk_vec3w start = bk_v3w(bk_splat(origin.x), bk_splat(origin.y), bk_splat(origin.z));
    const bk_ray ray = bk_ray_along(start, direction, facing, bk_mask_of((1u << count) - 1u));
    bk_fw t_near, t_far;

    bk_bounds(&ray, params, &t_near, &t_far);
    walk->t_start = bk_splat(0.0f);
    walk->t_limit = bk_splat(limit);
    walk->two_sided = bk_mask_of(both_sides ? ~0u : 0u);
    bk_walk_rays(grid, params, cache, &ray, walk, t_near, t_far, bk_splat(BK_FAR));
    return t_far;
}

/* Adds what an open ray found. */
BK_FN void bk_add_open(const bk_params *params, bk_uint found, float t, bk_vec3 direction,
                       bk_surroundings *sums)
{
    const bk_uint falloff = params->flags & BK_OPEN_FALLOFF;
    const float hidden = falloff ? bk_min(t / params->open_limit, 1.0f) : 0.0f;
    const float share = found ? hidden : 1.0f;

    sums->open += share;
    sums->bent = bk_add_scaled(sums->bent, share, direction);
}

BK_FN bk_surroundings bk_no_surroundings(void)
{
    bk_surroundings none;

    none.open = none.thickness = 0.0f;
    none.bent = bk_v3(0.0f, 0.0f, 0.0f);
    return none;
}

/* Turns sums into means. opens: open rays; counted: rays into the solid that found its end, or are
 * as long as they may be. */
BK_FN void bk_mean_surroundings(const bk_params *params, bk_uint opens, bk_uint counted,
                                bk_surroundings *sums)
{
    if (opens)
        sums->open = sums->open / (float)(bk_int)opens;
    sums->thickness = counted ? sums->thickness / (float)(bk_int)counted : params->thickness_limit;
}

/* Return the number of open rays, and of rays into the solid, that maps need from a hit. */
BK_FN bk_uint bk_open_rays(const bk_params *params)
{
    return params->maps & BK_OPEN_MAPS ? params->open_rays : 0;
}

BK_FN bk_uint bk_solid_rays(const bk_params *params)
{
    return params->maps & 1u << BK_MAP_thickness ? params->thickness_rays : 0;
}

/* Seeds of the directions of rays into the solid differ from those of open rays in these bits. */
#define BK_SOLID_SEED 4u

/* Sends the rays of one point, open ones first. Sums run in the order of rays, so that they do not
 * depend on BK_WIDTH. Both kinds share a loop, since a copy of the walk is long. */
BK_FN bk_surroundings bk_look_around(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                                     const bk_place_on_scan *from)
{
    const bk_uint opens = bk_open_rays(params), solids = bk_solid_rays(params);
    const bk_vec3 n = from->normal, inwards = bk_v3(-n.x, -n.y, -n.z);
    const bk_vec3 lifted = bk_add_scaled(from->position, BK_LIFT, n);
    bk_surroundings sums = bk_no_surroundings();
    bk_uint i = 0, lane, counted = 0;

    while (i < opens + solids) {
        const bk_uint open = i < opens, first = open ? i : i - opens, rays = open ? opens : solids;
        const bk_uint count = rays - first < BK_WIDTH ? rays - first : BK_WIDTH;
        const float sine2 = open ? params->open_sine2 : 1.0f;
        const float limit = open ? params->open_limit : params->thickness_limit;
        const bk_vec3w cone =
            bk_cone_directions(from->seed ^ (open ? 0u : BK_SOLID_SEED), first, rays, sine2);
        const bk_vec3w direction = bk_around(cone, open ? n : inwards);
        bk_walk walk;
        const bk_fw t_far =
            bk_walk_from(grid, params, cache, open ? lifted : from->position, direction,
                         bk_scalew(direction, bk_splat(from->side)), count, open, limit, &walk);
        for (lane = 0; lane < count; lane++) {
            const bk_uint found = bk_bits(walk.hit.found) >> lane & 1u;
            const float t = found ? bk_min(bk_lane(walk.hit.t, lane), limit) : limit;
            if (open) {
                bk_add_open(params, found, t, bk_lane3(&direction, lane), &sums);
            } else if (found || bk_lane(t_far, lane) >= limit) {
                sums.thickness += t;
                counted++;
            }
        }
        i += count;
    }
    bk_mean_surroundings(params, opens, counted, &sums);
    return sums;
}

#endif
