/* bk_compat.h - the one place where the kernel's three languages differ: C, OpenCL C 1.2 and CUDA.
 *
 * Results have to agree between devices, bit for bit where a device rounds as IEEE 754 asks: the
 * kernel uses only + - * / sqrt floor and comparisons in float, and contraction is off.
 *
 * bk_fw and bk_iw are BK_WIDTH floats and 32-bit integers with element-wise operators. A processor
 * has instructions for several; on GPUs, and where BK_WIDTH is 1, they are plain scalars. What is
 * true of a lane is told by a mask of bk_less(); it is only for bk_select() and its kin. Each lane
 * gets the same bits for any width. */
#ifndef BAKE_KERNEL_BK_COMPAT_H
#define BAKE_KERNEL_BK_COMPAT_H

#if defined(__OPENCL_VERSION__) || defined(__OPENCL_C_VERSION__)

#pragma OPENCL FP_CONTRACT OFF
typedef int bk_int;
typedef uint bk_uint;
typedef ulong bk_ulong;
#define BK_GLOBAL   __global
#define BK_CONSTANT __constant
#define BK_KERNEL   __kernel void

#ifdef BK_PTX
/* Compiled to PTX when the program is built, with Clang's own functions: a library of OpenCL's is
 * not needed. */
#define BK_FN            static inline __attribute__((always_inline))
#define BK_RESTRICT      restrict
#define bk_sqrt(x)       __nvvm_sqrt_rn_f(x)
#define bk_floor(x)      __builtin_floorf(x)
#define bk_abs(x)        __builtin_fabsf(x)
#define bk_popcount32(x) ((bk_uint)__builtin_popcount(x))
#define bk_popcount64(x) ((bk_uint)__builtin_popcountl(x))
#define bk_work_x()                                                                                \
    (__nvvm_read_ptx_sreg_ctaid_x() * __nvvm_read_ptx_sreg_ntid_x() + __nvvm_read_ptx_sreg_tid_x())
#define bk_work_y()                                                                                \
    (__nvvm_read_ptx_sreg_ctaid_y() * __nvvm_read_ptx_sreg_ntid_y() + __nvvm_read_ptx_sreg_tid_y())
#else
#define BK_FN static
#define BK_RESTRICT
#define bk_sqrt(x)       sqrt(x)
#define bk_floor(x)      floor(x)
#define bk_abs(x)        fabs(x)
#define bk_popcount32(x) popcount((bk_uint)(x))
#define bk_popcount64(x) ((bk_uint)popcount((bk_ulong)(x)))
#define bk_work_x()      ((bk_uint)get_global_id(0))
#define bk_work_y()      ((bk_uint)get_global_id(1))
#endif

#define BK_WIDTH        1
#define BK_NATIVE_LANES 0

#elif defined(__CUDACC__)

typedef int bk_int;
typedef unsigned int bk_uint;
typedef unsigned long long bk_ulong;
#define BK_GLOBAL
#define BK_CONSTANT      static __constant__ const
#define BK_FN            static __device__ __forceinline__
#define BK_KERNEL        extern "C" __global__ void
#define BK_RESTRICT      __restrict__
#define bk_work_x()      (blockIdx.x * blockDim.x + threadIdx.x)
#define bk_work_y()      (blockIdx.y * blockDim.y + threadIdx.y)
#define bk_sqrt(x)       sqrtf(x)
#define bk_floor(x)      floorf(x)
#define bk_abs(x)        fabsf(x)
#define bk_popcount32(x) ((bk_uint)__popc(x))
#define bk_popcount64(x) ((bk_uint)__popcll(x))

#define BK_WIDTH        1
#define BK_NATIVE_LANES 0

#else

#include <math.h>
#include <stdint.h>
typedef int32_t bk_int;
typedef uint32_t bk_uint;
typedef uint64_t bk_ulong;
#define BK_GLOBAL
#define BK_CONSTANT      static const
#define BK_FN            static inline
#define bk_sqrt(x)       sqrtf(x)
#define bk_floor(x)      floorf(x)
#define bk_abs(x)        fabsf(x)
#define bk_popcount32(x) ((bk_uint)__builtin_popcount(x))
#define bk_popcount64(x) ((bk_uint)__builtin_popcountll(x))

#ifndef BK_WIDTH
#define BK_WIDTH 1
#endif
#define BK_NATIVE_LANES (BK_WIDTH > 1)

#endif

#if BK_NATIVE_LANES

#if defined(__x86_64__)
#include <immintrin.h>
#endif
typedef float bk_fw __attribute__((vector_size(4 * BK_WIDTH)));
typedef int32_t bk_iw __attribute__((vector_size(4 * BK_WIDTH)));
typedef bk_iw bk_mask;
#define bk_lane(v, n)            ((v)[n])
#define bk_set_lane(v, n, value) ((v)[n] = (value))
#define bk_splat(a)              ((a) - (bk_fw){0})
#define bk_splati(a)             ((a) - (bk_iw){0})
#define bk_to_fw(i)              __builtin_convertvector((i), bk_fw)
#define bk_to_iw(f)              __builtin_convertvector((f), bk_iw)
#define bk_less(a, b)            ((a) < (b))
#define bk_not(mask)             (~(mask))
#define bk_keep(mask, f)         ((bk_fw)((mask) & (bk_iw)(f)))
#define bk_first(bits)           ((bk_uint)__builtin_ctz(bits))
BK_FN bk_iw bk_load_lanes(const bk_int words[BK_WIDTH])
{
    bk_iw lanes;
    __builtin_memcpy(&lanes, words, sizeof lanes);
    return lanes;
}
BK_FN void bk_store_lanes(bk_int words[BK_WIDTH], bk_iw lanes)
{
    __builtin_memcpy(words, &lanes, sizeof lanes);
}
/* Compilers do not find the instructions for these by themselves. */
#if BK_WIDTH == 4 && defined(__SSE4_1__)
#define bk_select(mask, a, b)  ((bk_fw)_mm_blendv_ps((__m128)(b), (__m128)(a), (__m128)(mask)))
#define bk_selecti(mask, a, b) ((bk_iw)bk_select(mask, (bk_fw)(a), (bk_fw)(b)))
#define bk_minw(a, b)          ((bk_fw)_mm_min_ps((__m128)(a), (__m128)(b)))
#define bk_maxw(a, b)          ((bk_fw)_mm_max_ps((__m128)(a), (__m128)(b)))
#define bk_mini(a, b)          ((bk_iw)_mm_min_epi32((__m128i)(a), (__m128i)(b)))
#define bk_maxi(a, b)          ((bk_iw)_mm_max_epi32((__m128i)(a), (__m128i)(b)))
#elif BK_WIDTH == 8 && defined(__AVX2__)
#define bk_select(mask, a, b)  ((bk_fw)_mm256_blendv_ps((__m256)(b), (__m256)(a), (__m256)(mask)))
#define bk_selecti(mask, a, b) ((bk_iw)bk_select(mask, (bk_fw)(a), (bk_fw)(b)))
#define bk_minw(a, b)          ((bk_fw)_mm256_min_ps((__m256)(a), (__m256)(b)))
#define bk_maxw(a, b)          ((bk_fw)_mm256_max_ps((__m256)(a), (__m256)(b)))
#define bk_mini(a, b)          ((bk_iw)_mm256_min_epi32((__m256i)(a), (__m256i)(b)))
#define bk_maxi(a, b)          ((bk_iw)_mm256_max_epi32((__m256i)(a), (__m256i)(b)))
#elif BK_WIDTH == 16 && defined(__AVX512F__)
#define bk_select(mask, a, b)                                                                      \
    ((bk_fw)_mm512_mask_blend_ps(_mm512_movepi32_mask((__m512i)(mask)), (__m512)(b), (__m512)(a)))
#define bk_selecti(mask, a, b) ((bk_iw)bk_select(mask, (bk_fw)(a), (bk_fw)(b)))
#define bk_minw(a, b)          ((bk_fw)_mm512_min_ps((__m512)(a), (__m512)(b)))
#define bk_maxw(a, b)          ((bk_fw)_mm512_max_ps((__m512)(a), (__m512)(b)))
#define bk_mini(a, b)          ((bk_iw)_mm512_min_epi32((__m512i)(a), (__m512i)(b)))
#define bk_maxi(a, b)          ((bk_iw)_mm512_max_epi32((__m512i)(a), (__m512i)(b)))
#else
#define bk_select(mask, a, b)  ((bk_fw)(((mask) & (bk_iw)(a)) | (~(mask) & (bk_iw)(b))))
#define bk_selecti(mask, a, b) (((mask) & (a)) | (~(mask) & (b)))
#define bk_minw(a, b)          bk_select((a) < (b), a, b)
#define bk_maxw(a, b)          bk_select((a) > (b), a, b)
#define bk_mini(a, b)          bk_selecti((a) < (b), a, b)
#define bk_maxi(a, b)          bk_selecti((a) > (b), a, b)
#endif
/* 32-bit words at numbers below BK_GATHER_MOST, where there is an instruction for that. */
#define BK_GATHER_MOST 0x80000000u
#if BK_WIDTH == 8 && defined(__AVX2__)
#define bk_gather(words, number)                                                                   \
    ((bk_iw)_mm256_i32gather_epi32((const int *)(const void *)(words), (__m256i)(number), 4))
#elif BK_WIDTH == 16 && defined(__AVX512F__)
#define bk_gather(words, number)                                                                   \
    ((bk_iw)_mm512_i32gather_epi32((__m512i)(number), (const void *)(words), 4))
#endif
BK_FN bk_fw bk_sqrtw(bk_fw f)
{
#if BK_WIDTH == 4 && defined(__SSE__)
    return (bk_fw)_mm_sqrt_ps((__m128)f);
#elif BK_WIDTH == 8 && defined(__AVX__)
    return (bk_fw)_mm256_sqrt_ps((__m256)f);
#elif BK_WIDTH == 16 && defined(__AVX512F__)
    return (bk_fw)_mm512_sqrt_ps((__m512)f);
#else
    for (int i = 0; i < BK_WIDTH; i++)
        f[i] = sqrtf(f[i]);
    return f;
#endif
}
BK_FN bk_fw bk_floorw(bk_fw f)
{
#if BK_WIDTH == 4 && defined(__SSE4_1__)
    return (bk_fw)_mm_floor_ps((__m128)f);
#elif BK_WIDTH == 8 && defined(__AVX__)
    return (bk_fw)_mm256_floor_ps((__m256)f);
#elif BK_WIDTH == 16 && defined(__AVX512F__)
    return (bk_fw)_mm512_roundscale_ps((__m512)f, 9);
#else
    for (int i = 0; i < BK_WIDTH; i++)
        f[i] = floorf(f[i]);
    return f;
#endif
}
/* The lanes that the mask is true for, lane 0 in the lowest bit, and back. */
BK_FN bk_uint bk_bits(bk_mask mask)
{
#if BK_WIDTH == 4 && defined(__SSE__)
    return (bk_uint)_mm_movemask_ps((__m128)mask);
#elif BK_WIDTH == 8 && defined(__AVX__)
    return (bk_uint)_mm256_movemask_ps((__m256)mask);
#elif BK_WIDTH == 16 && defined(__AVX512DQ__)
    return (bk_uint)_mm512_movepi32_mask((__m512i)mask);
#else
    bk_uint bits = 0;
    for (int i = 0; i < BK_WIDTH; i++)
        bits |= ((bk_uint)mask[i] & 1u) << i;
    return bits;
#endif
}
BK_FN bk_mask bk_mask_of(bk_uint bits)
{
#if BK_WIDTH == 16 && defined(__AVX512DQ__)
    return (bk_mask)_mm512_movm_epi32((__mmask16)bits);
#else
    bk_iw lanes = {0};
    for (int i = 0; i < BK_WIDTH; i++)
        lanes[i] = 1 << i;
    return (lanes & (bk_int)bits) != 0;
#endif
}

#else

typedef float bk_fw;
typedef bk_int bk_iw;
typedef bk_int bk_mask;
#define bk_lane(v, n)            (v)
#define bk_set_lane(v, n, value) ((v) = (value))
#define bk_splat(a)              (a)
#define bk_splati(a)             (a)
#define bk_to_fw(i)              ((float)(i))
#define bk_to_iw(f)              ((bk_int)(f))
#define bk_less(a, b)            ((a) < (b))
#define bk_not(mask)             (!(mask))
#define bk_keep(mask, f)         ((mask) ? (f) : 0.0f)
#define bk_select(mask, a, b)    ((mask) ? (a) : (b))
#define bk_selecti(mask, a, b)   ((mask) ? (a) : (b))
#define bk_minw(a, b)            ((a) < (b) ? (a) : (b))
#define bk_maxw(a, b)            ((a) > (b) ? (a) : (b))
#define bk_mini(a, b)            ((a) < (b) ? (a) : (b))
#define bk_maxi(a, b)            ((a) > (b) ? (a) : (b))
#define bk_first(bits)           0u
#define bk_load_lanes(words)     ((words)[0])
#define bk_store_lanes(words, v) ((words)[0] = (v))
#define bk_sqrtw(f)              bk_sqrt(f)
#define bk_floorw(f)             bk_floor(f)
#define bk_bits(mask)            ((mask) ? 1u : 0u)
#define bk_mask_of(bits)         ((bk_mask)((bits)&1u))

#endif

#endif
