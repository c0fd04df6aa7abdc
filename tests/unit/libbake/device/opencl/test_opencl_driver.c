/* test_opencl_driver.c - the choice of work groups. */
#include "libbake/device/opencl/opencl_api.h"
#include "tests/unit/test.h"

/* Work groups have sides that are powers of two, as large as kernels and devices allow. */
TEST(test_groups)
{
    static const struct {
        size_t items, sides[2], width, expected[2];
    } cases[] = {
        {256, {256, 256}, 0, {8, 8}},   {64, {64, 64}, 0, {8, 8}},
        {63, {64, 64}, 0, {8, 4}},      {16, {1024, 1024}, 0, {4, 4}},
        {1, {1024, 1024}, 0, {1, 1}},   {1024, {1024, 1}, 0, {8, 1}},
        {4, {6, 3}, 0, {2, 2}},         {0, {0, 0}, 0, {1, 1}},
        {256, {256, 256}, 32, {32, 2}}, {256, {256, 256}, 1, {1, 64}},
        {256, {16, 256}, 32, {16, 2}},  {16, {256, 256}, 32, {8, 2}},
        {1, {256, 256}, 16, {1, 1}},
    };
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        size_t sides[2];
        bake_opencl_group(cases[i].items, cases[i].sides, cases[i].width, sides);
        assert_int_equal(sides[0], cases[i].expected[0]);
        assert_int_equal(sides[1], cases[i].expected[1]);
    }
}

RUN_TESTS(NULL, NULL)
