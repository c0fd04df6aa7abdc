/* Tests how the parts of a plan are counted. */
#include "formats/farm/farm.h"
#include "tests/unit/test.h"

#include <string.h>

static const struct fmt_farm_kind kind = {.format = "a plan of a test"};
enum { TASKS = 100, LAST = 40 };

struct parts {
    struct bsq_ctx *ctx;
    uint32_t interrupt_at, checked;
};

/* Finds no part. */
static int find_none(void *arg, uint32_t task)
{
    struct parts *parts = arg;
    parts->checked++;
    if (task == parts->interrupt_at)
        bsq_interrupt(parts->ctx);
    return bsq_fail(parts->ctx, BSQ_ENOINPUT, "no part of task %u", task);
}

static int check_parts(struct parts *parts)
{
    const struct fmt_farm_part_steps steps = {.arg = parts, .check = find_none};
    struct fmt_farm_plan plan;
    assert_int_equal(fmt_farm_plan_init(parts->ctx, &kind, "plan.json", TASKS, &plan), 0);
    const int status = fmt_farm_parts_check(&plan, &steps);
    fmt_farm_plan_clear(&plan);
    return status;
}

TEST(test_missing_parts_are_counted)
{
    struct parts parts = {test_context(1, 0), TASKS, 0};
    assert_int_equal(check_parts(&parts), BSQ_ENOINPUT);
    assert_int_equal(parts.checked, TASKS);
    assert_non_null(strstr(bsq_error(parts.ctx), "100 of 100 parts are missing"));
    test_context_end(parts.ctx);
}

TEST(test_an_interruption_is_not_lost_among_missing_parts)
{
    struct parts parts = {test_context(1, 0), LAST, 0};
    assert_int_equal(check_parts(&parts), BSQ_EINTR);
    assert_int_equal(parts.checked, LAST + 1);
    assert_string_equal(bsq_error(parts.ctx), "interrupted");
    test_context_end(parts.ctx);
}

RUN_TESTS(NULL, NULL)
