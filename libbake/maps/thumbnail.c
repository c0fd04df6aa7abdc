/* thumbnail.c - box-filtered copies of maps, summed while the rows of the maps are written, and of
 * the texels without a hit. */
#include "libbake/maps/maps.h"

#include "base/parallel.h"

uint32_t bake_thumbnail_side(uint32_t most, uint64_t bytes)
{
    while (most > 1 && (uint64_t)most * most * 3 * sizeof(float) > bytes)
        most /= 2;
    return most;
}

int bake_thumbnail_create(struct bsq_ctx *ctx, uint32_t full_width, uint32_t full_height,
                          uint32_t side, struct bake_thumbnail *out)
{
    uint32_t longest = full_width > full_height ? full_width : full_height;
    *out = (struct bake_thumbnail){.full_width = full_width, .full_height = full_height};
    out->factor = (longest - 1) / side + 1;
    out->width = (full_width - 1) / out->factor + 1;
    out->height = (full_height - 1) / out->factor + 1;
    return BSQ_CALLOC(ctx, "texture of the preview", (uint64_t)out->width * out->height,
                      &out->texels);
}

void bake_thumbnail_free(struct bsq_ctx *ctx, struct bake_thumbnail *thumbnail)
{
    bsq_free(ctx, thumbnail->texels);
    thumbnail->texels = NULL;
}

struct addition {
    struct bsq_ctx *ctx;
    struct bake_thumbnail *thumbnail;
    bool missed; /* the samples are texels of an image whose misses are shown */
    uint32_t channels;
    uint32_t first_row, rows;
    const float *samples;
};

/* Returns how many of the map's texels a cell has along a side; the last cell may have fewer. */
static uint32_t texels_in(uint32_t cell, uint32_t factor, uint32_t full)
{
    uint32_t left = full - cell * factor;
    return left < factor ? left : factor;
}

/* Adds to one row of the thumbnail all given rows that belong to it. */
static int add_row(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct addition *addition = arg;
    struct bake_thumbnail *thumbnail = addition->thumbnail;
    uint32_t factor = thumbnail->factor;
    uint32_t cell_y = addition->first_row / factor + (uint32_t)index;
    uint32_t begin = cell_y * factor, end = begin + factor;
    if (begin < addition->first_row)
        begin = addition->first_row;
    if (end > addition->first_row + addition->rows)
        end = addition->first_row + addition->rows;
    const int last = addition->missed || addition->channels >= 3 ? 2 : 0;
    uint32_t cell_rows = texels_in(cell_y, factor, thumbnail->full_height);
    for (uint32_t y = begin; y < end; ++y) {
        const float *in = addition->samples + (size_t)(y - addition->first_row) *
                                                  thumbnail->full_width * addition->channels;
        float(*out)[3] = thumbnail->texels + (size_t)cell_y * thumbnail->width;
        for (uint32_t cell_x = 0; cell_x < thumbnail->width; ++cell_x) {
            uint32_t columns = texels_in(cell_x, factor, thumbnail->full_width);
            float weight = 1.0f / ((float)columns * (float)cell_rows);
            for (uint32_t x = 0; x < columns; ++x, in += addition->channels) {
                const float marks[3] = {in[0] == BAKE_MISSED, in[0] > BAKE_OUTSIDE, 0.0f};
                const float *samples = addition->missed ? marks : in;
                for (int c = 0; c < 3; ++c)
                    out[cell_x][c] += weight * samples[c < last ? c : last];
            }
        }
    }
    return 0;
}

static int add_rows(void *arg, uint32_t first_row, uint32_t rows, float *samples)
{
    struct addition *addition = arg;
    uint32_t first = first_row / addition->thumbnail->factor;
    uint32_t last = (first_row + rows - 1) / addition->thumbnail->factor;
    addition->first_row = first_row;
    addition->rows = rows;
    addition->samples = samples;
    return bsq_parallel_for(addition->ctx, last - first + 1, add_row, addition);
}

int bake_thumbnail_add(struct bsq_ctx *ctx, struct bake_thumbnail *thumbnail, uint32_t channels,
                       uint32_t first_row, uint32_t rows, const float *samples)
{
    struct addition addition = {.ctx = ctx, .thumbnail = thumbnail, .channels = channels};
    return add_rows(&addition, first_row, rows, (float *)(uintptr_t)samples);
}

int bake_thumbnail_of_missed(struct bsq_ctx *ctx, struct bake_image *image, uint32_t side,
                             struct bake_thumbnail *out)
{
    struct addition addition = {
        .ctx = ctx, .thumbnail = out, .missed = true, .channels = image->channels};
    BSQ_PASS(bake_thumbnail_create(ctx, image->width, image->height, side, out));
    return bake_image_bands(ctx, image, 256, false, add_rows, &addition);
}

/* ---- sampling ---- */

/* Finds the two cells around a coordinate and the weight of the second; clamped. */
static void thumbnail_split(float at, uint32_t size, uint32_t cells[2], float *share)
{
    float limit = (float)(size - 1);
    at = at > 0.0f ? (at < limit ? at : limit) : 0.0f;
    cells[0] = (uint32_t)at;
    cells[1] = cells[0] + 1 < size ? cells[0] + 1 : cells[0];
    *share = at - (float)cells[0];
}

void bake_thumbnail_sample(const struct bake_thumbnail *thumbnail, float u, float v, float out[3])
{
    /* The last cells may have fewer texels, so the scale is that of whole cells. */
    float x = u * (float)thumbnail->full_width / (float)thumbnail->factor - 0.5f;
    float y = (1.0f - v) * (float)thumbnail->full_height / (float)thumbnail->factor - 0.5f;
    uint32_t columns[2], rows[2];
    float sx, sy;
    thumbnail_split(x, thumbnail->width, columns, &sx);
    thumbnail_split(y, thumbnail->height, rows, &sy);
    float(*top)[3] = thumbnail->texels + (size_t)rows[0] * thumbnail->width;
    float(*bottom)[3] = thumbnail->texels + (size_t)rows[1] * thumbnail->width;
    for (int c = 0; c < 3; ++c) {
        float above = top[columns[0]][c] + sx * (top[columns[1]][c] - top[columns[0]][c]);
        float below = bottom[columns[0]][c] + sx * (bottom[columns[1]][c] - bottom[columns[0]][c]);
        out[c] = above + sy * (below - above);
    }
}
