/* region.c - the memory of a region's sums, and the records made from them.
 *
 * A wall thinner than a voxel has two sides whose normals would cancel. So the fragments of a voxel
 * are summed in classes of directions, and sides.c makes one or two records of the sums. */
#include "libvoxel/voxelize/records/region.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <string.h>

#include "base/srgb.h"

/* A second record below this share of the first one's area is noise. */
static const double second_share = 0.01;

/* Sums for all voxels and classes of a brick, two for each voxel of the region, and those that are
 * cleared ahead. */
enum {
    SUMS_MIN = VOX_CLASSES * VOX_BRICK_VOXELS + VOX_FRAGMENTS_AT_ONCE,
    SUMS_MAX = 2 * VOX_BRICKS * VOX_BRICK_VOXELS + VOX_FRAGMENTS_AT_ONCE
};

static_assert((uint64_t)SUMS_MAX <= VOX_LINK_NUMBER, "links hold all numbers");

/* ---- memory ---- */

static uint64_t bytes_per_sum(unsigned sums)
{
    return sizeof(struct vox_sum) + 3 * sizeof(uint32_t) / 2 +
           (sums & VOX_SUM_COLORS ? sizeof(struct vox_color_sum) : 0) +
           (sums & VOX_SUM_IDS ? sizeof(struct vox_vote) : 0) +
           sums / VOX_SUM_CHANNEL_VALUE * sizeof(double);
}

static uint64_t capacity_bytes(uint64_t bricks, uint64_t count, unsigned sums)
{
    return sizeof(struct vox_accumulator) +
           sums / VOX_SUM_CHANNEL_VALUE * VOX_FRAGMENT_LANES * sizeof(double) +
           (bricks + 1) * sizeof(vox_brick) + (count + 1) * bytes_per_sum(sums);
}

uint64_t vox_accumulator_bytes_min(unsigned sums)
{
    return capacity_bytes(1, SUMS_MIN, sums);
}

/* A surface leaves about 80 records in a brick, so records get most of the memory. */
static void set_capacities(struct vox_accumulator *a, uint64_t bytes, unsigned sums)
{
    uint64_t bricks = bytes / 5 / sizeof(vox_brick);
    bricks = bricks < 1 ? 1 : bricks > VOX_BRICKS ? VOX_BRICKS : bricks;
    uint64_t rest = capacity_bytes(bricks, 0, sums);
    uint64_t count = bytes > rest ? (bytes - rest) / bytes_per_sum(sums) : 0;
    a->brick_capacity = (uint32_t)bricks;
    a->sum_capacity = (uint32_t)(count < SUMS_MIN ? SUMS_MIN : count > SUMS_MAX ? SUMS_MAX : count);
}

int vox_accumulator_create(struct bsq_ctx *ctx, uint64_t bytes, unsigned sums,
                           struct vox_accumulator **out)
{
    struct vox_accumulator *a;
    int status;
    *out = NULL;
    BSQ_PASS(BSQ_CALLOC(ctx, "voxel sums", 1, &a));
    a->ctx = ctx;
    a->channel_words = sums / VOX_SUM_CHANNEL_VALUE;
    set_capacities(a, bytes, sums);
    const uint64_t count = (uint64_t)a->sum_capacity + 1;
    const uint64_t channel_bytes = a->channel_words * sizeof *a->channels;
    BSQ_TRY(BSQ_ALLOC(ctx, "voxel sums", (uint64_t)a->brick_capacity + 1, &a->bricks));
    BSQ_TRY(BSQ_ALLOC(ctx, "voxel sums", count, &a->sums));
    BSQ_TRY(BSQ_ALLOC(ctx, "voxel sums", count, &a->others));
    BSQ_TRY(BSQ_ALLOC(ctx, "voxel sums", count / 2, &a->shared));
    if (sums & VOX_SUM_COLORS)
        BSQ_TRY(BSQ_ALLOC(ctx, "voxel sums", count, &a->colors));
    if (sums & VOX_SUM_IDS)
        BSQ_TRY(BSQ_ALLOC(ctx, "voxel sums", count, &a->votes));
    if (channel_bytes > 0) {
        BSQ_TRY(bsq_alloc(ctx, "voxel sums", count, channel_bytes, &a->channels));
        BSQ_TRY(
            bsq_alloc(ctx, "voxel sums", VOX_FRAGMENT_LANES, channel_bytes, &a->fragment_channels));
    }
    memset(&a->bricks[0], 0, sizeof a->bricks[0]);
    *out = a;
done:
    if (status < 0)
        vox_accumulator_destroy(a);
    return status;
}

void vox_accumulator_destroy(struct vox_accumulator *a)
{
    if (!a)
        return;
    BSQ_FREE(a->ctx, a->bricks, a->sums, a->others, a->shared, a->colors, a->votes, a->channels,
             a->fragment_channels, a);
}

void vox_accumulator_clear(struct vox_accumulator *a)
{
    if (a->brick_count > 0)
        memset(a->brick_of, 0, sizeof a->brick_of);
    a->brick_count = 0;
    a->sum_count = a->ready_count = a->shared_count = 0;
    a->second_count = a->spare_count = 0;
}

/* ---- adding ---- */

/* Records that are cleared together. */
enum { READY_STEP = 2 * VOX_FRAGMENTS_AT_ONCE };

bool vox_accumulator_clear_next(struct vox_accumulator *a)
{
    uint32_t first = a->ready_count + 1, count = a->sum_capacity - a->ready_count;
    count = count < READY_STEP ? count : READY_STEP;
    memset(&a->sums[first], 0, count * sizeof *a->sums);
    memset(&a->others[first], 0, count * sizeof *a->others);
    if (a->colors)
        memset(&a->colors[first], 0, count * sizeof *a->colors);
    if (a->votes)
        memset(&a->votes[first], 0, count * sizeof *a->votes);
    if (a->channels)
        memset(a->channels + (uint64_t)first * a->channel_words, 0,
               (uint64_t)count * a->channel_words * sizeof *a->channels);
    a->ready_count += count;
    return a->ready_count - a->sum_count >= VOX_FRAGMENTS_AT_ONCE;
}

bool vox_accumulator_open_brick(struct vox_accumulator *a, uint32_t *brick)
{
    if (a->brick_count == a->brick_capacity)
        return false;
    *brick = ++a->brick_count;
    memset(&a->bricks[*brick], 0, sizeof a->bricks[*brick]);
    return true;
}

/* ---- records ---- */

void vox_color_tables_init(struct vox_color_tables *tables)
{
    for (int i = 0; i < 256; i++)
        tables->to_linear[i] = bsq_srgb_to_linear(i / 255.0);
    for (int i = 0; i < 255; i++)
        tables->boundary[i] = bsq_srgb_to_linear((i + 0.5) / 255.0);
    uint8_t code = 0;
    for (int i = 0; i <= VOX_COLOR_STEPS; i++) {
        while (code < 255 && (double)i / VOX_COLOR_STEPS >= tables->boundary[code])
            code++;
        tables->start[i] = code;
    }
}

/* Values outside of [0, 1] by less are due to rounding. */
static const double color_tolerance = 1e-6;

/* Returns the nearest 8-bit sRGB code of a linear value. Values outside of [0, 1] are clamped,
 * which sets *clamped; NaN gives 0. */
static inline uint32_t encode_srgb(const struct vox_color_tables *t, double linear, bool *clamped)
{
    if (!(linear > 0.0)) {
        *clamped |= linear < -color_tolerance;
        return 0;
    }
    if (linear >= 1.0) {
        *clamped |= linear > 1.0 + color_tolerance;
        return 255;
    }
    uint32_t code = t->start[(uint32_t)(linear * VOX_COLOR_STEPS)];
    while (code < 255 && linear >= t->boundary[code])
        code++;
    return code;
}

static uint32_t encode_color(const struct vox_color_sum *color,
                             const struct vox_color_tables *tables, uint64_t *clamped)
{
    bool any = false;
    if (!(color->area > 0.0))
        return 0;
    uint32_t packed = 0xff000000u;
    for (int k = 0; k < 3; k++)
        packed |= encode_srgb(tables, color->rgb[k] / color->area, &any) << (8 * k);
    *clamped += any;
    return packed;
}

/* The first and second records of a brick's voxels, as numbers of their sums. */
struct brick_records {
    uint32_t count[2], numbers[2][VOX_BRICK_VOXELS];
    bool has_second[VOX_BRICK_VOXELS];
};

/* Returns whether the first of two records is the larger one. If they are equal but for rounding,
 * their directions decide. */
static bool goes_first(const struct vox_sum *one, const struct vox_sum *other)
{
    static const double order[3] = {0.9, 0.5, 0.3};
    if (fabs(one->area - other->area) > 1e-6 * one->area)
        return one->area > other->area;
    return vox_dot(one->normal, order) > vox_dot(other->normal, order);
}

/* Chooses a voxel's records: the larger of its sums, then the other one if it is worth keeping. */
static void choose_records(const struct vox_accumulator *a, uint32_t number,
                           struct brick_records *chosen)
{
    uint32_t other = a->second_count > 0 ? a->others[number] : 0;
    if (other != 0 && goes_first(&a->sums[other], &a->sums[number])) {
        uint32_t smaller = number;
        number = other;
        other = smaller;
    }
    bool keep = other != 0 && a->sums[other].area >= second_share * a->sums[number].area;
    chosen->has_second[chosen->count[0]] = keep;
    chosen->numbers[0][chosen->count[0]++] = number;
    if (keep)
        chosen->numbers[1][chosen->count[1]++] = other;
}

/* Writes the means of channels. Values too large for float32 become the largest one. */
static void make_channels(const struct vox_accumulator *a, const uint32_t *numbers, uint32_t count,
                          float *out)
{
    const uint32_t words = a->channel_words;
    for (uint32_t i = 0; i < count; i++) {
        const double *sums = a->channels + (uint64_t)numbers[i] * words;
        const double area = a->sums[numbers[i]].area;
        for (uint32_t c = 0; c < words; c++)
            *out++ = (float)fmin(fmax(sums[c] / area, -FLT_MAX), FLT_MAX);
    }
}

static void region_append_records(const struct vox_accumulator *a, const uint32_t *numbers,
                                  uint32_t count, const struct vox_color_tables *tables,
                                  struct vox_records *to, uint64_t *clamped)
{
    struct fmt_nvdb_record *records = to->records + to->count;
    BSQ_SIMD_PICK(bsq_simd_best(), vox_make_records)(a->sums, numbers, count, records);
    for (uint32_t i = 0; a->colors && i < count; i++)
        records[i].color = encode_color(&a->colors[numbers[i]], tables, clamped);
    for (uint32_t i = 0; a->votes && i < count; i++)
        records[i].id = a->votes[numbers[i]].id;
    if (a->channels)
        make_channels(a, numbers, count, to->channels + to->count * a->channel_words);
    to->count += count;
}

/* Finds the touched voxels of a brick, and prefetches their sums, which lie in the order in which
 * voxels were first touched. */
static void find_voxels(const struct vox_accumulator *a, const uint32_t *cells, uint64_t mask[8])
{
    for (uint32_t word = 0; word < 8; word++) {
        mask[word] = 0;
        for (uint32_t i = 0; i < 64; i += 16)
            mask[word] |= (uint64_t)bits_of_sixteen(cells + 64 * word + i) << i;
        for (uint64_t bits = mask[word]; bits; bits &= bits - 1)
            __builtin_prefetch(
                &a->sums[cells[64 * word + (uint32_t)__builtin_ctzll(bits)] & VOX_LINK_NUMBER]);
    }
}

static void finish_brick(const struct vox_accumulator *a, uint32_t brick,
                         const struct vox_color_tables *tables, struct vox_leaves *leaves)
{
    const uint32_t *cells = a->bricks[a->brick_of[brick]];
    uint64_t *mask = leaves->masks[leaves->leaf_count];
    struct brick_records chosen;
    chosen.count[0] = chosen.count[1] = 0;
    find_voxels(a, cells, mask);
    for (uint32_t word = 0; word < 8; word++)
        for (uint64_t bits = mask[word]; bits; bits &= bits - 1)
            choose_records(a, cells[64 * word + (uint32_t)__builtin_ctzll(bits)] & VOX_LINK_NUMBER,
                           &chosen);

    struct fmt_nvdb_record *records = leaves->sides[0].records + leaves->sides[0].count;
    for (int s = 0; s < 2; s++)
        if (chosen.count[s] > 0)
            region_append_records(a, chosen.numbers[s], chosen.count[s], tables, &leaves->sides[s],
                                  &leaves->clamped_colors);
    for (uint32_t i = 0; chosen.count[1] > 0 && i < chosen.count[0]; i++)
        records[i].plane |= chosen.has_second[i] ? FMT_NVDB_PLANE_SECOND : 0;
    leaves->ids[leaves->leaf_count++] = (uint16_t)brick;
}

/* Ensures capacity for this many more leaves, and records of either side. */
static int grow_leaves(struct vox_leaves *l, uint64_t leaves, const uint64_t records[2])
{
    const char *what = "voxel records";
    const uint64_t bytes = l->channel_words * sizeof *l->sides->channels;
    leaves += l->leaf_count;
    BSQ_PASS(BSQ_GROW(l->ctx, what, leaves, &l->ids, &l->id_capacity));
    BSQ_PASS(BSQ_GROW(l->ctx, what, leaves, &l->masks, &l->mask_capacity));
    for (int s = 0; s < 2; s++) {
        struct vox_records *side = &l->sides[s];
        const uint64_t count = side->count + records[s];
        BSQ_PASS(BSQ_GROW(l->ctx, what, count, &side->records, &side->capacity));
        if (bytes > 0)
            BSQ_PASS(
                bsq_grow(l->ctx, what, count, bytes, &side->channels, &side->channel_capacity));
    }
    return 0;
}

uint64_t vox_accumulator_result_bytes(const struct vox_accumulator *a, const struct vox_leaves *l)
{
    uint64_t leaves = (uint64_t)l->leaf_count + a->brick_count;
    uint64_t records = l->sides[0].count + l->sides[1].count + a->sum_count - a->spare_count;
    return leaves * (sizeof *l->ids + sizeof *l->masks) +
           records * (sizeof *l->sides->records + a->channel_words * sizeof *l->sides->channels);
}

int vox_accumulator_finish(const struct vox_accumulator *a, const struct vox_color_tables *tables,
                           struct vox_leaves *l)
{
    const uint64_t records[2] = {a->sum_count - a->spare_count - a->second_count, a->second_count};
    l->channel_words = a->channel_words;
    BSQ_PASS(grow_leaves(l, a->brick_count, records));
    if (a->brick_count > 0)
        for (uint32_t brick = 0; brick < VOX_BRICKS; brick++)
            if (a->brick_of[brick] != 0)
                finish_brick(a, brick, tables, l);
    return 0;
}

/* ---- leaves ---- */

void vox_leaves_init(struct vox_leaves *leaves, struct bsq_ctx *ctx)
{
    *leaves = (struct vox_leaves){.ctx = ctx};
}

void vox_leaves_clear(struct vox_leaves *leaves)
{
    leaves->leaf_count = 0;
    leaves->clamped_colors = 0;
    leaves->sides[0].count = leaves->sides[1].count = 0;
}

void vox_leaves_free(struct vox_leaves *leaves)
{
    BSQ_FREE(leaves->ctx, leaves->ids, leaves->masks);
    for (int s = 0; s < 2; s++) {
        BSQ_FREE(leaves->ctx, leaves->sides[s].records, leaves->sides[s].channels);
    }
    vox_leaves_init(leaves, leaves->ctx);
}
