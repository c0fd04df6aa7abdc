/* bk_sample.h - from a texel's samples to rays, and from hits to the texel's sums. */
#ifndef BK_SAMPLE_H
#define BK_SAMPLE_H

#include "bk_trace.h"

/* A point of the low mesh; normal and tangent as interpolated, not unit. */
typedef struct bk_point {
    bk_vec3 position, normal, tangent;
    float handedness;
} bk_point;

BK_FN bk_vec3 bk_mix(const BK_GLOBAL float *a, const BK_GLOBAL float *b, const BK_GLOBAL float *c,
                     float wa, float wb, float wc)
{
    return bk_v3((wa * a[0] + wb * b[0]) + wc * c[0], (wa * a[1] + wb * b[1]) + wc * c[1],
                 (wa * a[2] + wb * b[2]) + wc * c[2]);
}

/* Point of a triangle at map position (x, y) in texels. */
BK_FN bk_point bk_point_at(const BK_GLOBAL bk_triangle *triangle, float x, float y)
{
    float dx = x - triangle->x0, dy = y - triangle->y0;
    float w1 = (triangle->b1[0] * dx + triangle->b1[1] * dy) + triangle->b1[2];
    float w2 = (triangle->b2[0] * dx + triangle->b2[1] * dy) + triangle->b2[2];
    float w0 = (1.0f - w1) - w2;
    bk_point point;

    point.position =
        bk_mix(triangle->position[0], triangle->position[1], triangle->position[2], w0, w1, w2);
    point.normal =
        bk_mix(triangle->normal[0], triangle->normal[1], triangle->normal[2], w0, w1, w2);
    point.tangent =
        bk_mix(triangle->tangent[0], triangle->tangent[1], triangle->tangent[2], w0, w1, w2);
    point.handedness = triangle->tangent[0][3];
    return point;
}

/* The map value m from which a MikkTSpace shader gets back `normal`: it computes
 * normalize(m.x T + m.y B + m.z N) with B = handedness * cross(N, T) and interpolated T and N, so
 * [T B N] m is parallel to the normal. Cramer's rule; the determinant's size drops out. */
BK_FN bk_vec3 bk_to_tangent_space(const bk_point *point, bk_vec3 normal)
{
    bk_vec3 t = point->tangent, n = point->normal;
    bk_vec3 b = bk_scale(bk_cross(n, t), point->handedness);
    bk_vec3 bn = bk_cross(b, n);
    float determinant = bk_dot(t, bn);
    bk_vec3 m;

    if (determinant == 0.0f)
        return bk_v3(0.0f, 0.0f, 1.0f);
    m = bk_v3(bk_dot(normal, bn), bk_dot(normal, bk_cross(n, t)), bk_dot(normal, bk_cross(t, b)));
    return bk_unit(determinant < 0.0f ? bk_scale(m, -1.0f) : m);
}

/* Traces one sample and adds it to its texel. */
BK_FN void bk_add_sample(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                         const BK_GLOBAL bk_triangle *triangle, float x, float y, bk_texel *texel)
{
    bk_point point = bk_point_at(triangle, x, y);
    bk_vec3 direction = bk_unit(point.normal), normal;
    bk_hit hit;

    texel->covered++;
    if (!(bk_dot(direction, direction) > 0.0f))
        return;
    bk_trace(grid, params, cache, point.position, direction, -params->back, params->front,
             direction, &hit);
    if (!hit.found)
        return;
    normal = bk_v3(hit.normal[0], hit.normal[1], hit.normal[2]);
    if (!(params->flags & BK_OBJECT_SPACE))
        normal = bk_to_tangent_space(&point, normal);
    texel->hits++;
    texel->normal[0] += normal.x;
    texel->normal[1] += normal.y;
    texel->normal[2] += normal.z;
    texel->color[0] += hit.color[0];
    texel->color[1] += hit.color[1];
    texel->color[2] += hit.color[2];
}

/* Texel (column, row) of a tile. */
BK_FN bk_texel bk_sample_texel(const bk_grid *grid, const bk_params *params, bk_cache *cache,
                               const BK_GLOBAL bk_triangle *triangles, const bk_tile *tile,
                               const BK_GLOBAL bk_uint *sample_triangles, bk_uint column,
                               bk_uint row)
{
    const bk_uint n = params->samples;
    bk_texel texel;
    bk_uint i, j;

    texel.normal[0] = texel.normal[1] = texel.normal[2] = 0.0f;
    texel.color[0] = texel.color[1] = texel.color[2] = 0.0f;
    texel.covered = texel.hits = 0;
    for (j = 0; j < n; j++) {
        bk_ulong first = (bk_ulong)(row * n + j) * (tile->width * n) + column * n;
        float y = (float)(tile->y + row) + ((float)j + 0.5f) / (float)n;
        for (i = 0; i < n; i++) {
            bk_uint triangle = sample_triangles[first + i];
            float x = (float)(tile->x + column) + ((float)i + 0.5f) / (float)n;
            if (triangle != BK_NO_TRIANGLE)
                bk_add_sample(grid, params, cache, &triangles[triangle], x, y, &texel);
        }
    }
    return texel;
}

#endif
