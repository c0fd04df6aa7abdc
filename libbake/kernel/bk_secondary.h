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
 * surface must not hide itself. So gaps of less than about a voxel look open. They end at any
 * surface, on either side. Rays into the solid start at the hit and end where they leave the solid,
 * at a surface that faces along them; the surface they start on faces against them. From
 * params->coarse on, any occupied voxel ends both kinds: how a far surface lies in its voxel hardly
 * matters, and its records need not be read. Rays that leave the grid inside the solid are not
 * counted: the scan has a hole, or they touched it only. */
#ifndef BAKE_KERNEL_BK_SECONDARY_H
#define BAKE_KERNEL_BK_SECONDARY_H

#include "bk_maps.h"
#include "bk_trace.h"

/* Distance above the hit at which open rays start, in voxels. It is larger than the margin of any
 * record, see bk_margin(). */
#define BK_LIFT 1.0f

/* From where a ray into the solid enters a far voxel to the surface, in voxels: the mean is 1 at
 * walls along the voxels, and 2 to 3 on scans, as rays also meet them at flat angles. */
#define BK_FAR_DEPTH 2.0f

/* Weight of the direction of a hit without open rays; each open ray has up to 1. */
#define BK_HIDDEN_WEIGHT 1.0e-3f

/* Weight of the thickness of a hit whose rays all leave the scan; each other ray has 1. */
#define BK_LEAVING_WEIGHT (1.0f / 1048576.0f)

#define BK_OPEN_MAPS      (1u << BK_MAP_ao | 1u << BK_MAP_bent)
#define BK_SECONDARY_MAPS (BK_OPEN_MAPS | 1u << BK_MAP_thickness)

/* What the rays of one hit found. */
typedef struct bk_surroundings {
    float open;      /* mean of the rays' shares: 1 if a ray meets nothing */
    bk_vec3 bent;    /* sum of their directions with these weights, object space */
    float thickness; /* sum of distances through the solid, in voxels */
    float solids;    /* number of these distances */
} bk_surroundings;

/* A point on the surface, and what its rays have in common. */
typedef struct bk_viewpoint {
    bk_vec3 position, normal; /* index space; unit, away from the solid */
    float side;               /* 1, or -1 if the scan's own normal points into the solid */
    bk_share share;
} bk_viewpoint;

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
    const float samples = (float)(bk_int)rays->samples, part = (float)(bk_int)share.first;
    const float shift = (part + bk_fraction(bk_hash(seed ^ 1u))) / samples;
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
 * they go into the solid, around the opposite one. */
BK_FN bk_vec3w bk_ray_directions(const bk_rays *rays, bk_share share, bk_vec3 normal, bk_uint first)
{
    const float side = rays->open ? 1.0f : -1.0f;

    return bk_around(bk_cone_directions(rays, share, first), bk_scale(normal, side));
}

/* Returns the same directions. Those that cross the triangle whose unit normal is `facet`, on the
 * side of `normal`, are mirrored at it; zero: there is no triangle. */
BK_FN bk_vec3w bk_hemisphere(const bk_rays *rays, bk_share share, bk_vec3 normal, bk_vec3 facet,
                             bk_uint first)
{
    const bk_fw zero = bk_splat(0.0f);
    const bk_vec3w f = bk_splat3(bk_scale(facet, rays->open ? 1.0f : -1.0f));
    const bk_vec3w d = bk_ray_directions(rays, share, normal, first);
    const bk_fw above = bk_dotw(d, f);

    return bk_select3(bk_less(above, zero), bk_add_scaledw(d, -2.0f * above, f), d);
}

/* ---- walking through blocks ---- */

/* Returns log2 of the side of the empty block around voxel (x, y, z), or 0 if its block of 4^3 has
 * voxels; *leaf is then the leaf that has them. Secondary rays cross mostly empty space, so blocks
 * of 4^3 and 32^3 voxels are looked up too: the bits of children are in the nodes that were read
 * anyway. */
BK_FN bk_uint bk_block_at(const bk_grid *grid, bk_cache *cache, bk_int x, bk_int y, bk_int z,
                          bk_uint *leaf)
{
    const bk_uint level = bk_locate(grid, cache, x, y, z);
    const BK_GLOBAL bk_ulong *words;
    bk_ulong some, bits;

    if (level == 0) {
        words = grid->leaves + (bk_ulong)cache->leaf * BK_LEAF_WORDS + BK_LEAF_MASK + (x & 4);
        bits = (bk_ulong)0x0f0f0f0fu << ((y & 4) << 3 | (z & 4));
        some = (words[0] | words[1] | words[2] | words[3]) & bits;
        *leaf = cache->leaf;
        return some ? 0u : 2u;
    }
    if (level != BK_LEAF_LOG2)
        return level;
    /* A word has 4 x 16 children: those of 4 layers in y. */
    words = grid->lowers + (bk_ulong)cache->lower * BK_LOWER_WORDS + BK_LOWER_CHILD_MASK;
    words += (x >> 5 & 3) << 4 | (y >> 5 & 3);
    bits = ((bk_ulong)0x000f000fu << 32 | 0x000f000fu) << (z >> 3 & 12);
    some = (words[0] | words[4] | words[8] | words[12]) & bits;
    return some ? level : 5u;
}

/* Looks up the blocks of lanes that have left theirs. caches: of each lane. */
BK_FN void bk_enter_blocks(const bk_grid *grid, bk_cache caches[BK_WIDTH], bk_uint bits,
                           bk_cursor *cursor)
{
    bk_int x[BK_WIDTH], y[BK_WIDTH], z[BK_WIDTH], masks[BK_WIDTH], leaves[BK_WIDTH];

    bk_store_lanes(x, cursor->x);
    bk_store_lanes(y, cursor->y);
    bk_store_lanes(z, cursor->z);
    bk_store_lanes(masks, cursor->mask);
    bk_store_lanes(leaves, cursor->leaf);
    for (; bits; bits &= bits - 1u) {
        const bk_uint lane = bk_first(bits);
        bk_uint leaf = 0;
        const bk_uint level = bk_block_at(grid, &caches[lane], x[lane], y[lane], z[lane], &leaf);
        masks[lane] = ((bk_int)1 << level) - 1;
        leaves[lane] = (bk_int)leaf;
    }
    cursor->mask = bk_load_lanes(masks);
    cursor->leaf = bk_load_lanes(leaves);
}

/* Ends walks in occupied voxels that they enter at t. */
BK_FN void bk_stop(bk_walk *walk, bk_mask lanes, bk_fw t)
{
    const bk_fw depth = bk_select(walk->two_sided, bk_splat(0.0f), bk_splat(BK_FAR_DEPTH));

    walk->hit.found = walk->hit.found | lanes;
    walk->hit.t = bk_select(lanes, t + depth, walk->hit.t);
    walk->side = bk_selecti(lanes, bk_splati(BK_APART), walk->side);
}

/* Tests the voxels that lanes are in from t to t_out, and ends the runs of lanes in empty blocks.
 * Voxels that are entered at params->coarse or later have a surface if they are occupied. */
BK_FN void bk_meet_voxels(const bk_grid *grid, const bk_params *params, const bk_ray *ray,
                          bk_walk *walk, bk_uint active, const bk_cursor *cursor, bk_fw t,
                          bk_fw t_out)
{
    const bk_uint in_leaf = active & bk_bits(cursor->mask == 0);
    bk_uint occupied = in_leaf ? bk_find_occupied(grid, in_leaf, cursor) : 0;
    const bk_uint coarse = occupied & bk_bits(bk_not(bk_less(t, bk_splat(params->coarse))));
    bk_mask ended = bk_mask_of(active & ~occupied);
    bk_ulong values[BK_WIDTH];

    if (coarse) {
        bk_stop(walk, bk_mask_of(coarse), t);
        occupied &= ~coarse;
    }
    bk_rank_voxels(grid, occupied, cursor, values);
    if (occupied)
        ended = ended | bk_meet_records(grid, ray, walk, occupied, values, cursor, t, t_out);
    if (bk_bits(ended & (walk->side != BK_APART)))
        bk_end_run(walk, ended);
}

/* Returns the layer of an axis in which rays are at t_event, when they cross a border of another
 * axis. They were in layer `from` before, and stay in the aligned block around it; mask = side - 1.
 * Borders of this axis are crossed if their t is smaller and, in the lanes of `ties`, if it is
 * equal. up: of bk_upwards(). The position at t_event may be rounded into the next layer, so the
 * borders decide. */
BK_FN bk_iw bk_layer_in(bk_iw from, bk_iw mask, bk_iw up, bk_mask ties, bk_fw start,
                        bk_fw direction, bk_fw inverse, bk_fw t_event, bk_iw base)
{
    const bk_iw low = from & ~mask, at = base + bk_to_iw(bk_floorw(start + direction * t_event));
    const bk_iw crossed = bk_maxi(bk_selecti(up != 0, at - from, from - at), bk_splati(0));
    /* Borders number `crossed` and the next one, counted along the ray. */
    const bk_iw layer = bk_selecti(up != 0, from + crossed, from - crossed + 1);
    const bk_fw last = bk_border(layer, base, start, inverse);
    const bk_fw next = bk_border(layer - (up | 1), base, start, inverse);
    const bk_mask over = bk_selecti(ties, bk_less(t_event, last), bk_not(bk_less(last, t_event)));
    const bk_mask under = bk_selecti(ties, bk_not(bk_less(t_event, next)), bk_less(next, t_event));
    const bk_iw less = bk_selecti(over & (crossed != 0), bk_splati(1), bk_splati(0));
    const bk_iw more = bk_selecti(under, bk_splati(1), bk_splati(0));
    const bk_iw steps = crossed - less + more;

    return bk_mini(bk_maxi(bk_selecti(up != 0, from + steps, from - steps), low), low + mask);
}

/* Walks rays from walk->t_start to walk->t_limit, like bk_walk_rays(), but in other steps: a step
 * goes through a voxel of an occupied block of 4^3, or through an empty block. Lanes have caches of
 * their own, because rays of a hemisphere part.
 *
 * Borders are crossed in the order of their t and, if these are equal, of their axes. So the voxels
 * that a ray visits do not depend on the size of empty blocks, and a device may skip empty space in
 * another way. */
BK_FN void bk_walk_blocks(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                          const bk_ray *ray, bk_walk *walk, bk_fw t_near, bk_fw t_far)
{
    const bk_vec3w o = ray->start, d = ray->direction, inverse = ray->inverse;
    const bk_iw up_x = bk_upwards(inverse.x), up_y = bk_upwards(inverse.y);
    const bk_iw up_z = bk_upwards(inverse.z);
    const bk_fw t_end = bk_minw(walk->t_limit, t_far);
    const bk_mask never = bk_mask_of(0);
    bk_cache caches[BK_WIDTH];
    bk_cursor cursor;
    bk_fw t;
    bk_uint active = bk_begin_walk(params, ray, walk, t_near, t_end, &t, &cursor), lane;
    const bk_mask walked = bk_mask_of(active);

    if (!active)
        return;
    for (lane = 0; lane < BK_WIDTH; lane++)
        caches[lane] = *cache;
    bk_enter_blocks(grid, caches, active, &cursor);
    do {
        const bk_iw mask = cursor.mask, x = cursor.x, y = cursor.y, z = cursor.z;
        const bk_iw fx = bk_exit_layer(x, mask, up_x), fy = bk_exit_layer(y, mask, up_y);
        const bk_iw fz = bk_exit_layer(z, mask, up_z);
        const bk_fw tx = bk_border(fx, ray->bx, o.x, inverse.x);
        const bk_fw ty = bk_border(fy, ray->by, o.y, inverse.y);
        const bk_fw tz = bk_border(fz, ray->bz, o.z, inverse.z);
        const bk_fw t_event = bk_minw(tx, bk_minw(ty, tz)), t_out = bk_maxw(t, t_event);
        const bk_mask along_x = bk_not(bk_less(ty, tx)) & bk_not(bk_less(tz, tx));
        const bk_mask along_y = bk_not(along_x) & bk_not(bk_less(tz, ty));
        const bk_mask along_z = bk_not(along_x) & bk_not(along_y);

        bk_meet_voxels(grid, params, ray, walk, active, &cursor, t, t_out);
        cursor.x = bk_selecti(along_x, fx + ~up_x, x);
        cursor.y = bk_selecti(along_y, fy + ~up_y, y);
        cursor.z = bk_selecti(along_z, fz + ~up_z, z);
        if (bk_bits(mask != 0)) {
            const bk_iw in_x =
                bk_layer_in(x, mask, up_x, bk_not(along_x), o.x, d.x, inverse.x, t_event, ray->bx);
            const bk_iw in_y =
                bk_layer_in(y, mask, up_y, along_z, o.y, d.y, inverse.y, t_event, ray->by);
            const bk_iw in_z =
                bk_layer_in(z, mask, up_z, never, o.z, d.z, inverse.z, t_event, ray->bz);
            cursor.x = bk_selecti(along_x, cursor.x, in_x);
            cursor.y = bk_selecti(along_y, cursor.y, in_y);
            cursor.z = bk_selecti(along_z, cursor.z, in_z);
        }
        t = t_out;
        active &= bk_bits(bk_less(t, t_end) & bk_not(walk->hit.found));
        bk_enter_blocks(
            grid, caches,
            active &
                bk_bits((mask | (((cursor.x ^ x) | (cursor.y ^ y) | (cursor.z ^ z)) & ~3)) != 0),
            &cursor);
    } while (active);
    bk_end_run(walk, walked);
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

/* Ends the sums of all rays of a point: `open` becomes a mean. */
BK_FN void bk_end_surroundings(const bk_params *params, bk_surroundings *sums)
{
    if (bk_open_rays(params))
        sums->open = sums->open / (float)(bk_int)bk_open_rays(params);
    if (sums->solids == 0.0f) {
        sums->solids = BK_LEAVING_WEIGHT;
        sums->thickness = BK_LEAVING_WEIGHT * params->thickness_limit;
    }
}

/* Returns where a point's rays start. */
BK_FN bk_vec3 bk_ray_start(const bk_rays *rays, const bk_viewpoint *from)
{
    return rays->open ? bk_add_scaled(from->position, BK_LIFT, from->normal) : from->position;
}

/* Traces the rays of these lanes to the first surface within their limit. Rays that are not open
 * meet only surfaces that face along them. side: of their points. Returns the distance to what they
 * met, in voxels. It is negative for open rays that met nothing, and for rays into the solid that
 * do not count. */
BK_FN bk_fw bk_look(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                    const bk_rays *rays, bk_vec3w start, bk_vec3w direction, bk_fw side,
                    bk_uint lanes)
{
    const bk_fw limit = bk_splat(rays->limit);
    const bk_ray ray =
        bk_ray_along(start, direction, bk_scalew(direction, side), bk_mask_of(lanes));
    bk_fw t_near, t_far, t;
    bk_mask through;
    bk_walk walk;

    bk_bounds(&ray, params, &t_near, &t_far);
    walk.t_start = bk_splat(0.0f);
    walk.t_limit = limit;
    walk.two_sided = bk_mask_of(rays->open ? ~0u : 0u);
    bk_walk_blocks(grid, params, cache, &ray, &walk, t_near, t_far);
    through = bk_mask_of(rays->open ? 0u : ~0u) & bk_not(bk_less(t_far, limit));
    t = bk_select(walk.hit.found, bk_minw(walk.hit.t, limit), limit);
    return bk_select(walk.hit.found | through, t, bk_splat(-1.0f));
}

/* Adds what `count` rays have found: results of bk_look(). */
BK_FN void bk_add_looks(const bk_params *params, const bk_rays *rays, bk_uint count, bk_fw found,
                        bk_vec3w direction, bk_surroundings *sums)
{
    bk_uint lane;

    for (lane = 0; lane < count; lane++) {
        const float t = bk_lane(found, lane);
        const bk_uint met = t < 0.0f ? 0u : 1u;
        if (rays->open) {
            bk_add_open(params, met, t, bk_lane3(&direction, lane), sums);
        } else if (met) {
            sums->thickness += t;
            sums->solids += 1.0f;
        }
    }
}

/* Adds up what the rays of a point found, as bk_look_around() does. found: of all its rays, open
 * ones first. */
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
            bk_fw t = zero;
            for (lane = 0; lane < count; lane++)
                bk_set_lane(t, lane, found[first + lane]);
            if (directed)
                directions = bk_ray_directions(&rays, from->share, from->normal, first);
            bk_add_looks(params, &rays, count, t, directions, &sums);
        }
        found += rays.count;
    }
    bk_end_surroundings(params, &sums);
    return sums;
}

/* Sends the rays of one point, open ones first. Sums run in the order of rays, so that they do not
 * depend on BK_WIDTH. Both kinds share a loop, since a copy of the walk is long. */
BK_FN bk_surroundings bk_look_around(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                                     const bk_viewpoint *from)
{
    const bk_uint opens = bk_open_rays(params), solids = bk_solid_rays(params);
    bk_surroundings sums = bk_no_surroundings();
    bk_uint i = 0;

    while (i < opens + solids) {
        const bk_rays rays = bk_rays_of(params, i < opens);
        const bk_uint first = rays.open ? i : i - opens;
        const bk_uint count = rays.count - first < BK_WIDTH ? rays.count - first : BK_WIDTH;
        const bk_vec3w direction = bk_ray_directions(&rays, from->share, from->normal, first);
        const bk_fw t = bk_look(grid, params, cache, &rays, bk_splat3(bk_ray_start(&rays, from)),
                                direction, bk_splat(from->side), (1u << count) - 1u);
        bk_add_looks(params, &rays, count, t, direction, &sums);
        i += count;
    }
    bk_end_surroundings(params, &sums);
    return sums;
}

#endif
