/* cpu.c - which instruction sets this processor has. */
#include "base/simd/simd.h"

/* The first processors with AVX-512 lower their clock much when they use it; those with VBMI2 do
 * not.
 */
enum bsq_simd bsq_simd_best(void)
{
#ifdef __x86_64__
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("bmi") ||
        !__builtin_cpu_supports("bmi2"))
        return BSQ_SIMD_BASE;
    bool all = __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw") &&
               __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512vbmi2");
    return all ? BSQ_SIMD_AVX512 : BSQ_SIMD_AVX2;
#else
    return BSQ_SIMD_BASE;
#endif
}
