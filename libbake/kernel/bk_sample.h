/* bk_sample.h - from a texel's samples to rays, and from hits to the texel's sums. */
#ifndef BAKE_KERNEL_BK_SAMPLE_H
#define BAKE_KERNEL_BK_SAMPLE_H

#include "bk_tree.h"

/* Points of the low-poly mesh. Vectors are interpolated, so they are not unit vectors. */
typedef struct bk_point {
    bk_vec3w position, direction, normal, tangent;
    bk_fw handedness, reach;
} bk_point;

BK_FN bk_vec3w bk_mix(const BK_GLOBAL float *a, const BK_GLOBAL float *b, const BK_GLOBAL float *c,
                      bk_fw wa, bk_fw wb, bk_fw wc)
{
    return bk_v3w((wa * a[0] + wb * b[0]) + wc * c[0], (wa * a[1] + wb * b[1]) + wc * c[1],
                  (wa * a[2] + wb * b[2]) + wc * c[2]);
}

/* Returns the points of one triangle at map positions (x, y) in texels. */
BK_FN bk_point bk_point_at(const BK_GLOBAL bk_triangle *triangle, bk_fw x, bk_fw y)
{
    const bk_fw dx = x - triangle->x0, dy = y - triangle->y0;
    const bk_fw w1 = (triangle->b1[0] * dx + triangle->b1[1] * dy) + triangle->b1[2];
    const bk_fw w2 = (triangle->b2[0] * dx + triangle->b2[1] * dy) + triangle->b2[2];
    const bk_fw w0 = (1.0f - w1) - w2;
    bk_point point;

    point.position =
        bk_mix(triangle->position[0], triangle->position[1], triangle->position[2], w0, w1, w2);
    point.direction =
        bk_mix(triangle->direction[0], triangle->direction[1], triangle->direction[2], w0, w1, w2);
    point.normal =
        bk_mix(triangle->normal[0], triangle->normal[1], triangle->normal[2], w0, w1, w2);
    point.tangent =
        bk_mix(triangle->tangent[0], triangle->tangent[1], triangle->tangent[2], w0, w1, w2);
    point.handedness = bk_splat(triangle->tangent[0][3]);
    point.reach = (w0 * triangle->reach[0] + w1 * triangle->reach[1]) + w2 * triangle->reach[2];
    return point;
}

/* Turns a ray's direction, of any length, towards the normal of the triangle, on the same side. The
 * unit vectors of both are blended. A triangle without an area turns nothing. */
BK_FN bk_vec3 bk_skewed(const BK_GLOBAL bk_triangle *triangle, bk_vec3 direction, bk_uint skew)
{
    const BK_GLOBAL float *a = triangle->position[0], *b = triangle->position[1],
                          *c = triangle->position[2];
    const float share = (float)(bk_int)skew / (float)(bk_int)BK_SKEW_ONE;
    const float length = bk_sqrt(bk_dot(direction, direction));
    const bk_vec3 face = bk_unit(bk_cross(bk_v3(b[0] - a[0], b[1] - a[1], b[2] - a[2]),
                                          bk_v3(c[0] - a[0], c[1] - a[1], c[2] - a[2])));
    const float side = bk_dot(face, direction) < 0.0f ? -1.0f : 1.0f;
    bk_vec3 blend;

    if (skew == 0 || !(bk_dot(face, face) > 0.0f) || !(length > 0.0f))
        return direction;
    blend = bk_scale(direction, (1.0f - share) / length);
    return bk_scale(bk_unit(bk_add_scaled(blend, side * share, face)), length);
}

/* Returns the map values m from which a MikkTSpace shader gets back `normal`. The shader computes
 * normalize(m.x T + m.y B + m.z N) with B = handedness * cross(N, T) and interpolated T and N, so
 * [T B N] m is parallel to the normal. Uses Cramer's rule; the size of the determinant does not
 * matter. */
BK_FN bk_vec3w bk_to_tangent_space(const bk_point *point, bk_vec3w normal)
{
    const bk_fw zero = bk_splat(0.0f);
    const bk_vec3w t = point->tangent, n = point->normal;
    const bk_vec3w nt = bk_crossw(n, t), b = bk_scalew(nt, point->handedness);
    const bk_vec3w bn = bk_crossw(b, n);
    const bk_fw determinant = bk_dotw(t, bn);
    const bk_vec3w m =
        bk_v3w(bk_dotw(normal, bn), bk_dotw(normal, nt), bk_dotw(normal, bk_crossw(t, b)));
    const bk_mask mirrored = bk_less(determinant, zero);
    const bk_vec3w unit = bk_unitw(bk_select3(mirrored, bk_v3w(-m.x, -m.y, -m.z), m));

    /* A texel without a tangent frame points straight out. */
    return bk_select3(determinant == zero, bk_v3w(zero, zero, bk_splat(1.0f)), unit);
}

/* Samples to trace: lane by lane the triangle and the map position in texels. Lanes from `count`
 * on are not traced. */
typedef struct bk_samples {
    bk_uint count;
    bk_uint triangle[BK_WIDTH];
    float x[BK_WIDTH], y[BK_WIDTH];
    bk_uint skew[BK_WIDTH];           /* only read with BK_SKEW */
    BK_GLOBAL float *texel[BK_WIDTH]; /* sums of the texels; transfer maps are added by tracing */
} bk_samples;

/* Returns the points of the low-poly mesh that the samples lie on. Mostly all are on one
 * triangle. */
BK_FN bk_point bk_points_at(const bk_params *params, const BK_GLOBAL bk_triangle *triangles,
                            const bk_samples *samples)
{
    const bk_uint first = samples->triangle[0];
    bk_fw x = bk_splat(0.0f), y = x;
    bk_point points;
    bk_uint lane;

    for (lane = 0; lane < BK_WIDTH; lane++) {
        const bk_uint used = lane < samples->count ? lane : 0;
        bk_set_lane(x, lane, samples->x[used]);
        bk_set_lane(y, lane, samples->y[used]);
    }
    points = bk_point_at(&triangles[first], x, y);
    for (lane = 1; lane < samples->count; lane++) {
        bk_point point;
        if (samples->triangle[lane] == first)
            continue;
        point = bk_point_at(&triangles[samples->triangle[lane]], x, y);
        bk_set_lane3(&points.position, lane, bk_lane3(&point.position, lane));
        bk_set_lane3(&points.direction, lane, bk_lane3(&point.direction, lane));
        bk_set_lane3(&points.normal, lane, bk_lane3(&point.normal, lane));
        bk_set_lane3(&points.tangent, lane, bk_lane3(&point.tangent, lane));
        bk_set_lane(points.handedness, lane, bk_lane(point.handedness, lane));
        bk_set_lane(points.reach, lane, bk_lane(point.reach, lane));
    }
    for (lane = 0; lane < samples->count && params->flags & BK_SKEW; lane++)
        bk_set_lane3(&points.direction, lane,
                     bk_skewed(&triangles[samples->triangle[lane]],
                               bk_lane3(&points.direction, lane), samples->skew[lane]));
    return points;
}

/* Where rays start, in index space: `reach` outside of the low-poly mesh. They go inwards from
 * there, through the mesh, and without a cage also outwards, to t_max. */
typedef struct bk_start {
    bk_vec3w origin, direction; /* on the mesh; unit, outwards */
    bk_fw reach, t_max;
} bk_start;

BK_FN bk_start bk_start_at(const bk_params *params, const bk_point *points)
{
    bk_start start;

    start.origin = points->position;
    start.direction = bk_unitw(points->direction);
    start.reach = points->reach;
    start.t_max = bk_splat(params->front);
    if (params->flags & BK_CAGE)
        start.reach = start.t_max = bk_dotw(points->direction, start.direction);
    return start;
}

/* Returns which rays of its texel a sample has, by its place in a map with n x n samples a texel.
 * In another texel, samples at the same place have others. */
BK_FN bk_share bk_sample_share(float x, float y, bk_uint n)
{
    const bk_uint column = (bk_uint)(bk_int)x, row = (bk_uint)(bk_int)y;
    const bk_uint i = (bk_uint)(bk_int)(x * (float)(bk_int)n) - column * n;
    const bk_uint j = (bk_uint)(bk_int)(y * (float)(bk_int)n) - row * n;
    bk_share share;

    share.seed = bk_hash(column + 0x9e3779b9u * bk_hash(row));
    share.first = ((share.seed >> 16) * (n * n) >> 16) + j * n + i;
    if (share.first >= n * n)
        share.first -= n * n;
    return share;
}

/* Hits as maps take them: see bk_map_hit. Values of lanes whose ray hit nothing mean nothing. */
typedef struct bk_map_hits {
    bk_uint found, reversed; /* bit by bit; reversed: the scan's own normal points into the solid */
    bk_fw t;
    bk_vec3w position, normal, map_normal, color;
    bk_iw id;
    bk_fw open, thickness, solids; /* 0 unless bk_surroundings_for_maps() has set them */
    bk_fw confidence;              /* for its map only, see bk_set_confidence() */
    bk_vec3w bent;
} bk_map_hits;

/* Turns hits of rays into hits for maps. */
BK_FN void bk_hits_for_maps(const bk_params *params, const bk_point *points, const bk_start *start,
                            const bk_hits *hits, bk_map_hits *out)
{
    const bk_fw unit = bk_splat(params->unit);

    out->found = hits->found;
    out->reversed = hits->reversed;
    out->t = hits->t * unit;
    out->position = bk_scalew(bk_add_scaledw(start->origin, hits->t, start->direction), unit);
    out->normal = out->map_normal = hits->normal;
    if (!(params->flags & BK_OBJECT_SPACE))
        out->map_normal = bk_to_tangent_space(points, hits->normal);
    out->color = hits->color;
    out->id = hits->id;
    out->open = out->thickness = out->solids = bk_splat(0.0f);
    out->bent = out->map_normal;
}

/* Sets the confidence in hits: the share of the ray's length that was left at the hit, times the
 * cosine between ray and surface, times g / (g + |t|), where g is the distance from the hit to the
 * next surface that the ray could have hit too, in voxels. */
BK_FN void bk_set_confidence(const bk_params *params, const bk_start *start, const bk_hits *hits,
                             bk_fw next, bk_map_hits *out)
{
    const bk_fw zero = bk_splat(0.0f), one = bk_splat(1.0f);
    const bk_fw away = bk_absw(hits->t);
    const bk_fw length = bk_select(bk_less(hits->t, zero), bk_splat(params->back), start->t_max);
    const bk_fw left = bk_maxw(one - away / bk_maxw(length, away), zero);
    const bk_fw slope = bk_minw(bk_absw(bk_dotw(hits->normal, start->direction)), one);

    /* A hit on the mesh itself leaves all of a ray of any length. */
    out->confidence = bk_select(away == zero, slope, left * slope * (next / (next + away)));
}

/* Turns what secondary rays found, lane by lane, into values for maps. A bent direction has the
 * weight of its open rays; a hit without any has the normal with hardly a weight, so that hidden
 * texels have a direction too. */
BK_FN void bk_surroundings_for_maps(const bk_params *params, const bk_point *points,
                                    const bk_surroundings sums[BK_WIDTH], bk_map_hits *out)
{
    bk_vec3w bent = out->normal;
    bk_fw weight = bk_splat(BK_HIDDEN_WEIGHT);
    bk_uint lane;

    for (lane = 0; lane < BK_WIDTH; lane++) {
        const bk_vec3 sum = sums[lane].bent;
        if (!(out->found >> lane & 1u))
            continue;
        bk_set_lane(out->open, lane, sums[lane].open);
        bk_set_lane(out->thickness, lane, sums[lane].thickness * params->unit);
        bk_set_lane(out->solids, lane, sums[lane].solids);
        if (bk_dot(sum, sum) > 0.0f) {
            bk_set_lane3(&bent, lane, bk_unit(sum));
            bk_set_lane(weight, lane, bk_sqrt(bk_dot(sum, sum)));
        }
    }
    if (!(params->flags & BK_OBJECT_SPACE))
        bent = bk_to_tangent_space(points, bent);
    out->bent = bk_scalew(bent, weight);
}

/* Samples on their way to hits. */
typedef struct bk_traced {
    bk_point points;
    bk_start start;
    bk_hits hits;
} bk_traced;

/* Traces samples, and adds transfer maps to their texels. */
BK_FN void bk_trace_hits(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                         const BK_GLOBAL bk_triangle *triangles, const bk_samples *samples,
                         bk_traced *traced, bk_map_hits *out)
{
    const bk_uint transfers = bk_transfer_sums(params->maps);
    const bk_uint passes = params->maps >> BK_MAP_confidence & 1u ? 2 : 1;
    bk_lines lines;
    bk_hits hits;
    bk_uint lane, pass = 0;

    traced->points = bk_points_at(params, triangles, samples);
    traced->start = bk_start_at(params, &traced->points);
    lines.count = samples->count;
    lines.origin = traced->start.origin;
    lines.direction = lines.facing = traced->start.direction;
    lines.reach = traced->start.reach;
    lines.t_min = bk_splat(-params->back);
    lines.gap = 0.0f;
    lines.t_max = traced->start.t_max;
    for (lane = 0; lane < BK_WIDTH; lane++)
        lines.sums[lane] = samples->texel[lane] + transfers;
    /* GCC 12 does not see that the first pass sets it. */
    traced->hits.color = bk_splat3(bk_v3(0.0f, 0.0f, 0.0f));
    /* A loop, so that bk_trace() is compiled into one place. */
    BK_ROLLED
    for (;;) {
        bk_trace(grid, params, cache, &lines, &hits);
        if (pass == 0)
            traced->hits = hits;
        if (++pass == passes)
            break;
        bk_skip_bounds(&hits, &lines);
    }
    bk_hits_for_maps(params, &traced->points, &traced->start, &traced->hits, out);
    out->confidence = bk_splat(0.0f);
    if (passes > 1)
        bk_set_confidence(params, &traced->start, &traced->hits,
                          bk_select(bk_mask_of(hits.found), bk_absw(hits.t), bk_splat(BK_FAR)),
                          out);
}

/* Returns the viewpoint at a sample's hit, from which further rays start. */
BK_FN bk_viewpoint bk_viewpoint_of_hit(const bk_params *params, const bk_samples *samples,
                                       const bk_traced *traced, bk_uint lane)
{
    const bk_vec3w position =
        bk_add_scaledw(traced->start.origin, traced->hits.t, traced->start.direction);
    bk_viewpoint viewpoint;

    viewpoint.solid_from = bk_lane3(&position, lane);
    viewpoint.normal = bk_lane3(&traced->hits.up, lane);
    viewpoint.crowded = bk_crowded_by(&traced->hits, lane);
    viewpoint.open_from =
        bk_add_scaled(viewpoint.solid_from, viewpoint.crowded ? 0.0f : BK_LIFT, viewpoint.normal);
    viewpoint.facet = bk_v3(0.0f, 0.0f, 0.0f);
    viewpoint.side = traced->hits.reversed >> lane & 1u ? -1.0f : 1.0f;
    viewpoint.share = bk_sample_share(samples->x[lane], samples->y[lane], params->samples);
    return viewpoint;
}

BK_FN void bk_copy_lane(const bk_vec3w *from, bk_uint lane, float to[3])
{
    const bk_vec3 v = bk_lane3(from, lane);

    to[0] = v.x;
    to[1] = v.y;
    to[2] = v.z;
}

/* Adds one lane's sample to its texel. */
BK_FN void bk_add_sample(const bk_params *params, const bk_map_hits *hits, bk_uint lane,
                         BK_GLOBAL float *texel)
{
    bk_map_hit hit;

    texel[BK_COVERED] += 1.0f;
    if (!(hits->found >> lane & 1u))
        return;
    hit.t = bk_lane(hits->t, lane);
    bk_copy_lane(&hits->position, lane, hit.position);
    bk_copy_lane(&hits->normal, lane, hit.normal);
    bk_copy_lane(&hits->map_normal, lane, hit.map_normal);
    bk_copy_lane(&hits->color, lane, hit.color);
    bk_copy_lane(&hits->bent, lane, hit.bent);
    hit.id = (bk_uint)bk_lane(hits->id, lane);
    hit.open = bk_lane(hits->open, lane);
    hit.thickness = bk_lane(hits->thickness, lane);
    hit.solids = bk_lane(hits->solids, lane);
    if (params->maps >> BK_MAP_confidence & 1u)
        hit.confidence = bk_lane(hits->confidence, lane);
    bk_add_to_maps(params->maps, &hit, texel);
}

/* Returns the number of a texel's sample (i, j) among the patch's samples. */
BK_FN bk_ulong bk_sample_index(const bk_patch *patch, bk_uint n, bk_uint column, bk_uint row,
                               bk_uint i, bk_uint j)
{
    return (bk_ulong)(row * n + j) * (patch->width * n) + column * n + i;
}

/* Returns the skew of the sample with this number. */
BK_FN bk_uint bk_sample_skew(const bk_params *params, const bk_patch *patch,
                             const BK_GLOBAL bk_uint *sample_triangles, bk_ulong index)
{
    const bk_uint n = params->samples;

    if (!(params->flags & BK_SKEW))
        return 0;
    return sample_triangles[(bk_ulong)(patch->width * n) * (patch->height * n) + index];
}

/* Returns a sample's position along one axis of the map, in texels. */
BK_FN float bk_sample_position(bk_uint texel, bk_uint i, bk_uint n)
{
    return (float)texel + ((float)i + 0.5f) / (float)n;
}

#if BK_WIDTH == 1
/* Viewpoints of samples, and what the rays from these found. */
typedef struct bk_looks {
    bk_uint stage; /* BK_ADD ..; BK_ADD: the other fields are not used */
    BK_GLOBAL bk_viewpoint *points;
    const BK_GLOBAL float *found; /* bk_ray_count() values for each point */
} bk_looks;

/* Adds a sample to its texel, or stores its viewpoint. index: of its viewpoint. */
BK_FN void bk_trace_sample(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                           const BK_GLOBAL bk_triangle *triangles, const bk_samples *samples,
                           const bk_looks *looks, bk_uint index)
{
    bk_surroundings sums = bk_no_surroundings();
    bk_viewpoint from;
    bk_traced traced;
    bk_map_hits hits;

    bk_trace_hits(grid, params, cache, triangles, samples, &traced, &hits);
    from = bk_viewpoint_of_hit(params, samples, &traced, 0);
    if (looks->stage == BK_POINTS) {
        from.side = hits.found ? from.side : 0.0f;
        looks->points[index] = from;
        return;
    }
    if (looks->stage == BK_ADD_FOUND) {
        if (hits.found)
            sums = bk_add_up(params, &from, looks->found + (bk_ulong)index * bk_ray_count(params));
        bk_surroundings_for_maps(params, &traced.points, &sums, &hits);
    }
    bk_add_sample(params, &hits, 0, samples->texel[0]);
}

/* Traces the samples of texel (column, row) of a patch that are in a batch. */
BK_FN void bk_sample_texel(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                           const BK_GLOBAL bk_triangle *triangles, const bk_patch *patch,
                           const bk_batch *batch, const BK_GLOBAL bk_uint *sample_triangles,
                           bk_uint column, bk_uint row, const bk_looks *looks,
                           BK_GLOBAL float *texel)
{
    const bk_uint n = params->samples, lines = batch->end_line - batch->first_line;
    const bk_uint texels = (row - batch->first_row) * (batch->end_column - batch->first_column) +
                           (column - batch->first_column);
    bk_uint i, j, index = texels * lines * n;
    bk_samples samples;

    samples.count = 1;
    samples.texel[0] = texel;
    for (j = batch->first_line; j < batch->end_line; j++) {
        samples.y[0] = bk_sample_position(patch->y + row, j, n);
        for (i = 0; i < n; i++, index++) {
            const bk_ulong number = bk_sample_index(patch, n, column, row, i, j);
            samples.x[0] = bk_sample_position(patch->x + column, i, n);
            samples.triangle[0] = sample_triangles[number];
            samples.skew[0] = bk_sample_skew(params, patch, sample_triangles, number);
            if (samples.triangle[0] != BK_NO_TRIANGLE)
                bk_trace_sample(grid, params, cache, triangles, &samples, looks, index);
            else if (looks->stage == BK_POINTS)
                looks->points[index].side = 0.0f;
        }
    }
}

#endif

#endif
