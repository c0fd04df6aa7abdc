/* test_positions.c - the table finds the same equal positions as a comparison of every pair. */
#include "base/geometry/positions.h"
#include "tests/unit/test.h"

enum { KNOWN = 300, OTHERS = 203 };

/* Returns one of few positions, so that many are equal. Some have -0 for 0. */
static void random_position(unsigned *seed, float p[3])
{
    for (int a = 0; a < 3; a++) {
        *seed = *seed * 1103515245u + 12345u;
        p[a] = (float)((int)(*seed >> 16 & 7) - 3);
        if (p[a] == 0.0f && (*seed >> 20 & 1))
            p[a] = -0.0f;
    }
}

static bool same(const float p[3], const float q[3])
{
    return p[0] == q[0] && p[1] == q[1] && p[2] == q[2];
}

TEST(equal_positions_are_found)
{
    unsigned seed = 5;
    static float known[KNOWN][3], other[3];
    uint32_t *slots = calloc(bsq_positions_cells(KNOWN), sizeof *slots);
    assert_non_null(slots);
    struct bsq_positions table = {slots, bsq_positions_cells(KNOWN) - 1, (const float(*)[3])known};
    for (uint32_t i = 0; i < KNOWN; i++) {
        random_position(&seed, known[i]);
        uint32_t *slot = bsq_positions_find(&table, known[i]);
        if (*slot == 0)
            *slot = i + 1;
    }
    for (uint32_t i = 0; i < OTHERS; i++) {
        uint32_t first = 0;
        random_position(&seed, other);
        while (first < KNOWN && !same(known[first], other))
            first++;
        assert_int_equal(*bsq_positions_find(&table, other), first < KNOWN ? first + 1 : 0);
    }
    free(slots);
}

RUN_TESTS(NULL, NULL)
