/* failing.h - makes allocations and starts of threads fail on request.
 *
 * The test program replaces malloc(), calloc(), realloc(), free() and pthread_create(), also for
 * shared libraries, and counts blocks that are not freed. Sanitizers have their own replacements.
 * With them, only calls in Bisque's objects can fail, and the sanitizer finds leaks. Use it for one
 * job at a time, which may have any number of threads. */
#ifndef TEST_FAILING_H
#define TEST_FAILING_H

#include <stdbool.h>
#include <stdint.h>

enum failing { FAILING_MEMORY, FAILING_THREADS };

/* Starts counting calls. Call number `first` (from 0) will fail; so will all later ones if
 * `all_after`. */
void failing_begin(enum failing what, uint64_t first, bool all_after);

struct failing_result {
    uint64_t calls, failed; /* since failing_begin() */
    int64_t leaked;         /* blocks allocated since then and not freed; 0 with a sanitizer */
};
/* Stops counting; no call fails any more. */
struct failing_result failing_end(void);

#endif
