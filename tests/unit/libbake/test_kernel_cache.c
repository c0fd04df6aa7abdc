/* test_kernel_cache.c - entries come back whole, or not at all. */
#include <dirent.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "libbake/kernel_cache_internal.h"

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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_round_trip, setup, teardown),
        cmocka_unit_test_setup_teardown(test_damage, setup, teardown),
        cmocka_unit_test_setup_teardown(test_no_cache, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
