/* nvdb_files.h - the file that tests of grid files write and read. */
#ifndef TEST_NVDB_FILES_H
#define TEST_NVDB_FILES_H

#include "formats/grid/nvdb.h"

static const char nvdb_path[] = "a.nvdb";

#define assert_ok(ctx, call)                                                                       \
    do {                                                                                           \
        int assert_ok_status = (call);                                                             \
        if (assert_ok_status)                                                                      \
            fail_msg("%s: %d, %s", #call, assert_ok_status, bsq_error(ctx));                       \
    } while (0)

#endif
