/* comparison.h - what the parts of a comparison share. */
#ifndef BAKE_COMPARE_COMPARISON_H
#define BAKE_COMPARE_COMPARISON_H

#include "formats/image/exr.h"
#include "libbake/compare.h"

/* The maps, and the error of each texel; -1 where none was computed. */
struct bake_comparison {
    struct fmt_exr_image a, b, a_mask, b_mask; /* masks have no samples where none was given */
    enum bake_compare_kind kind;
    uint32_t a_rgb[3], b_rgb[3]; /* channel numbers, where the kind needs them */
    float *errors;               /* height x width */
};

/* Draws the errors in place, with a scale from 0 to `top` below. */
int bake_heatmap_write(struct bsq_ctx *ctx, const struct bake_comparison *comparison, double top,
                       const char *path);
/* Draws their distribution over 0 .. `top`, with the report's percentiles marked. */
int bake_histogram_write(struct bsq_ctx *ctx, const struct bake_comparison *comparison,
                         const struct bake_compare_report *report, double top, const char *path);

/* The labels of a scale from 0 to `top` over a picture of `width` pixels, `scale` pixels to a dot:
 * where they and their ticks are, in pixels from the left. Labels that have no room beside more
 * important ones (the last, the first, the middle one) are not shown. */
enum { BAKE_SCALE_TICKS = 5, BAKE_SCALE_MARGIN = 24 /* dots beside the bar */ };
struct bake_scale_label {
    char text[48];
    int64_t tick, left, width;
    bool shown;
};
void bake_scale_layout(int64_t width, unsigned scale, double top, const char *unit,
                       struct bake_scale_label labels[BAKE_SCALE_TICKS]);

#endif
