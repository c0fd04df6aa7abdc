/* lanes.h - private to voxelizing: doubles side by side, on which every operation works alike.
 *
 * As many as the instructions go for which a source is compiled, so that the same source serves
 * several. Lanes never meet in arithmetic: results do not depend on their number. Arithmetic and
 * comparisons are the compiler's own on vectors; here is what it has no operator for. */
#ifndef VOX_LANES_H
#define VOX_LANES_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#ifdef __AVX2__
#include <immintrin.h>
#define LANE_COUNT 4
#else
#define LANE_COUNT 2
#ifdef __SSE4_1__
#include <smmintrin.h>
#elif defined __SSE2__
#include <emmintrin.h>
#endif
#endif

typedef double lanes __attribute__((vector_size(8 * LANE_COUNT)));
/* All bits of a lane or none, as comparisons yield. */
typedef long long lane_mask __attribute__((vector_size(8 * LANE_COUNT)));

#define LANES_INLINE static inline __attribute__((always_inline))

LANES_INLINE lanes lanes_all(double x)
{
    return x - (lanes){0.0};
}

/* x where the mask is set, 0 elsewhere */
LANES_INLINE lanes lanes_keep(lane_mask mask, lanes x)
{
    return (lanes)(mask & (lane_mask)x);
}

LANES_INLINE lanes lanes_abs(lanes x)
{
    return (lanes)((lane_mask)x & INT64_MAX);
}

/* x in all lanes */
LANES_INLINE lane_mask lanes_all_bits(uint64_t x)
{
    return (long long)x - (lane_mask){0};
}

/* Two's complement of whole numbers in the low 51 bits, others above. */
LANES_INLINE lane_mask lanes_integer_bits(lanes x)
{
    return (lane_mask)(x + 0x1.8p52);
}

/* Four numbers of one thing, whatever the number of lanes. Not one vector: compilers keep vectors
 * larger than the processor's in memory, where loads wait for smaller stores. */
#define ROW_PARTS (4 / LANE_COUNT)
struct row {
    lanes part[ROW_PARTS];
};

/* At any double. */
typedef double lanes_in_memory __attribute__((vector_size(8 * LANE_COUNT), aligned(8), may_alias));

LANES_INLINE struct row row_load(const double *from)
{
    struct row x;
    for (int i = 0; i < ROW_PARTS; i++)
        x.part[i] = *(const lanes_in_memory *)(from + i * LANE_COUNT);
    return x;
}

LANES_INLINE void row_store(struct row x, double *to)
{
    for (int i = 0; i < ROW_PARTS; i++)
        *(lanes_in_memory *)(to + i * LANE_COUNT) = x.part[i];
}

LANES_INLINE struct row row_sum(struct row a, struct row b)
{
    for (int i = 0; i < ROW_PARTS; i++)
        a.part[i] += b.part[i];
    return a;
}

LANES_INLINE struct row row_difference(struct row a, struct row b)
{
    for (int i = 0; i < ROW_PARTS; i++)
        a.part[i] -= b.part[i];
    return a;
}

LANES_INLINE struct row row_product(struct row a, struct row b)
{
    for (int i = 0; i < ROW_PARTS; i++)
        a.part[i] *= b.part[i];
    return a;
}

LANES_INLINE struct row row_times(double factor, struct row x)
{
    for (int i = 0; i < ROW_PARTS; i++)
        x.part[i] *= lanes_all(factor);
    return x;
}

/* Adds x to the four numbers. */
LANES_INLINE void row_add(double *to, struct row x)
{
    row_store(row_sum(row_load(to), x), to);
}

LANES_INLINE struct row row_of(double a, double b, double c, double d)
{
    const double numbers[4] = {a, b, c, d};
    struct row x;
    for (int i = 0; i < 4; i++)
        x.part[i / LANE_COUNT][i % LANE_COUNT] = numbers[i];
    return x;
}

/* x with another last number */
LANES_INLINE struct row row_with_last(struct row x, double last)
{
    x.part[3 / LANE_COUNT][3 % LANE_COUNT] = last;
    return x;
}

/* The number with this index. */
LANES_INLINE double row_number(struct row x, int i)
{
    return x.part[i / LANE_COUNT][i % LANE_COUNT];
}

/* Four whole numbers, whatever the number of lanes: a voxel and a number that does not matter. */
typedef int32_t four_ints __attribute__((vector_size(16)));

LANES_INLINE four_ints four_load(const int32_t from[4])
{
    four_ints x;
    memcpy(&x, from, sizeof x);
    return x;
}

#ifdef __SSE4_1__

LANES_INLINE four_ints four_min(four_ints a, four_ints b)
{
    return (four_ints)_mm_min_epi32((__m128i)a, (__m128i)b);
}

LANES_INLINE four_ints four_max(four_ints a, four_ints b)
{
    return (four_ints)_mm_max_epi32((__m128i)a, (__m128i)b);
}

LANES_INLINE bool four_any(four_ints mask)
{
    return _mm_movemask_epi8((__m128i)mask) != 0;
}

#else

LANES_INLINE four_ints four_min(four_ints a, four_ints b)
{
    four_ints less = a < b;
    return (less & a) | (~less & b);
}

LANES_INLINE four_ints four_max(four_ints a, four_ints b)
{
    four_ints more = a > b;
    return (more & a) | (~more & b);
}

LANES_INLINE bool four_any(four_ints mask)
{
    return (mask[0] | mask[1] | mask[2] | mask[3]) != 0;
}

#endif

/* Bit i: number i is not 0. */
LANES_INLINE uint32_t sixteen_bits(const uint32_t from[16])
{
#ifdef __SSE2__
    const __m128i zero = _mm_setzero_si128();
    __m128i is_zero[4];
    for (int i = 0; i < 4; i++)
        is_zero[i] =
            _mm_cmpeq_epi32(_mm_loadu_si128((const __m128i *)(const void *)(from + 4 * i)), zero);
    __m128i half[2] = {_mm_packs_epi32(is_zero[0], is_zero[1]),
                       _mm_packs_epi32(is_zero[2], is_zero[3])};
    return (uint32_t)_mm_movemask_epi8(_mm_packs_epi16(half[0], half[1])) ^ 0xffff;
#else
    uint32_t bits = 0;
    for (int i = 0; i < 16; i++)
        bits |= (uint32_t)(from[i] != 0) << i;
    return bits;
#endif
}

#if defined __AVX2__

/* The numbers with indices 1, 2, 0 and 3. */
LANES_INLINE struct row row_turn(struct row x)
{
    x.part[0] = _mm256_permute4x64_pd(x.part[0], 0xc9);
    return x;
}

LANES_INLINE lanes lanes_select(lane_mask mask, lanes yes, lanes no)
{
    return _mm256_blendv_pd(no, yes, (__m256d)mask);
}

/* a < b ? a : b */
LANES_INLINE lanes lanes_min(lanes a, lanes b)
{
    return _mm256_min_pd(a, b);
}

/* a > b ? a : b */
LANES_INLINE lanes lanes_max(lanes a, lanes b)
{
    return _mm256_max_pd(a, b);
}

LANES_INLINE lanes lanes_sqrt(lanes x)
{
    return _mm256_sqrt_pd(x);
}

/* Bit i: lane i of the mask. */
LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
    return (unsigned)_mm256_movemask_pd((__m256d)mask);
}

/* Rows become columns: lane i of out[k] is lane k of in[i]. */
LANES_INLINE void lanes_transpose(const lanes in[4], lanes out[4])
{
    lanes a = _mm256_unpacklo_pd(in[0], in[1]), b = _mm256_unpackhi_pd(in[0], in[1]);
    lanes c = _mm256_unpacklo_pd(in[2], in[3]), d = _mm256_unpackhi_pd(in[2], in[3]);
    out[0] = _mm256_permute2f128_pd(a, c, 0x20);
    out[1] = _mm256_permute2f128_pd(b, d, 0x20);
    out[2] = _mm256_permute2f128_pd(a, c, 0x31);
    out[3] = _mm256_permute2f128_pd(b, d, 0x31);
}

/* Lane i of out[k] becomes from[i][k] - low[i][k]. from[i] has four readable numbers. */
LANES_INLINE void lanes_gather(const double *const from[LANE_COUNT],
                               const int32_t *const low[LANE_COUNT], lanes out[3])
{
    lanes in[4], turned[4];
    for (int i = 0; i < 4; i++)
        in[i] = _mm256_loadu_pd(from[i]) -
                _mm256_cvtepi32_pd(_mm_loadu_si128((const __m128i *)(const void *)low[i]));
    lanes_transpose(in, turned);
    for (int k = 0; k < 3; k++)
        out[k] = turned[k];
}

/* Lane i of out[k] becomes from[i][k]. from[i] has four readable numbers. */
LANES_INLINE void lanes_gather_integers(const int32_t *const from[LANE_COUNT], lanes out[3])
{
    lanes in[4], turned[4];
    for (int i = 0; i < 4; i++)
        in[i] = _mm256_cvtepi32_pd(_mm_loadu_si128((const __m128i *)(const void *)from[i]));
    lanes_transpose(in, turned);
    for (int k = 0; k < 3; k++)
        out[k] = turned[k];
}

/* Lane i of out[k] becomes from[i][k]. */
LANES_INLINE void lanes_gather_four(const double *const from[LANE_COUNT], lanes out[4])
{
    lanes in[4];
    for (int i = 0; i < 4; i++)
        in[i] = _mm256_loadu_pd(from[i]);
    lanes_transpose(in, out);
}

/* Lane i of out[k] becomes from[i][k]. from[i] has four readable numbers. */
LANES_INLINE void lanes_gather_floats(const float *const from[LANE_COUNT], lanes out[3])
{
    lanes in[4], turned[4];
    for (int i = 0; i < 4; i++)
        in[i] = _mm256_cvtps_pd(_mm_loadu_ps(from[i]));
    lanes_transpose(in, turned);
    for (int k = 0; k < 3; k++)
        out[k] = turned[k];
}

/* Lane i becomes *from[i]. */
LANES_INLINE lanes lanes_gather_float(const float *const from[LANE_COUNT])
{
    return _mm256_cvtps_pd(_mm_setr_ps(*from[0], *from[1], *from[2], *from[3]));
}

/* to[i][k] becomes lane i of in[k]. */
LANES_INLINE void lanes_scatter(const lanes in[4], double *const to[LANE_COUNT])
{
    lanes turned[4];
    lanes_transpose(in, turned);
    for (int i = 0; i < 4; i++)
        _mm256_storeu_pd(to[i], turned[i]);
}

/* to[i][0] and to[i][1] become lane i of x and of y. */
LANES_INLINE void lanes_scatter_pairs(lanes x, lanes y, double *const to[LANE_COUNT])
{
    lanes even = _mm256_unpacklo_pd(x, y), odd = _mm256_unpackhi_pd(x, y);
    _mm_storeu_pd(to[0], _mm256_castpd256_pd128(even));
    _mm_storeu_pd(to[1], _mm256_castpd256_pd128(odd));
    _mm_storeu_pd(to[2], _mm256_extractf128_pd(even, 1));
    _mm_storeu_pd(to[3], _mm256_extractf128_pd(odd, 1));
}

#else

LANES_INLINE struct row row_turn(struct row x)
{
    return (struct row){{__builtin_shufflevector(x.part[0], x.part[1], 1, 2),
                         __builtin_shufflevector(x.part[0], x.part[1], 0, 3)}};
}

LANES_INLINE lanes lanes_select(lane_mask mask, lanes yes, lanes no)
{
    return (lanes)((mask & (lane_mask)yes) | (~mask & (lane_mask)no));
}

LANES_INLINE lanes lanes_min(lanes a, lanes b)
{
#ifdef __SSE4_1__
    return _mm_min_pd(a, b);
#else
    return lanes_select(a < b, a, b);
#endif
}

LANES_INLINE lanes lanes_max(lanes a, lanes b)
{
#ifdef __SSE4_1__
    return _mm_max_pd(a, b);
#else
    return lanes_select(a > b, a, b);
#endif
}

LANES_INLINE lanes lanes_sqrt(lanes x)
{
    return (lanes){sqrt(x[0]), sqrt(x[1])};
}

LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
    return (unsigned)(mask[0] & 1) | (unsigned)(mask[1] & 2);
}

LANES_INLINE void lanes_gather(const double *const from[LANE_COUNT],
                               const int32_t *const low[LANE_COUNT], lanes out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = (lanes){from[0][k] - low[0][k], from[1][k] - low[1][k]};
}

LANES_INLINE void lanes_gather_integers(const int32_t *const from[LANE_COUNT], lanes out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = (lanes){(double)from[0][k], (double)from[1][k]};
}

LANES_INLINE void lanes_gather_four(const double *const from[LANE_COUNT], lanes out[4])
{
    for (int k = 0; k < 4; k++)
        out[k] = (lanes){from[0][k], from[1][k]};
}

LANES_INLINE void lanes_gather_floats(const float *const from[LANE_COUNT], lanes out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = (lanes){(double)from[0][k], (double)from[1][k]};
}

LANES_INLINE lanes lanes_gather_float(const float *const from[LANE_COUNT])
{
    return (lanes){(double)*from[0], (double)*from[1]};
}

LANES_INLINE void lanes_scatter(const lanes in[4], double *const to[LANE_COUNT])
{
    for (int k = 0; k < 4; k++) {
        to[0][k] = in[k][0];
        to[1][k] = in[k][1];
    }
}

LANES_INLINE void lanes_scatter_pairs(lanes x, lanes y, double *const to[LANE_COUNT])
{
    for (int i = 0; i < 2; i++) {
        to[i][0] = x[i];
        to[i][1] = y[i];
    }
}

#endif
#endif
