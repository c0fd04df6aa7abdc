/* time_spans.h - for how long something was busy, from spans of time that overlap: kernels of
 * several queues run at once, and their sum would say more than the clock. */
#ifndef BAKE_DEVICE_TIME_SPANS_H
#define BAKE_DEVICE_TIME_SPANS_H

enum { BAKE_BUSY_SPANS = 256 };

struct bake_span {
    double start, end; /* seconds on any one clock */
};

/* Zero at first. Not thread-safe. */
struct bake_busy {
    double closed; /* length of the spans that are left out of the list */
    unsigned count;
    struct bake_span spans[BAKE_BUSY_SPANS];
};

/* Adds a span. Spans may come in any order, as long as none comes after more than BAKE_BUSY_SPANS /
 * 2 later ones that do not touch each other. */
void bake_busy_add(struct bake_busy *busy, double start, double end);

/* Length of the union of all spans. */
double bake_busy_seconds(struct bake_busy *busy);

#endif
