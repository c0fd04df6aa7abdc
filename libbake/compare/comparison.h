/* comparison.h - what the files of this folder share; private to it. Its public header is
 * libbake/compare.h. */
#ifndef BAKE_COMPARE_COMPARISON_H
#define BAKE_COMPARE_COMPARISON_H

#include <math.h>

#include "base/output.h"
#include "formats/image/exr_read.h"
#include "libbake/compare.h"

/* Error of a texel that not both maps cover. */
#define BAKE_NOT_COVERED (-1.0f)

/* What the samples of a file are. */
struct bake_samples {
    bool integers; /* which are 0 to 1 in the image */
    double gamma;  /* exponent that turns colours into linear light; 0: the curve of sRGB */
};

/* Two maps of the same size and the error of each texel. */
struct bake_comparison {
    struct fmt_exr_image a, b, a_mask, b_mask; /* without a mask, its `samples` are NULL */
    struct bake_samples a_samples, b_samples;
    enum bake_compare_kind kind;
    /* The channels that are compared with each other. They are R, G and B unless the maps are
     * BAKE_COMPARE_DATA; a grey map has one channel for all three. */
    uint32_t (*pairs)[2];
    uint32_t pair_count;
    /* height x width. BAKE_NOT_COVERED: not compared. NaN: a value is not finite. */
    float *errors;
};

/* Reads R, G and B of a texel of both maps; of other channels the first three, or the last again.
 */
static inline void read_rgb(const struct bake_comparison *c, uint64_t texel, float a[3], float b[3])
{
    for (uint32_t k = 0; k < 3; k++) {
        const uint32_t *pair = c->pairs[k < c->pair_count ? k : c->pair_count - 1];
        a[k] = c->a.samples[texel * c->a.channel_count + pair[0]];
        b[k] = c->b.samples[texel * c->b.channel_count + pair[1]];
    }
}

/* Returns whether all values of a texel are finite, that of the map's mask included. */
static inline bool is_finite(const struct fmt_exr_image *image, const struct fmt_exr_image *mask,
                             uint64_t texel)
{
    const float *samples = image->samples + texel * image->channel_count;
    bool finite = !mask->samples || isfinite(mask->samples[texel * mask->channel_count]);
    for (uint32_t k = 0; k < image->channel_count; k++)
        finite = finite && isfinite(samples[k]);
    return finite;
}

/* Returns whether a map covers a texel. A mask that is NaN there does not say that it doesn't. */
static inline bool covers(const struct fmt_exr_image *mask, uint64_t texel)
{
    return !mask->samples || !(mask->samples[texel * mask->channel_count] <= 0);
}

/* Fills the report. Errors: BSQ_EDATA if no texel is covered by both maps, or none is compared and
 * ignore_nan is set; BSQ_ENOMEM, BSQ_EINTR. */
int bake_comparison_summarise(struct bsq_ctx *ctx, const struct bake_compare_options *options,
                              const struct bake_comparison *comparison,
                              struct bake_compare_report *report);

#endif
