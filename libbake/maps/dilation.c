/* dilation.c - exact nearest-texel transform in bands.
 *
 * The transform works on columns first, then rows (Meijster, Roerdink & Hesselink, "A General
 * Algorithm for Computing Distance Transforms in Linear Time", 2000): the nearest valid texel of a
 * column is found by two sweeps, and along a row the columns' candidates form parabolas whose lower
 * envelope is the answer. A candidate's row is added to its squared distance, scaled so that it
 * only decides ties; all arithmetic is on integers.
 *
 * A band needs to know of the rest of the map only the nearest valid texel above it and below it in
 * each column. The one above is carried from band to band; those below are found by a first pass
 * and kept, one row a band, in an image of their own. So no band reads its neighbours again,
 * however large the padding is.
 *
 * In a row only the runs of texels that are not valid need work, and a valid texel at a run's end
 * hides all candidates beyond it. */
#include "libbake/maps/dilation.h"

#include <string.h>

#include "base/parallel.h"

#define NO_SLOT UINT32_MAX

enum { STRIP = 128 }; /* columns that are swept together: whole cache lines, state in L1 */

/* One worker's memory for a row. */
struct scratch {
    uint32_t *site;  /* columns of the envelope's parabolas */
    uint32_t *start; /* first column where each is the lowest */
    const float **sources;
};

/* Candidates of a band are numbered by slot: 0 is the one above the band, 1 + row those inside,
 * row_count + 1 the one below. In carried texels sample 0 holds the row number (1 + row as an
 * integer's bits, 0: none). */
struct bake_padding {
    struct bsq_ctx *ctx;
    const struct bake_image *image;
    uint32_t width, height, channels, band_rows, band_count;
    uint64_t limit;             /* squared distance */
    struct bake_image *carried; /* row b: nearest below band b */
    float *below_buffer, *band_buffer;
    float *above;
    const float *below;
    const float *rows;
    uint32_t *slots; /* row_count x width: nearest candidate in the column */
    uint32_t band;   /* number of the next band */
    uint32_t first_row, row_count;
    struct scratch *scratch;
};

static bool is_valid(const float *texel)
{
    return texel[0] > 0.0f;
}

static uint32_t carried_row(const float *texel)
{
    uint32_t bits;
    memcpy(&bits, texel, sizeof bits);
    return bits;
}

static void carry(const struct bake_padding *padding, float *to, const float *texel, uint32_t row)
{
    uint32_t bits = row + 1;
    memcpy(to, texel, padding->channels * sizeof *to);
    memcpy(to, &bits, sizeof bits);
}

/* ---- what is carried between bands ---- */

static uint32_t strip_count(const struct bake_padding *padding)
{
    return (padding->width - 1) / STRIP + 1;
}

static uint32_t strip_end(const struct bake_padding *padding, uint64_t strip)
{
    uint64_t end = (strip + 1) * STRIP;
    return end < padding->width ? (uint32_t)end : padding->width;
}

/* Replaces the carried texels of a strip by the band's highest valid ones (`up`: going to the band
 * above) or lowest ones. */
static void carry_strip(const struct bake_padding *padding, uint64_t strip, float *carried, bool up)
{
    uint32_t begin = (uint32_t)strip * STRIP, end = strip_end(padding, strip);
    uint32_t left = end - begin;
    bool found[STRIP] = {false};
    for (uint32_t i = 0; i < padding->row_count && left > 0; ++i) {
        uint32_t row = up ? i : padding->row_count - 1 - i;
        const float *texels = padding->rows + (size_t)row * padding->width * padding->channels;
        for (uint32_t x = begin; x < end; ++x) {
            const float *texel = texels + (size_t)x * padding->channels;
            if (!found[x - begin] && is_valid(texel)) {
                found[x - begin] = true;
                --left;
                carry(padding, carried + (size_t)x * padding->channels, texel,
                      padding->first_row + row);
            }
        }
    }
}

static int carry_up(void *arg, uint64_t strip, unsigned worker)
{
    (void)worker;
    struct bake_padding *padding = arg;
    carry_strip(padding, strip, padding->below_buffer, true);
    return 0;
}

static int carry_down(void *arg, uint64_t strip, unsigned worker)
{
    (void)worker;
    struct bake_padding *padding = arg;
    carry_strip(padding, strip, padding->above, false);
    return 0;
}

static int load_band(struct bake_padding *padding, uint32_t band)
{
    padding->first_row = band * padding->band_rows;
    uint32_t left = padding->height - padding->first_row;
    padding->row_count = left < padding->band_rows ? left : padding->band_rows;
    return bake_image_rows(padding->image, padding->first_row, padding->row_count,
                           padding->band_buffer, &padding->rows);
}

/* The first pass, from the lowest band to the highest. */
static int find_below(struct bake_padding *padding)
{
    memset(padding->below_buffer, 0,
           (size_t)padding->width * padding->channels * sizeof *padding->below_buffer);
    for (uint32_t band = padding->band_count; band-- > 0;) {
        int status =
            bake_image_write(padding->carried, 0, band, padding->width, 1, padding->below_buffer);
        if (status < 0)
            return status;
        if (band == 0)
            break; /* nothing is above */
        status = load_band(padding, band);
        if (status < 0)
            return status;
        status = bsq_parallel_for(padding->ctx, strip_count(padding), carry_up, padding);
        if (status < 0)
            return status;
    }
    return 0;
}

/* ---- columns ---- */

/* Row of a candidate. */
static int64_t slot_row(const struct bake_padding *padding, uint32_t column, uint32_t slot)
{
    size_t texel = (size_t)column * padding->channels;
    if (slot == 0)
        return (int64_t)carried_row(padding->above + texel) - 1;
    if (slot == padding->row_count + 1)
        return (int64_t)carried_row(padding->below + texel) - 1;
    return (int64_t)padding->first_row + slot - 1;
}

static int sweep_strip(void *arg, uint64_t strip, unsigned worker)
{
    (void)worker;
    const struct bake_padding *padding = arg;
    uint32_t begin = (uint32_t)strip * STRIP, end = strip_end(padding, strip);
    uint32_t nearest[STRIP];
    for (uint32_t x = begin; x < end; ++x)
        nearest[x - begin] =
            carried_row(padding->above + (size_t)x * padding->channels) ? 0 : NO_SLOT;
    for (uint32_t row = 0; row < padding->row_count; ++row) {
        const float *texels = padding->rows + (size_t)row * padding->width * padding->channels;
        uint32_t *slots = padding->slots + (size_t)row * padding->width;
        for (uint32_t x = begin; x < end; ++x) {
            if (is_valid(texels + (size_t)x * padding->channels))
                nearest[x - begin] = row + 1;
            slots[x] = nearest[x - begin];
        }
    }
    for (uint32_t x = begin; x < end; ++x)
        nearest[x - begin] = carried_row(padding->below + (size_t)x * padding->channels)
                                 ? padding->row_count + 1
                                 : NO_SLOT;
    for (uint32_t row = padding->row_count; row-- > 0;) {
        uint32_t *slots = padding->slots + (size_t)row * padding->width;
        int64_t y = (int64_t)padding->first_row + row;
        for (uint32_t x = begin; x < end; ++x) {
            uint32_t below = nearest[x - begin];
            if (slots[x] == row + 1)
                nearest[x - begin] = row + 1;
            else if (slots[x] == NO_SLOT)
                slots[x] = below;
            else if (below != NO_SLOT &&
                     slot_row(padding, x, below) - y < y - slot_row(padding, x, slots[x]))
                slots[x] = below;
        }
    }
    return 0;
}

/* ---- rows ---- */

struct row {
    const struct bake_padding *padding;
    const uint32_t *slots;
    int64_t y;
    int64_t scale; /* more than any row number */
};

/* Height of a column's parabola: squared distance in the column, ties decided by the row. */
static int64_t parabola(const struct row *row, uint32_t column)
{
    int64_t site = slot_row(row->padding, column, row->slots[column]);
    return row->scale * (site - row->y) * (site - row->y) + site;
}

static int64_t floor_divide(int64_t a, int64_t b)
{
    return a / b - (a % b < 0);
}

/* Last column where the parabola at i is as low as the one at j, i < j. */
static int64_t last_of(int64_t height_i, int64_t i, int64_t height_j, int64_t j, int64_t scale)
{
    return floor_divide(height_j - height_i + scale * (j * j - i * i), 2 * scale * (j - i));
}

/* Builds the lower envelope over columns [begin, end) of candidates in [first, last]; returns the
 * number of parabolas. */
static uint32_t build_envelope(const struct row *row, uint32_t begin, uint32_t end, uint32_t first,
                               uint32_t last, struct scratch *scratch)
{
    uint32_t count = 0;
    for (uint32_t j = first; j <= last; ++j) {
        if (row->slots[j] == NO_SLOT)
            continue;
        int64_t height = parabola(row, j);
        int64_t start = begin;
        while (count > 0) {
            uint32_t i = scratch->site[count - 1];
            start = last_of(parabola(row, i), i, height, j, row->scale) + 1;
            if (start > scratch->start[count - 1])
                break;
            start = begin;
            --count;
        }
        if (start >= end)
            continue;
        scratch->site[count] = j;
        scratch->start[count] = (uint32_t)start;
        ++count;
    }
    return count;
}

static const float *texel_of(const struct bake_padding *padding, uint32_t column, uint32_t slot)
{
    size_t texel = (size_t)column * padding->channels;
    if (slot == 0)
        return padding->above + texel;
    if (slot == padding->row_count + 1)
        return padding->below + texel;
    return padding->rows + (size_t)(slot - 1) * padding->width * padding->channels + texel;
}

/* Finds the sources of the texels [begin, end), none of which is valid, while those on either side
 * are (or are the map's border). */
static void fill_run(const struct row *row, uint32_t begin, uint32_t end, struct scratch *scratch)
{
    const struct bake_padding *padding = row->padding;
    uint32_t first = begin > 0 ? begin - 1 : 0;
    uint32_t last = end < padding->width ? end : padding->width - 1;
    uint32_t count = build_envelope(row, begin, end, first, last, scratch);
    uint32_t q = 0;
    for (uint32_t x = begin; x < end; ++x) {
        scratch->sources[x] = NULL;
        if (count == 0)
            continue;
        while (q + 1 < count && scratch->start[q + 1] <= x)
            ++q;
        uint32_t column = scratch->site[q], slot = row->slots[column];
        int64_t dx = (int64_t)column - x, dy = slot_row(padding, column, slot) - row->y;
        if ((uint64_t)(dx * dx + dy * dy) <= padding->limit)
            scratch->sources[x] = texel_of(padding, column, slot);
    }
}

void bake_padding_row(struct bake_padding *padding, uint32_t number, unsigned worker,
                      const float *const **sources, const float **texels)
{
    struct scratch *scratch = &padding->scratch[worker];
    const struct row row = {.padding = padding,
                            .slots = padding->slots + (size_t)number * padding->width,
                            .y = (int64_t)padding->first_row + number,
                            .scale = padding->height};
    const float *own = padding->rows + (size_t)number * padding->width * padding->channels;
    uint32_t x = 0;
    while (x < padding->width) {
        uint32_t begin = x;
        while (x < padding->width && row.slots[x] != number + 1)
            ++x;
        if (x > begin)
            fill_run(&row, begin, x, scratch);
        for (; x < padding->width && row.slots[x] == number + 1; ++x)
            scratch->sources[x] = own + (size_t)x * padding->channels;
    }
    *sources = scratch->sources;
    *texels = own;
}

/* ---- bands ---- */

int bake_padding_next_band(struct bake_padding *padding, uint32_t *first_row, uint32_t *row_count)
{
    int status = 0;
    *row_count = 0;
    if (padding->band > 0) /* the rows of the band before are still there */
        status = bsq_parallel_for(padding->ctx, strip_count(padding), carry_down, padding);
    if (status < 0 || padding->band == padding->band_count)
        return status;
    status = load_band(padding, padding->band);
    if (status == 0)
        status = bake_image_rows(padding->carried, padding->band, 1, padding->below_buffer,
                                 &padding->below);
    if (status == 0)
        status = bsq_parallel_for(padding->ctx, strip_count(padding), sweep_strip, padding);
    if (status < 0)
        return status;
    ++padding->band;
    *first_row = padding->first_row;
    *row_count = padding->row_count;
    return 0;
}

uint64_t bake_padding_row_bytes(const struct bake_image *image)
{
    uint64_t texel_bytes = sizeof(uint32_t);
    if (!bake_image_in_memory(image))
        texel_bytes += bake_image_channels(image) * sizeof(float);
    return texel_bytes * bake_image_width(image);
}

static int allocate(struct bake_padding *padding, const char *beside)
{
    struct bsq_ctx *ctx = padding->ctx;
    unsigned workers = bsq_threads(ctx);
    uint64_t row_bytes = (uint64_t)padding->width * padding->channels * sizeof(float);
    bool in_memory = bake_image_in_memory(padding->image);
    struct bake_image_options carried = {.width = padding->width,
                                         .height = padding->band_count,
                                         .channels = padding->channels,
                                         .memory_bytes = in_memory ? UINT64_MAX : 0,
                                         .beside = beside};
    int status = bake_image_create(ctx, &carried, &padding->carried);
    if (status == 0)
        status = bsq_alloc(ctx, "padding", 1, row_bytes, &padding->below_buffer);
    if (status == 0)
        status = bsq_calloc(ctx, "padding", 1, row_bytes, &padding->above);
    if (status == 0 && !in_memory)
        status =
            bsq_alloc(ctx, "band of the map", padding->band_rows, row_bytes, &padding->band_buffer);
    if (status == 0)
        status = bsq_alloc(ctx, "padding", (uint64_t)padding->band_rows * padding->width,
                           sizeof *padding->slots, &padding->slots);
    if (status == 0)
        status = bsq_calloc(ctx, "padding", workers, sizeof *padding->scratch, &padding->scratch);
    for (unsigned w = 0; status == 0 && w < workers; ++w) {
        struct scratch *scratch = &padding->scratch[w];
        status = bsq_alloc(ctx, "padding", padding->width, sizeof *scratch->site, &scratch->site);
        if (status == 0)
            status =
                bsq_alloc(ctx, "padding", padding->width, sizeof *scratch->start, &scratch->start);
        if (status == 0)
            status = bsq_alloc(ctx, "padding", padding->width, sizeof *scratch->sources,
                               &scratch->sources);
    }
    return status;
}

int bake_padding_create(struct bsq_ctx *ctx, const struct bake_image *image, uint32_t band_rows,
                        uint32_t distance, const char *beside, struct bake_padding **out)
{
    *out = NULL;
    struct bake_padding *padding;
    int status = bsq_calloc(ctx, "padding", 1, sizeof *padding, &padding);
    if (status < 0)
        return status;
    padding->ctx = ctx;
    padding->image = image;
    padding->width = bake_image_width(image);
    padding->height = bake_image_height(image);
    padding->channels = bake_image_channels(image);
    padding->band_rows = band_rows < padding->height ? band_rows : padding->height;
    padding->band_count = (padding->height - 1) / padding->band_rows + 1;
    padding->limit = distance == UINT32_MAX ? UINT64_MAX : (uint64_t)distance * distance;
    status = allocate(padding, beside);
    if (status == 0)
        status = find_below(padding);
    if (status < 0)
        bake_padding_free(padding);
    else
        *out = padding;
    return status;
}

void bake_padding_free(struct bake_padding *padding)
{
    if (!padding)
        return;
    struct bsq_ctx *ctx = padding->ctx;
    for (unsigned w = 0; padding->scratch && w < bsq_threads(ctx); ++w) {
        bsq_free(ctx, padding->scratch[w].site);
        bsq_free(ctx, padding->scratch[w].start);
        bsq_free(ctx, (void *)padding->scratch[w].sources);
    }
    bsq_free(ctx, padding->scratch);
    bsq_free(ctx, padding->slots);
    bsq_free(ctx, padding->band_buffer);
    bsq_free(ctx, padding->above);
    bsq_free(ctx, padding->below_buffer);
    bake_image_free(padding->carried);
    bsq_free(ctx, padding);
}
