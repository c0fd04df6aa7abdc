/* verdict.c - collects the errors of maps and compares them with limits. */
#include "tests/scan/verdict.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

int verdict_option(struct verdict_limits *limits, int option, const char *value)
{
    switch (option) {
    case 'm':
        limits->mean_angle = atof(value);
        return 1;
    case 'p':
        limits->p95_angle = atof(value);
        return 1;
    case 'c':
        limits->color = atof(value);
        return 1;
    case 'h':
        limits->hits = atof(value);
        return 1;
    default:
        return 0;
    }
}

void verdict_start(struct verdict *verdict, uint64_t most)
{
    *verdict = (struct verdict){.angles = malloc((most ? most : 1) * sizeof *verdict->angles)};
    if (!verdict->angles) {
        perror("check");
        exit(71);
    }
}

void verdict_normal(struct verdict *verdict, const double encoded[3], const double expected[3])
{
    double a[3], cross = 0, dot = 0;
    for (int k = 0; k < 3; k++) {
        a[k] = 2 * encoded[k] - 1;
        dot += a[k] * expected[k];
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        double c = a[j] * expected[k] - a[k] * expected[j];
        cross += c * c;
    }
    double angle = atan2(sqrt(cross), dot) * 57.29577951308232;
    verdict->angles[verdict->compared++] = (float)angle;
    verdict->angle_sum += angle;
}

void verdict_color(struct verdict *verdict, const double found[3], const double expected[3])
{
    for (int k = 0; k < 3; k++, verdict->color_count++)
        verdict->color_sum += fabs(found[k] - expected[k]);
}

static int ascending(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* Prints a figure and its limit. Returns 1 if the figure is outside, else 0. */
static int judge(const char *what, double value, double limit, int at_most)
{
    int ok = at_most ? value <= limit : value >= limit;
    printf("%s %s: %.6g (%s %g)\n", ok ? "within " : "OUTSIDE", what, value,
           at_most ? "at most" : "at least", limit);
    return !ok;
}

int verdict_finish(struct verdict *v, const struct verdict_limits *limits)
{
    uint64_t seen = v->compared + v->missed + v->unsolved;
    printf("texels %llu, compared %llu, missed %llu, without reference %llu\n",
           (unsigned long long)seen, (unsigned long long)v->compared, (unsigned long long)v->missed,
           (unsigned long long)v->unsolved);
    if (!v->compared) {
        puts("OUTSIDE: no texel could be compared");
        return 1;
    }
    qsort(v->angles, v->compared, sizeof *v->angles, ascending);
    int failed = judge("mean angle", v->angle_sum / (double)v->compared, limits->mean_angle, 1);
    failed += judge("95th percentile", v->angles[v->compared * 95 / 100], limits->p95_angle, 1);
    printf("        median %.4g, 99th %.4g, largest %.4g degrees\n", v->angles[v->compared / 2],
           v->angles[v->compared * 99 / 100], v->angles[v->compared - 1]);
    failed += judge("share of hits", 1 - (double)v->missed / (double)seen, limits->hits, 0);
    if (v->color_count)
        failed +=
            judge("mean colour error", v->color_sum / (double)v->color_count, limits->color, 1);
    free(v->angles);
    return failed != 0;
}

void verdict_load(struct bsq_ctx *ctx, const char *path, struct fmt_exr_image *image)
{
    if (fmt_exr_read(ctx, path, image)) {
        fprintf(stderr, "check: %s\n", bsq_error(ctx));
        exit(65);
    }
}

void verdict_pixel(const struct fmt_exr_image *image, uint64_t index, double out[3])
{
    static const char *const names[] = {"R", "G", "B"};
    for (int k = 0; k < 3; k++)
        out[k] =
            (double)image->samples[index * image->channel_count + fmt_exr_channel(image, names[k])];
}

double verdict_linear(double srgb)
{
    return srgb <= 0.04045 ? srgb / 12.92 : pow((srgb + 0.055) / 1.055, 2.4);
}
