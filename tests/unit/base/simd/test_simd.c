/* test_simd.c - vector operations give the bits of scalar code at each level that the processor
 * has. */
#include "tests/unit/base/simd/operations.h"
#include "tests/unit/test.h"

static void check_level(enum bsq_simd level)
{
    if (bsq_simd_best() < level)
        skip();
    BSQ_SIMD_PICK(level, test_operations)(test_seed());
}

TEST(test_base_operations)
{
    check_level(BSQ_SIMD_BASE);
}

TEST(test_avx2_operations)
{
    check_level(BSQ_SIMD_AVX2);
}

TEST(test_avx512_operations)
{
    check_level(BSQ_SIMD_AVX512);
}

RUN_TESTS(NULL, NULL)
