/* operations.h - checks of base/simd, compiled for each level of enum bsq_simd. */
#ifndef TEST_OPERATIONS_H
#define TEST_OPERATIONS_H

#include "base/simd/simd.h"

/* Checks each operation against scalar code, on random numbers and special values. */
typedef void test_operations_fn(uint64_t seed);
BSQ_SIMD_DECLARE(test_operations_fn, test_operations);

#endif
