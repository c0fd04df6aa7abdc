/* bk_compat.h - the one place where the kernel's three languages differ: C, OpenCL C 1.2 and CUDA.
 *
 * Devices that round as IEEE 754 requires must give the same bits. So the kernel uses only + - * /
 * sqrt floor and comparisons, in float and, for triangles, in double, and contraction is off.
 *
 * bk_lower() and bk_upper() are for numbers that are not NaN, where it does not matter which zero
 * they return.
 *
 * BK_DOUBLE is defined if there is double precision. bk_or() may be called for the same word
 * by many work items.
 *
 * BK_FN begins the definition of a function. BK_GLOBAL marks pointers to a device's memory, such as
 * the grid and the texels; it is empty in C and CUDA. BK_ROLLED stands before a loop that GPUs do
 * not unroll, because its copies would need more registers than there are.
 *
 * bk_fw and bk_iw are BK_WIDTH floats and 32-bit integers with element-wise operators: vectors on
 * processors, plain scalars on GPUs and if BK_WIDTH is 1. A bk_mask, as bk_less() returns it, is
 * true or false in each lane; only bk_select() and similar functions take it. A lane gets the same
 * bits for any width. */
#ifndef BAKE_KERNEL_BK_COMPAT_H
#define BAKE_KERNEL_BK_COMPAT_H

#if defined(__OPENCL_VERSION__) || defined(__OPENCL_C_VERSION__)

#pragma OPENCL FP_CONTRACT OFF
typedef int bk_int;
typedef uint bk_uint;
typedef ulong bk_ulong;
typedef ulong2 bk_ulong2;
typedef float4 bk_float4;
#ifdef cl_khr_fp64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#define BK_DOUBLE
#endif
#define BK_GLOBAL __global
#define BK_KERNEL __kernel void

#ifdef BK_PTX
/* Compiled to PTX by the build, with Clang's built-in functions instead of an OpenCL library. */
#define BK_FN            static inline __attribute__((always_inline))
#define BK_ROLLED        _Pragma("clang loop unroll(disable)")
#define BK_RESTRICT      restrict
#define bk_sqrt(x)       __nvvm_sqrt_rn_f(x)
#define bk_floor(x)      __builtin_floorf(x)
#define bk_abs(x)        __builtin_fabsf(x)
#define bk_lower(a, b)   __builtin_fminf(a, b)
#define bk_upper(a, b)   __builtin_fmaxf(a, b)
#define bk_popcount32(x) ((bk_uint)__builtin_popcount(x))
#define bk_popcount64(x) ((bk_uint)__builtin_popcountl(x))
#define bk_or(p, bits)   ((void)__sync_fetch_and_or(p, bits))
#define bk_work_x()                                                                                \
    (__nvvm_read_ptx_sreg_ctaid_x() * __nvvm_read_ptx_sreg_ntid_x() + __nvvm_read_ptx_sreg_tid_x())
#define bk_work_y()                                                                                \
    (__nvvm_read_ptx_sreg_ctaid_y() * __nvvm_read_ptx_sreg_ntid_y() + __nvvm_read_ptx_sreg_tid_y())
#else
#define BK_FN static
#define BK_ROLLED
#define BK_RESTRICT
#define bk_sqrt(x)       sqrt(x)
#define bk_floor(x)      floor(x)
#define bk_abs(x)        fabs(x)
#define bk_lower(a, b)   fmin(a, b)
#define bk_upper(a, b)   fmax(a, b)
#define bk_popcount32(x) popcount((bk_uint)(x))
#define bk_popcount64(x) ((bk_uint)popcount((bk_ulong)(x)))
#define bk_or(p, bits)   ((void)atomic_or((volatile __global uint *)(p), bits))
#define bk_work_x()      ((bk_uint)get_global_id(0))
#define bk_work_y()      ((bk_uint)get_global_id(1))
#endif

#define bk_prefetch(p)  ((void)0)
#define BK_WIDTH        1
#define BK_NATIVE_LANES 0

#elif defined(__CUDACC__)

typedef int bk_int;
typedef unsigned int bk_uint;
typedef unsigned long long bk_ulong;
typedef ulonglong2 bk_ulong2;
typedef float4 bk_float4;
#define BK_DOUBLE
#define BK_GLOBAL
#define BK_FN            static __device__ __forceinline__
#define BK_ROLLED        _Pragma("unroll 1")
#define BK_KERNEL        extern "C" __global__ void
#define BK_RESTRICT      __restrict__
#define bk_work_x()      (blockIdx.x * blockDim.x + threadIdx.x)
#define bk_work_y()      (blockIdx.y * blockDim.y + threadIdx.y)
#define bk_sqrt(x)       sqrtf(x)
#define bk_floor(x)      floorf(x)
#define bk_abs(x)        fabsf(x)
#define bk_lower(a, b)   fminf(a, b)
#define bk_upper(a, b)   fmaxf(a, b)
#define bk_popcount32(x) ((bk_uint)__popc(x))
#define bk_popcount64(x) ((bk_uint)__popcll(x))
#define bk_or(p, bits)   ((void)atomicOr(p, bits))
#define bk_prefetch(p)   ((void)0)

#define BK_WIDTH        1
#define BK_NATIVE_LANES 0

#else

#include <math.h>
#include <stdint.h>
typedef int32_t bk_int;
typedef uint32_t bk_uint;
typedef uint64_t bk_ulong;
typedef struct bk_ulong2 {
    bk_ulong x, y;
} bk_ulong2;
typedef struct bk_float4 {
    float x, y, z, w;
} bk_float4;
#define BK_DOUBLE
#define BK_GLOBAL
#define BK_FN static inline
#define BK_ROLLED
#define bk_sqrt(x)       sqrtf(x)
#define bk_floor(x)      floorf(x)
#define bk_abs(x)        fabsf(x)
#define bk_lower(a, b)   ((a) < (b) ? (a) : (b))
#define bk_upper(a, b)   ((a) > (b) ? (a) : (b))
#define bk_popcount32(x) ((bk_uint)__builtin_popcount(x))
#define bk_popcount64(x) ((bk_uint)__builtin_popcountll(x))
#define bk_or(p, bits)   ((void)(*(p) |= (bits)))
#define bk_prefetch(p)   __builtin_prefetch(p)

#ifndef BK_WIDTH
#define BK_WIDTH 1
#endif
#define BK_NATIVE_LANES (BK_WIDTH > 1)

#endif

#if BK_NATIVE_LANES

#ifndef SIMD_FLOATS
#define SIMD_FLOATS BK_WIDTH
#endif
#include "base/simd/simd.h"
_Static_assert(SIMD_FLOATS == BK_WIDTH, "vectors have as many floats as the kernel has lanes");
typedef floats bk_fw;
typedef float_ints bk_iw;
typedef float_ints bk_mask;
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
#define bk_select(mask, a, b)    floats_select(mask, a, b)
#define bk_selecti(mask, a, b)   ((bk_iw)floats_select(mask, (bk_fw)(a), (bk_fw)(b)))
#define bk_minw(a, b)            floats_min(a, b)
#define bk_maxw(a, b)            floats_max(a, b)
#define bk_mini(a, b)            floats_min_ints(a, b)
#define bk_maxi(a, b)            floats_max_ints(a, b)
#define bk_sqrtw(f)              floats_sqrt(f)
#define bk_floorw(f)             floats_floor(f)
/* Convert a mask to bits, lane 0 in the lowest, and back. */
#define bk_bits(mask)    floats_bits(mask)
#define bk_mask_of(bits) floats_mask_of(bits)
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
/* Gathers 32-bit words with indices below BK_GATHER_MOST, if the processor has an instruction. */
#define BK_GATHER_MOST 0x80000000u
#ifdef floats_gather
#define bk_gather(words, number) floats_gather(words, number)
#endif

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
