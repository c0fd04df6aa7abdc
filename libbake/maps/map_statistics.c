/* map_statistics.c - statistics of the values of a whole map, for the range of its encoding.
 *
 * Each row has sums of its own, which are added in the order of the rows. So they do not depend on
 * the number of threads. */
#include <math.h>

#include "base/parallel.h"
#include "libbake/maps/maps.h"

enum { BAND_ROWS = 256 };

struct measuring {
    struct bsq_ctx *ctx;
    uint32_t width, channels, offset; /* of an image; of the map's value in a texel */
    const float *texels;
    struct bake_statistics *all, rows[BAND_ROWS];
};

void bake_statistics_add_value(struct bake_statistics *to, float value)
{
    const double magnitude = fabs((double)value);
    to->count++;
    to->largest = fmax(to->largest, magnitude);
    to->sum += magnitude;
    to->squares += magnitude * magnitude;
}

double bake_statistics_mean(const struct bake_statistics *statistics)
{
    return statistics->count > 0 ? statistics->sum / (double)statistics->count : 0;
}

double bake_statistics_mean_square(const struct bake_statistics *statistics)
{
    return statistics->count > 0 ? statistics->squares / (double)statistics->count : 0;
}

static int statistics_measure_row(void *arg, uint64_t row, unsigned worker)
{
    struct measuring *measuring = arg;
    struct bake_statistics statistics = {0};
    const float *texel = measuring->texels + row * measuring->width * measuring->channels;
    (void)worker;
    for (uint32_t x = 0; x < measuring->width; ++x, texel += measuring->channels)
        if (texel[0] > 0.0f)
            bake_statistics_add_value(&statistics, texel[measuring->offset]);
    measuring->rows[row] = statistics;
    return 0;
}

static int measure_band(void *arg, uint32_t first_row, uint32_t rows, float *texels)
{
    struct measuring *measuring = arg;
    struct bake_statistics *all = measuring->all;
    (void)first_row;
    measuring->texels = texels;
    const int status = bsq_parallel_for(measuring->ctx, rows, statistics_measure_row, measuring);
    for (uint32_t i = 0; status == 0 && i < rows; i++) {
        all->count += measuring->rows[i].count;
        all->largest = fmax(all->largest, measuring->rows[i].largest);
        all->sum += measuring->rows[i].sum;
        all->squares += measuring->rows[i].squares;
    }
    return status;
}

/* Adds the values at an offset in the texels. */
static int measure_values(struct bsq_ctx *ctx, struct bake_image *image, uint32_t offset,
                          struct bake_statistics *out)
{
    struct measuring measuring = {.ctx = ctx,
                                  .width = image->width,
                                  .channels = image->channels,
                                  .offset = offset,
                                  .all = out};
    return bake_image_bands(ctx, image, BAND_ROWS, false, measure_band, &measuring);
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
