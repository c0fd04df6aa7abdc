/* pyramid.c - images as square cells of several sizes, in memory or in a temporary file.
 *
 * A block has 64 columns and as many rows as fit, so that the blocks of all levels have equal bytes
 * and a row of blocks is one range of the file. Each level has one row of blocks in memory until it
 * is written. It sums the cells of the next level at the same time, so an image is read once and
 * from the top.
 *
 * A box is averaged from the largest cells that fit along each side at least four times. Cells at
 * the right and lower edges cover fewer texels and weigh less. So the integral over the whole image
 * is the same on every level, for any image size.
 *
 * The cache is divided into small sets. A block belongs to one of them, which is locked while the
 * block is read and used. A failed read is a failure of the thread that wanted the block, and
 * leaves nothing behind that another one would wait for. */
#include "formats/texture/pyramid.h"

#include <math.h>
#include <string.h>

#include "base/srgb.h"

enum { BLOCK_COLUMNS = 64, BLOCK_BYTES = 96 * BLOCK_COLUMNS, SET_BLOCKS = 8 };
enum { CELLS_ALONG = 4 }; /* least cells along a side of a box, on levels above 0 */
#define LEAST_BYTES ((uint64_t)1 << 20)

struct level {
    unsigned shift; /* cells have 2^shift texels along a side */
    uint32_t width, height;
    uint32_t cell_bytes, block_rows, blocks_across;
    uint64_t first; /* block, of those of the image */
    /* While rows are added: */
    uint8_t *band; /* the current row of blocks; NULL: rows go to their place in memory */
    double *sums;  /* of the current row of cells; level 0 has none */
    float *row;    /* a complete row of cells; level 0: in linear light */
    uint32_t next_row;
};

struct transfer {
    struct transfer *next;
    unsigned bits;
    double gamma;
    float table[];
};

/* A part of the cache. */
struct block_set {
    pthread_mutex_t lock;
    uint64_t clock;
    uint64_t used[SET_BLOCKS]; /* when each slot was used last; 0: it is empty */
    uint64_t numbers[SET_BLOCKS];
};

/* ---- what images share ---- */

void fmt_blocks_create(struct bsq_ctx *ctx, uint64_t bytes, struct fmt_blocks *blocks)
{
    *blocks = (struct fmt_blocks){.ctx = ctx, .file = BSQ_FILE_CLOSED};
    blocks->bytes = bytes > LEAST_BYTES ? bytes : LEAST_BYTES;
    pthread_mutex_init(&blocks->lock, NULL);
}

int fmt_blocks_finish(struct fmt_blocks *blocks)
{
    const uint64_t set_bytes = SET_BLOCKS * BLOCK_BYTES + sizeof(struct block_set);
    uint64_t count = (blocks->bytes - blocks->resident) / set_bytes;
    const uint64_t useful = blocks->file_count / SET_BLOCKS * 2 + 1; /* sets fill unevenly */
    if (blocks->file_count == 0)
        return 0;
    count = count < useful ? count : useful;
    BSQ_PASS(
        bsq_alloc(blocks->ctx, "texture cache", count, SET_BLOCKS * BLOCK_BYTES, &blocks->slots));
    BSQ_PASS(BSQ_CALLOC(blocks->ctx, "texture cache", count, &blocks->sets));
    blocks->set_count = count;
    for (uint64_t i = 0; i < count; i++)
        pthread_mutex_init(&blocks->sets[i].lock, NULL);
    return 0;
}

void fmt_blocks_free(struct fmt_blocks *blocks)
{
    struct bsq_ctx *ctx = blocks->ctx;
    for (uint64_t i = 0; i < blocks->set_count; i++)
        pthread_mutex_destroy(&blocks->sets[i].lock);
    BSQ_FREE(ctx, blocks->sets, blocks->slots);
    while (blocks->transfers) {
        struct transfer *next = blocks->transfers->next;
        bsq_free(ctx, blocks->transfers);
        blocks->transfers = next;
    }
    bsq_file_close(ctx, &blocks->file);
    pthread_mutex_destroy(&blocks->lock);
}

/* Finds or makes the table of a kind of integers. The lock is held. */
static int find_table(struct fmt_blocks *blocks, unsigned bits, double gamma, const float **out)
{
    const uint64_t count = UINT64_C(1) << bits;
    struct transfer *t = blocks->transfers;
    while (t && (t->bits != bits || t->gamma != gamma))
        t = t->next;
    if (!t) {
        BSQ_PASS(
            bsq_alloc(blocks->ctx, "texture values", 1, sizeof *t + count * sizeof *t->table, &t));
        *t = (struct transfer){.next = blocks->transfers, .bits = bits, .gamma = gamma};
        for (uint64_t i = 0; i < count; i++) {
            const double s = (double)i / (double)(count - 1);
            t->table[i] = (float)(gamma == 0 ? bsq_srgb_to_linear(s) : pow(s, gamma));
        }
        blocks->transfers = t;
    }
    *out = t->table;
    return 0;
}

/* ---- adding images ---- */

static uint32_t cell_count(uint32_t texels, unsigned shift)
{
    return (uint32_t)((texels + (UINT64_C(1) << shift) - 1) >> shift);
}

/* Returns how many texels cell i of a side of `texels` has along it. */
static double cell_extent(uint32_t i, unsigned shift, uint32_t texels)
{
    const uint64_t left = texels - ((uint64_t)i << shift), size = UINT64_C(1) << shift;
    return (double)(left < size ? left : size);
}

/* Lays out the levels. Returns the number of their blocks. */
static uint64_t pyramid_lay_out(struct fmt_pyramid *p)
{
    uint64_t blocks = 0;
    for (uint32_t n = 0; n < p->level_count; n++) {
        struct level *level = &p->levels[n];
        level->shift = n == 0 ? 0 : n + 1;
        level->width = cell_count(p->width, level->shift);
        level->height = cell_count(p->height, level->shift);
        level->cell_bytes = p->channels * (n == 0 ? p->sample_bytes : (uint32_t)sizeof(float));
        level->block_rows = BLOCK_BYTES / BLOCK_COLUMNS / level->cell_bytes;
        level->blocks_across = (level->width + BLOCK_COLUMNS - 1) / BLOCK_COLUMNS;
        level->first = blocks;
        blocks += (uint64_t)level->blocks_across *
                  ((level->height + level->block_rows - 1) / level->block_rows);
    }
    return blocks;
}

/* Finds the place of an image: memory as long as there is some. The lock is held. */
static int pyramid_find_place(struct fmt_pyramid *p, uint64_t count)
{
    struct fmt_blocks *blocks = p->blocks;
    const uint64_t bytes = count * BLOCK_BYTES, most = blocks->bytes / 4 * 3;
    if (bytes <= most - blocks->resident) {
        BSQ_PASS(bsq_alloc(blocks->ctx, "texture", count, BLOCK_BYTES, &p->memory));
        p->resident = bytes;
        blocks->resident += bytes;
    } else {
        if (blocks->file.fd < 0)
            BSQ_PASS(bsq_file_temp(blocks->ctx, NULL, "textures", &blocks->file));
        p->first = blocks->file_count;
        blocks->file_count += count;
    }
    return 0;
}

/* Allocates what adding rows to a level needs. */
static int pyramid_prepare(struct fmt_pyramid *p, struct level *level)
{
    struct bsq_ctx *ctx = p->blocks->ctx;
    const uint64_t samples = (uint64_t)level->width * p->channels;
    BSQ_PASS(BSQ_ALLOC(ctx, "texture rows", samples, &level->row));
    if (level->shift > 0)
        BSQ_PASS(BSQ_CALLOC(ctx, "texture rows", samples, &level->sums));
    if (!p->memory)
        BSQ_PASS(bsq_calloc(ctx, "texture rows", level->blocks_across, BLOCK_BYTES, &level->band));
    return 0;
}

int fmt_pyramid_begin(struct fmt_pyramid *p, double gamma)
{
    struct fmt_blocks *blocks = p->blocks;
    const uint32_t side = p->width < p->height ? p->width : p->height;
    for (p->level_count = 1; side >> (p->level_count + 1) >= CELLS_ALONG;)
        p->level_count++;
    BSQ_PASS(BSQ_CALLOC(blocks->ctx, "texture", p->level_count, &p->levels));
    const uint64_t count = pyramid_lay_out(p);
    pthread_mutex_lock(&blocks->lock);
    int status =
        p->sample_bytes < 4 ? find_table(blocks, 8 * p->sample_bytes, gamma, &p->table) : 0;
    if (status == 0)
        status = pyramid_find_place(p, count);
    pthread_mutex_unlock(&blocks->lock);
    BSQ_PASS(status);
    for (uint32_t n = 0; n < p->level_count; n++)
        BSQ_PASS(pyramid_prepare(p, &p->levels[n]));
    return 0;
}

/* Converts a row to linear light. Returns the result. */
static const float *pyramid_make_linear(struct fmt_pyramid *p, const void *row)
{
    float *out = p->levels[0].row;
    const size_t count = (size_t)p->width * p->channels;
    if (p->sample_bytes == 1) {
        for (size_t i = 0; i < count; i++)
            out[i] = p->table[((const uint8_t *)row)[i]];
    } else if (p->sample_bytes == 2) {
        for (size_t i = 0; i < count; i++)
            out[i] = p->table[((const uint16_t *)row)[i]];
    } else {
        for (size_t i = 0; i < count; i += p->channels) {
            bool broken = false;
            for (size_t c = i; c < i + p->channels; c++) {
                const float value = ((const float *)row)[c];
                broken |= !isfinite(value);
                out[c] = isfinite(value) ? value : 0;
            }
            p->broken += broken;
        }
    }
    return out;
}

/* Adds a row of cells to the blocks of its level. */
static int store_row(struct fmt_pyramid *p, struct level *level, const void *row)
{
    const uint32_t y = level->next_row++, line = y % level->block_rows;
    const uint64_t first = level->first + (uint64_t)(y / level->block_rows) * level->blocks_across;
    const size_t line_bytes = (size_t)BLOCK_COLUMNS * level->cell_bytes;
    const size_t row_bytes = (size_t)level->width * level->cell_bytes;
    uint8_t *to = (p->memory ? p->memory + first * BLOCK_BYTES : level->band) + line * line_bytes;
    for (size_t at = 0; at < row_bytes; at += line_bytes, to += BLOCK_BYTES)
        memcpy(to, (const uint8_t *)row + at,
               row_bytes - at < line_bytes ? row_bytes - at : line_bytes);
    if (p->memory || (line + 1 < level->block_rows && y + 1 < level->height))
        return 0;
    return bsq_file_write(p->blocks->ctx, &p->blocks->file, level->band,
                          (uint64_t)level->blocks_across * BLOCK_BYTES,
                          (p->first + first) * BLOCK_BYTES);
}

/* Adds the last row of a level to the sums of the next level. Returns whether a row of cells is
 * complete there, after which the sums are 0. */
static bool add_to_above(const struct fmt_pyramid *p, const struct level *below,
                         struct level *above, const float *row)
{
    const unsigned step = above->shift - below->shift;
    const uint32_t y = below->next_row - 1, last = below->width - 1;
    const double high = cell_extent(y, below->shift, p->height);
    const double full = high * cell_extent(0, below->shift, p->width);
    for (uint32_t x = 0; x <= last; x++) {
        const double weight = x < last ? full : high * cell_extent(x, below->shift, p->width);
        double *sum = above->sums + (size_t)(x >> step) * p->channels;
        for (uint32_t c = 0; c < p->channels; c++)
            sum[c] += weight * (double)*row++;
    }
    if (below->next_row < below->height && below->next_row % (1u << step) != 0)
        return false;
    const double rows = cell_extent(y >> step, above->shift, p->height);
    double *sum = above->sums;
    for (uint32_t x = 0; x < above->width; x++)
        for (uint32_t c = 0; c < p->channels; c++, sum++) {
            above->row[sum - above->sums] =
                (float)(*sum / (cell_extent(x, above->shift, p->width) * rows));
            *sum = 0;
        }
    return true;
}

int fmt_pyramid_add_row(struct fmt_pyramid *p, const void *row)
{
    const float *linear = pyramid_make_linear(p, row);
    BSQ_PASS(store_row(p, &p->levels[0], p->sample_bytes < 4 ? row : linear));
    for (uint32_t n = 1; n < p->level_count; n++) {
        if (!add_to_above(p, &p->levels[n - 1], &p->levels[n], linear))
            break;
        linear = p->levels[n].row;
        BSQ_PASS(store_row(p, &p->levels[n], linear));
    }
    return 0;
}

void fmt_pyramid_end(struct fmt_pyramid *p)
{
    for (uint32_t n = 0; p->levels && n < p->level_count; n++) {
        struct level *level = &p->levels[n];
        BSQ_FREE(p->blocks->ctx, level->band, level->sums, level->row);
        level->band = NULL;
        level->sums = NULL;
        level->row = NULL;
    }
}

void fmt_pyramid_free(struct fmt_pyramid *p)
{
    if (!p->levels)
        return;
    fmt_pyramid_end(p);
    pthread_mutex_lock(&p->blocks->lock);
    p->blocks->resident -= p->resident;
    pthread_mutex_unlock(&p->blocks->lock);
    BSQ_FREE(p->blocks->ctx, p->memory, p->levels);
    p->levels = NULL;
}

/* ---- reading blocks ---- */

/* A block in use. */
struct use {
    const uint8_t *cells;
    struct block_set *set; /* is locked; NULL: none */
};

/* Returns the slot of a block, or the one that it replaces. The set is locked. */
static unsigned pyramid_find_slot(const struct block_set *set, uint64_t number)
{
    unsigned oldest = 0;
    for (unsigned i = 0; i < SET_BLOCKS; i++) {
        if (set->used[i] > 0 && set->numbers[i] == number)
            return i;
        if (set->used[i] < set->used[oldest])
            oldest = i;
    }
    return oldest;
}

/* Reads a block of an image. End its use with give_back(), also after a failure. */
static int pyramid_take(const struct fmt_pyramid *p, uint64_t block, struct use *use)
{
    struct fmt_blocks *blocks = p->blocks;
    int status = 0;
    *use = (struct use){p->memory ? p->memory + block * BLOCK_BYTES : NULL, NULL};
    if (p->memory)
        return 0;
    const uint64_t number = p->first + block;
    const uint64_t index = (number * UINT64_C(0x9e3779b97f4a7c15) >> 32) % blocks->set_count;
    struct block_set *set = use->set = &blocks->sets[index];
    pthread_mutex_lock(&set->lock);
    const unsigned slot = pyramid_find_slot(set, number);
    uint8_t *cells = blocks->slots + (index * SET_BLOCKS + slot) * BLOCK_BYTES;
    if (set->used[slot] == 0 || set->numbers[slot] != number) {
        set->used[slot] = 0;
        status =
            bsq_file_read(blocks->ctx, &blocks->file, cells, BLOCK_BYTES, number * BLOCK_BYTES);
    }
    if (status == 0) {
        set->numbers[slot] = number;
        set->used[slot] = ++set->clock;
    }
    use->cells = cells;
    return status;
}

static void give_back(const struct use *use)
{
    if (use->set)
        pthread_mutex_unlock(&use->set->lock);
}

/* ---- averages ---- */

/* A rectangle in texels; the origin is the image's upper left corner. */
struct rectangle {
    double x0, x1, y0, y1;
};

/* Cells [x0, x1) x [y0, y1). */
struct cells {
    uint32_t x0, x1, y0, y1;
};

/* Returns the length that [first, first + extent) and [a, b) share. They must not be disjoint. */
static double pyramid_overlap(double first, double extent, double a, double b)
{
    const double end = first + extent;
    return (end < b ? end : b) - (first < a ? a : first);
}

/* Adds to `sum` the integral of cells of one block over the part of a rectangle that they cover.
 * Inlined for each type of samples. */
static inline __attribute__((always_inline)) void
add_cells(const struct fmt_pyramid *p, const struct level *level, unsigned sample_bytes,
          const void *block, const struct cells *cells, const struct rectangle *r, double sum[3])
{
    const double size = (double)(UINT64_C(1) << level->shift);
    const uint32_t channels = p->channels == 3 ? 3 : 1;
    for (uint32_t y = cells->y0; y < cells->y1; y++) {
        size_t i = ((size_t)(y % level->block_rows) * BLOCK_COLUMNS + cells->x0 % BLOCK_COLUMNS) *
                   channels;
        double line[3] = {0, 0, 0};
        for (uint32_t x = cells->x0; x < cells->x1; x++) {
            const double weight =
                pyramid_overlap(x * size, cell_extent(x, level->shift, p->width), r->x0, r->x1);
            for (uint32_t c = 0; c < channels; c++, i++)
                line[c] +=
                    weight * (double)(sample_bytes == 1   ? p->table[((const uint8_t *)block)[i]]
                                      : sample_bytes == 2 ? p->table[((const uint16_t *)block)[i]]
                                                          : ((const float *)block)[i]);
        }
        const double weight =
            pyramid_overlap(y * size, cell_extent(y, level->shift, p->height), r->y0, r->y1);
        for (uint32_t c = 0; c < channels; c++)
            sum[c] += weight * line[c];
    }
}

static void pyramid_add_block(const struct fmt_pyramid *p, const struct level *level,
                              const uint8_t *block, const struct cells *cells,
                              const struct rectangle *r, double sum[3])
{
    if (level->shift > 0 || p->sample_bytes == 4)
        add_cells(p, level, 4, block, cells, r, sum);
    else if (p->sample_bytes == 2)
        add_cells(p, level, 2, block, cells, r, sum);
    else
        add_cells(p, level, 1, block, cells, r, sum);
}

static uint32_t least(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

/* Adds to `sum` the integral of a level over a rectangle inside the image, block by block. */
static int add_level(const struct fmt_pyramid *p, const struct level *level,
                     const struct rectangle *r, double sum[3])
{
    const double size = (double)(UINT64_C(1) << level->shift);
    const uint32_t x_end = least(level->width, (uint32_t)ceil(r->x1 / size));
    const uint32_t y_end = least(level->height, (uint32_t)ceil(r->y1 / size));
    struct cells cells = {.y0 = (uint32_t)(r->y0 / size)};
    int status = 0;
    for (; cells.y0 < y_end && status == 0; cells.y0 = cells.y1) {
        const uint32_t down = cells.y0 / level->block_rows;
        cells.y1 = least(y_end, (down + 1) * level->block_rows);
        cells.x0 = (uint32_t)(r->x0 / size);
        for (; cells.x0 < x_end && status == 0; cells.x0 = cells.x1) {
            const uint32_t across = cells.x0 / BLOCK_COLUMNS;
            struct use use;
            cells.x1 = least(x_end, (across + 1) * BLOCK_COLUMNS);
            status = pyramid_take(p, level->first + (uint64_t)down * level->blocks_across + across,
                                  &use);
            if (status == 0)
                pyramid_add_block(p, level, use.cells, &cells, r, sum);
            give_back(&use);
        }
    }
    return status;
}

/* Divides an interval on a circle into one or two in [0, period]. Returns their number. */
static int wrap(double centre, double extent, double period, double first[2], double last[2])
{
    double start = centre - extent / 2;
    start -= floor(start / period) * period;
    if (!(start >= 0 && start < period)) /* rounding, or not a number */
        start = 0;
    first[0] = start;
    last[0] = fmin(start + extent, period);
    first[1] = 0;
    last[1] = start + extent - period;
    return start + extent <= period ? 1 : 2;
}

int fmt_pyramid_average(const struct fmt_pyramid *p, double x, double y, double width,
                        double height, float out[3])
{
    double sum[3] = {0, 0, 0}, x0[2], x1[2], y0[2], y1[2];
    width = fmin(fmax(width, 1), p->width);
    height = fmin(fmax(height, 1), p->height);
    const int shift = (int)floor(log2(fmin(width, height) / CELLS_ALONG));
    const struct level *level =
        &p->levels[shift < 2 ? 0 : least((uint32_t)shift, p->level_count) - 1];
    const int across = wrap(x, width, p->width, x0, x1), down = wrap(y, height, p->height, y0, y1);
    for (int j = 0; j < down; j++)
        for (int i = 0; i < across; i++)
            BSQ_PASS(add_level(p, level, &(struct rectangle){x0[i], x1[i], y0[j], y1[j]}, sum));
    for (uint32_t c = 0; c < 3; c++)
        out[c] = (float)(sum[p->channels == 3 ? c : 0] / (width * height));
    return 0;
}
