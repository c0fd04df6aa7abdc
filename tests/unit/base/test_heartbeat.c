/* Tests that lines for schedulers are repeated if the percentage does not move. The clock is an
 * argument, so that the test need not wait. */
/* Its functions and its state are private. NOLINTNEXTLINE(bugprone-suspicious-include) */
#include "tools/cli_percent.c"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <unistd.h>
#include <cmocka.h>

/* Returns how many lines are printed if `seconds` pass after a line. */
static long lines_after(enum cli_progress progress, long seconds, const char *expected)
{
    struct cli cli = {.program = "bisque-bake", .progress = progress};
    FILE *file = tmpfile();
    char line[64] = "";
    assert_non_null(file);
    fflush(stdout);
    const int before = dup(STDOUT_FILENO);
    assert_true(dup2(fileno(file), STDOUT_FILENO) >= 0);
    state.cli = &cli;
    state.percent = 42;
    clock_gettime(CLOCK_MONOTONIC, &state.at);
    struct timespec now = state.at;
    now.tv_sec += seconds;
    repeat_line(&now);
    fflush(stdout);
    dup2(before, STDOUT_FILENO);
    close(before);
    rewind(file);
    long count = 0;
    for (; fgets(line, sizeof line, file); count++)
        assert_string_equal(line, expected);
    fclose(file);
    state.cli = NULL;
    return count;
}

static void a_line_is_repeated_within_thirty_seconds(void **unused)
{
    (void)unused;
    assert_int_equal(lines_after(CLI_PROGRESS_OPENJD, 29, "openjd_progress: 42.0\n"), 1);
    assert_int_equal(lines_after(CLI_PROGRESS_PERCENT, 29, "Progress: 42%\n"), 1);
    assert_int_equal(lines_after(CLI_PROGRESS_ALF, 29, "ALF_PROGRESS 42%\n"), 1);
}

static void a_line_is_not_repeated_at_once(void **unused)
{
    (void)unused;
    assert_int_equal(lines_after(CLI_PROGRESS_PERCENT, 20, ""), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_line_is_repeated_within_thirty_seconds),
        cmocka_unit_test(a_line_is_not_repeated_at_once),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
