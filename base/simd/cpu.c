/* cpu.c - which instruction sets this processor has, and which one jobs use. */
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "base/simd/simd.h"

static enum bsq_simd used;
static pthread_once_t used_once = PTHREAD_ONCE_INIT;

/* Returns the highest level that this processor can run. The first processors with AVX-512 lower
 * their clock much when they use it; those with VBMI2 do not. */
static enum bsq_simd highest(void)
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

bool bsq_simd_named(const char *name, enum bsq_simd *out)
{
    static const char *const names[] = BSQ_SIMD_NAMES;
    const enum bsq_simd most = highest();
    for (unsigned level = 0; name && level <= most; level++)
        if (strcmp(name, names[level]) == 0) {
            *out = level;
            return true;
        }
    *out = most;
    return !name;
}

static void cpu_choose(void)
{
    bsq_simd_named(getenv("BSQ_SIMD"), &used);
}

enum bsq_simd bsq_simd_best(void)
{
    pthread_once(&used_once, cpu_choose);
    return used;
}
