/* error_statistics.c - the figures of a comparison: coverage, mean, percentiles, PSNR.
 *
 * Sums run over the texels in order on one thread, so that they do not depend on the number of
 * threads. */
#include <math.h>

#include "base/srgb.h"
#include "libbake/compare/comparison.h"

/* Checks for an interruption, once every 2^20 texels: maps have up to billions of them. */
static bool interrupted(struct bsq_ctx *ctx, uint64_t texel)
{
    return texel % (1 << 20) == 0 && bsq_check(ctx) < 0;
}

/* Returns the value that would stand at index `rank` if the values were sorted. Reorders them.
 * Linear on average (Hoare, "Algorithm 65: Find", 1961). */
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
        /* Values low..j are <= pivot, values i..high are >= pivot, those between equal it. */
        if (rank <= j)
            high = j;
        else if (rank >= i)
            low = i;
        else
            break;
    }
    return values[rank];
}

/* Returns the percentile of this share by nearest rank. Reorders the values. */
static float percentile(float *values, uint64_t count, double share)
{
    uint64_t rank = (uint64_t)ceil(share * (double)count);
    return select_rank(values, (int64_t)count, rank > 0 ? (int64_t)rank - 1 : 0);
}

static int find_percentiles(struct bsq_ctx *ctx, const struct bake_comparison *c,
                            struct bake_compare_report *r)
{
    float *values, median = 0, p95 = 0, p99 = 0;
    int status = BSQ_ALLOC(ctx, "sorting errors", r->compared, &values);
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

/* Counts a texel that has no error. */
static void count_not_compared(const struct bake_comparison *c, uint64_t texel,
                               struct bake_compare_report *r)
{
    if (!isnan(c->errors[texel])) {
        r->only_a += covers(&c->a_mask, texel) && !covers(&c->b_mask, texel);
        r->only_b += covers(&c->b_mask, texel) && !covers(&c->a_mask, texel);
        return;
    }
    r->not_finite++;
    r->not_finite_a += !is_finite(&c->a, &c->a_mask, texel);
    r->not_finite_b += !is_finite(&c->b, &c->b_mask, texel);
}

/* Fills in all figures of the error but the percentiles, and the coverage. */
static void sum_errors(struct bsq_ctx *ctx, const struct bake_comparison *c,
                       struct bake_compare_report *r)
{
    double sum = 0, squares = 0, above_1 = 0, above_5 = 0;
    uint64_t texels = (uint64_t)r->width * r->height;
    r->max = -1;
    for (uint64_t i = 0; i < texels && !interrupted(ctx, i); i++) {
        double error = c->errors[i];
        if (!(error >= 0)) {
            count_not_compared(c, i, r);
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
    double both = count + (double)r->not_finite;
    r->agreement = both / (both + (double)r->only_a + (double)r->only_b);
}

/* Computes the PSNR. */
static void measure_noise(struct bsq_ctx *ctx, const struct bake_comparison *c,
                          struct bake_compare_report *r)
{
    uint64_t texels = (uint64_t)r->width * r->height;
    double squares = 0;
    for (uint64_t i = 0; i < texels && !interrupted(ctx, i); i++) {
        float a[3], b[3];
        if (!(c->errors[i] >= 0))
            continue;
        read_rgb(c, i, a, b);
        for (int k = 0; k < 3; k++) {
            double d = bsq_linear_to_srgb((double)a[k]) - bsq_linear_to_srgb((double)b[k]);
            squares += d * d;
        }
    }
    r->psnr = -10 * log10(squares / (3 * (double)r->compared));
}

/* Computes the relative differences. */
static void measure_relative(struct bsq_ctx *ctx, const struct bake_comparison *c,
                             struct bake_compare_report *r)
{
    uint64_t texels = (uint64_t)r->width * r->height, count = 0;
    for (uint64_t i = 0; i < texels && !interrupted(ctx, i); i++)
        for (uint32_t k = 0; k < c->pair_count && c->errors[i] >= 0; k++, count++) {
            double a = (double)c->a.samples[i * c->a.channel_count + c->pairs[k][0]];
            double b = (double)c->b.samples[i * c->b.channel_count + c->pairs[k][1]];
            double larger = fmax(fabs(a), fabs(b)), d = fabs(a - b);
            double relative = larger > 0 ? d / larger : 0;
            r->relative_mean += relative;
            r->relative_max = fmax(r->relative_max, relative);
        }
    r->relative_mean /= (double)count;
}

/* Sets the figures of maps without a texel that is finite in both. */
static void set_infinite(struct bake_compare_report *r)
{
    r->mean = r->rms = r->median = r->p95 = r->p99 = r->max = INFINITY;
    r->above_1 = r->above_5 = 1;
    r->psnr = -INFINITY;
    r->relative_mean = r->relative_max = INFINITY;
}

int bake_comparison_summarise(struct bsq_ctx *ctx, const struct bake_compare_options *o,
                              const struct bake_comparison *c, struct bake_compare_report *r)
{
    r->kind = c->kind;
    r->width = c->a.width;
    r->height = c->a.height;
    sum_errors(ctx, c, r);
    BSQ_PASS(bsq_check(ctx));
    if (r->compared == 0 && (r->not_finite == 0 || o->ignore_nan))
        return bsq_fail(ctx, BSQ_EDATA, "no texel is covered by both %s and %s%s", o->a_path,
                        o->b_path, r->not_finite > 0 ? " and finite in both" : "");
    if (r->compared == 0) {
        set_infinite(r);
        return 0;
    }
    if (c->kind == BAKE_COMPARE_COLOR)
        measure_noise(ctx, c, r);
    if (c->kind == BAKE_COMPARE_DATA)
        measure_relative(ctx, c, r);
    BSQ_PASS(bsq_check(ctx));
    return find_percentiles(ctx, c, r);
}
