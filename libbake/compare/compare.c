/* compare.c - loads two maps, checks that they can be compared, and measures the error of each
 * texel. */
#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "libbake/compare/comparison.h"

const char *bake_compare_unit(enum bake_compare_kind kind)
{
    static const char *const units[] = {"", "degrees", "dE2000", "difference"};
    return units[kind];
}

/* ---- inputs ---- */

static int check_same_size(struct bsq_ctx *ctx, const char *path, const struct fmt_exr_image *image,
                           const char *other_path, const struct fmt_exr_image *other)
{
    if (image->width == other->width && image->height == other->height)
        return 0;
    return bsq_fail(ctx, BSQ_EDATA, "%s has %u x %u texels, %s has %u x %u", path, image->width,
                    image->height, other_path, other->width, other->height);
}

static int load(struct bsq_ctx *ctx, const struct bake_compare_options *o,
                struct bake_comparison *c)
{
    int status = 0;
    BSQ_TRY(fmt_exr_read(ctx, o->a_path, &c->a));
    BSQ_TRY(fmt_exr_read(ctx, o->b_path, &c->b));
    BSQ_TRY(check_same_size(ctx, o->a_path, &c->a, o->b_path, &c->b));
    if (o->a_mask_path) {
        BSQ_TRY(fmt_exr_read(ctx, o->a_mask_path, &c->a_mask));
        BSQ_TRY(check_same_size(ctx, o->a_mask_path, &c->a_mask, o->a_path, &c->a));
    }
    if (o->b_mask_path) {
        BSQ_TRY(fmt_exr_read(ctx, o->b_mask_path, &c->b_mask));
        BSQ_TRY(check_same_size(ctx, o->b_mask_path, &c->b_mask, o->b_path, &c->b));
    }
done:
    return status;
}

/* Sets rgb[] to the channels R, G and B, and returns whether there are all three. */
static bool find_rgb(const struct fmt_exr_image *image, uint32_t rgb[3])
{
    static const char *const names[] = {"R", "G", "B"};
    bool all = true;
    for (int k = 0; k < 3; k++) {
        rgb[k] = fmt_exr_channel(image, names[k]);
        all = all && rgb[k] != UINT32_MAX;
    }
    return all;
}

static bool same_channels(const struct fmt_exr_image *a, const struct fmt_exr_image *b)
{
    if (a->channel_count != b->channel_count)
        return false;
    for (uint32_t k = 0; k < a->channel_count; k++)
        if (strcmp(a->channels[k], b->channels[k]) != 0)
            return false;
    return true;
}

/* Checks whether nine in ten of the reference's values, decoded, have length 1. Colours hardly ever
 * do. Looks at about 65536 texels. */
static bool looks_like_normals(const struct bake_comparison *c)
{
    uint64_t texels = (uint64_t)c->b.width * c->b.height, unit = 0, seen = 0;
    uint64_t step = texels / 65536 + 1;
    for (uint64_t i = 0; i < texels; i += step) {
        float rgb[3], square = 0;
        read_rgb(&c->b, c->b_rgb, i, rgb);
        for (int k = 0; k < 3; k++)
            square += (2 * rgb[k] - 1) * (2 * rgb[k] - 1);
        unit += fabsf(square - 1) < 0.05f;
        seen += isfinite(square) != 0;
    }
    return unit * 10 > seen * 9;
}

static enum bake_compare_kind kind_of_map(const struct bake_comparison *c, bool rgb)
{
    const char *map = fmt_exr_image_attribute(&c->b, "bisque:map");
    if (map && rgb && strcmp(map, "normal") == 0)
        return BAKE_COMPARE_NORMAL;
    if (map && rgb && strcmp(map, "color") == 0)
        return BAKE_COMPARE_COLOR;
    if (map || !rgb)
        return BAKE_COMPARE_DATA;
    return looks_like_normals(c) ? BAKE_COMPARE_NORMAL : BAKE_COMPARE_COLOR;
}

/* Refuses maps whose attributes say that their values mean different things: the error would mean
 * nothing. Attributes that only one of the maps has are not checked. */
static int check_same_meaning(struct bsq_ctx *ctx, const struct bake_compare_options *o,
                              const struct bake_comparison *c)
{
    static const char *const names[] = {"bisque:map",   "bisque:normalSpace", "bisque:tangents",
                                        "bisque:green", "bisque:encoding",    "bisque:unit",
                                        "bisque:origin"};
    for (unsigned i = 0; !o->force && i < sizeof names / sizeof *names; i++) {
        const char *a = fmt_exr_image_attribute(&c->a, names[i]);
        const char *b = fmt_exr_image_attribute(&c->b, names[i]);
        if (a && b && strcmp(a, b) != 0)
            return bsq_fail(ctx, BSQ_EDATA,
                            "%s has %s \"%s\", %s has \"%s\": these maps cannot be compared",
                            o->a_path, names[i], a, o->b_path, b);
    }
    return 0;
}

static int choose_kind(struct bsq_ctx *ctx, const struct bake_compare_options *o,
                       struct bake_comparison *c)
{
    bool a_rgb = find_rgb(&c->a, c->a_rgb), b_rgb = find_rgb(&c->b, c->b_rgb);
    c->kind = o->kind == BAKE_COMPARE_AUTO ? kind_of_map(c, a_rgb && b_rgb) : o->kind;
    if (c->kind != BAKE_COMPARE_DATA && !(a_rgb && b_rgb))
        return bsq_fail(ctx, BSQ_EDATA, "%s has no channels R, G and B",
                        a_rgb ? o->b_path : o->a_path);
    if (c->kind == BAKE_COMPARE_DATA && !same_channels(&c->a, &c->b))
        return bsq_fail(ctx, BSQ_EDATA, "%s and %s have different channels", o->a_path, o->b_path);
    return 0;
}

/* ---- the error of a texel ---- */

/* Returns the angle in degrees between two encoded normals. The arc tangent is accurate for small
 * angles, unlike the arc cosine of the dot product. */
static float angle_between(const float a[3], const float b[3])
{
    double n[3], m[3], cross = 0, dot = 0;
    for (int k = 0; k < 3; k++) {
        n[k] = 2 * (double)a[k] - 1;
        m[k] = 2 * (double)b[k] - 1;
        dot += n[k] * m[k];
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        double x = n[j] * m[k] - n[k] * m[j];
        cross += x * x;
    }
    return (float)(atan2(sqrt(cross), dot) * 57.295779513082320877);
}

static float colour_difference(const float a[3], const float b[3])
{
    double lab_a[3], lab_b[3];
    bake_lab(a, lab_a);
    bake_lab(b, lab_b);
    return (float)bake_ciede2000(lab_a, lab_b);
}

static float largest_difference(const struct bake_comparison *c, uint64_t texel)
{
    uint32_t count = c->a.channel_count;
    float largest = 0;
    for (uint32_t k = 0; k < count; k++) {
        float d = fabsf(c->a.samples[texel * count + k] - c->b.samples[texel * count + k]);
        largest = d > largest ? d : largest;
    }
    return largest;
}

static float error_at(const struct bake_comparison *c, uint64_t texel)
{
    float a[3], b[3];
    if (c->kind == BAKE_COMPARE_DATA)
        return largest_difference(c, texel);
    read_rgb(&c->a, c->a_rgb, texel, a);
    read_rgb(&c->b, c->b_rgb, texel, b);
    return c->kind == BAKE_COMPARE_NORMAL ? angle_between(a, b) : colour_difference(a, b);
}

static int measure_row(void *arg, uint64_t y, unsigned worker)
{
    (void)worker;
    struct bake_comparison *c = arg;
    for (uint64_t texel = y * c->a.width; texel < (y + 1) * c->a.width; texel++) {
        if (!covers(&c->a_mask, texel) || !covers(&c->b_mask, texel))
            c->errors[texel] = BAKE_NOT_COVERED;
        else if (!is_finite(&c->a, &c->a_mask, texel) || !is_finite(&c->b, &c->b_mask, texel))
            c->errors[texel] = NAN;
        else
            c->errors[texel] = error_at(c, texel);
    }
    return 0;
}

/* ---- all ---- */

int bake_compare(struct bsq_ctx *ctx, const struct bake_compare_options *options,
                 struct bake_compare_report *report)
{
    struct bake_comparison c = {0};
    struct bsq_output_group pictures = {0};
    memset(report, 0, sizeof *report);
    int status = 0;
    BSQ_TRY(load(ctx, options, &c));
    BSQ_TRY(check_same_meaning(ctx, options, &c));
    BSQ_TRY(choose_kind(ctx, options, &c));
    BSQ_TRY(
        bsq_alloc(ctx, "errors", (uint64_t)c.a.width * c.a.height, sizeof *c.errors, &c.errors));
    BSQ_TRY(bsq_parallel_for(ctx, c.a.height, measure_row, &c));
    BSQ_TRY(bake_comparison_summarise(ctx, options, &c, report));
    double top = options->scale > 0                         ? options->scale
                 : report->p99 > 0 && isfinite(report->p99) ? report->p99
                                                            : 1;
    if (options->heatmap_path)
        BSQ_TRY(bake_heatmap_write(ctx, &c, top, options->heatmap_path, &pictures));
    if (options->histogram_path)
        BSQ_TRY(bake_histogram_write(ctx, &c, report, top, options->histogram_path, &pictures));
    BSQ_TRY(bsq_output_group_commit(&pictures));
done:
    bsq_output_group_discard(&pictures);
    bsq_free(ctx, c.errors);
    fmt_exr_image_free(ctx, &c.a), fmt_exr_image_free(ctx, &c.b);
    fmt_exr_image_free(ctx, &c.a_mask), fmt_exr_image_free(ctx, &c.b_mask);
    return status;
}
