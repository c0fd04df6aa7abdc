/* phase.h - prints the cost of each phase of a baseline to standard output, as key=value lines such
 * as "parse.wall=0.71". The first phase begins with the program. */
#ifndef BENCH_PHASE_H
#define BENCH_PHASE_H

#include <stdio.h>
#include <sys/resource.h>
#include <time.h>

struct phase_clock {
    double wall, user, system;
};

static inline struct phase_clock phase_now(void)
{
    struct timespec t;
    struct rusage usage;
    clock_gettime(CLOCK_MONOTONIC, &t);
    getrusage(RUSAGE_SELF, &usage);
    struct phase_clock now = {
        (double)t.tv_sec + (double)t.tv_nsec * 1e-9,
        (double)usage.ru_utime.tv_sec + (double)usage.ru_utime.tv_usec * 1e-6,
        (double)usage.ru_stime.tv_sec + (double)usage.ru_stime.tv_usec * 1e-6,
    };
    return now;
}

/* Prints the cost since *begin and the peak of resident memory so far, and sets *begin to now. */
static inline void phase_end(const char *name, struct phase_clock *begin)
{
    struct rusage usage;
    struct phase_clock now = phase_now();
    getrusage(RUSAGE_SELF, &usage);
    printf("%s.wall=%.4f\n%s.user=%.4f\n%s.system=%.4f\n%s.rss_kib=%ld\n", name,
           now.wall - begin->wall, name, now.user - begin->user, name, now.system - begin->system,
           name, usage.ru_maxrss);
    *begin = now;
}

#endif
