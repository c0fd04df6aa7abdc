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

static bool within(const float p[3], const float min[3], const float max[3])
{
    for (int a = 0; a < 3; a++)
        if (p[a] < min[a] || p[a] > max[a])
            return false;
    return true;
}

/* Tries every number of positions, as the last batch and its last vector may be incomplete. */
TEST(test_match)
{
    unsigned seed = 5;
    print_message("seed %u\n", seed);
    static float known[KNOWN][3];
    uint32_t *slots = calloc(bsq_positions_slots(KNOWN), sizeof *slots);
    assert_non_null(slots);
    struct bsq_positions table = {slots, bsq_positions_slots(KNOWN) - 1, (const float(*)[3])known};
    for (uint32_t i = 0; i < KNOWN; i++) {
        random_position(&seed, known[i]);
        uint32_t *slot = bsq_positions_find(&table, known[i]);
        if (*slot == 0)
            *slot = i + 1;
    }
    const float min[3] = {-2.0f, -3.0f, -1.0f}, max[3] = {3.0f, 1.0f, 2.0f};
    for (uint32_t count = 0; count <= OTHERS; count++) {
        /* The exact size, so that a sanitizer finds reads beyond it. */
        float(*others)[3] = malloc(count > 0 ? count * sizeof *others : 1);
        uint32_t *numbers = malloc((count + 1) * sizeof *numbers);
        bool any = false;
        assert_true(others && numbers);
        numbers[count] = 77;
        for (uint32_t i = 0; i < count; i++)
            random_position(&seed, others[i]);
        bool found =
            bsq_positions_match(&table, min, max, (const float(*)[3])others, count, numbers);
        for (uint32_t i = 0; i < count; i++) {
            uint32_t first = 0;
            while (first < KNOWN && !same(known[first], others[i]))
                first++;
            uint32_t expected = first < KNOWN && within(others[i], min, max) ? first + 1 : 0;
            assert_int_equal(numbers[i], expected);
            any |= expected != 0;
        }
        assert_int_equal(found, any);
        assert_int_equal(numbers[count], 77);
        free(others);
        free(numbers);
    }
    free(slots);
}

RUN_TESTS(NULL, NULL)
