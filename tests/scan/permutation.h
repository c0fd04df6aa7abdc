/* permutation.h - a random order of 0 .. count - 1 in constant memory: a Feistel network over the
 * next power of four, applied again until the result is in range (Black & Rogaway, "Ciphers with
 * Arbitrary Finite Domains", 2002). */
#ifndef SCAN_PERMUTATION_H
#define SCAN_PERMUTATION_H

#include <stdint.h>

static inline uint64_t scan_mix(uint64_t x)
{
    x ^= x >> 33;
    x *= 0xff51afd7ed558ccdu;
    x ^= x >> 33;
    x *= 0xc4ceb9fe1a85ec53u;
    return x ^ x >> 33;
}

/* Returns the number at place `index` of the order. */
static inline uint64_t scan_permute(uint64_t index, uint64_t count, uint64_t seed)
{
    unsigned half = 1;
    while (half < 32 && (uint64_t)1 << 2 * half < count)
        half++;
    uint64_t mask = ((uint64_t)1 << half) - 1;
    do {
        uint64_t left = index >> half, right = index & mask;
        for (uint64_t round = 0; round < 4; round++) {
            uint64_t next = left ^ (scan_mix(right + (seed + round) * 0x9e3779b97f4a7c15u) & mask);
            left = right;
            right = next;
        }
        index = left << half | right;
    } while (index >= count);
    return index;
}

#endif
