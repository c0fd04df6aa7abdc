/* lanes_avx512.h - eight lanes, for AVX-512. A mask has one bit for each lane. */
#ifndef BSQ_SIMD_LANES_AVX512_H
#define BSQ_SIMD_LANES_AVX512_H

typedef __mmask8 lane_mask;

LANES_INLINE lane_mask lanes_less(doubles a, doubles b)
{
    return _mm512_cmp_pd_mask(a, b, _CMP_LT_OQ);
}

LANES_INLINE lane_mask lanes_equal(doubles a, doubles b)
{
    return _mm512_cmp_pd_mask(a, b, _CMP_EQ_OQ);
}

LANES_INLINE lane_mask lanes_signs(doubles x)
{
    return _mm512_movepi64_mask((__m512i)x);
}

LANES_INLINE unsigned lanes_bits(lane_mask mask)
{
    return mask;
}

LANES_INLINE doubles lanes_keep(lane_mask mask, doubles x)
{
    return _mm512_maskz_mov_pd(mask, x);
}

LANES_INLINE lane_ints lanes_set_bits(lane_mask mask, lane_ints x, lane_ints bits)
{
    return (lane_ints)_mm512_mask_or_epi64((__m512i)x, mask, (__m512i)x, (__m512i)bits);
}

LANES_INLINE lane_ints lanes_add_ints(lane_mask mask, lane_ints x, lane_ints y)
{
    return (lane_ints)_mm512_mask_add_epi64((__m512i)x, mask, (__m512i)x, (__m512i)y);
}

LANES_INLINE doubles lanes_select(lane_mask mask, doubles yes, doubles no)
{
    return _mm512_mask_mov_pd(no, mask, yes);
}

LANES_INLINE doubles lanes_min(doubles a, doubles b)
{
    return _mm512_min_pd(a, b);
}

LANES_INLINE doubles lanes_max(doubles a, doubles b)
{
    return _mm512_max_pd(a, b);
}

LANES_INLINE doubles lanes_abs(doubles x)
{
    return _mm512_abs_pd(x);
}

LANES_INLINE doubles lanes_sqrt(doubles x)
{
    return _mm512_sqrt_pd(x);
}

/* Sets lane i to the lane of x whose index is in the low three bits of which[i]. */
LANES_INLINE doubles lanes_pick(doubles x, lane_ints which)
{
    return _mm512_permutexvar_pd((__m512i)which, x);
}

/* Returns the lanes of the mask one after the other, then zeros. */
LANES_INLINE doubles lanes_pack(lane_mask mask, doubles x)
{
    return _mm512_maskz_compress_pd(mask, x);
}

LANES_INLINE void lanes_gather_four(const double *const from[LANE_COUNT], doubles out[4])
{
    doubles in[4];
    for (int i = 0; i < 4; i++) {
        const double *const *pair = &from[i / 2 * 4 + i % 2];
        in[i] = _mm512_insertf64x4(_mm512_castpd256_pd512(_mm256_loadu_pd(pair[0])),
                                   _mm256_loadu_pd(pair[2]), 1);
    }
    doubles a = _mm512_unpacklo_pd(in[0], in[1]), b = _mm512_unpackhi_pd(in[0], in[1]);
    doubles c = _mm512_unpacklo_pd(in[2], in[3]), d = _mm512_unpackhi_pd(in[2], in[3]);
    out[0] = _mm512_shuffle_f64x2(a, c, 0x88);
    out[1] = _mm512_shuffle_f64x2(b, d, 0x88);
    out[2] = _mm512_shuffle_f64x2(a, c, 0xdd);
    out[3] = _mm512_shuffle_f64x2(b, d, 0xdd);
}

/* Returns four 32-bit words from each address. */
LANES_INLINE __m512i lanes_four_rows(const void *const from[4])
{
    __m512i rows = _mm512_castsi128_si512(_mm_loadu_si128((const __m128i *)from[0]));
    rows = _mm512_inserti32x4(rows, _mm_loadu_si128((const __m128i *)from[1]), 1);
    rows = _mm512_inserti32x4(rows, _mm_loadu_si128((const __m128i *)from[2]), 2);
    return _mm512_inserti32x4(rows, _mm_loadu_si128((const __m128i *)from[3]), 3);
}

/* Returns columns `first` and first + 1 of eight rows of four words. */
LANES_INLINE __m512i lanes_two_columns(__m512i rows, __m512i more_rows, int first)
{
    const __m512i places =
        _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 1, 5, 9, 13, 17, 21, 25, 29);
    return _mm512_permutex2var_epi32(rows, _mm512_add_epi32(places, _mm512_set1_epi32(first)),
                                     more_rows);
}

LANES_INLINE void lanes_gather_integers(const int32_t *const from[LANE_COUNT], doubles out[3])
{
    __m512i rows = lanes_four_rows((const void *const *)from);
    __m512i more_rows = lanes_four_rows((const void *const *)from + 4);
    __m512i xy = lanes_two_columns(rows, more_rows, 0), z = lanes_two_columns(rows, more_rows, 2);
    out[0] = _mm512_cvtepi32_pd(_mm512_castsi512_si256(xy));
    out[1] = _mm512_cvtepi32_pd(_mm512_extracti64x4_epi64(xy, 1));
    out[2] = _mm512_cvtepi32_pd(_mm512_castsi512_si256(z));
}

LANES_INLINE void lanes_gather_floats(const float *const from[LANE_COUNT], doubles out[4])
{
    __m512i rows = lanes_four_rows((const void *const *)from);
    __m512i more_rows = lanes_four_rows((const void *const *)from + 4);
    __m512i xy = lanes_two_columns(rows, more_rows, 0), zw = lanes_two_columns(rows, more_rows, 2);
    out[0] = _mm512_cvtps_pd((__m256)_mm512_castsi512_si256(xy));
    out[1] = _mm512_cvtps_pd((__m256)_mm512_extracti64x4_epi64(xy, 1));
    out[2] = _mm512_cvtps_pd((__m256)_mm512_castsi512_si256(zw));
    out[3] = _mm512_cvtps_pd((__m256)_mm512_extracti64x4_epi64(zw, 1));
}

LANES_INLINE void lanes_scatter(const doubles in[4], double *const to[LANE_COUNT])
{
    const __m512i low = _mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11);
    const __m512i high = _mm512_setr_epi64(4, 5, 12, 13, 6, 7, 14, 15);
    for (int odd = 0; odd < 2; odd++) {
        doubles first = odd ? _mm512_unpackhi_pd(in[0], in[1]) : _mm512_unpacklo_pd(in[0], in[1]);
        doubles last = odd ? _mm512_unpackhi_pd(in[2], in[3]) : _mm512_unpacklo_pd(in[2], in[3]);
        doubles a = _mm512_permutex2var_pd(first, low, last);
        doubles b = _mm512_permutex2var_pd(first, high, last);
        _mm256_storeu_pd(to[odd], _mm512_castpd512_pd256(a));
        _mm256_storeu_pd(to[odd + 2], _mm512_extractf64x4_pd(a, 1));
        _mm256_storeu_pd(to[odd + 4], _mm512_castpd512_pd256(b));
        _mm256_storeu_pd(to[odd + 6], _mm512_extractf64x4_pd(b, 1));
    }
}

LANES_INLINE void lanes_scatter_six(const doubles in[6], double *const to[LANE_COUNT])
{
    for (int odd = 0; odd < 2; odd++) {
        doubles pair[3];
        for (int k = 0; k < 3; k++)
            pair[k] = odd ? _mm512_unpackhi_pd(in[2 * k], in[2 * k + 1])
                          : _mm512_unpacklo_pd(in[2 * k], in[2 * k + 1]);
        doubles a = _mm512_shuffle_f64x2(pair[0], pair[1], 0x88);
        doubles b = _mm512_shuffle_f64x2(pair[0], pair[1], 0xdd);
        _mm512_storeu_pd(to[odd], _mm512_shuffle_f64x2(a, pair[2], 0x08));
        _mm512_storeu_pd(to[odd + 2], _mm512_shuffle_f64x2(b, pair[2], 0x18));
        _mm512_storeu_pd(to[odd + 4], _mm512_shuffle_f64x2(a, pair[2], 0x2d));
        _mm512_storeu_pd(to[odd + 6], _mm512_shuffle_f64x2(b, pair[2], 0x3d));
    }
}

#endif
