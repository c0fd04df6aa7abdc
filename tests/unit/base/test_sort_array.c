/* test_sort_array.c - arrays of all small sizes, of large items, and what sorting allocates. */
#include "base/sort_array.h"
#include "tests/unit/test.h"

#include <malloc.h>

/* Items of more than the 64 bytes that are swapped at a time. */
struct item {
    uint32_t key;
    uint32_t rest[18]; /* multiples of the key */
};

static uint32_t next_random(uint32_t *seed)
{
    *seed = *seed * 1103515245u + 12345u;
    return *seed >> 16;
}

static int by_key(const void *a, const void *b)
{
    const struct item *x = a, *y = b;
    return (x->key > y->key) - (x->key < y->key);
}

static void sort_and_check(uint64_t count, uint32_t keys, uint32_t *seed)
{
    struct item *items = malloc((count + 1) * sizeof *items);
    uint64_t sum = 0;
    for (uint64_t i = 0; i < count; i++) {
        items[i].key = next_random(seed) % keys;
        for (uint32_t r = 0; r < 18; r++)
            items[i].rest[r] = items[i].key * (r + 2);
        sum += items[i].key;
    }
    bsq_sort(items, count, sizeof *items, by_key);
    for (uint64_t i = 0; i < count; i++) {
        assert_true(i == 0 || items[i - 1].key <= items[i].key);
        for (uint32_t r = 0; r < 18; r++)
            assert_int_equal(items[i].rest[r], items[i].key * (r + 2));
        sum -= items[i].key;
    }
    assert_int_equal(sum, 0);
    free(items);
}

TEST(test_sorts)
{
    uint32_t seed = 7;
    bsq_sort(NULL, 0, sizeof(struct item), by_key);
    for (uint64_t count = 0; count < 100; count++) {
        sort_and_check(count, 65536, &seed);
        sort_and_check(count, 3, &seed);
    }
    sort_and_check(20000, 65536, &seed);
}

static size_t allocated(void)
{
    const struct mallinfo2 info = mallinfo2();
    return info.uordblks + info.hblkhd;
}

static size_t most;

static int by_value(const void *a, const void *b)
{
    const uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    const size_t now = allocated();
    most = now > most ? now : most;
    return (x > y) - (x < y);
}

TEST(test_allocates_nothing)
{
    enum { COUNT = 5000 };
    uint32_t *values = malloc(COUNT * sizeof *values), seed = 3;
    for (int i = 0; i < COUNT; i++)
        values[i] = next_random(&seed);
    const size_t before = allocated();
    most = before;
    bsq_sort(values, COUNT, sizeof *values, by_value);
    assert_int_equal(most, before);
    free(values);
}

RUN_TESTS(NULL, NULL)
