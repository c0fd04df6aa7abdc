/* verdict.h - what the checkers of maps have in common: angles, percentiles, limits. */
#ifndef SCAN_VERDICT_H
#define SCAN_VERDICT_H

#include <stddef.h>
#include <stdint.h>

#include "formats/image/exr_read.h"

struct verdict {
    float *angles; /* degrees, one per compared texel */
    uint64_t compared, unsolved, missed;
    double angle_sum, color_sum;
    uint64_t color_count;
};

struct verdict_limits {
    double mean_angle, p95_angle, color, hits; /* at most, at most, at most, at least */
};
#define VERDICT_NO_LIMITS                                                                          \
    {                                                                                              \
        INFINITY, INFINITY, INFINITY, 0                                                            \
    }

/* Reads one of the limits' options (m, p, c, h of getopt); 0 where it is another. */
int verdict_option(struct verdict_limits *limits, int option, const char *value);

void verdict_start(struct verdict *verdict, uint64_t most);
/* Notes an encoded normal n / 2 + 1 / 2 against the expected one (any length). */
void verdict_normal(struct verdict *verdict, const double encoded[3], const double expected[3]);
void verdict_color(struct verdict *verdict, const double found[3], const double expected[3]);
/* Prints figures against limits; the exit status. */
int verdict_finish(struct verdict *verdict, const struct verdict_limits *limits);

/* Loads an image or exits with the reason. */
void verdict_load(struct bsq_ctx *ctx, const char *path, struct fmt_exr_image *image);
/* R, G and B of a texel. */
void verdict_pixel(const struct fmt_exr_image *image, uint64_t index, double out[3]);
/* sRGB 0..1 to linear light. */
double verdict_linear(double srgb);

#endif
