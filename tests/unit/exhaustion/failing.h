/* failing.h - memory and threads that run out on request, for tests of what happens then.
 *
 * The test program's own malloc(), calloc(), realloc(), free() and pthread_create() take the C
 * library's place, for the shared libraries too, and count what is not freed. Where a sanitizer has
 * its own they only take the place of those that Bisque's objects call, and the sanitizer finds
 * leaks. One job at a time; its threads may be many. */
#ifndef TEST_FAILING_H
#define TEST_FAILING_H

#include <stdbool.h>
#include <stdint.h>

enum failing { FAILING_MEMORY, FAILING_THREADS };

/* From now on call number `first` (from 0) fails, and all after it too where `all_after`. */
void failing_begin(enum failing what, uint64_t first, bool all_after);

struct failing_result {
    uint64_t calls, failed; /* since failing_begin() */
    int64_t leaked; /* blocks that were allocated since and not freed; 0 where a sanitizer counts */
};
/* Everything works again. */
struct failing_result failing_end(void);

#endif
