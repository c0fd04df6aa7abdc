/* clock_internal.h - seconds for reports. */
#ifndef BAKE_CLOCK_INTERNAL_H
#define BAKE_CLOCK_INTERNAL_H

#include <time.h>

static inline double bake_clock(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

#endif
