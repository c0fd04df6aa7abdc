/* dilation.c - exact nearest-texel transform in bands.
 *
 * The transform works on columns first, then on rows (Meijster, Roerdink & Hesselink, "A General
 * Algorithm for Computing Distance Transforms in Linear Time", 2000). Two sweeps find the nearest
 * valid texel in each column. Along a row these candidates form parabolas, and the lower envelope
 * of the parabolas gives the nearest texel. Squared distances are scaled and the candidate's row is
 * added, so that the row only decides ties. All arithmetic is on integers.
 *
 * Of the rest of the map, a band needs only the nearest valid texel above it and below it in each
 * column. Those above are carried from band to band. Those below are found by a first pass, which
 * keeps one row for each band in an image of its own. So no band reads its neighbours again,
 * however large the padding is.
 *
 * Only runs of texels that are not valid need work. A valid texel at the end of a run hides all
 * candidates beyond it. */
#include "libbake/maps/dilation.h"

#include <string.h>

#include "base/parallel.h"

#define NO_SLOT UINT32_MAX

enum { STRIP = 128 }; /* columns that are swept together: whole cache lines, state in L1 */

/* One worker's memory for a row. */
struct scratch {
    uint32_t *site;  /* columns of the envelope's parabolas */
    uint32_t *start; /* first column of each in the envelope */
    const float **sources;
};

/* The candidates of a column have slot numbers: 0 is the texel above the band, 1 + row a texel of
 * the band, row_count + 1 the texel below the band. Sample 0 of a carried texel holds the bits of
 * an integer: 1 + its row in the map, or 0 if there is no valid texel. */
struct bake_dilation {
    struct bsq_ctx *ctx;
    const struct bake_image *image;
    uint32_t width, height, channels, band_rows, band_count;
    uint64_t limit;             /* largest squared distance of a source */
    struct bake_image *carried; /* row b: for each column the nearest texel below band b */
    float *below_buffer, *band_buffer;
    float *above;       /* for each column the nearest texel above the band */
    const float *below; /* for each column the nearest texel below the band */
    const float *rows;  /* texels of the current band */
    uint32_t *slots;    /* row_count x width: nearest candidate in the column */
    uint32_t band;      /* number of the next band */
    uint32_t first_row, row_count;
    struct scratch *scratch;
};

static bool dilation_is_valid(const float *texel)
{
    return texel[0] > 0.0f;
}

static uint32_t carried_row(const float *texel)
{
    uint32_t bits;
    memcpy(&bits, texel, sizeof bits);
    return bits;
}

static void carry(const struct bake_dilation *dilation, float *to, const float *texel, uint32_t row)
{
    uint32_t bits = row + 1;
    memcpy(to, texel, dilation->channels * sizeof *to);
    memcpy(to, &bits, sizeof bits);
}

/* ---- texels carried between bands ---- */

static uint32_t strip_count(const struct bake_dilation *dilation)
{
    return (dilation->width - 1) / STRIP + 1;
}

static uint32_t strip_end(const struct bake_dilation *dilation, uint64_t strip)
{
    uint64_t end = (strip + 1) * STRIP;
    return end < dilation->width ? (uint32_t)end : dilation->width;
}

/* Replaces the carried texels of a strip by valid texels of the band: by the highest of each column
 * if `up`, for the band above, otherwise by the lowest. Keeps those of columns without any. */
static void carry_strip(const struct bake_dilation *dilation, uint64_t strip, float *carried,
                        bool up)
{
    uint32_t begin = (uint32_t)strip * STRIP, end = strip_end(dilation, strip);
    uint32_t left = end - begin;
    bool found[STRIP] = {false};
    for (uint32_t i = 0; i < dilation->row_count && left > 0; ++i) {
        uint32_t row = up ? i : dilation->row_count - 1 - i;
        const float *texels = dilation->rows + (size_t)row * dilation->width * dilation->channels;
        for (uint32_t x = begin; x < end; ++x) {
            const float *texel = texels + (size_t)x * dilation->channels;
            if (!found[x - begin] && dilation_is_valid(texel)) {
                found[x - begin] = true;
                --left;
                carry(dilation, carried + (size_t)x * dilation->channels, texel,
                      dilation->first_row + row);
            }
        }
    }
}

static int carry_up(void *arg, uint64_t strip, unsigned worker)
{
    (void)worker;
    struct bake_dilation *dilation = arg;
    carry_strip(dilation, strip, dilation->below_buffer, true);
    return 0;
}

static int carry_down(void *arg, uint64_t strip, unsigned worker)
{
    (void)worker;
    struct bake_dilation *dilation = arg;
    carry_strip(dilation, strip, dilation->above, false);
    return 0;
}

static int load_band(struct bake_dilation *dilation, uint32_t band)
{
    dilation->first_row = band * dilation->band_rows;
    uint32_t left = dilation->height - dilation->first_row;
    dilation->row_count = left < dilation->band_rows ? left : dilation->band_rows;
    return bake_image_rows(dilation->image, dilation->first_row, dilation->row_count,
                           dilation->band_buffer, &dilation->rows);
}

/* Fills `carried`, from the lowest band to the highest; nothing is above the first. */
static int find_below(struct bake_dilation *dilation)
{
    for (uint32_t band = dilation->band_count; band-- > 0;) {
        BSQ_PASS(bake_image_write(dilation->carried, 0, band, dilation->width, 1,
                                  dilation->below_buffer));
        if (band == 0)
            break;
        BSQ_PASS(load_band(dilation, band));
        BSQ_PASS(bsq_parallel_for(dilation->ctx, strip_count(dilation), carry_up, dilation));
    }
    return 0;
}

/* ---- columns ---- */

/* Returns the row of a candidate in the map. */
static int64_t slot_row(const struct bake_dilation *dilation, uint32_t column, uint32_t slot)
{
    size_t texel = (size_t)column * dilation->channels;
    if (slot == 0)
        return (int64_t)carried_row(dilation->above + texel) - 1;
    if (slot == dilation->row_count + 1)
        return (int64_t)carried_row(dilation->below + texel) - 1;
    return (int64_t)dilation->first_row + slot - 1;
}

/* Fills the slots of a strip: one sweep down, then one up. The upper candidate wins ties. */
static int sweep_strip(void *arg, uint64_t strip, unsigned worker)
{
    (void)worker;
    const struct bake_dilation *dilation = arg;
    uint32_t begin = (uint32_t)strip * STRIP, end = strip_end(dilation, strip);
    uint32_t nearest[STRIP];
    for (uint32_t x = begin; x < end; ++x)
        nearest[x - begin] =
            carried_row(dilation->above + (size_t)x * dilation->channels) ? 0 : NO_SLOT;
    for (uint32_t row = 0; row < dilation->row_count; ++row) {
        const float *texels = dilation->rows + (size_t)row * dilation->width * dilation->channels;
        uint32_t *slots = dilation->slots + (size_t)row * dilation->width;
        for (uint32_t x = begin; x < end; ++x) {
            if (dilation_is_valid(texels + (size_t)x * dilation->channels))
                nearest[x - begin] = row + 1;
            slots[x] = nearest[x - begin];
        }
    }
    for (uint32_t x = begin; x < end; ++x)
        nearest[x - begin] = carried_row(dilation->below + (size_t)x * dilation->channels)
                                 ? dilation->row_count + 1
                                 : NO_SLOT;
    for (uint32_t row = dilation->row_count; row-- > 0;) {
        uint32_t *slots = dilation->slots + (size_t)row * dilation->width;
        int64_t y = (int64_t)dilation->first_row + row;
        for (uint32_t x = begin; x < end; ++x) {
            uint32_t below = nearest[x - begin];
            if (slots[x] == row + 1)
                nearest[x - begin] = row + 1;
            else if (slots[x] == NO_SLOT)
                slots[x] = below;
            else if (below != NO_SLOT &&
                     slot_row(dilation, x, below) - y < y - slot_row(dilation, x, slots[x]))
                slots[x] = below;
        }
    }
    return 0;
}

/* ---- rows ---- */

struct row {
    const struct bake_dilation *dilation;
    const uint32_t *slots;
    int64_t y;
    int64_t scale; /* larger than any row number */
};

/* Returns the height of a column's parabola at its vertex: the scaled squared distance within the
 * column, plus the row. */
static int64_t parabola(const struct row *row, uint32_t column)
{
    int64_t site = slot_row(row->dilation, column, row->slots[column]);
    return row->scale * (site - row->y) * (site - row->y) + site;
}

static int64_t floor_divide(int64_t a, int64_t b)
{
    return a / b - (a % b < 0);
}

/* Returns the last column where the parabola at i is as low as the parabola at j; i < j. */
static int64_t last_of(int64_t height_i, int64_t i, int64_t height_j, int64_t j, int64_t scale)
{
    return floor_divide(height_j - height_i + scale * (j * j - i * i), 2 * scale * (j - i));
}

/* Builds the lower envelope over the columns [begin, end) of the candidates in [first, last].
 * Returns the number of parabolas in it. */
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

static const float *texel_of(const struct bake_dilation *dilation, uint32_t column, uint32_t slot)
{
    size_t texel = (size_t)column * dilation->channels;
    if (slot == 0)
        return dilation->above + texel;
    if (slot == dilation->row_count + 1)
        return dilation->below + texel;
    return dilation->rows + (size_t)(slot - 1) * dilation->width * dilation->channels + texel;
}

/* Finds the sources of a run of texels, [begin, end), none of which is valid. On either side of the
 * run there is a valid texel or the border of the map. */
static void fill_run(const struct row *row, uint32_t begin, uint32_t end, struct scratch *scratch)
{
    const struct bake_dilation *dilation = row->dilation;
    uint32_t first = begin > 0 ? begin - 1 : 0;
    uint32_t last = end < dilation->width ? end : dilation->width - 1;
    uint32_t count = build_envelope(row, begin, end, first, last, scratch);
    uint32_t q = 0;
    for (uint32_t x = begin; x < end; ++x) {
        scratch->sources[x] = NULL;
        if (count == 0)
            continue;
        while (q + 1 < count && scratch->start[q + 1] <= x)
            ++q;
        uint32_t column = scratch->site[q], slot = row->slots[column];
        int64_t dx = (int64_t)column - x, dy = slot_row(dilation, column, slot) - row->y;
        if ((uint64_t)(dx * dx + dy * dy) <= dilation->limit)
            scratch->sources[x] = texel_of(dilation, column, slot);
    }
}

void bake_dilation_row(struct bake_dilation *dilation, uint32_t number, unsigned worker,
                       const float *const **sources, const float **texels)
{
    struct scratch *scratch = &dilation->scratch[worker];
    const struct row row = {.dilation = dilation,
                            .slots = dilation->slots + (size_t)number * dilation->width,
                            .y = (int64_t)dilation->first_row + number,
                            .scale = dilation->height};
    const float *own = dilation->rows + (size_t)number * dilation->width * dilation->channels;
    uint32_t x = 0;
    while (x < dilation->width) {
        uint32_t begin = x;
        while (x < dilation->width && row.slots[x] != number + 1)
            ++x;
        if (x > begin)
            fill_run(&row, begin, x, scratch);
        for (; x < dilation->width && row.slots[x] == number + 1; ++x)
            scratch->sources[x] = own + (size_t)x * dilation->channels;
    }
    *sources = scratch->sources;
    *texels = own;
}

/* ---- bands ---- */

int bake_dilation_next_band(struct bake_dilation *dilation, uint32_t *first_row,
                            uint32_t *row_count)
{
    *row_count = 0;
    if (dilation->band > 0) /* the rows of the previous band are still loaded */
        BSQ_PASS(bsq_parallel_for(dilation->ctx, strip_count(dilation), carry_down, dilation));
    if (dilation->band == dilation->band_count)
        return 0;
    BSQ_PASS(load_band(dilation, dilation->band));
    BSQ_PASS(bake_image_rows(dilation->carried, dilation->band, 1, dilation->below_buffer,
                             &dilation->below));
    BSQ_PASS(bsq_parallel_for(dilation->ctx, strip_count(dilation), sweep_strip, dilation));
    ++dilation->band;
    *first_row = dilation->first_row;
    *row_count = dilation->row_count;
    return 0;
}

uint64_t bake_dilation_row_bytes(const struct bake_image *image)
{
    uint64_t texel_bytes = sizeof(uint32_t);
    if (!image->samples)
        texel_bytes += image->channels * sizeof(float);
    return texel_bytes * image->width;
}

static int dilation_allocate(struct bake_dilation *dilation, const char *beside)
{
    struct bsq_ctx *ctx = dilation->ctx;
    const uint32_t width = dilation->width;
    const uint64_t row_bytes = (uint64_t)width * dilation->channels * sizeof(float);
    const bool in_memory = dilation->image->samples != NULL;
    const struct bake_image_options carried = {.width = width,
                                               .height = dilation->band_count,
                                               .channels = dilation->channels,
                                               .memory_bytes = in_memory ? UINT64_MAX : 0,
                                               .beside = beside};
    BSQ_PASS(bake_image_create(ctx, &carried, &dilation->carried));
    BSQ_PASS(bsq_calloc(ctx, "padding", 1, row_bytes, &dilation->below_buffer));
    BSQ_PASS(bsq_calloc(ctx, "padding", 1, row_bytes, &dilation->above));
    if (!in_memory)
        BSQ_PASS(bsq_alloc(ctx, "band of the map", dilation->band_rows, row_bytes,
                           &dilation->band_buffer));
    BSQ_PASS(BSQ_ALLOC(ctx, "padding", (uint64_t)dilation->band_rows * width, &dilation->slots));
    BSQ_PASS(BSQ_CALLOC(ctx, "padding", bsq_threads(ctx), &dilation->scratch));
    for (unsigned w = 0; w < bsq_threads(ctx); ++w) {
        struct scratch *scratch = &dilation->scratch[w];
        BSQ_PASS(BSQ_ALLOC(ctx, "padding", width, &scratch->site));
        BSQ_PASS(BSQ_ALLOC(ctx, "padding", width, &scratch->start));
        BSQ_PASS(BSQ_ALLOC(ctx, "padding", width, &scratch->sources));
    }
    return 0;
}

int bake_dilation_create(struct bsq_ctx *ctx, const struct bake_image *image, uint32_t band_rows,
                         uint32_t padding, const char *beside, struct bake_dilation **out)
{
    struct bake_dilation *dilation = NULL;
    int status;
    *out = NULL;
    BSQ_TRY(BSQ_CALLOC(ctx, "padding", 1, &dilation));
    dilation->ctx = ctx;
    dilation->image = image;
    dilation->width = image->width;
    dilation->height = image->height;
    dilation->channels = image->channels;
    dilation->band_rows = band_rows < dilation->height ? band_rows : dilation->height;
    dilation->band_count = (dilation->height - 1) / dilation->band_rows + 1;
    dilation->limit = padding == UINT32_MAX ? UINT64_MAX : (uint64_t)padding * padding;
    BSQ_TRY(dilation_allocate(dilation, beside));
    BSQ_TRY(find_below(dilation));
    *out = dilation;
    dilation = NULL;
done:
    bake_dilation_free(dilation);
    return status;
}

void bake_dilation_free(struct bake_dilation *dilation)
{
    if (!dilation)
        return;
    struct bsq_ctx *ctx = dilation->ctx;
    for (unsigned w = 0; dilation->scratch && w < bsq_threads(ctx); ++w) {
        BSQ_FREE(ctx, dilation->scratch[w].site, dilation->scratch[w].start,
                 (void *)dilation->scratch[w].sources);
    }
    BSQ_FREE(ctx, dilation->scratch, dilation->slots, dilation->band_buffer, dilation->above,
             dilation->below_buffer);
    bake_image_free(dilation->carried);
    bsq_free(ctx, dilation);
}
