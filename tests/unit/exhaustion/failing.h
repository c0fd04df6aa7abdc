/* failing.h - lets memory and threads run out on request.
 *
 * The test program defines malloc(), calloc(), realloc(), free() and pthread_create(), also for
 * shared libraries, and counts blocks that are not freed. A sanitizer has its own; then only
 * Bisque's objects call these, and the sanitizer finds leaks. One job at a time, with any number of
 * threads. */
#ifndef TEST_FAILING_H
#define TEST_FAILING_H

#include <stdbool.h>
#include <stdint.h>

enum failing { FAILING_MEMORY, FAILING_THREADS };

/* Makes call number `first` (from 0) fail, and all later calls if `all_after`. */
void failing_begin(enum failing what, uint64_t first, bool all_after);

struct failing_result {
    uint64_t calls, failed; /* since failing_begin() */
    int64_t leaked;         /* blocks allocated since and not freed; 0 if a sanitizer counts them */
};
/* Makes everything work again. */
struct failing_result failing_end(void);

#endif
