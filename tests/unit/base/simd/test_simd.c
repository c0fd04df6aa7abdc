/* test_simd.c - vector operations give the bits of scalar code at each level that the processor
 * has. */
#include "tests/unit/base/simd/operations.h"
#include "tests/unit/fixture.h"

static void check_level(enum bsq_simd level)
{
    if (bsq_simd_best() < level)
        skip();
    BSQ_SIMD_PICK(level, test_operations)(test_seed());
}

static void test_base_operations(void **state)
{
    (void)state;
    check_level(BSQ_SIMD_BASE);
}

static void test_avx2_operations(void **state)
{
    (void)state;
    check_level(BSQ_SIMD_AVX2);
}

static void test_avx512_operations(void **state)
{
    (void)state;
    check_level(BSQ_SIMD_AVX512);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_base_operations),
        cmocka_unit_test(test_avx2_operations),
        cmocka_unit_test(test_avx512_operations),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
