/* vec.c - unit vectors as points of an unfolded octahedron, and normal maps. */
#include "base/geometry/vec.h"

/* ---- unit vectors ----
 *
 * The sphere is projected onto an octahedron, whose lower half is folded outwards into the square
 * [-1, 1]^2. Each coordinate is then rounded to 1 / 32767. */

static float sign_of(float value)
{
    return value >= 0.0f ? 1.0f : -1.0f;
}

static uint32_t quantise(float value)
{
    return (uint32_t)lrintf(value * 32767.0f) & 0xffffu;
}

static float dequantise(uint32_t bits)
{
    float value = (float)(int16_t)(bits & 0xffffu) / 32767.0f;
    return value < -1.0f ? -1.0f : value;
}

uint32_t bsq_oct_pack(struct bsq_vec3 unit)
{
    float sum = fabsf(unit.x) + fabsf(unit.y) + fabsf(unit.z);
    if (!(sum > 0.0f) || !isfinite(sum))
        return 0; /* no direction: +z */
    float x = unit.x / sum, y = unit.y / sum;
    if (unit.z < 0.0f) {
        float folded_x = (1.0f - fabsf(y)) * sign_of(x);
        y = (1.0f - fabsf(x)) * sign_of(y);
        x = folded_x;
    }
    return quantise(x) | quantise(y) << 16;
}

struct bsq_vec3 bsq_oct_unpack(uint32_t packed)
{
    float x = dequantise(packed), y = dequantise(packed >> 16);
    float z = 1.0f - fabsf(x) - fabsf(y);
    if (z < 0.0f) {
        float unfolded_x = (1.0f - fabsf(y)) * sign_of(x);
        y = (1.0f - fabsf(x)) * sign_of(y);
        x = unfolded_x;
    }
    return bsq_unit3(bsq_v3(x, y, z));
}

/* ---- normal maps ---- */

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
