/* compare.h - measures how far apart two texture maps are.
 *
 * Takes two OpenEXR files of the same size, and optional coverage masks. Gives the distribution of
 * the error over the texels, and on request two PNG pictures of it. */
#ifndef BAKE_COMPARE_H
#define BAKE_COMPARE_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What the values of the maps mean. It decides how the error of a texel is measured. */
enum bake_compare_kind {
    /* By the attribute "bisque:map" of map b; without one, by its channels and values. */
    BAKE_COMPARE_AUTO,
    /* R, G, B hold a unit normal n as n / 2 + 1/2. Error: the angle in degrees, 0 to 180. */
    BAKE_COMPARE_NORMAL,
    /* R, G, B hold linear Rec. 709 light. Error: the CIEDE2000 difference, of which about 1 is just
     * noticeable (Sharma, Wu & Dalal, "The CIEDE2000 Color-Difference Formula: Implementation
     * Notes", Color Research and Application 30(1), 2005). */
    BAKE_COMPARE_COLOR,
    /* Any channels, the same in both maps. Error: the largest absolute difference of a channel. */
    BAKE_COMPARE_DATA
};

/* All paths stay the caller's and need to live only until bake_compare() returns. */
struct bake_compare_options {
    const char *a_path, *b_path; /* OpenEXR; b is the reference */
    /* OpenEXR masks of the maps' size. A map covers the texels where the first channel of its mask
     * is above 0; NULL: it covers all texels. Only texels that both maps cover are compared. */
    const char *a_mask_path, *b_mask_path;
    enum bake_compare_kind kind;
    const char *heatmap_path;   /* PNG of the error of each texel with its scale; NULL: none */
    const char *histogram_path; /* PNG of the error's distribution; NULL: none */
    double scale; /* error at the top of the pictures' scale; 0: the 99th percentile */
    bool force;   /* compare maps although their attributes say that they hold different things */
};

struct bake_compare_report {
    enum bake_compare_kind kind; /* never BAKE_COMPARE_AUTO */
    uint32_t width, height;      /* texels */
    uint64_t compared;           /* texels that both maps cover */
    uint64_t only_a, only_b;     /* texels that one map covers and the other does not */
    double agreement;            /* compared / (compared + only_a + only_b) */
    /* Distribution of the error over the compared texels, in the unit of bake_compare_unit().
     * Percentiles are by nearest rank: the smallest error that is at least as large as the errors
     * of this share of the texels. */
    double mean, rms, median, p95, p99, max;
    uint32_t max_x, max_y;   /* first texel with the largest error; (0, 0) is the top left */
    double above_1, above_5; /* share of the compared texels with an error above 1 and above 5 */
    /* Colours only: peak signal to noise ratio of the sRGB-encoded values, in dB; infinite if the
     * maps are equal. */
    double psnr;
    /* Data only, over all channels: |a - b| / max(|a|, |b|), 0 if both are 0. */
    double relative_mean, relative_max;
};

/* Returns the unit of the error for legends: "degrees", "dE2000" or "difference", and "" for
 * BAKE_COMPARE_AUTO. Static storage. */
const char *bake_compare_unit(enum bake_compare_kind kind);

/* Compares two maps on all threads of the context, and fills *report. Each picture is written whole
 * or not at all. Not to be called from parallel work of the same context.
 * Memory: both maps, their masks and one error a texel as 32-bit floats, a second copy of the
 * compared errors, and the picture; all of it from the context's budget and freed on return.
 * Errors, explained by bsq_error():
 *   BSQ_ENOINPUT  a file does not exist;
 *   BSQ_EDATA     a file is damaged or not OpenEXR; sizes or channels differ or do not suit the
 *                 kind; no texel is covered by both maps; a compared value is not a number; or,
 *                 without `force`, both files have an attribute bisque:map, normalSpace, tangents,
 *                 green or encoding, and its values differ;
 *   BSQ_ECANTCREAT, BSQ_EIO  a picture cannot be written;
 *   BSQ_ENOMEM, BSQ_EINTR. */
int bake_compare(struct bsq_ctx *ctx, const struct bake_compare_options *options,
                 struct bake_compare_report *report);

#ifdef __cplusplus
}
#endif
#endif
