/* compare.c - loads two maps, measures the error texel by texel and sums it up. */
#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "base/srgb.h"
#include "libbake/compare/colour_difference.h"
#include "libbake/compare/comparison.h"

const char *bake_compare_unit(enum bake_compare_kind kind)
{
    static const char *const units[] = {"", "degrees", "dE2000", "difference"};
    return units[kind];
}

/* ---- loading ---- */

static int same_size(struct bsq_ctx *ctx, const char *path, const struct fmt_exr_image *image,
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
    int status = fmt_exr_read(ctx, o->a_path, &c->a);
    if (!status)
        status = fmt_exr_read(ctx, o->b_path, &c->b);
    if (!status)
        status = same_size(ctx, o->a_path, &c->a, o->b_path, &c->b);
    if (!status && o->a_mask_path)
        status = fmt_exr_read(ctx, o->a_mask_path, &c->a_mask);
    if (!status && o->a_mask_path)
        status = same_size(ctx, o->a_mask_path, &c->a_mask, o->a_path, &c->a);
    if (!status && o->b_mask_path)
        status = fmt_exr_read(ctx, o->b_mask_path, &c->b_mask);
    if (!status && o->b_mask_path)
        status = same_size(ctx, o->b_mask_path, &c->b_mask, o->b_path, &c->b);
    return status;
}

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

static void read_rgb(const struct fmt_exr_image *image, const uint32_t rgb[3], uint64_t texel,
                     float out[3])
{
    const float *samples = image->samples + texel * image->channel_count;
    for (int k = 0; k < 3; k++)
        out[k] = samples[rgb[k]];
}

/* Do the reference's values, decoded, have length 1? Colours hardly ever do. */
static bool looks_like_normals(const struct bake_comparison *c)
{
    uint64_t texels = (uint64_t)c->b.width * c->b.height, unit = 0, seen = 0;
    uint64_t step = texels / 65536 + 1;
    for (uint64_t i = 0; i < texels; i += step, seen++) {
        float rgb[3], square = 0;
        read_rgb(&c->b, c->b_rgb, i, rgb);
        for (int k = 0; k < 3; k++)
            square += (2 * rgb[k] - 1) * (2 * rgb[k] - 1);
        unit += fabsf(square - 1) < 0.05f;
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

/* Maps may say what their values are; where they disagree, an error would be a number without
 * meaning. Maps that say nothing are judged by their values alone. */
static int same_meaning(struct bsq_ctx *ctx, const struct bake_compare_options *o,
                        const struct bake_comparison *c)
{
    static const char *const names[] = {"bisque:map", "bisque:normalSpace", "bisque:tangents",
                                        "bisque:green", "bisque:encoding"};
    for (unsigned i = 0; !o->force && i < sizeof names / sizeof *names; i++) {
        const char *a = fmt_exr_image_attribute(&c->a, names[i]);
        const char *b = fmt_exr_image_attribute(&c->b, names[i]);
        if (a && b && strcmp(a, b) != 0)
            return bsq_fail(ctx, BSQ_EDATA,
                            "%s has %s \"%s\", %s has \"%s\": these maps do not compare", o->a_path,
                            names[i], a, o->b_path, b);
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

/* ---- errors ---- */

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

static bool covers(const struct fmt_exr_image *mask, uint64_t texel)
{
    return !mask->samples || mask->samples[texel * mask->channel_count] > 0;
}

static int measure_row(void *arg, uint64_t y, unsigned worker)
{
    (void)worker;
    struct bake_comparison *c = arg;
    for (uint64_t texel = y * c->a.width; texel < (y + 1) * c->a.width; texel++) {
        bool both = covers(&c->a_mask, texel) && covers(&c->b_mask, texel);
        c->errors[texel] = both ? error_at(c, texel) : -1;
    }
    return 0;
}

/* ---- figures ---- */

/* Maps have up to billions of texels: true once in a while, so that an interruption is noticed. */
static bool interrupted(struct bsq_ctx *ctx, uint64_t texel)
{
    return texel % (1 << 20) == 0 && bsq_check(ctx) < 0;
}

/* The value that would stand at `rank` if the values were sorted (Hoare's selection); reorders
 * them. */
static float select_rank(float *values, int64_t count, int64_t rank)
{
    int64_t low = 0, high = count - 1;
    while (low < high) {
        float pivot = values[low + (high - low) / 2];
        int64_t i = low, j = high;
        while (i <= j) {
            while (values[i] < pivot)
                i++;
            while (values[j] > pivot)
                j--;
            if (i > j)
                break;
            float swapped = values[i];
            values[i++] = values[j];
            values[j--] = swapped;
        }
        /* low..j holds values <= pivot, i..high values >= pivot, what lies between equals it. */
        if (rank <= j)
            high = j;
        else if (rank >= i)
            low = i;
        else
            break;
    }
    return values[rank];
}

static float percentile(float *values, uint64_t count, double share)
{
    uint64_t rank = (uint64_t)ceil(share * (double)count);
    return select_rank(values, (int64_t)count, rank > 0 ? (int64_t)rank - 1 : 0);
}

static int find_percentiles(struct bsq_ctx *ctx, const struct bake_comparison *c,
                            struct bake_compare_report *r)
{
    float *values, median = 0, p95 = 0, p99 = 0;
    int status = bsq_alloc(ctx, "sorting errors", r->compared, sizeof *values, &values);
    if (status)
        return status;
    uint64_t texels = (uint64_t)r->width * r->height, count = 0;
    for (uint64_t i = 0; i < texels && !interrupted(ctx, i); i++)
        if (c->errors[i] >= 0)
            values[count++] = c->errors[i];
    float *const figures[] = {&median, &p95, &p99};
    static const double shares[] = {0.5, 0.95, 0.99};
    for (int k = 0; k < 3 && (status = bsq_check(ctx)) == 0; k++)
        *figures[k] = percentile(values, count, shares[k]);
    r->median = median;
    r->p95 = p95;
    r->p99 = p99;
    bsq_free(ctx, values);
    return status;
}

static void sum_errors(struct bsq_ctx *ctx, const struct bake_comparison *c,
                       struct bake_compare_report *r)
{
    double sum = 0, squares = 0, above_1 = 0, above_5 = 0;
    uint64_t texels = (uint64_t)r->width * r->height;
    r->max = -1;
    for (uint64_t i = 0; i < texels && !interrupted(ctx, i); i++) {
        double error = c->errors[i];
        if (error < 0) {
            r->only_a += covers(&c->a_mask, i) && !covers(&c->b_mask, i);
            r->only_b += covers(&c->b_mask, i) && !covers(&c->a_mask, i);
            continue;
        }
        r->compared++;
        sum += error;
        squares += error * error;
        above_1 += error > 1;
        above_5 += error > 5;
        if (error > r->max) {
            r->max = error;
            r->max_x = (uint32_t)(i % r->width);
            r->max_y = (uint32_t)(i / r->width);
        }
    }
    double count = (double)r->compared;
    r->mean = sum / count;
    r->rms = sqrt(squares / count);
    r->above_1 = above_1 / count;
    r->above_5 = above_5 / count;
    r->agreement = count / (count + (double)r->only_a + (double)r->only_b);
}

static void measure_noise(struct bsq_ctx *ctx, const struct bake_comparison *c,
                          struct bake_compare_report *r)
{
    uint64_t texels = (uint64_t)r->width * r->height;
    double squares = 0;
    for (uint64_t i = 0; i < texels && !interrupted(ctx, i); i++) {
        float a[3], b[3];
        if (c->errors[i] < 0)
            continue;
        read_rgb(&c->a, c->a_rgb, i, a);
        read_rgb(&c->b, c->b_rgb, i, b);
        for (int k = 0; k < 3; k++) {
            double d = bsq_linear_to_srgb((double)a[k]) - bsq_linear_to_srgb((double)b[k]);
            squares += d * d;
        }
    }
    r->psnr = -10 * log10(squares / (3 * (double)r->compared));
}

static void measure_relative(struct bsq_ctx *ctx, const struct bake_comparison *c,
                             struct bake_compare_report *r)
{
    uint64_t samples = (uint64_t)r->width * r->height * c->a.channel_count, count = 0;
    for (uint64_t i = 0; i < samples && !interrupted(ctx, i); i++) {
        double a = fabs((double)c->a.samples[i]), b = fabs((double)c->b.samples[i]);
        if (c->errors[i / c->a.channel_count] < 0)
            continue;
        double larger = fmax(a, b), d = fabs((double)c->a.samples[i] - (double)c->b.samples[i]);
        double relative = larger > 0 ? d / larger : 0;
        r->relative_mean += relative;
        r->relative_max = fmax(r->relative_max, relative);
        count++;
    }
    r->relative_mean /= (double)count;
}

static int summarise(struct bsq_ctx *ctx, const struct bake_compare_options *o,
                     const struct bake_comparison *c, struct bake_compare_report *r)
{
    r->kind = c->kind;
    r->width = c->a.width;
    r->height = c->a.height;
    sum_errors(ctx, c, r);
    int status = bsq_check(ctx);
    if (status < 0)
        return status;
    if (r->compared == 0)
        return bsq_fail(ctx, BSQ_EDATA, "no texel is covered by both %s and %s", o->a_path,
                        o->b_path);
    if (isnan(r->mean))
        return bsq_fail(ctx, BSQ_EDATA, "%s or %s holds values that are not numbers", o->a_path,
                        o->b_path);
    if (c->kind == BAKE_COMPARE_COLOR)
        measure_noise(ctx, c, r);
    if (c->kind == BAKE_COMPARE_DATA)
        measure_relative(ctx, c, r);
    status = bsq_check(ctx);
    return status < 0 ? status : find_percentiles(ctx, c, r);
}

int bake_compare(struct bsq_ctx *ctx, const struct bake_compare_options *options,
                 struct bake_compare_report *report)
{
    struct bake_comparison c = {0};
    memset(report, 0, sizeof *report);
    int status = load(ctx, options, &c);
    if (!status)
        status = same_meaning(ctx, options, &c);
    if (!status)
        status = choose_kind(ctx, options, &c);
    if (!status)
        status =
            bsq_alloc(ctx, "errors", (uint64_t)c.a.width * c.a.height, sizeof *c.errors, &c.errors);
    if (!status)
        status = bsq_parallel_for(ctx, c.a.height, measure_row, &c);
    if (!status)
        status = summarise(ctx, options, &c, report);
    double top = options->scale > 0 ? options->scale : report->p99 > 0 ? report->p99 : 1;
    if (!status && options->heatmap_path)
        status = bake_heatmap_write(ctx, &c, top, options->heatmap_path);
    if (!status && options->histogram_path)
        status = bake_histogram_write(ctx, &c, report, top, options->histogram_path);
    bsq_free(ctx, c.errors);
    fmt_exr_image_free(ctx, &c.a), fmt_exr_image_free(ctx, &c.b);
    fmt_exr_image_free(ctx, &c.a_mask), fmt_exr_image_free(ctx, &c.b_mask);
    return status;
}
