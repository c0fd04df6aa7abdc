/* map_statistics.c - statistics of the values of a whole map, for the range of its encoding.
 *
 * Sums are kept as Kulisch does ("Computer Arithmetic and Validity", 2008): a float is a whole
 * number of 24 bits times a power of two, so it is added to a long whole number at the place of
 * this power. */
#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "libbake/maps/maps.h"

/* Powers of two that the sums count. */
enum { SUM_UNIT = -149, SQUARE_UNIT = 2 * SUM_UNIT };

/* Digits of the sums: they hold 2^43 floats of any size, and their squares. */
enum { SUM_DIGITS = 5, SQUARE_DIGITS = 10 };

/* Adds number * 2^shift. */
static void statistics_add_shifted(uint64_t *digits, unsigned count, uint64_t number,
                                   unsigned shift)
{
    unsigned __int128 rest = (unsigned __int128)number << shift % 64;
    for (unsigned i = shift / 64; i < count && rest > 0; i++) {
        rest += digits[i];
        digits[i] = (uint64_t)rest;
        rest >>= 64;
    }
}

static void add_digits(uint64_t *to, unsigned count, const uint64_t *more)
{
    for (unsigned i = 0; i < count; i++)
        statistics_add_shifted(to, count, more[i], 64 * i);
}

static double to_double(const uint64_t *digits, unsigned count, int unit)
{
    double value = 0;
    for (unsigned i = count; i-- > 0;)
        value += ldexp((double)digits[i], unit + 64 * (int)i);
    return value;
}

void bake_statistics_add_value(struct bake_statistics *to, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    const uint32_t exponent = bits >> 23 & 255, fraction = bits & 0x7fffff;
    const uint64_t number = exponent > 0 ? fraction | 1u << 23 : fraction;
    const unsigned shift = exponent > 0 ? exponent - 1 : 0;
    to->count++;
    to->largest = fmax(to->largest, fabs((double)value));
    statistics_add_shifted(to->sum, SUM_DIGITS, number, shift);
    statistics_add_shifted(to->squares, SQUARE_DIGITS, number * number, 2 * shift);
}

void bake_statistics_add(struct bake_statistics *to, const struct bake_statistics *more)
{
    to->count += more->count;
    to->largest = fmax(to->largest, more->largest);
    add_digits(to->sum, SUM_DIGITS, more->sum);
    add_digits(to->squares, SQUARE_DIGITS, more->squares);
}

double bake_statistics_mean(const struct bake_statistics *statistics)
{
    const double sum = to_double(statistics->sum, SUM_DIGITS, SUM_UNIT);
    return statistics->count > 0 ? sum / (double)statistics->count : 0;
}

double bake_statistics_mean_square(const struct bake_statistics *statistics)
{
    const double sum = to_double(statistics->squares, SQUARE_DIGITS, SQUARE_UNIT);
    return statistics->count > 0 ? sum / (double)statistics->count : 0;
}

/* ---- measuring ---- */

enum { BAND_ROWS = 256 };

struct measuring {
    struct bsq_ctx *ctx;
    uint32_t width, channels, offset; /* of an image; of the map's value in a texel */
    const float *texels;
    struct bake_statistics *workers; /* one each */
};

static int statistics_measure_row(void *arg, uint64_t row, unsigned worker)
{
    const struct measuring *measuring = arg;
    const float *texel = measuring->texels + row * measuring->width * measuring->channels;
    for (uint32_t x = 0; x < measuring->width; ++x, texel += measuring->channels)
        if (texel[0] > 0.0f)
            bake_statistics_add_value(&measuring->workers[worker], texel[measuring->offset]);
    return 0;
}

static int measure_band(void *arg, uint32_t first_row, uint32_t rows, float *texels)
{
    struct measuring *measuring = arg;
    (void)first_row;
    measuring->texels = texels;
    return bsq_parallel_for(measuring->ctx, rows, statistics_measure_row, measuring);
}

/* Adds the values at an offset in the texels. */
static int measure_values(struct bsq_ctx *ctx, struct bake_image *image, uint32_t offset,
                          struct bake_statistics *out)
{
    struct measuring measuring = {
        .ctx = ctx, .width = image->width, .channels = image->channels, .offset = offset};
    int status = bsq_calloc(ctx, "statistics", bsq_threads(ctx), sizeof *measuring.workers,
                            &measuring.workers);
    if (status == 0)
        status = bake_image_bands(ctx, image, BAND_ROWS, false, measure_band, &measuring);
    for (unsigned w = 0; status == 0 && w < bsq_threads(ctx); w++)
        bake_statistics_add(out, &measuring.workers[w]);
    bsq_free(ctx, measuring.workers);
    return status;
}

int bake_image_measure(struct bsq_ctx *ctx, struct bake_image *image, uint32_t maps,
                       struct bake_statistics statistics[BK_MAP_COUNT])
{
    int status = 0;
    for (unsigned i = 0; status == 0 && i < BK_MAP_COUNT; ++i)
        if (maps & 1u << i && bake_map_table[i].measured)
            status = measure_values(ctx, image, bake_map_offset(maps, i), &statistics[i]);
    return status;
}
