/* octahedral.c - unit vectors as points of an unfolded octahedron.
 *
 * The sphere is projected onto an octahedron, whose lower half is folded outwards into the square
 * [-1, 1]^2. Each coordinate is then rounded to 1 / 32767. */
#include "base/octahedral.h"

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
