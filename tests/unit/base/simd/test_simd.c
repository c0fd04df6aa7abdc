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

TEST(test_names_of_levels)
{
    enum bsq_simd highest, level;
    assert_true(bsq_simd_named(NULL, &highest));
#ifdef __x86_64__
    assert_true(bsq_simd_named("sse4.2", &level));
    assert_int_equal(level, BSQ_SIMD_BASE);
    assert_int_equal(bsq_simd_named("avx2", &level), highest >= BSQ_SIMD_AVX2);
    assert_int_equal(level, highest >= BSQ_SIMD_AVX2 ? BSQ_SIMD_AVX2 : highest);
    assert_int_equal(bsq_simd_named("avx512", &level), highest >= BSQ_SIMD_AVX512);
    assert_int_equal(level, highest);
#endif
    assert_false(bsq_simd_named("", &level));
    assert_int_equal(level, highest);
    assert_false(bsq_simd_named("avx", &level));
    assert_int_equal(level, highest);
}

RUN_TESTS(NULL, NULL)
