/* cpu.c - which instruction sets this processor has. */
#include "base/simd/simd.h"

/* AVX-512 lowers the clock of its first processors by much. Those that have VBMI2 are later ones.
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
