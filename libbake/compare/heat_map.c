/* heat_map.c - the heat map of a comparison, as PNG: a pixel a texel.
 *
 * Colours run from near black over purple and orange to light yellow with steadily growing
 * lightness. So the picture reads the same in grey and for colour-blind eyes. Texels that were not
 * compared are blue-grey, those with values that are not finite are cyan. The file names the error
 * of the lightest colour in its attribute "bisque:errors": it is another one in each comparison. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "formats/image/image_writer.h"
#include "libbake/compare/comparison.h"

static const float not_compared[3] = {0.22f, 0.25f, 0.30f}, not_finite[3] = {0.0f, 0.9f, 0.9f};

/* Returns the colour of an error; `value` is its share of the top of the scale, clamped to 0..1. */
static void heat(double value, float color[3])
{
    static const float stops[][3] = {{0.02f, 0.02f, 0.07f}, {0.24f, 0.06f, 0.42f},
                                     {0.60f, 0.15f, 0.45f}, {0.90f, 0.36f, 0.24f},
                                     {0.98f, 0.69f, 0.22f}, {0.99f, 0.98f, 0.75f}};
    const int last = sizeof stops / sizeof *stops - 1;
    double x = fmin(fmax(value, 0), 1) * last;
    int i = x < last ? (int)x : last - 1;
    for (int k = 0; k < 3; k++)
        color[k] = stops[i][k] + (float)(x - i) * (stops[i + 1][k] - stops[i][k]);
}

static int write_rows(struct bsq_ctx *ctx, const struct bake_comparison *comparison, double top,
                      struct fmt_image_writer *writer)
{
    const uint64_t width = comparison->a.width;
    const float *error = comparison->errors;
    float(*row)[3];
    int status;
    BSQ_TRY(bsq_alloc(ctx, "heat map", width, sizeof *row, &row));
    for (uint32_t y = 0; y < comparison->a.height; y++) {
        for (uint64_t x = 0; x < width; x++, error++)
            if (*error >= 0)
                heat((double)*error / top, row[x]);
            else
                memcpy(row[x], isnan(*error) ? not_finite : not_compared, sizeof row[x]);
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(fmt_image_write_rows(writer, row[0], 1));
    }
done:
    bsq_free(ctx, row);
    return status;
}

int bake_heatmap_write(struct bsq_ctx *ctx, const struct bake_comparison *comparison, double top,
                       const char *path, struct bsq_output_group *group)
{
    char scale[64];
    const struct fmt_image_attribute attribute = {"bisque:errors", scale};
    const struct fmt_image_options options = {.width = comparison->a.width,
                                              .height = comparison->a.height,
                                              .channel_count = 3,
                                              .type = FMT_UINT8,
                                              .attributes = &attribute,
                                              .attribute_count = 1};
    struct fmt_image_writer *writer = NULL;
    struct bsq_output *output;
    int status;
    snprintf(scale, sizeof scale, "0 to %.6g %s", top, bake_compare_unit(comparison->kind));
    BSQ_TRY(fmt_image_create(ctx, &fmt_png_format, path, &options, &writer));
    BSQ_TRY(write_rows(ctx, comparison, top, writer));
    status = fmt_image_hand_over(writer, &output);
    writer = NULL;
    if (status == 0)
        status = bsq_output_group_add(group, output);
done:
    fmt_image_discard(writer);
    return status;
}
