/* vertex_normals.h - packs vertex normals as formats/FORMATS.md describes them, one at a time. */
#ifndef TEST_VERTEX_NORMALS_H
#define TEST_VERTEX_NORMALS_H

#include <math.h>
#include <stdint.h>
#include <string.h>

static inline uint64_t test_pack_normal(const double n[3], float rise)
{
    const double sum = fabs(n[0]) + fabs(n[1]) + fabs(n[2]);
    double x = n[0] / sum, y = n[1] / sum;
    uint32_t bits;
    memcpy(&bits, &rise, sizeof bits);
    if (n[2] < 0) {
        const double old = x;
        x = copysign(1 - fabs(y), x);
        y = copysign(1 - fabs(old), y);
    }
    return (uint64_t)(2097152 + lrint(x * 2097151)) |
           (uint64_t)(2097152 + lrint(y * 2097151)) << 22 | (uint64_t)(bits >> 12) << 44;
}

#endif
