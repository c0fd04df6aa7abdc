/* bk_secondary.h - rays from the scan's surface: which part of the hemisphere above a hit is open,
 * and how far it is through the solid below.
 *
 * In: hits of a texel's samples. Out: the same hits with `open`, `bent` and `thickness`.
 *
 * Directions are cosine-weighted: points spread evenly over a disc, raised onto the hemisphere
 * (Malley's method; Pharr, Jakob and Humphreys, "Physically Based Rendering", 13.6.3). Ray k of the
 * n rays of a texel has the squared radius (k + a) / n and the angle k c + b, in turns. Sample s of
 * m has the rays s, s + m, s + 2 m and so on. So samples that see the same share one set, as good
 * as that of a single sample. a and b are hashes of the texel's place in the map, so neighbours use
 * other directions and nothing depends on patches, threads or lanes.
 *
 * Open rays start one voxel above the hit: planes of neighbouring voxels do not meet exactly, and a
 * surface must not hide itself. They end at any surface, on either side. If another surface is
 * beside the hit, or the hit lies in a hollow, that start would be past what hides it. Open rays of
 * such crowded points come from the hit itself, and meet what is less than a voxel above its
 * tangent plane by the rule of bk_meets(). bk_wall.h tells of a wall that stands there. Rays into
 * the solid start at the hit and end where they leave the solid, at a surface that faces along
 * them; the surface they start on faces against them. From params->coarse on, any occupied voxel
 * ends both kinds: how a far surface lies in its voxel hardly matters, and its records need not be
 * read. Rays that leave the grid inside the solid are not counted: the scan has a hole, or they
 * touched it only. */
#ifndef BAKE_KERNEL_BK_SECONDARY_H
#define BAKE_KERNEL_BK_SECONDARY_H

#include "bk_trace.h"

/* Height above the tangent plane of a crowded point at which its open rays start, in voxels. */
#define BK_NEAR_START 0.15f
/* The least cosine between a ray and the normal, for these heights. */
#define BK_RISE_MIN 0.05f

/* From where a ray into the solid enters a far voxel to the surface, in voxels: the mean is 1 at
 * walls along the voxels, and 2 to 3 on scans, as rays also meet them at flat angles. */
#define BK_FAR_DEPTH 2.0f

/* Weight of the direction of a hit without open rays; each open ray has up to 1. */
#define BK_HIDDEN_WEIGHT 1.0e-3f

/* Weight of the thickness of a hit whose rays all leave the scan; each other ray has 1. */
#define BK_LEAVING_WEIGHT (1.0f / 1048576.0f)

#define BK_SECONDARY_MAPS (BK_OPEN_MAPS | 1u << BK_MAP_thickness)

/* What the rays of one hit found. */
typedef struct bk_surroundings {
    float open;      /* mean of the rays' shares: 1 if a ray meets nothing */
    bk_vec3 bent;    /* sum of their directions with these weights, object space */
    float thickness; /* sum of distances through the solid, in voxels */
    float solids;    /* number of these distances */
} bk_surroundings;

/* Why a point is crowded: see bk_find_crowded(); it has a wall. */
enum { BK_CROWDED_BY_PLANES = 1, BK_CROWDED_BY_WALL = 2 };

/* A point on the surface, and what its rays have in common; index space. */
typedef struct bk_viewpoint {
    bk_vec3 open_from, solid_from; /* where rays start: above the surface; on it */
    bk_vec3 normal;                /* unit, away from the solid */
    bk_vec3 facet;   /* unit normal of the triangle, on that side; zero: there is none */
    float side;      /* 1, or -1 if the scan's own normal points into the solid; 0: no rays start */
    bk_uint crowded; /* not 0, but BK_CROWDED_..: both kinds of rays start on the surface */
    bk_share share;
} bk_viewpoint;

/* Returns why a hit is crowded, 0 if it is not. */
BK_FN bk_uint bk_crowded_by(const bk_hits *hits, bk_uint lane)
{
    if (hits->walled >> lane & 1u)
        return BK_CROWDED_BY_WALL;
    return hits->crowded >> lane & 1u ? BK_CROWDED_BY_PLANES : 0u;
}

/* Seeds of the directions of rays into the solid differ from those of open rays in these bits. */
#define BK_SOLID_SEED 4u

/* Rays of a point that have the same purpose: open ones, or those into the solid. */
typedef struct bk_rays {
    bk_uint open, count; /* count: of a point */
    bk_uint samples;     /* of a texel, which share directions */
    float sine2, limit;  /* squared sine of half of the cone's angle; length in voxels */
} bk_rays;

BK_FN bk_rays bk_rays_of(const bk_params *params, bk_uint open)
{
    bk_rays rays;

    rays.open = open;
    rays.count = open ? bk_open_rays(params) : bk_solid_rays(params);
    rays.samples = params->samples * params->samples;
    rays.sine2 = open ? params->open_sine2 : 1.0f;
    rays.limit = open ? params->open_limit : params->thickness_limit;
    return rays;
}

/* Return what the state of a viewpoint has, see struct bake_ray_states: words of 64 bits, with a
 * bit for each open ray if any hit will do; and distances, for other rays. */
BK_FN bk_uint bk_state_words(const bk_params *params)
{
    return params->flags & BK_OPEN_FALLOFF ? 0u : (bk_open_rays(params) + 63u) / 64u;
}
BK_FN bk_uint bk_state_lengths(const bk_params *params)
{
    return bk_solid_rays(params) + (params->flags & BK_OPEN_FALLOFF ? bk_open_rays(params) : 0u);
}

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

/* Turn between a ray and the next one of its texel, of 2^32: the golden ratio, or if a texel has
 * four samples a number whose multiples by four turn evenly too, see
 * docs/decisions/0020-rays-from-hits.md. */
#define BK_TURN         2654435769u
#define BK_TURN_OF_FOUR 1543181750u

/* Returns unit directions around the z axis: those of a point's rays `first` and following ones. */
BK_FN bk_vec3w bk_cone_directions(const bk_rays *rays, bk_share share, bk_uint first)
{
    const bk_uint seed = share.seed ^ (rays->open ? 0u : BK_SOLID_SEED);
    const float samples = (float)(bk_int)rays->samples, ordinal = (float)(bk_int)share.first;
    const float shift = (ordinal + bk_fraction(bk_hash(seed ^ 1u))) / samples;
    const bk_uint turn_each = rays->samples == 4u ? BK_TURN_OF_FOUR : BK_TURN;
    const bk_uint angle = bk_hash(seed ^ 2u);
    bk_int number[BK_WIDTH], turn[BK_WIDTH];
    bk_fw square, radius, sine, cosine;
    bk_uint lane;

    for (lane = 0; lane < BK_WIDTH; lane++) {
        const bk_uint i = first + lane;
        number[lane] = (bk_int)i;
        turn[lane] = (bk_int)(((i * rays->samples + share.first) * turn_each + angle) >> 8);
    }
    square = (bk_to_fw(bk_load_lanes(number)) + shift) * (rays->sine2 / (float)(bk_int)rays->count);
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

/* Returns directions of a point's rays like bk_cone_directions(), around its unit normal or, if
 * they go into the solid, around the opposite one. Those that cross the triangle are mirrored at
 * it. */
BK_FN bk_vec3w bk_ray_directions(const bk_rays *rays, const bk_viewpoint *from, bk_uint first)
{
    const float side = rays->open ? 1.0f : -1.0f;
    const bk_vec3w d =
        bk_around(bk_cone_directions(rays, from->share, first), bk_scale(from->normal, side));
    const bk_vec3w f = bk_splat3(bk_scale(from->facet, side));
    bk_fw above;

    if (from->facet.x == 0.0f && from->facet.y == 0.0f && from->facet.z == 0.0f)
        return d;
    above = bk_dotw(d, f);
    return bk_select3(bk_less(above, bk_splat(0.0f)), bk_add_scaledw(d, -2.0f * above, f), d);
}

/* Returns where a point's rays start. */
BK_FN bk_vec3 bk_ray_start(const bk_rays *rays, const bk_viewpoint *from)
{
    return rays->open ? from->open_from : from->solid_from;
}

/* Ends walks in occupied voxels that they enter at t. */
BK_FN void bk_stop(bk_walk *walk, bk_mask lanes, bk_fw t)
{
    const bk_fw depth = bk_select(walk->two_sided, bk_splat(0.0f), bk_splat(BK_FAR_DEPTH));

    walk->hit.found = walk->hit.found | lanes;
    walk->hit.t = bk_select(lanes, t + depth, walk->hit.t);
    walk->side = bk_selecti(lanes, bk_splati(BK_APART), walk->side);
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

    none.open = none.thickness = none.solids = 0.0f;
    none.bent = bk_v3(0.0f, 0.0f, 0.0f);
    return none;
}

/* Returns the cosines of the angles between the open rays of a crowded point and its normal; 0 for
 * other rays. */
BK_FN bk_fw bk_ray_rise(const bk_rays *rays, const bk_viewpoint *from, bk_vec3w direction)
{
    if (!rays->open || !from->crowded)
        return bk_splat(0.0f);
    return bk_maxw(bk_dotw(direction, bk_splat3(from->normal)), bk_splat(BK_RISE_MIN));
}

/* Sets the bounds of rays' walks and what they meet. rise: of bk_ray_rise(). */
BK_FN void bk_set_walk(const bk_rays *rays, bk_fw rise, bk_walk *walk)
{
    const bk_mask crowded = bk_less(bk_splat(0.0f), rise);

    walk->open = rays->open;
    walk->t_start = bk_keep(crowded, BK_NEAR_START / rise);
    walk->t_near = bk_keep(crowded, BK_LIFT / rise);
    walk->t_limit = bk_splat(rays->limit);
    walk->two_sided = bk_mask_of(rays->open ? ~0u : 0u);
}

/* Adds up what the rays of a point found, in the order of rays, so that sums do not depend on
 * BK_WIDTH. found: the distance of each ray to what it met, open rays first; negative for open rays
 * that met nothing, and for rays into the solid that do not count. */
BK_FN bk_surroundings bk_add_up(const bk_params *params, const bk_viewpoint *from,
                                const BK_GLOBAL float *found)
{
    const bk_fw zero = bk_splat(0.0f);
    const bk_uint directed = params->maps & 1u << BK_MAP_bent;
    bk_surroundings sums = bk_no_surroundings();
    bk_uint open, first, lane;

    for (open = 2; open-- > 0;) {
        const bk_rays rays = bk_rays_of(params, open);
        BK_ROLLED
        for (first = 0; first < rays.count; first += BK_WIDTH) {
            const bk_uint left = rays.count - first, count = left < BK_WIDTH ? left : BK_WIDTH;
            bk_vec3w directions = bk_v3w(zero, zero, zero);
            if (directed && open)
                directions = bk_ray_directions(&rays, from, first);
            for (lane = 0; lane < count; lane++) {
                const float t = found[first + lane];
                const bk_uint met = t < 0.0f ? 0u : 1u;
                if (open) {
                    bk_add_open(params, met, t, bk_lane3(&directions, lane), &sums);
                } else if (met) {
                    sums.thickness += t;
                    sums.solids += 1.0f;
                }
            }
        }
        found += rays.count;
    }
    if (bk_open_rays(params))
        sums.open = sums.open / (float)(bk_int)bk_open_rays(params);
    if (sums.solids == 0.0f) {
        sums.solids = BK_LEAVING_WEIGHT;
        sums.thickness = BK_LEAVING_WEIGHT * params->thickness_limit;
    }
    return sums;
}

#endif
