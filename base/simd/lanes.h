/* lanes.h - vectors of LANE_COUNT doubles, and masks of lanes.
 *
 * LANE_COUNT follows the instruction set that a source is compiled for: eight lanes
 * (lanes_avx512.h), four (lanes_avx2.h) or two (lanes_two.h). Arithmetic uses the compiler's
 * operators on vectors. These headers add only what has no operator, and comparisons, which yield
 * different masks on different instruction sets.
 *
 * A mask has one bit for each lane with AVX-512, else a whole lane of equal bits. The operators ~,
 * & and | work on both. */
#ifndef BSQ_SIMD_LANES_H
#define BSQ_SIMD_LANES_H

#include <math.h>
#include <stdint.h>

#if defined __AVX512F__ && defined __AVX512DQ__ && defined __AVX512VL__
#define LANE_COUNT 8
#elif defined __AVX2__
#define LANE_COUNT 4
#else
#define LANE_COUNT 2
#endif

#ifdef __AVX2__
#include <immintrin.h>
#elif defined __SSE4_1__
#include <smmintrin.h>
#elif defined __SSE2__
#include <emmintrin.h>
#endif

typedef double doubles __attribute__((vector_size(8 * LANE_COUNT)));
/* 64-bit integers, or the bits of doubles. */
typedef long long lane_ints __attribute__((vector_size(8 * LANE_COUNT)));

/* The same in memory that is aligned for one lane only. */
typedef double lanes_in_memory __attribute__((vector_size(8 * LANE_COUNT), aligned(8), may_alias));
typedef long long ints_in_memory
    __attribute__((vector_size(8 * LANE_COUNT), aligned(8), may_alias));

#define LANES_INLINE static inline __attribute__((always_inline))

LANES_INLINE doubles lanes_all(double x)
{
    return x - (doubles){0.0};
}

LANES_INLINE lane_ints lanes_all_bits(uint64_t x)
{
    return (long long)x - (lane_ints){0};
}

LANES_INLINE doubles lanes_load(const double *from)
{
    return *(const lanes_in_memory *)from;
}

LANES_INLINE lane_ints lanes_load_ints(const long long *from)
{
    return *(const ints_in_memory *)from;
}

LANES_INLINE void lanes_store(doubles x, double *to)
{
    *(lanes_in_memory *)to = x;
}

LANES_INLINE void lanes_store_ints(lane_ints x, long long *to)
{
    *(ints_in_memory *)to = x;
}

/* Returns integers whose low 51 bits are those of the integral values of x in two's complement; the
 * bits above are arbitrary. */
LANES_INLINE lane_ints lanes_integer_bits(doubles x)
{
    return (lane_ints)(x + 0x1.8p52);
}

#if LANE_COUNT == 8
#include "base/simd/lanes_avx512.h"
#elif LANE_COUNT == 4
#include "base/simd/lanes_avx2.h"
#else
#include "base/simd/lanes_two.h"
#endif

/* Returns an empty mask. */
LANES_INLINE lane_mask lanes_none(void)
{
    return lanes_less(lanes_all(0.0), lanes_all(0.0));
}

#endif
