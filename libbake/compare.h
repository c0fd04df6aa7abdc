/* compare.h - how far apart are two maps? */
#ifndef BAKE_COMPARE_H
#define BAKE_COMPARE_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

enum bake_compare_kind {
    BAKE_COMPARE_AUTO, /* from the file's "bisque:map" attribute, else from its channels and values
                        */
    BAKE_COMPARE_NORMAL, /* R, G, B hold n / 2 + 1/2: the angle between the normals in degrees */
    BAKE_COMPARE_COLOR,  /* R, G, B hold linear Rec. 709 light: CIEDE2000 colour difference */
    BAKE_COMPARE_DATA    /* any channels: the largest absolute difference of a channel */
};

struct bake_compare_options {
    const char *a_path, *b_path; /* EXR, same size and channels; b is the reference */
    /* Masks: texels count where the first channel is > 0. NULL: all texels of that map. */
    const char *a_mask_path, *b_mask_path;
    enum bake_compare_kind kind;
    const char *heatmap_path;   /* PNG of the error in place with its scale, or NULL */
    const char *histogram_path; /* PNG of its distribution, or NULL */
    double scale;               /* error at the top of the scale; 0: automatic */
    bool force; /* compare maps whose attributes say that they hold different things */
};

struct bake_compare_report {
    enum bake_compare_kind kind;
    uint32_t width, height;
    uint64_t compared;       /* texels that both maps cover */
    uint64_t only_a, only_b; /* texels that one of them covers */
    double agreement;        /* compared / (compared + only_a + only_b) */
    /* Distribution of the error of enum bake_compare_kind over the compared texels; percentiles are
     * the smallest errors that this share of texels does not exceed. */
    double mean, rms, median, p95, p99, max;
    uint32_t max_x, max_y;   /* where the largest error is, from the top left */
    double above_1, above_5; /* share of texels with an error above 1 and 5 */
    double psnr; /* colour: peak signal to noise ratio of the sRGB-encoded values, in dB */
    double relative_mean, relative_max; /* data: |a - b| / max(|a|, |b|) */
};

/* Unit of the error, for legends: "degrees", "dE2000", "difference"; static storage. */
const char *bake_compare_unit(enum bake_compare_kind kind);

/* Compares two maps. Holds both in memory, from the budget. Errors: BSQ_ENOINPUT, BSQ_EDATA where
 * sizes or channels differ, no texel is covered by both, or, without `force`, where the attributes
 * of both say what the values mean and differ: kind of map, space, tangents, green, encoding. */
int bake_compare(struct bsq_ctx *ctx, const struct bake_compare_options *options,
                 struct bake_compare_report *report);

#ifdef __cplusplus
}
#endif
#endif
