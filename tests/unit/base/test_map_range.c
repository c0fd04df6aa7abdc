/* test_map_range.c - what the signal handler of base/map.c finds while another thread reuses an
 * entry of its list. The moment is too short to be met from outside, so this includes the source.
 */
#include "base/map.c"
#include "tests/unit/test.h"

/* An entry went from [1000, 9000) to [2000, 3000). */
TEST(test_entries_that_are_changed_are_skipped)
{
    struct bsq_map_range range = {0};
    map_set_range(&range, 1000, 9000);
    assert_int_equal(end_around(&range, 5000), 9000);
    assert_int_equal(end_around(&range, 999), 0);
    assert_int_equal(end_around(&range, 9000), 0);
    atomic_fetch_add(&range.version, 1);
    atomic_store(&range.start, 2000);
    assert_int_equal(end_around(&range, 5000), 0);
    atomic_store(&range.end, 3000);
    assert_int_equal(end_around(&range, 2500), 0);
    atomic_fetch_add(&range.version, 1);
    assert_int_equal(end_around(&range, 2500), 3000);
    assert_int_equal(end_around(&range, 5000), 0);
}

RUN_TESTS(NULL, NULL)
