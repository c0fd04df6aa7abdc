/* time_spans.h - the length of the union of time spans. Kernels of several streams overlap, so
 * their sum would exceed the time that passed. */
#ifndef BAKE_DEVICE_COMPUTE_TIME_SPANS_H
#define BAKE_DEVICE_COMPUTE_TIME_SPANS_H

enum { BAKE_TIME_SPANS_MAX = 256 };

struct bake_span {
    double start, end; /* seconds on any one clock */
};

/* Zero at first. Not thread-safe. */
struct bake_time_spans {
    double closed; /* length of the spans that have left the list */
    unsigned count;
    struct bake_span spans[BAKE_TIME_SPANS_MAX];
};

/* Adds a span. Spans may come in any order, as long as none comes after more than
 * BAKE_TIME_SPANS_MAX / 2 later ones that do not touch each other. */
void bake_time_spans_add(struct bake_time_spans *spans, double start, double end);

/* Returns the length of the union of all spans, in seconds. */
double bake_time_spans_seconds(struct bake_time_spans *spans);

#endif
