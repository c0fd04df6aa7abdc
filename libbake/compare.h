/** @file
 * libbake: measures how far apart two texture maps are.
 *
 * Takes two images of the same size, OpenEXR, PNG or others, and optional coverage masks. Gives the
 * distribution of the error over the texels, and on request a PNG picture of it.
 *
 * @example compare_maps.c
 * Prints how far apart two maps are. */
#ifndef BAKE_COMPARE_H
#define BAKE_COMPARE_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/** What the values of the maps mean. It decides how the error of a texel is measured. */
enum bake_compare_kind {
    /** By the attribute "bisque:map" of map a or else b; without one, by channels and values. */
    BAKE_COMPARE_AUTO,
    /** R, G, B hold a unit normal n as n / 2 + 1/2. Error: the angle in degrees, 0 to 180. */
    BAKE_COMPARE_NORMAL,
    /** R, G, B hold linear Rec. 709 light, which files of integers have as sRGB. Error: the
     * CIEDE2000 difference, of which about 1 is just noticeable (Sharma, Wu and Dalal, "The
     * CIEDE2000 Color-Difference Formula: Implementation Notes", Color Research and Application
     * 30(1), 2005). */
    BAKE_COMPARE_COLOR,
    /** Any channels, the same in both maps, or grey against R, G and B. Alpha of one map only does
     * not count. Error: the largest absolute difference of a channel. */
    BAKE_COMPARE_DATA
};

struct bake_page;

/** What bake_compare() reads and writes. The caller owns all paths; they must live until it
 * returns. All zeros but the size and the first two paths are the defaults. */
struct bake_compare_options {
    size_t size;        /**< Of the structure, see bsq_check_size(). */
    const char *a_path; /**< Input: a map. */
    const char *b_path; /**< Input: the reference. */
    /** Input: a mask of the maps' size. Map a covers the texels whose first channel in the
     * mask is above 0; NULL: it covers all. Only texels that both maps cover are compared. */
    const char *a_mask_path;
    const char *b_mask_path;     /**< The same for map b. */
    enum bake_compare_kind kind; /**< What the values mean. */
    const char *heatmap_path;    /**< Output: the error of each texel, PNG, or NULL. */
    struct bake_page *page; /**< Gets both maps and the errors, see bake_page_open(); or NULL. */
    double scale; /**< Error at the top of the heat map's scale; 0: the 99th percentile. */
    bool force; /**< Compares maps even if their attributes say that they hold different things. */
    /** Takes it as an error if no texel has finite values; otherwise the figures are infinite. */
    bool ignore_nan;
};

/** The result of a comparison. Errors are in the unit of bake_compare_unit(). A percentile is the
 * smallest error that is at least as large as the errors of that share of the texels. If no texel
 * is compared, all figures are infinite. */
struct bake_compare_report {
    size_t size;                 /**< Of the structure, see bsq_clear_report(). */
    enum bake_compare_kind kind; /**< Never BAKE_COMPARE_AUTO. */
    uint32_t width;              /**< Width of the maps in texels. */
    uint32_t height;             /**< Height of the maps in texels. */
    uint64_t compared;           /**< Texels that both maps cover, with finite values. */
    /** Texels that both maps cover, with a value in one of them that is NaN or infinite, or with
     * such a value in a mask. They have no error and are in no figure; a limit should not hold. */
    uint64_t not_finite;
    uint64_t not_finite_a; /**< Those of them with such a value in map a or its mask. */
    uint64_t not_finite_b; /**< Those with such a value in map b or its mask. */
    uint64_t only_a;       /**< Texels that only map a covers. */
    uint64_t only_b;       /**< Texels that only map b covers. */
    double agreement;      /**< Share of the texels that both cover, of those that one does. */
    double mean;           /**< Mean error of the compared texels. */
    double rms;            /**< Root of the mean square of the error. */
    double median;         /**< 50th percentile. */
    double p95;            /**< 95th percentile. */
    double p99;            /**< 99th percentile. */
    double max;            /**< Largest error. */
    double scale;          /**< Error of the heat map's lightest colour. */
    uint32_t max_x;        /**< Column of the first texel with the largest error, from 0. */
    uint32_t max_y;        /**< Row of that texel, from 0 at the top. */
    double above_1;        /**< Share of the compared texels with an error above 1. */
    double above_5;        /**< Share of the compared texels with an error above 5. */
    /** Colours only: peak signal to noise ratio of the sRGB-encoded values, in dB. Infinite if the
     * maps are equal. */
    double psnr;
    double relative_mean; /**< Data only: mean of |a - b| / max(|a|, |b|), 0 if both are 0. */
    double relative_max;  /**< Data only: the largest of these. */
};

/** Returns the unit of the error for legends: "degrees", "dE2000" or "difference", and "" for
 * BAKE_COMPARE_AUTO. Static storage. */
const char *bake_compare_unit(enum bake_compare_kind kind);

/** Fills in the defaults: no files. */
void bake_compare_defaults(struct bake_compare_options *options);

/** Compares two maps on all threads of the context, and fills in *report. The picture is written
 * whole or not at all. Must not be called from parallel work of the same context.
 *
 * Memory: both maps, their masks and one error a texel as 32-bit floats, and a second copy of the
 * compared errors. All of it is reserved from the context's budget and freed on
 * return.
 *
 * Errors: BSQ_ENOINPUT; BSQ_EDATA if a file is damaged or no image, if sizes or channels differ
 * or do not suit the kind, if no texel is covered by both maps, if `ignore_nan` leaves none, or,
 * without `force`, if both files have an attribute bisque:map, normalSpace, tangents,
 * green, encoding, unit or origin and its values differ; BSQ_ECANTCREAT; BSQ_EIO; BSQ_ENOMEM;
 * BSQ_EINTR. */
int bake_compare(struct bsq_ctx *ctx, const struct bake_compare_options *options,
                 struct bake_compare_report *report);

#ifdef __cplusplus
}
#endif
#endif
