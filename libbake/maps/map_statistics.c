/* map_statistics.c - statistics of the values of a whole map, for the range of its encoding.
 *
 * Floating-point sums depend on their order. So each row is summed alone, and the sums of the rows
 * are added from top to bottom, whatever the number of threads and of rows that are read at a time.
 */
#include <math.h>

#include "base/parallel.h"
#include "libbake/maps/maps.h"

enum { BAND_ROWS = 256 };

struct band {
    uint32_t width, channels, place;
    const float *texels;
    struct bake_statistics rows[BAND_ROWS];
};

static int measure_row(void *arg, uint64_t row, unsigned worker)
{
    (void)worker;
    struct band *band = arg;
    const float *texel = band->texels + row * band->width * band->channels;
    struct bake_statistics sums = {0};
    for (uint32_t x = 0; x < band->width; ++x, texel += band->channels) {
        if (!(texel[0] > 0.0f))
            continue;
        const double magnitude = fabs((double)texel[band->place]);
        ++sums.count;
        sums.largest = fmax(sums.largest, magnitude);
        sums.sum += magnitude;
        sums.squares += magnitude * magnitude;
    }
    band->rows[row] = sums;
    return 0;
}

static void add_rows(const struct band *band, uint32_t rows, struct bake_statistics *out)
{
    for (uint32_t row = 0; row < rows; ++row) {
        out->count += band->rows[row].count;
        out->largest = fmax(out->largest, band->rows[row].largest);
        out->sum += band->rows[row].sum;
        out->squares += band->rows[row].squares;
    }
}

/* Returns the rows that are read at a time: from a quarter of what is left of the budget. */
static uint32_t choose_rows(struct bsq_ctx *ctx, uint64_t row_bytes)
{
    const uint64_t rows = bsq_memory_share(ctx, "rows that are measured", 4) / row_bytes;
    return rows < 1 ? 1 : rows < BAND_ROWS ? (uint32_t)rows : BAND_ROWS;
}

/* Adds the values at this place of the texels. */
static int measure_values(struct bsq_ctx *ctx, const struct bake_image *image, uint32_t place,
                          struct bake_statistics *statistics)
{
    struct band band = {
        .width = bake_image_width(image), .channels = bake_image_channels(image), .place = place};
    const uint64_t row_bytes = (uint64_t)band.width * band.channels * sizeof(float);
    const uint32_t step = choose_rows(ctx, row_bytes), height = bake_image_height(image);
    float *buffer = NULL;
    int status = 0;
    if (!bake_image_in_memory(image))
        status = bsq_alloc(ctx, "rows of the map", step, row_bytes, &buffer);
    for (uint32_t y = 0; status == 0 && y < height; y += step) {
        const uint32_t rows = height - y < step ? height - y : step;
        status = bake_image_rows(image, y, rows, buffer, &band.texels);
        if (status == 0)
            status = bsq_parallel_for(ctx, rows, measure_row, &band);
        if (status == 0)
            add_rows(&band, rows, statistics);
    }
    bsq_free(ctx, buffer);
    return status;
}

int bake_image_measure(struct bsq_ctx *ctx, const struct bake_image *image, uint32_t maps,
                       struct bake_statistics statistics[BK_MAP_COUNT])
{
    int status = 0;
    for (unsigned i = 0; status == 0 && i < BK_MAP_COUNT; ++i)
        if (maps & 1u << i && bake_map_table[i].measured)
            status = measure_values(ctx, image, bake_place_of(maps, i), &statistics[i]);
    return status;
}
