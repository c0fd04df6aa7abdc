/* bk_compat.h - the one place where the kernel's three languages differ: C, OpenCL C 1.2 and CUDA.
 *
 * Results have to agree between devices, bit for bit where a device rounds as IEEE 754 asks: the
 * kernel uses only + - * / sqrt floor and comparisons in float, and contraction is off.
 *
 * bk_f4 and bk_i4 are four floats and four 32-bit integers with element-wise operators; comparing
 * two bk_f4 gives a bk_i4 of all ones or zeros. Processors have instructions for them; on GPUs they
 * are four independent variables. */
#ifndef BK_COMPAT_H
#define BK_COMPAT_H

#if defined(__OPENCL_VERSION__) || defined(__OPENCL_C_VERSION__)

#pragma OPENCL FP_CONTRACT OFF
typedef int bk_int;
typedef uint bk_uint;
typedef ulong bk_ulong;
#define BK_GLOBAL        __global
#define BK_CONSTANT      __constant
#define BK_FN            static
#define bk_sqrt(x)       sqrt(x)
#define bk_floor(x)      floor(x)
#define bk_abs(x)        fabs(x)
#define bk_popcount32(x) popcount((bk_uint)(x))
#define bk_popcount64(x) ((bk_uint)popcount((bk_ulong)(x)))

typedef float4 bk_f4;
typedef int4 bk_i4;
#define bk_lane(v, n)        ((v).s##n)
#define bk_set4(a, b, c, d)  ((float4)(a, b, c, d))
#define bk_seti4(a, b, c, d) ((int4)(a, b, c, d))
#define bk_to_f4(i)          convert_float4(i)
#define bk_mask4(mask, f)    as_float4((mask)&as_int4(f))
#define bk_sqrt4(f)          sqrt(f)

#elif defined(__CUDACC__)

typedef int bk_int;
typedef unsigned int bk_uint;
typedef unsigned long long bk_ulong;
#define BK_GLOBAL
#define BK_CONSTANT      static __constant__ const
#define BK_FN            static __device__ __forceinline__
#define bk_sqrt(x)       sqrtf(x)
#define bk_floor(x)      floorf(x)
#define bk_abs(x)        fabsf(x)
#define bk_popcount32(x) ((bk_uint)__popc(x))
#define bk_popcount64(x) ((bk_uint)__popcll(x))

struct bk_f4 {
    float l0, l1, l2, l3;
};
struct bk_i4 {
    bk_int l0, l1, l2, l3;
};
#define bk_lane(v, n)    ((v).l##n)
#define BK_OPERATOR(type, element, op)                                                             \
    BK_FN type operator op(type a, type b)                                                         \
    {                                                                                              \
        return type{a.l0 op b.l0, a.l1 op b.l1, a.l2 op b.l2, a.l3 op b.l3};                       \
    }                                                                                              \
    BK_FN type operator op(type a, element b)                                                      \
    {                                                                                              \
        return type{a.l0 op b, a.l1 op b, a.l2 op b, a.l3 op b};                                   \
    }                                                                                              \
    BK_FN type operator op(element a, type b)                                                      \
    {                                                                                              \
        return type{a op b.l0, a op b.l1, a op b.l2, a op b.l3};                                   \
    }
BK_OPERATOR(bk_f4, float, +)
BK_OPERATOR(bk_f4, float, -)
BK_OPERATOR(bk_f4, float, *)
BK_OPERATOR(bk_f4, float, /)
BK_OPERATOR(bk_i4, bk_int, -)
BK_OPERATOR(bk_i4, bk_int, &)
BK_OPERATOR(bk_i4, bk_int, ^)
BK_OPERATOR(bk_i4, bk_int, >>)
#undef BK_OPERATOR
BK_FN bk_i4 operator<(bk_f4 a, bk_f4 b)
{
    return bk_i4{-(a.l0 < b.l0), -(a.l1 < b.l1), -(a.l2 < b.l2), -(a.l3 < b.l3)};
}
BK_FN bk_f4 bk_set4(float a, float b, float c, float d)
{
    return bk_f4{a, b, c, d};
}
BK_FN bk_i4 bk_seti4(bk_int a, bk_int b, bk_int c, bk_int d)
{
    return bk_i4{a, b, c, d};
}
BK_FN bk_f4 bk_to_f4(bk_i4 i)
{
    return bk_f4{(float)i.l0, (float)i.l1, (float)i.l2, (float)i.l3};
}
BK_FN bk_f4 bk_mask4(bk_i4 m, bk_f4 f)
{
    return bk_f4{m.l0 ? f.l0 : 0.0f, m.l1 ? f.l1 : 0.0f, m.l2 ? f.l2 : 0.0f, m.l3 ? f.l3 : 0.0f};
}
BK_FN bk_f4 bk_sqrt4(bk_f4 f)
{
    return bk_f4{sqrtf(f.l0), sqrtf(f.l1), sqrtf(f.l2), sqrtf(f.l3)};
}

#else

#include <math.h>
#include <stdint.h>
typedef int32_t bk_int;
typedef uint32_t bk_uint;
typedef uint64_t bk_ulong;
#define BK_GLOBAL
#define BK_CONSTANT          static const
#define BK_FN                static inline
#define bk_sqrt(x)           sqrtf(x)
#define bk_floor(x)          floorf(x)
#define bk_abs(x)            fabsf(x)
#define bk_popcount32(x)     ((bk_uint)__builtin_popcount(x))
#define bk_popcount64(x)     ((bk_uint)__builtin_popcountll(x))

typedef float bk_f4 __attribute__((vector_size(16)));
typedef int32_t bk_i4 __attribute__((vector_size(16)));
#define bk_lane(v, n)        ((v)[n])
#define bk_set4(a, b, c, d)  ((bk_f4){(a), (b), (c), (d)})
#define bk_seti4(a, b, c, d) ((bk_i4){(a), (b), (c), (d)})
#define bk_to_f4(i)          __builtin_convertvector((i), bk_f4)
#define bk_mask4(mask, f)    ((bk_f4)((mask) & (bk_i4)(f)))
BK_FN bk_f4 bk_sqrt4(bk_f4 f)
{
    return bk_set4(sqrtf(f[0]), sqrtf(f[1]), sqrtf(f[2]), sqrtf(f[3]));
}

#endif

#endif
