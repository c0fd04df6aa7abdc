/* test_space_curve.c - both curves number each cell of a cube once, in their documented order. */
#include "base/geometry/space_curve.h"
#include "tests/unit/test.h"

TEST(test_morton_keys_interleave_bits)
{
    for (uint32_t i = 0; i < 1000; i++) {
        const uint32_t cell[3] = {i * 2654435761u >> 11, i * 40503u & 0x1fffff, 0x1fffff - i};
        const uint32_t small[3] = {cell[0] & 31, cell[1] & 31, cell[2] & 31};
        uint64_t key = 0;
        for (int bit = 21; bit-- > 0;)
            for (int k = 0; k < 3; k++)
                key = key << 1 | (cell[k] >> bit & 1);
        assert_true(bsq_morton_key(cell) == key);
        assert_int_equal(bsq_morton_short_key(small), key & 0x7fff);
    }
}

TEST(test_hilbert_cells_follow_each_other)
{
    enum { BITS = 4, SIDE = 1 << BITS, CELLS = SIDE * SIDE * SIDE };
    static uint32_t cells[CELLS][3], seen[CELLS];
    for (uint32_t i = 0; i < CELLS; i++) {
        const uint32_t cell[3] = {i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE};
        const uint64_t place = bsq_hilbert_place(cell, BITS);
        assert_true(place < CELLS && !seen[place]);
        seen[place] = 1;
        for (int k = 0; k < 3; k++)
            cells[place][k] = cell[k];
    }
    for (uint32_t i = 1; i < CELLS; i++) {
        int steps = 0;
        for (int k = 0; k < 3; k++)
            steps += abs((int)cells[i][k] - (int)cells[i - 1][k]);
        assert_int_equal(steps, 1);
    }
}

RUN_TESTS(NULL, NULL)
