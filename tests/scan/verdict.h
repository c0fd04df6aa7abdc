/* verdict.h - shared by the checkers of maps: errors of normals and colours, and their limits. */
#ifndef SCAN_VERDICT_H
#define SCAN_VERDICT_H

#include <stddef.h>
#include <stdint.h>

#include "formats/image/exr_read.h"

struct verdict {
    float *angles;     /* degrees, one per compared texel */
    uint64_t compared; /* texels */
    uint64_t unsolved; /* texels without a reference */
    uint64_t missed;   /* texels where the bake has no hit, but the reference does */
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

/* Parses one of the limits' options (m, p, c, h of getopt). Returns 0 for any other option. */
int verdict_option(struct verdict_limits *limits, int option, const char *value);

/* Starts a verdict on at most `most` texels. */
void verdict_start(struct verdict *verdict, uint64_t most);
/* Compares an encoded normal n / 2 + 1 / 2 with the expected one (of any length). */
void verdict_normal(struct verdict *verdict, const double encoded[3], const double expected[3]);
/* Compares two linear colours. */
void verdict_color(struct verdict *verdict, const double found[3], const double expected[3]);
/* Prints the figures and their limits. Returns the exit status: 0 if all limits hold, else 1. */
int verdict_finish(struct verdict *verdict, const struct verdict_limits *limits);

/* Loads an image, or prints the error and exits. */
void verdict_load(struct bsq_ctx *ctx, const char *path, struct fmt_exr_image *image);
/* Gets R, G and B of a texel. */
void verdict_pixel(const struct fmt_exr_image *image, uint64_t index, double out[3]);
/* Converts sRGB 0..1 to linear light. */
double verdict_linear(double srgb);

#endif
