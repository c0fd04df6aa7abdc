/* normal_map.c - see normal_map.h. */
#include "base/normal_map.h"

#include <math.h>

#include "base/vec.h"

/* Computes the direction in which the first texture coordinate grows on the plane of unit normal n,
 * as MikkTSpace has it, and across it the direction of the second one. False if the triangle has no
 * area in the texture. */
static bool tangents(const double edge[2][3], const double uv[2][2], const double n[3], double t[3],
                     double b[3])
{
    const double area = uv[0][0] * uv[1][1] - uv[0][1] * uv[1][0];
    double along[3], facet[3];
    for (int k = 0; k < 3; k++)
        along[k] = copysign(1, area) * (uv[1][1] * edge[0][k] - uv[0][1] * edge[1][k]);
    const double out = bsq_dotd(along, n);
    for (int k = 0; k < 3; k++)
        t[k] = along[k] - out * n[k];
    const double length = sqrt(bsq_dotd(t, t));
    if (area == 0 || !(length > 0))
        return false;
    for (int k = 0; k < 3; k++)
        t[k] /= length;
    /* A mirrored texture and a normal on the triangle's other side each turn the second one. */
    bsq_crossd(edge[0], edge[1], facet);
    bsq_crossd(n, t, b);
    if ((area < 0) != (bsq_dotd(facet, n) < 0))
        for (int k = 0; k < 3; k++)
            b[k] = -b[k];
    return true;
}

bool bsq_normal_map_apply(const double edge[2][3], const double uv_edge[2][2], const float texel[3],
                          double normal[3])
{
    double t[3], b[3], sum[3];
    if ((texel[0] == 0 && texel[1] == 0 && texel[2] == 0) || !tangents(edge, uv_edge, normal, t, b))
        return false;
    for (int k = 0; k < 3; k++)
        sum[k] = (2 * (double)texel[0] - 1) * t[k] + (2 * (double)texel[1] - 1) * b[k] +
                 (2 * (double)texel[2] - 1) * normal[k];
    const double length = sqrt(bsq_dotd(sum, sum));
    for (int k = 0; k < 3 && length > 1e-6; k++)
        normal[k] = sum[k] / length;
    return length > 1e-6;
}
