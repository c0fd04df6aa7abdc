/* test_kernel_cache.c - entries come back whole, or not at all. */
#include <dirent.h>
#include <fcntl.h>
#include <inttypes.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

#include "libbake/device/opencl/kernel_cache.h"

struct fixture {
    char home[64], directory[80];
};

static int setup(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);

    strcpy(f->home, "/tmp/bisque-cache.XXXXXX");
    assert_non_null(mkdtemp(f->home));
    snprintf(f->directory, sizeof f->directory, "%s/bisque", f->home);
    setenv("XDG_CACHE_HOME", f->home, 1);
    *state = f;
    return 0;
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    char command[128];

    snprintf(command, sizeof command, "rm -rf %s", f->home);
    assert_int_equal(system(command), 0);
    free(f);
    return 0;
}

static void assert_entry(const char *key, const void *data, uint64_t bytes)
{
    void *got;
    uint64_t got_bytes;

    assert_true(bake_kernel_cache_get(key, &got, &got_bytes));
    assert_int_equal(got_bytes, bytes);
    assert_memory_equal(got, data, bytes);
    free(got);
}

static void assert_none(const char *key)
{
    void *got;
    uint64_t bytes;

    assert_false(bake_kernel_cache_get(key, &got, &bytes));
    assert_null(got);
}

/* Path of the only file in the cache. */
static void find_file(const struct fixture *f, char path[400])
{
    DIR *directory = opendir(f->directory);
    int count = 0;

    assert_non_null(directory);
    for (struct dirent *entry; (entry = readdir(directory));)
        if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0) {
            snprintf(path, 400, "%s/%s", f->directory, entry->d_name);
            count++;
        }
    closedir(directory);
    assert_int_equal(count, 1);
}

static void test_round_trip(void **state)
{
    (void)state;
    assert_none("a");
    bake_kernel_cache_put("a", "kernel of a", 11);
    bake_kernel_cache_put("b", "", 0);
    assert_entry("a", "kernel of a", 11);
    assert_entry("b", "", 0);
    assert_none("c");
    bake_kernel_cache_put("a", "another", 7);
    assert_entry("a", "another", 7);
}

static void test_damage(void **state)
{
    struct fixture *f = *state;
    char path[400], bytes[400];
    FILE *file;
    size_t size;

    bake_kernel_cache_put("device\ndriver", "0123456789", 10);
    find_file(f, path);
    file = fopen(path, "rb");
    size = fread(bytes, 1, sizeof bytes, file);
    fclose(file);
    assert_true(size > 23 && size < sizeof bytes);
    for (size_t i = 0; i < size; i++) {
        bytes[i] ^= 0x10;
        file = fopen(path, "wb");
        assert_int_equal(fwrite(bytes, 1, size, file), size);
        fclose(file);
        bytes[i] ^= 0x10;
        assert_none("device\ndriver");
    }
    for (size_t length = 0; length < size; length++) {
        file = fopen(path, "wb");
        assert_int_equal(fwrite(bytes, 1, length, file), length);
        fclose(file);
        assert_none("device\ndriver");
    }
    bake_kernel_cache_put("device\ndriver", "0123456789", 10);
    assert_entry("device\ndriver", "0123456789", 10);
    find_file(f, path); /* nothing temporary is left */
}

static void test_no_cache(void **state)
{
    struct fixture *f = *state;
    FILE *file = fopen(f->directory, "wb"); /* a file where the directory would be */

    fclose(file);
    bake_kernel_cache_put("a", "data", 4);
    assert_none("a");
    setenv("XDG_CACHE_HOME", "relative", 1);
    unsetenv("HOME");
    bake_kernel_cache_put("a", "data", 4);
    assert_none("a");
    assert_int_equal(access("relative", F_OK), -1);
    setenv("HOME", f->home, 1);
    bake_kernel_cache_put("a", "data", 4);
    assert_entry("a", "data", 4);
}

/* Path of a key's entry. */
static void name_entry(const struct fixture *f, const char *key, char path[400])
{
    snprintf(path, 400, "%s/%016" PRIx64 ".kernel", f->directory,
             bake_kernel_hash(key, strlen(key)));
}

static void set_age(const char *path, time_t days)
{
    const struct timespec then = {.tv_sec = time(NULL) - days * 24 * 60 * 60};
    assert_int_equal(utimensat(AT_FDCWD, path, (const struct timespec[2]){then, then}, 0), 0);
}

static void make_file(const char *path, off_t bytes, time_t days)
{
    const int fd = open(path, O_WRONLY | O_CREAT | O_EXCL, 0600);
    assert_true(fd >= 0);
    assert_int_equal(ftruncate(fd, bytes), 0);
    close(fd);
    set_age(path, days);
}

static void test_unused_entries_go(void **state)
{
    struct fixture *f = *state;
    char old[400], used[400], path[400];

    bake_kernel_cache_put("old", "1", 1);
    bake_kernel_cache_put("used", "2", 1);
    bake_kernel_cache_put("fresh", "3", 1);
    name_entry(f, "old", old);
    name_entry(f, "used", used);
    set_age(old, BAKE_KERNEL_CACHE_DAYS + 1);
    set_age(used, BAKE_KERNEL_CACHE_DAYS + 1);
    assert_entry("used", "2", 1); /* which makes it young */
    snprintf(path, sizeof path, "%s/.new-dead01", f->directory);
    make_file(path, 10, 2);
    bake_kernel_cache_put("another", "4", 1);
    assert_none("old");
    assert_entry("used", "2", 1);
    assert_entry("fresh", "3", 1);
    assert_entry("another", "4", 1);
    assert_int_equal(access(old, F_OK), -1);
    assert_int_equal(access(path, F_OK), -1);
    /* What is not of the cache stays, and so does what another process writes now. */
    snprintf(path, sizeof path, "%s/notes", f->directory);
    make_file(path, 10, 1000);
    snprintf(old, sizeof old, "%s/.new-living", f->directory);
    make_file(old, 10, 0);
    bake_kernel_cache_put("another", "5", 1);
    assert_int_equal(access(path, F_OK), 0);
    assert_int_equal(access(old, F_OK), 0);
}

static void test_size_is_limited(void **state)
{
    struct fixture *f = *state;
    char keys[3][8] = {"first", "second", "third"}, path[400];

    bake_kernel_cache_put("small", "1", 1);
    for (int i = 0; i < 3; i++) {
        name_entry(f, keys[i], path);
        make_file(path, BAKE_KERNEL_CACHE_BYTES / 3, 3 - i); /* sparse */
    }
    bake_kernel_cache_put("another", "2", 1);
    for (int i = 0; i < 3; i++) {
        name_entry(f, keys[i], path);
        assert_int_equal(access(path, F_OK), i == 0 ? -1 : 0);
    }
    assert_entry("small", "1", 1);
    assert_entry("another", "2", 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_round_trip, setup, teardown),
        cmocka_unit_test_setup_teardown(test_damage, setup, teardown),
        cmocka_unit_test_setup_teardown(test_no_cache, setup, teardown),
        cmocka_unit_test_setup_teardown(test_unused_entries_go, setup, teardown),
        cmocka_unit_test_setup_teardown(test_size_is_limited, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
