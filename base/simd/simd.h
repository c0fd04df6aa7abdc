/* simd.h - the vector types of all code that works on several numbers at once, and the choice of
 * the instruction set that it runs on.
 *
 * A source named *_lanes.c is compiled once for each level of enum bsq_simd (see the Makefile). Its
 * functions are named by BSQ_SIMD_NAME(), declared by BSQ_SIMD_DECLARE() and called through
 * BSQ_SIMD_PICK(). Lanes never meet in arithmetic, so every level yields the same bits.
 *
 * Takes: the instruction set of the compilation. Gives: `doubles` and `floats`, which are vectors;
 * `struct row`, four doubles; `eights`, eight floats; and their operations. These names have no
 * prefix because they are types and inline functions, which never reach the linker. */
#ifndef BSQ_SIMD_SIMD_H
#define BSQ_SIMD_SIMD_H

#include <stdbool.h>

#include "base/simd/eights.h"
#include "base/simd/floats.h"
#include "base/simd/lanes.h"
#include "base/simd/rows.h"

/* Levels in ascending order. A processor that has one has those below it. */
enum bsq_simd {
    BSQ_SIMD_BASE, /* any processor */
    BSQ_SIMD_AVX2, /* AVX2, BMI and BMI2 */
    BSQ_SIMD_AVX512
};

/* Returns the level that jobs use: the highest that this processor can run, or a lower one that
 * BSQ_SIMD of the environment names. The environment is read once. */
enum bsq_simd bsq_simd_best(void);

/* Sets *out to the level of this name, and to the highest if name is NULL or no level of this
 * processor has it. Returns false in the last case. */
bool bsq_simd_named(const char *name, enum bsq_simd *out);

#ifdef __x86_64__
#define BSQ_SIMD_NAMES                                                                             \
    {                                                                                              \
        "sse4.2", "avx2", "avx512"                                                                 \
    }
#define BSQ_SIMD_DECLARE(type, name) type name##_base, name##_avx2, name##_avx512
#define BSQ_SIMD_PICK(level, name)                                                                 \
    ((level) == BSQ_SIMD_AVX512 ? name##_avx512                                                    \
     : (level) == BSQ_SIMD_AVX2 ? name##_avx2                                                      \
                                : name##_base)
#else
#define BSQ_SIMD_NAMES                                                                             \
    {                                                                                              \
        "base"                                                                                     \
    }
#define BSQ_SIMD_DECLARE(type, name) type name##_base
#define BSQ_SIMD_PICK(level, name)   ((void)(level), name##_base)
#endif

/* The Makefile defines BSQ_SIMD_SUFFIX when it compiles for a level above the base. */
#ifndef BSQ_SIMD_SUFFIX
#define BSQ_SIMD_SUFFIX base
#endif
#define BSQ_SIMD_JOIN(name, suffix)   name##_##suffix
#define BSQ_SIMD_EXPAND(name, suffix) BSQ_SIMD_JOIN(name, suffix)
#define BSQ_SIMD_NAME(name)           BSQ_SIMD_EXPAND(name, BSQ_SIMD_SUFFIX)

#endif
