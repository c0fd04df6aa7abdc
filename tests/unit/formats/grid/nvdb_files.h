/* nvdb_files.h - paths of the files that tests of grid files write and read. */
#ifndef TEST_NVDB_FILES_H
#define TEST_NVDB_FILES_H

#include "formats/grid/nvdb.h"

/* Two files in a directory of the test program, which the two functions make and remove; for
 * cmocka. Removing fails if the directory has other files. */
extern char nvdb_path[64], nvdb_other_path[64];
int nvdb_make_directory(void **state);
int nvdb_remove_directory(void **state);

/* Returns the bytes of a file, to be freed with free(). */
uint8_t *nvdb_read_file(const char *name, uint64_t *size);

#define assert_ok(ctx, call)                                                                       \
    do {                                                                                           \
        int assert_ok_status = (call);                                                             \
        if (assert_ok_status)                                                                      \
            fail_msg("%s: %d, %s", #call, assert_ok_status, bsq_error(ctx));                       \
    } while (0)

#endif
