/* bk_surface.h - the surface around a hit, from the planes, normals and colours of nearby voxels.
 *
 * A record says that the surface in its voxel is the plane n . (x - centre) = d. Planes of
 * neighbouring voxels disagree, so they are blended with weights over the 2x2x2 voxels whose
 * centres surround the point: a partition of unity (Ohtake, Belyaev, Alexa, Turk, Seidel,
 * "Multi-level Partition of Unity Implicits", SIGGRAPH 2003). BK_WIDTH points are blended at a
 * time. */
#ifndef BAKE_KERNEL_BK_SURFACE_H
#define BAKE_KERNEL_BK_SURFACE_H

#include "bk_grid.h"
#include "bk_vec.h"

#define BK_PLANE_SECOND       (1u << 24)
#define BK_PLANE_INCONSISTENT (1 << 25)
#define BK_FACET_NOISE_SHIFT  26
#define BK_FACET_NOISE_MAX    7

#define BK_MARGIN_SMOOTH 0.2f
#define BK_MARGIN_FOLD   0.4f

/* A record whose plane is this far from the hit, in voxels, belongs to another surface: another
 * sheet of the same orientation, or the other side of a crease. Weights fall smoothly to 0 at this
 * distance. */
#define BK_SHEET_DISTANCE 0.75f
/* Records are means over their voxels, which lowers slopes by 1/24 of their second derivatives.
 * Take a line and the cubic p whose means are the heights and slopes g of two records. Then p' =
 * (1 - u) g0 + u g1 + (6 u (1 - u) + 1/2) r, where r is the difference of the heights minus the
 * mean of the slopes. The cubic through points lacks the 1/2. Across the line u (1 - u) is 1/6 on
 * average, so the same share restores the loss from means over the other axes. A record's
 * facet-noise weight says how much of that to leave out. */
#define BK_MEAN_SLOPE 0.5f
/* Points that are farther than this before the plane of a voxel around them, in voxels, are
 * crowded. That is a hollow with a curvature radius of about 8 voxels. */
#define BK_CROWDED 0.04f

/* Longest correction of a unit normal by the planes' offsets. */
#define BK_CORRECTION_MAX 0.5f

/* Returns the linear colour of record `number`. */
BK_FN bk_vec3 bk_color_of(const bk_grid *grid, bk_ulong number)
{
    const bk_uint rgba = grid->colors[number];

    return bk_v3(grid->srgb[rgba & 255u], grid->srgb[rgba >> 8 & 255u],
                 grid->srgb[rgba >> 16 & 255u]);
}

/* ---- BK_WIDTH records at a time ---- */

/* Decodes the signed normalised 16-bit integer in the low half of each word. */
BK_FN bk_fw bk_snorm16w(bk_iw words)
{
    return bk_to_fw(((words & 0xffff) ^ 0x8000) - 0x8000) * (1.0f / 32767.0f);
}

/* Decodes octahedral unit vectors (Meyer et al. 2010; Cigolle et al. 2014). */
BK_FN bk_vec3w bk_decode_normalw(bk_iw packed)
{
    const bk_fw zero = bk_splat(0.0f);
    const bk_fw x = bk_snorm16w(packed), y = bk_snorm16w(packed >> 16);
    const bk_fw z = 1.0f - bk_absw(x) - bk_absw(y);
    const bk_fw fold = bk_maxw(0.0f - z, zero), unfold = 0.0f - fold;

    return bk_unitw(bk_v3w(x + bk_select(bk_less(x, zero), fold, unfold),
                           y + bk_select(bk_less(y, zero), fold, unfold), z));
}

/* Decoded surface records. */
typedef struct bk_record {
    bk_vec3w normal; /* unit */
    bk_fw offset;    /* of the plane along the normal, in voxels from the centre */
    bk_fw margin;    /* how far the surface may be from the plane, in voxels */
    bk_iw low, high; /* words of the record's number */
} bk_record;

/* Returns the length of a record's mean normal, 1 if the surface in the voxel is flat. */
BK_FN bk_fw bk_coverage(bk_iw planes)
{
    return bk_to_fw(planes >> 16 & 255) * (1.0f / 255.0f);
}

/* Returns how far the surface may be from its mean plane, in voxels. A smooth surface deviates by
 * about half the curvature times the square of half a voxel's diagonal: 0.1 at a curvature radius
 * of 4 voxels. Rough surfaces with details of 2 voxels and slopes of 50 degrees lose one ray in
 * 20000 with a margin of 0.2, one in 2000 with 0.1. The mean plane of a fold cuts off its edge;
 * coverage, the cosine of half the fold's angle, tells how deep. A box's edge is 0.35 from the
 * plane. */
BK_FN bk_fw bk_margin(bk_iw planes)
{
    const bk_fw coverage = bk_coverage(planes);

    return BK_MARGIN_SMOOTH +
           BK_MARGIN_FOLD * bk_sqrtw(bk_maxw(0.98f - coverage * coverage, bk_splat(0.0f)));
}

/* ---- blending ---- */

/* The records of the cell around a point, for each lane. Corners are in the order (x, y, z) = 000,
 * 001, ... */
typedef struct bk_cell {
    bk_int normals[8][BK_WIDTH], planes[8][BK_WIDTH]; /* as stored */
    bk_int present[BK_WIDTH];                         /* bit i: corner i has a record */
    bk_int sheets[BK_WIDTH];                          /* not 0: some voxel has two records */
    bk_ulong numbers[8][BK_WIDTH];
} bk_cell;

/* Returns the number of that record of value index v whose orientation is closer to `normal`. */
BK_FN bk_ulong bk_choose_record(const bk_grid *grid, bk_ulong v, bk_vec3 normal)
{
    const bk_ulong second = bk_second(grid, v);
    bk_vec3w a, b;

    if (second == 0)
        return v;
    a = bk_decode_normalw(bk_splati((bk_int)grid->normals[v]));
    b = bk_decode_normalw(bk_splati((bk_int)grid->normals[second]));
    return bk_dot(bk_lane3(&b, 0), normal) > bk_dot(bk_lane3(&a, 0), normal) ? second : v;
}

/* Finds the value indices of voxels `bit` and `bit` + 1 (z and z + 1) of a layer of a leaf. Returns
 * which are active, as bits. base: value index of the layer's first active voxel. */
BK_FN bk_uint bk_layer_pair(const bk_grid *grid, bk_ulong layer, bk_ulong base, bk_uint bit,
                            bk_ulong values[2])
{
    const bk_uint active = (bk_uint)(layer >> bit) & 3u;
    const bk_ulong first = base + bk_popcount64(layer & (((bk_ulong)1 << bit) - 1u));
    const bk_ulong second = first + (active & 1u);

    values[0] = active & 1u && first < grid->second_base ? first : 0;
    values[1] = active & 2u && second < grid->second_base ? second : 0;
    return active;
}

/* Finds the value indices of the eight corners of a cell with lowest voxel (x, y, z), 0 if not
 * active. Returns which are active, as bits. */
BK_FN bk_uint bk_cell_values(const bk_grid *grid, bk_cache *cache, bk_int x, bk_int y, bk_int z,
                             bk_ulong values[8])
{
    /* Axes along which the corners lie in two leaves, and the other axes, as bits of a corner. */
    const bk_uint across = ((x & 7) == 7 ? 4u : 0u) | ((y & 7) == 7 ? 2u : 0u) | ((z & 7) == 7);
    const bk_uint within = 7u & ~across;
    bk_uint i, side = 0, active = 0;

    for (i = 0; i < 8; i++)
        values[i] = 0;
    if (across == 0) {
        /* The usual case. */
        const bk_uint layer = (bk_uint)x & 7u, bit = ((bk_uint)y & 7u) << 3 | ((bk_uint)z & 7u);
        if (bk_locate(grid, cache, x, y, z) != 0)
            return 0;
        for (i = 0; i < 2; i++) {
            const BK_GLOBAL bk_ulong *words = grid->leaves + (bk_ulong)cache->leaf * BK_LEAF_WORDS;
            const bk_ulong base = bk_leaf_rank(grid, words, layer + i, 0);
            const bk_ulong voxels = words[BK_LEAF_MASK + layer + i];
            active |= bk_layer_pair(grid, voxels, base, bit, values + 4 * i) << 4 * i;
            active |= bk_layer_pair(grid, voxels, base, bit + 8u, values + 4 * i + 2)
                      << (4 * i + 2);
        }
        return active;
    }
    do {
        i = 0;
        if (bk_locate(grid, cache, x + (bk_int)(side >> 2), y + (bk_int)(side >> 1 & 1u),
                      z + (bk_int)(side & 1u)) != 0)
            continue;
        do {
            const bk_uint corner = side | i;
            values[corner] =
                bk_leaf_value(grid, cache->leaf, x + (bk_int)(corner >> 2),
                              y + (bk_int)(corner >> 1 & 1u), z + (bk_int)(corner & 1u));
            active |= (bk_uint)(values[corner] != 0) << corner;
            i = (i - within) & within; /* the next subset */
        } while (i);
    } while ((side = (side - across) & across));
    return active;
}

BK_FN void bk_cell_clear(bk_uint lane, bk_cell *cell)
{
    bk_uint i;

    for (i = 0; i < 8; i++) {
        cell->normals[i][lane] = 0;
        cell->planes[i][lane] = 0;
        cell->numbers[i][lane] = 0;
    }
    cell->present[lane] = cell->sheets[lane] = 0;
}

/* Fills one lane. Of two records in a voxel, takes the one whose orientation is closer to `sheet`.
 */
BK_FN void bk_cell_load(const bk_grid *grid, bk_cache *cache, bk_int x, bk_int y, bk_int z,
                        bk_vec3 sheet, bk_uint lane, bk_cell *cell)
{
    bk_ulong values[8];
    bk_uint i, planes = 0;
    cell->present[lane] = (bk_int)bk_cell_values(grid, cache, x, y, z, values);
    for (i = 0; i < 8; i++) {
        const bk_uint plane = grid->planes[values[i]];
        planes |= plane;
        cell->normals[i][lane] = (bk_int)grid->normals[values[i]];
        cell->planes[i][lane] = (bk_int)plane;
        cell->numbers[i][lane] = values[i];
    }
    cell->sheets[lane] = (bk_int)(planes & BK_PLANE_SECOND);
    if (!cell->sheets[lane])
        return;
    for (i = 0; i < 8; i++)
        if (values[i] != 0 && ((bk_uint)cell->planes[i][lane] & BK_PLANE_SECOND)) {
            const bk_ulong number = bk_choose_record(grid, values[i], sheet);
            cell->normals[i][lane] = (bk_int)grid->normals[number];
            cell->planes[i][lane] = (bk_int)grid->planes[number];
            cell->numbers[i][lane] = number;
        }
}

/* Weights of the lower and upper side of a cell along one axis, for a point at u (0 to 1) from the
 * lower centre. */
typedef struct bk_sides {
    bk_fw r[2];      /* the point's coordinate minus the centre's */
    bk_fw tent[2];   /* 1 - |r| */
    bk_fw smooth[2]; /* 3 tent^2 - 2 tent^3 */
    bk_fw slope[2];  /* derivative of smooth along the axis, and bk_mean_slope() */
} bk_sides;

/* Computes all but the slopes. */
BK_FN bk_sides bk_sides_at(bk_fw u)
{
    const bk_fw down = 1.0f - u;
    bk_sides sides;

    sides.r[0] = u;
    sides.r[1] = u - 1.0f;
    sides.tent[0] = down;
    sides.tent[1] = u;
    sides.smooth[0] = down * down * (1.0f + 2.0f * u);
    sides.smooth[1] = u * u * (3.0f - 2.0f * u);
    sides.slope[0] = sides.slope[1] = bk_splat(0.0f);
    return sides;
}

BK_FN void bk_set_slopes(bk_sides *sides, bk_fw mean_slope)
{
    sides->slope[1] = 6.0f * sides->tent[1] * sides->tent[0] + mean_slope;
    sides->slope[0] = -sides->slope[1];
}

/* The weights of a cell's corners for points in each lane. */
typedef struct bk_weights {
    bk_sides x, y, z;
} bk_weights;

/* One corner of the cell in each lane. It keeps only what the weights do not give, since eight
 * corners fill the registers of processors and GPUs. */
typedef struct bk_corner {
    bk_vec3w normal;
    bk_fw offset; /* of the plane from the voxel's centre */
    bk_fw f;      /* distance of the point to the plane */
    bk_fw gate;   /* factor of the corner's weights, 0 to 1 */
    bk_fw trust;  /* the same, but 0 if the plane is inconsistent with the normal */
} bk_corner;

/* Returns corner i of a cell. Records of other sheets get no weight. Records of folds get little:
 * their normal is a mean of both sides, and their neighbours have the normals of each side. The
 * weight has a factor of coverage to the eighth power: 1/2 if a surface turns by 45 degrees, 1/16
 * at 90, 0.95 on a cylinder with a radius of 2.5 voxels. Among the powers 4, 8, 16 and 32 it leaves
 * the fewest texels with errors above 5 degrees, on the bunny and on the vase. */
BK_FN bk_corner bk_corner_at(const bk_cell *cell, bk_uint i, bk_vec3w sheet, const bk_weights *at)
{
    const bk_uint ix = i >> 2, iy = i >> 1 & 1u, iz = i & 1u;
    const bk_iw planes = bk_load_lanes(cell->planes[i]);
    const bk_fw zero = bk_splat(0.0f), d = bk_snorm16w(planes);
    const bk_vec3w n = bk_decode_normalw(bk_load_lanes(cell->normals[i]));
    const bk_fw agreement = bk_dotw(n, sheet);
    const bk_fw f = n.x * at->x.r[ix] + n.y * at->y.r[iy] + n.z * at->z.r[iz] - d;
    const bk_fw near =
        bk_maxw(1.0f - f * f * (1.0f / (BK_SHEET_DISTANCE * BK_SHEET_DISTANCE)), zero);
    const bk_mask there = (bk_load_lanes(cell->present) & (bk_int)(1u << i)) != 0;
    const bk_fw coverage = bk_coverage(planes), squared = coverage * coverage;
    const bk_fw fourth = squared * squared, smooth = fourth * fourth;
    bk_corner corner;

    corner.normal = n;
    corner.offset = d;
    corner.f = f;
    corner.gate = bk_keep(bk_less(zero, agreement) & there, (near * near) * smooth);
    /* A facet's plane does not predict normals that were interpolated over the facet. */
    corner.trust = corner.gate * (1.0f - bk_to_fw((planes & BK_PLANE_INCONSISTENT) >> 25));
    return corner;
}

/* Returns the tent weight of corner i. */
BK_FN bk_fw bk_tent(const bk_corner *corner, bk_uint i, const bk_weights *at)
{
    return corner->gate * (at->x.tent[i >> 2] * (at->y.tent[i >> 1 & 1u] * at->z.tent[i & 1u]));
}

/* Returns the smooth weight of corner i. */
BK_FN bk_fw bk_smooth(const bk_corner *corner, bk_uint i, const bk_weights *at)
{
    return at->x.smooth[i >> 2] *
           (corner->gate * (at->y.smooth[i >> 1 & 1u] * at->z.smooth[i & 1u]));
}

/* Adds four sums, each of the terms of corners i and i + 4. */
BK_FN bk_fw bk_sum_pairs(const bk_fw pair[4])
{
    return (pair[0] + pair[2]) + (pair[1] + pair[3]);
}

/* Returns how much of the slope that means over voxels lose is restored: less with facet noise. */
BK_FN bk_fw bk_mean_slope(const bk_cell *cell, const bk_fw tents[8])
{
    bk_fw noise[4], weight[4];
    bk_uint i;

    for (i = 0; i < 4; i++) {
        const bk_iw a = bk_load_lanes(cell->planes[i]) >> BK_FACET_NOISE_SHIFT & BK_FACET_NOISE_MAX;
        const bk_iw b =
            bk_load_lanes(cell->planes[i + 4]) >> BK_FACET_NOISE_SHIFT & BK_FACET_NOISE_MAX;
        noise[i] = tents[i] * bk_to_fw(a) + tents[i + 4] * bk_to_fw(b);
        weight[i] = tents[i] + tents[i + 4];
    }
    return BK_MEAN_SLOPE -
           (BK_MEAN_SLOPE / BK_FACET_NOISE_MAX) * (bk_sum_pairs(noise) / bk_sum_pairs(weight));
}

/* Returns the gradient of the smooth weight of corner i, from bk_sides.slope. */
BK_FN bk_vec3w bk_weight_slope(const bk_corner *corner, bk_uint i, const bk_weights *at)
{
    const bk_uint ix = i >> 2, iy = i >> 1 & 1u, iz = i & 1u;
    const bk_fw trust = corner->trust;

    return bk_v3w(at->x.slope[ix] * (trust * (at->y.smooth[iy] * at->z.smooth[iz])),
                  at->x.smooth[ix] * (trust * (at->y.slope[iy] * at->z.smooth[iz])),
                  at->x.smooth[ix] * (trust * (at->y.smooth[iy] * at->z.slope[iz])));
}

/* Blends the linear colours of one lane with the corners' tent weights, whose sum is `weight`. */
BK_FN bk_vec3 bk_blend_color(const bk_grid *grid, const bk_cell *cell, const bk_fw tents[8],
                             bk_uint lane, float weight)
{
    bk_vec3 color = bk_v3(0.0f, 0.0f, 0.0f);
    bk_uint i;

    for (i = 0; i < 8; i++) {
        const float w = bk_lane(tents[i], lane);
        if (w > 0.0f)
            color = bk_add_scaled(color, w, bk_color_of(grid, cell->numbers[i][lane]));
    }
    return bk_scale(color, 1.0f / weight);
}

/* Returns the point's distance to the surface as corner i predicts it: the mean of the predictions
 * with the corner's own normal and with normal n. */
BK_FN bk_fw bk_predict(const bk_corner *corner, bk_uint i, const bk_weights *at, bk_vec3w n)
{
    /* The point minus the foot of the voxel's centre on the plane. */
    const bk_vec3w e = bk_v3w(at->x.r[i >> 2] - corner->normal.x * corner->offset,
                              at->y.r[i >> 1 & 1u] - corner->normal.y * corner->offset,
                              at->z.r[i & 1u] - corner->normal.z * corner->offset);

    return 0.5f * (corner->f + bk_dotw(e, n));
}

/* The blended surface near points. */
typedef struct bk_blend {
    bk_mask found;   /* the cell has records of this sheet */
    bk_fw weight;    /* sum of the corners' tent weights */
    bk_fw distance;  /* of the point to the blended surface along the normal */
    bk_vec3w normal; /* unit */
} bk_blend;

/* Returns the tent blend of the corners' normals, as a unit vector. */
BK_FN bk_vec3w bk_blend_tent(const bk_corner corners[8], const bk_fw tents[8])
{
    bk_fw x[4], y[4], z[4];
    bk_uint i;

    for (i = 0; i < 4; i++) {
        const bk_corner *a = &corners[i], *b = &corners[i + 4];
        x[i] = tents[i] * a->normal.x + tents[i + 4] * b->normal.x;
        y[i] = tents[i] * a->normal.y + tents[i + 4] * b->normal.y;
        z[i] = tents[i] * a->normal.z + tents[i + 4] * b->normal.z;
    }
    return bk_unitw(bk_v3w(bk_sum_pairs(x), bk_sum_pairs(y), bk_sum_pairs(z)));
}

/* Returns the normal and the distance of the blended surface.
 *
 * The tent blend n of the records' normals is exact if normals vary linearly. If they do not, the
 * planes' offsets add information. A plane alone predicts the point's distance f as if the normal
 * were constant. The trapezoid rule, h = (n_i + n) . e_i / 2, is exact for quadratic surfaces, so
 * the predictions h differ by the surface's third derivative. The gradient of the blended h, with
 * smooth weights, adds that to the normal. Along a line it is the derivative of the cubic Hermite
 * interpolant, apart from bk_mean_slope(). The error is a third of the tent blend's at details of 4
 * and 8 voxels, half at 16. */
BK_FN bk_blend bk_blend_corners(const bk_corner corners[8], const bk_fw tents[8],
                                const bk_weights *at)
{
    const bk_vec3w n = bk_blend_tent(corners, tents);
    bk_fw h[8], w[4], s[4], sh[4], cx[4], cy[4], cz[4], total;
    bk_vec3w c;
    bk_mask small;
    bk_blend blend;
    bk_uint i;

    for (i = 0; i < 4; i++) {
        const bk_corner *a = &corners[i], *b = &corners[i + 4];
        const bk_fw sa = bk_smooth(a, i, at), sb = bk_smooth(b, i + 4, at);
        h[i] = bk_predict(a, i, at, n);
        h[i + 4] = bk_predict(b, i + 4, at, n);
        w[i] = tents[i] + tents[i + 4];
        s[i] = sa + sb;
        sh[i] = sa * h[i] + sb * h[i + 4];
    }
    blend.weight = bk_sum_pairs(w);
    total = bk_sum_pairs(s);
    /* With faint weights, n may be 0: all surfaces around turn by nearly 180 degrees. */
    blend.found = bk_less(bk_splat(0.5f), bk_dotw(n, n)) & bk_less(bk_splat(0.0f), total);
    blend.distance = bk_sum_pairs(sh) / total;
    for (i = 0; i < 4; i++) {
        const bk_vec3w a = bk_weight_slope(&corners[i], i, at);
        const bk_vec3w b = bk_weight_slope(&corners[i + 4], i + 4, at);
        const bk_fw ha = h[i] - blend.distance, hb = h[i + 4] - blend.distance;
        cx[i] = a.x * ha + b.x * hb;
        cy[i] = a.y * ha + b.y * hb;
        cz[i] = a.z * ha + b.z * hb;
    }
    c = bk_scalew(bk_v3w(bk_sum_pairs(cx), bk_sum_pairs(cy), bk_sum_pairs(cz)), 1.0f / total);
    small = bk_less(bk_dotw(c, c), bk_splat(BK_CORRECTION_MAX * BK_CORRECTION_MAX));
    c = bk_select3(small, c, bk_scalew(bk_unitw(c), bk_splat(BK_CORRECTION_MAX)));
    blend.normal = bk_unitw(bk_v3w(n.x + c.x, n.y + c.y, n.z + c.z));
    return blend;
}

#endif
