/* lanes_avx2.h - four lanes, for AVX2. */
#ifndef BSQ_SIMD_LANES_AVX2_H
#define BSQ_SIMD_LANES_AVX2_H

#include "base/simd/lanes_masked.h"

LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
    return (unsigned)_mm256_movemask_pd((__m256d)mask);
}

LANES_INLINE doubles lanes_select(lane_mask mask, doubles yes, doubles no)
{
    return _mm256_blendv_pd(no, yes, (__m256d)mask);
}

LANES_INLINE doubles lanes_min(doubles a, doubles b)
{
    return _mm256_min_pd(a, b);
}

LANES_INLINE doubles lanes_max(doubles a, doubles b)
{
    return _mm256_max_pd(a, b);
}

LANES_INLINE doubles lanes_sqrt(doubles x)
{
    return _mm256_sqrt_pd(x);
}

/* Transposes: lane i of out[k] is lane k of in[i]. */
LANES_INLINE void lanes_transpose(const doubles in[4], doubles out[4])
{
    doubles a = _mm256_unpacklo_pd(in[0], in[1]), b = _mm256_unpackhi_pd(in[0], in[1]);
    doubles c = _mm256_unpacklo_pd(in[2], in[3]), d = _mm256_unpackhi_pd(in[2], in[3]);
    out[0] = _mm256_permute2f128_pd(a, c, 0x20);
    out[1] = _mm256_permute2f128_pd(b, d, 0x20);
    out[2] = _mm256_permute2f128_pd(a, c, 0x31);
    out[3] = _mm256_permute2f128_pd(b, d, 0x31);
}

LANES_INLINE void lanes_gather_four(const double *const from[LANE_COUNT], doubles out[4])
{
    doubles in[4];
    for (int i = 0; i < 4; i++)
        in[i] = _mm256_loadu_pd(from[i]);
    lanes_transpose(in, out);
}

LANES_INLINE void lanes_gather_integers(const int32_t *const from[LANE_COUNT], doubles out[3])
{
    doubles in[4], turned[4];
    for (int i = 0; i < 4; i++)
        in[i] = _mm256_cvtepi32_pd(_mm_loadu_si128((const __m128i *)(const void *)from[i]));
    lanes_transpose(in, turned);
    for (int k = 0; k < 3; k++)
        out[k] = turned[k];
}

LANES_INLINE void lanes_gather_floats(const float *const from[LANE_COUNT], doubles out[4])
{
    doubles in[4];
    for (int i = 0; i < 4; i++)
        in[i] = _mm256_cvtps_pd(_mm_loadu_ps(from[i]));
    lanes_transpose(in, out);
}

LANES_INLINE void lanes_scatter(const doubles in[4], double *const to[LANE_COUNT])
{
    doubles turned[4];
    lanes_transpose(in, turned);
    for (int i = 0; i < 4; i++)
        _mm256_storeu_pd(to[i], turned[i]);
}

LANES_INLINE void lanes_scatter_six(const doubles in[6], double *const to[LANE_COUNT])
{
    doubles even = _mm256_unpacklo_pd(in[4], in[5]), odd = _mm256_unpackhi_pd(in[4], in[5]);
    lanes_scatter(in, to);
    _mm_storeu_pd(to[0] + 4, _mm256_castpd256_pd128(even));
    _mm_storeu_pd(to[1] + 4, _mm256_castpd256_pd128(odd));
    _mm_storeu_pd(to[2] + 4, _mm256_extractf128_pd(even, 1));
    _mm_storeu_pd(to[3] + 4, _mm256_extractf128_pd(odd, 1));
}

#endif
