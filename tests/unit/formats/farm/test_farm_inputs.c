/* Tests when the inputs of a plan are read to compare them, and when their identity is enough. */
#include "formats/farm/farm.h"
#include "base/job_files.h"
#include "tests/unit/test.h"

#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static const struct fmt_farm_kind kind = {.format = "a plan of a test"};
static char directory[64], name[80];
static time_t later; /* how far the clock is ahead of the file system's */

time_t time(time_t *out)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    now.tv_sec += later;
    if (out)
        *out = now.tv_sec;
    return now.tv_sec;
}

/* Writes a file, again and again until the system gives it another time of change. */
static void write_file(const char *text)
{
    struct stat before = {0}, now;
    int fd = open(name, O_WRONLY | O_CREAT, 0600);
    assert_true(fd >= 0 && fstat(fd, &before) == 0);
    do {
        assert_int_equal(pwrite(fd, text, strlen(text), 0), (ssize_t)strlen(text));
        assert_int_equal(fstat(fd, &now), 0);
    } while (now.st_ctim.tv_sec == before.st_ctim.tv_sec &&
             now.st_ctim.tv_nsec == before.st_ctim.tv_nsec);
    close(fd);
}

/* Makes a plan whose input is the file, and which is made after the file's last change by `later`
 * seconds. */
static struct bsq_ctx *make_plan(struct fmt_farm_plan *plan)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct bsq_file file;
    assert_int_equal(bsq_note_input(ctx, name, "the input"), 0);
    assert_int_equal(bsq_file_open(ctx, name, &file), 0);
    bsq_file_close(ctx, &file);
    assert_int_equal(fmt_farm_plan_init(ctx, &kind, "plan.json", 1, plan), 0);
    assert_int_equal(fmt_farm_add_inputs(plan), 0);
    assert_int_equal(plan->input_count, 1);
    return ctx;
}

static void end(struct bsq_ctx *ctx, struct fmt_farm_plan *plan)
{
    fmt_farm_plan_clear(plan);
    test_context_end(ctx);
}

/* A plan with a wrong checksum shows whether the file is read. */
TEST(test_known_file_is_not_read)
{
    for (later = 0; later < 20; later += 10) {
        struct fmt_farm_plan plan;
        write_file("abcdef");
        struct bsq_ctx *ctx = make_plan(&plan);
        assert_int_equal(fmt_farm_check_inputs(&plan), 0);
        plan.inputs[0].hash[0] ^= 1;
        const int expected = later > 0 ? 0 : BSQ_EDATA;
        assert_int_equal(fmt_farm_check_inputs(&plan), expected);
        end(ctx, &plan);
    }
}

/* Other content of the same size is noticed, also if the file has its old time of modification. */
TEST(test_changed_file)
{
    later = 10;
    for (int restore = 0; restore < 2; restore++) {
        struct fmt_farm_plan plan;
        struct stat info;
        write_file("abcdef");
        assert_int_equal(stat(name, &info), 0);
        struct bsq_ctx *ctx = make_plan(&plan);
        write_file("abcdeg");
        if (restore)
            assert_int_equal(
                utimensat(AT_FDCWD, name, (struct timespec[2]){info.st_atim, info.st_mtim}, 0), 0);
        struct bsq_ctx *task = test_context(1, 0);
        plan.ctx = task;
        assert_int_equal(fmt_farm_check_inputs(&plan), BSQ_EDATA);
        assert_non_null(strstr(bsq_error(task), "the input is not the file that the plan"));
        /* The same content with another time is the same input. */
        write_file("abcdef");
        bsq_ctx_destroy(task);
        task = plan.ctx = test_context(1, 0);
        assert_int_equal(fmt_farm_check_inputs(&plan), 0);
        bsq_ctx_destroy(task);
        plan.ctx = ctx;
        end(ctx, &plan);
    }
}

static int make_directory(void **state)
{
    (void)state;
    strcpy(directory, "/tmp/test_farm_inputs_XXXXXX");
    assert_non_null(mkdtemp(directory));
    snprintf(name, sizeof name, "%s/input", directory);
    return 0;
}

static int remove_directory(void **state)
{
    (void)state;
    return unlink(name) == 0 && rmdir(directory) == 0 ? 0 : -1;
}

RUN_TESTS(make_directory, remove_directory)
