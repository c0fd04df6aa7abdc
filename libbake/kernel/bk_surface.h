/* bk_surface.h - the surface around a hit: planes, normals and colours of the voxels near it.
 *
 * A record says: in this voxel the surface is the plane n . (x - centre) = d. Where planes of
 * neighbouring voxels disagree, their blend decides, with weights over the 2x2x2 voxels whose
 * centres surround the point: a partition of unity (Ohtake, Belyaev, Alexa, Turk, Seidel,
 * "Multi-level Partition of Unity Implicits", SIGGRAPH 2003). The eight voxels are worked on four
 * at a time. */
#ifndef BK_SURFACE_H
#define BK_SURFACE_H

#include "bk_grid.h"
#include "bk_srgb.h"
#include "bk_vec.h"

#define BK_PLANE_SECOND (1u << 24)
#define BK_PLANE_SHADED (1 << 25)

#define BK_MARGIN_SMOOTH 0.2f
#define BK_MARGIN_FOLD   0.4f

/* A record whose plane passes this far from the hit belongs to another sheet of the same
 * orientation. */
#define BK_SHEET_DISTANCE 0.75f
/* Longest correction that the offsets make to a unit normal. */
#define BK_CORRECTION_MAX 0.5f

/* A surface record as the traversal uses it. */
typedef struct bk_record {
    bk_vec3 normal; /* unit */
    float offset;   /* of the plane along the normal, in voxels from the centre */
    float margin;   /* how far the surface may be from the plane, in voxels */
    bk_ulong number;
} bk_record;

/* Signed 16-bit normalised integer in the low half of a word. */
BK_FN float bk_snorm16(bk_uint word)
{
    return (float)((bk_int)((word & 0xffffu) ^ 0x8000u) - 0x8000) * (1.0f / 32767.0f);
}

/* Octahedral unit vector (Meyer et al. 2010; Cigolle et al. 2014). */
BK_FN bk_vec3 bk_decode_normal(bk_uint packed)
{
    float x = bk_snorm16(packed), y = bk_snorm16(packed >> 16);
    float z = 1.0f - bk_abs(x) - bk_abs(y);
    float fold = bk_max(-z, 0.0f);

    return bk_unit(bk_v3(x >= 0.0f ? x - fold : x + fold, y >= 0.0f ? y - fold : y + fold, z));
}

/* The surface's distance from its mean plane. A smooth one errs by about half the curvature times the square of half
 * a voxel's diagonal: 0.1 voxels at a curvature radius of 4 voxels. Rough surfaces with details of 2 voxels and
 * slopes of 50 degrees lose one ray in 20000 with a margin of 0.2, one in 2000 with half of it. A fold's mean
 * plane cuts its edge: coverage, the cosine of half the fold's angle, tells how deep. At a box's edge
 * the faces end 0.35 voxels from the plane. */
BK_FN float bk_margin(bk_uint plane)
{
    const float coverage = (float)(plane >> 16 & 255u) * (1.0f / 255.0f);
    return BK_MARGIN_SMOOTH +
           BK_MARGIN_FOLD * bk_sqrt(bk_max(0.98f - coverage * coverage, 0.0f));
}

BK_FN bk_record bk_load(const bk_grid *grid, bk_ulong number, bk_uint plane)
{
    bk_record record;
    record.normal = bk_decode_normal(grid->normals[number]);
    record.offset = bk_snorm16(plane);
    record.margin = bk_margin(plane);
    record.number = number;
    return record;
}

BK_FN bk_vec3 bk_decode_color(bk_uint rgba)
{
    return bk_v3(bk_srgb[rgba & 255u], bk_srgb[rgba >> 8 & 255u], bk_srgb[rgba >> 16 & 255u]);
}

/* ---- four at a time ---- */

typedef struct bk_vec3x4 {
    bk_f4 x, y, z;
} bk_vec3x4;

BK_FN bk_f4 bk_splat(float a)
{
    return bk_set4(a, a, a, a);
}

BK_FN bk_f4 bk_max4(bk_f4 a, bk_f4 b)
{
    bk_i4 less = a < b;
    return bk_mask4(less, b) + bk_mask4(less ^ -1, a);
}

BK_FN bk_f4 bk_abs4(bk_f4 a)
{
    return bk_max4(a, 0.0f - a);
}

BK_FN float bk_sum4(bk_f4 a)
{
    return (bk_lane(a, 0) + bk_lane(a, 2)) + (bk_lane(a, 1) + bk_lane(a, 3));
}

BK_FN bk_f4 bk_snorm16x4(bk_i4 words)
{
    return bk_to_f4(((words & 0xffff) ^ 0x8000) - 0x8000) * (1.0f / 32767.0f);
}

/* bk_decode_normal() of four words. */
BK_FN bk_vec3x4 bk_decode_normal4(bk_i4 packed)
{
    const bk_f4 zero = bk_splat(0.0f);
    bk_f4 x = bk_snorm16x4(packed), y = bk_snorm16x4(packed >> 16);
    bk_f4 z = 1.0f - bk_abs4(x) - bk_abs4(y);
    bk_f4 fold = bk_max4(0.0f - z, zero);
    bk_vec3x4 n;
    bk_f4 scale;

    x = x + (bk_mask4(x < zero, fold) - bk_mask4((x < zero) ^ -1, fold));
    y = y + (bk_mask4(y < zero, fold) - bk_mask4((y < zero) ^ -1, fold));
    scale = 1.0f / bk_sqrt4(x * x + y * y + z * z);
    n.x = x * scale;
    n.y = y * scale;
    n.z = z * scale;
    return n;
}

/* ---- blending ---- */

/* Of the two records of value index v, the number of the one whose orientation is closer to
 * `normal`. */
BK_FN bk_ulong bk_choose_record(const bk_grid *grid, bk_ulong v, bk_vec3 normal)
{
    bk_ulong second = bk_second(grid, v);
    float a, b;

    if (second == 0)
        return v;
    a = bk_dot(bk_decode_normal(grid->normals[v]), normal);
    b = bk_dot(bk_decode_normal(grid->normals[second]), normal);
    return b > a ? second : v;
}

/* Weights of the two sides of a cell along one axis for a point at u, 0 .. 1, from the lower
 * centre. */
typedef struct bk_sides {
    float r[2];      /* the point's coordinate minus the centre's */
    float tent[2];   /* 1 - |r| */
    float smooth[2]; /* 3 tent^2 - 2 tent^3 */
    float slope[2];  /* derivative of smooth along the axis */
} bk_sides;

BK_FN bk_sides bk_sides_at(float u)
{
    float down = 1.0f - u;
    bk_sides sides;

    sides.r[0] = u;
    sides.r[1] = u - 1.0f;
    sides.tent[0] = down;
    sides.tent[1] = u;
    sides.smooth[0] = down * down * (1.0f + 2.0f * u);
    sides.smooth[1] = u * u * (3.0f - 2.0f * u);
    sides.slope[1] = 6.0f * u * down;
    sides.slope[0] = -sides.slope[1];
    return sides;
}

/* The four corners of one x side of a cell, in the order of (y, z) = 00, 01, 10, 11. */
typedef struct bk_face {
    bk_vec3x4 normal;
    bk_f4 f;         /* distance of the point to the plane */
    bk_vec3x4 e;     /* point minus foot point (of the voxel's centre on its plane) */
    bk_f4 w;         /* tent weight */
    bk_f4 s;         /* smooth weight */
    bk_vec3x4 slope; /* gradient of s, of planes that go with their normals */
} bk_face;

/* numbers: of the records, 0 for none. Those of other sheets get no weight. */
BK_FN void bk_face_load(const bk_grid *grid, const bk_ulong numbers[4], bk_vec3 sheet, int side,
                        const bk_sides *x, const bk_sides *y, const bk_sides *z, bk_face *face)
{
    const bk_i4 words =
        bk_seti4((bk_int)grid->normals[numbers[0]], (bk_int)grid->normals[numbers[1]],
                 (bk_int)grid->normals[numbers[2]], (bk_int)grid->normals[numbers[3]]);
    const bk_i4 planes =
        bk_seti4((bk_int)grid->planes[numbers[0]], (bk_int)grid->planes[numbers[1]],
                 (bk_int)grid->planes[numbers[2]], (bk_int)grid->planes[numbers[3]]);
    const bk_f4 there = bk_set4(numbers[0] ? 1.0f : 0.0f, numbers[1] ? 1.0f : 0.0f,
                                numbers[2] ? 1.0f : 0.0f, numbers[3] ? 1.0f : 0.0f);
    const bk_f4 zero = bk_splat(0.0f), d = bk_snorm16x4(planes);
    const bk_f4 ry = bk_set4(y->r[0], y->r[0], y->r[1], y->r[1]);
    const bk_f4 rz = bk_set4(z->r[0], z->r[1], z->r[0], z->r[1]);
    const bk_f4 sy = bk_set4(y->smooth[0], y->smooth[0], y->smooth[1], y->smooth[1]);
    const bk_f4 sz = bk_set4(z->smooth[0], z->smooth[1], z->smooth[0], z->smooth[1]);
    const bk_f4 gy = bk_set4(y->slope[0], y->slope[0], y->slope[1], y->slope[1]);
    const bk_f4 gz = bk_set4(z->slope[0], z->slope[1], z->slope[0], z->slope[1]);
    const bk_f4 ty = bk_set4(y->tent[0], y->tent[0], y->tent[1], y->tent[1]);
    const bk_f4 tz = bk_set4(z->tent[0], z->tent[1], z->tent[0], z->tent[1]);
    const bk_vec3x4 n = bk_decode_normal4(words);
    const bk_f4 agreement = n.x * sheet.x + n.y * sheet.y + n.z * sheet.z;
    const bk_f4 f = n.x * x->r[side] + n.y * ry + n.z * rz - d;
    const bk_f4 near =
        bk_max4(1.0f - f * f * (1.0f / (BK_SHEET_DISTANCE * BK_SHEET_DISTANCE)), zero);
    /* A facet's plane says nothing of a normal that was interpolated over it. */
    const bk_f4 trust = 1.0f - bk_to_f4((planes & BK_PLANE_SHADED) >> 25);
    const bk_f4 gate = bk_mask4(zero < agreement, near * there);
    const bk_f4 syz = gate * (sy * sz);

    face->normal = n;
    face->f = f;
    face->e.x = x->r[side] - n.x * d;
    face->e.y = ry - n.y * d;
    face->e.z = rz - n.z * d;
    face->w = gate * (x->tent[side] * (ty * tz));
    face->s = x->smooth[side] * syz;
    face->slope.x = x->slope[side] * (trust * syz);
    face->slope.y = x->smooth[side] * (trust * (gate * (gy * sz)));
    face->slope.z = x->smooth[side] * (trust * (gate * (sy * gz)));
}

/* Value indices of the eight corners of a cell with lowest voxel (x, y, z), 0 where not active. */
BK_FN void bk_cell_values(const bk_grid *grid, bk_cache *cache, bk_int x, bk_int y, bk_int z,
                          bk_ulong values[8])
{
    bk_uint i;

    if ((x & 7) < 7 && (y & 7) < 7 && (z & 7) < 7) {
        /* The usual case: one leaf holds all. */
        const bk_uint present = bk_locate(grid, cache, x, y, z) == 0;
        for (i = 0; i < 4; i++) {
            values[2 * i] = values[2 * i + 1] = 0;
            if (present)
                bk_leaf_pair(grid, cache->leaf, x + (bk_int)(i >> 1), y + (bk_int)(i & 1u), z,
                             values + 2 * i);
        }
        return;
    }
    for (i = 0; i < 8; i++) {
        const bk_int cx = x + (bk_int)(i >> 2), cy = y + (bk_int)(i >> 1 & 1u);
        const bk_int cz = z + (bk_int)(i & 1u);
        values[i] = 0;
        if (bk_locate(grid, cache, cx, cy, cz) == 0)
            values[i] = bk_leaf_value(grid, cache->leaf, cx, cy, cz);
    }
}

/* Turns value indices into record numbers, choosing the nearer orientation where a voxel has two.
 */
BK_FN void bk_choose_records(const bk_grid *grid, bk_vec3 sheet, bk_ulong values[8])
{
    bk_uint i, planes = 0;

    for (i = 0; i < 8; i++)
        planes |= grid->planes[values[i]];
    if (!(planes & BK_PLANE_SECOND))
        return;
    for (i = 0; i < 8; i++)
        if (values[i] != 0 && (grid->planes[values[i]] & BK_PLANE_SECOND))
            values[i] = bk_choose_record(grid, values[i], sheet);
}

/* Blended linear colour with the faces' tent weights. */
BK_FN bk_vec3 bk_blend_color(const bk_grid *grid, const bk_ulong numbers[8], const bk_face *low,
                             const bk_face *high, float weight)
{
    const float w[8] = {bk_lane(low->w, 0),  bk_lane(low->w, 1),  bk_lane(low->w, 2),
                        bk_lane(low->w, 3),  bk_lane(high->w, 0), bk_lane(high->w, 1),
                        bk_lane(high->w, 2), bk_lane(high->w, 3)};
    bk_vec3 color = bk_v3(0.0f, 0.0f, 0.0f);
    bk_uint i;

    for (i = 0; i < 8; i++)
        if (w[i] > 0.0f)
            color = bk_add_scaled(color, w[i], bk_decode_color(grid->colors[numbers[i]]));
    return bk_scale(color, 1.0f / weight);
}

/* Half the sum of the prediction errors of the planes if the normal were n and if it were their
 * own. */
BK_FN bk_f4 bk_predict(const bk_face *face, bk_vec3 n)
{
    return 0.5f * (face->f + (face->e.x * n.x + face->e.y * n.y + face->e.z * n.z));
}

/* A point on or near the surface, blended. */
typedef struct bk_blend {
    bk_uint found;  /* 0: no record of this sheet around */
    float distance; /* of the point to the blended surface along the normal */
    bk_vec3 normal; /* unit */
    bk_vec3 color;
} bk_blend;

/* Normal and distance of the blended surface.
 *
 * The tent blend n of the records' normals is exact where normals vary linearly. Where they do not,
 * the planes' offsets know more: a plane predicts the point's distance to the surface as if the
 * normal were the same everywhere, f. With the trapezoid rule, h = (n_i + n) . e_i / 2, the
 * prediction is exact for quadratic surfaces, and what the predictions differ by is the surface's
 * third derivative. The gradient of the blended h, with smooth weights, adds just that to the
 * normal; along a line it is the derivative of the cubic Hermite interpolant. Halves the error of
 * the tent blend at details of 4 to 16 voxels. */
BK_FN bk_blend bk_blend_faces(const bk_face *a, const bk_face *b)
{
    const float w = bk_sum4(a->w + b->w), s = bk_sum4(a->s + b->s);
    bk_blend blend;
    bk_vec3 n, c;
    bk_f4 ha, hb;

    blend.found = w > 0.0f && s > 0.0f;
    blend.distance = 0.0f;
    blend.normal = blend.color = bk_v3(0.0f, 0.0f, 0.0f);
    if (!blend.found)
        return blend;
    n = bk_unit(bk_v3(bk_sum4(a->w * a->normal.x + b->w * b->normal.x),
                      bk_sum4(a->w * a->normal.y + b->w * b->normal.y),
                      bk_sum4(a->w * a->normal.z + b->w * b->normal.z)));
    ha = bk_predict(a, n);
    hb = bk_predict(b, n);
    blend.distance = bk_sum4(a->s * ha + b->s * hb) / s;
    ha = ha - blend.distance;
    hb = hb - blend.distance;
    c = bk_scale(bk_v3(bk_sum4(a->slope.x * ha + b->slope.x * hb),
                       bk_sum4(a->slope.y * ha + b->slope.y * hb),
                       bk_sum4(a->slope.z * ha + b->slope.z * hb)),
                 1.0f / s);
    if (!(bk_dot(c, c) < BK_CORRECTION_MAX * BK_CORRECTION_MAX))
        c = bk_scale(bk_unit(c), BK_CORRECTION_MAX);
    blend.normal = bk_unit(bk_add_scaled(n, 1.0f, c));
    return blend;
}

/* Blends the records around a point, of the sheet with about this normal. at: relative to the
 * lowest corner of voxel (bx, by, bz). */
BK_FN bk_blend bk_blend_around(const bk_grid *grid, bk_cache *cache, bk_int bx, bk_int by,
                               bk_int bz, bk_vec3 at, bk_vec3 sheet, bk_uint has_color)
{
    const float cx = bk_floor(at.x - 0.5f), cy = bk_floor(at.y - 0.5f), cz = bk_floor(at.z - 0.5f);
    const bk_sides x = bk_sides_at(at.x - 0.5f - cx), y = bk_sides_at(at.y - 0.5f - cy);
    const bk_sides z = bk_sides_at(at.z - 0.5f - cz);
    bk_ulong numbers[8];
    bk_face low, high;
    bk_blend blend;

    bk_cell_values(grid, cache, bx + (bk_int)cx, by + (bk_int)cy, bz + (bk_int)cz, numbers);
    bk_choose_records(grid, sheet, numbers);
    bk_face_load(grid, numbers, sheet, 0, &x, &y, &z, &low);
    bk_face_load(grid, numbers + 4, sheet, 1, &x, &y, &z, &high);
    blend = bk_blend_faces(&low, &high);
    if (blend.found && has_color)
        blend.color = bk_blend_color(grid, numbers, &low, &high, bk_sum4(low.w + high.w));
    return blend;
}

#endif
