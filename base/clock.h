/* clock.h - wall time for reports. */
#ifndef BSQ_CLOCK_H
#define BSQ_CLOCK_H

#include <time.h>

/* Returns seconds on a clock that only goes forward. */
static inline double bsq_seconds_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

#endif
