/* shares.c - divides the texels of a bake among its parts.
 *
 * Blocks of texels are ordered along a curve through the scan, and cut into runs with about as many
 * samples. So neighbours in space have one part, whatever the layout of the charts, and the rays of
 * a part cross few chunks that other parts read too. */
#include "base/parallel.h"
#include "base/sort_array.h"
#include "libbake/job/job.h"
#include "libbake/job/parts.h"
#include "libbake/kernel/bk_sample.h"

/* The last side keeps the overhead of a block small. A share has BLOCKS_A_SHARE blocks or more, if
 * the maps are large enough. */
enum { LARGEST_SIDE = BAKE_MOST_BLOCK_SIDE, SMALLEST_SIDE = 16, BLOCKS_A_SHARE = 64 };

#define NO_SHARE UINT32_MAX

/* ---- sides of blocks ---- */

static uint64_t blocks_with(const struct bake_job *job, uint32_t side)
{
    uint64_t blocks = 0;
    for (uint32_t i = 0; i < job->udim.count; i++)
        blocks += ((job->tiles[i].options.width - 1) / side + UINT64_C(1)) *
                  ((job->tiles[i].options.height - 1) / side + UINT64_C(1));
    return blocks;
}

/* Returns a side for blocks: smaller if many parts share few texels. */
static uint32_t shares_choose_side(const struct bake_job *job)
{
    uint32_t side = LARGEST_SIDE;
    while (side > SMALLEST_SIDE &&
           blocks_with(job, side) < (uint64_t)BLOCKS_A_SHARE * job->options->parts)
        side /= 2;
    return side;
}

static int cut_tile(struct bake_job *job, uint32_t side, struct bake_tile *tile)
{
    struct bake_blocks *blocks = &tile->blocks;
    uint64_t count;
    blocks->side = side;
    blocks->columns = (tile->options.width - 1) / side + 1;
    blocks->rows = (tile->options.height - 1) / side + 1;
    count = (uint64_t)blocks->columns * blocks->rows;
    int status = BSQ_ALLOC(job->ctx, "blocks of a tile", count, &tile->shares);
    for (uint64_t b = 0; status == 0 && b < count; b++)
        tile->shares[b] = NO_SHARE;
    return status;
}

int bake_cut_blocks(struct bake_job *job)
{
    const uint32_t side = shares_choose_side(job);
    for (uint32_t t = 0; t < job->udim.count; t++)
        BSQ_PASS(cut_tile(job, side, &job->tiles[t]));
    return 0;
}

/* ---- the work in each block ---- */

struct counting {
    const struct bake_job *job;
    const struct bake_raster *raster;
    const struct bake_blocks *of;
    struct bake_share_block *blocks; /* out, one for each patch of the raster */
    uint32_t tile;
    uint32_t **samples; /* one buffer a worker */
};

/* Returns where a sample lies on the curve through the scan. */
static uint64_t curve_index(const struct counting *counting, uint32_t triangle, float x, float y)
{
    const bk_point point = bk_point_at(&counting->job->triangles[triangle], x, y);
    const float at[3] = {point.position.x, point.position.y, point.position.z};
    return bake_surface_curve_index(&counting->job->surface, at);
}

/* Counts the samples of a block, and places it on the curve by its middle sample. */
static int count_block(void *arg, uint64_t index, unsigned worker)
{
    const struct counting *counting = arg;
    const struct bk_patch patch = bake_raster_patch(counting->raster, (uint32_t)index);
    const uint32_t side = counting->of->side;
    uint32_t *samples = counting->samples[worker], covered = 0, covering = 0;
    uint64_t overlaps;
    int status = bake_raster_fill(counting->raster, (uint32_t)index, samples, &overlaps);
    for (uint32_t i = 0; i < patch.width * patch.height && status == 0; i++)
        covered += samples[i] != BK_NO_TRIANGLE;
    struct bake_share_block *block = &counting->blocks[index];
    *block =
        (struct bake_share_block){.tile = counting->tile,
                                  .block = patch.y / side * counting->of->columns + patch.x / side,
                                  .samples = covered};
    for (uint32_t i = 0; i < patch.width * patch.height && status == 0; i++) {
        const uint32_t x = patch.x + i % patch.width, y = patch.y + i / patch.width;
        if (samples[i] != BK_NO_TRIANGLE && covering++ == covered / 2)
            block->index = curve_index(counting, samples[i], (float)x + 0.5f, (float)y + 0.5f);
    }
    return status;
}

struct block_list {
    struct bake_share_block *blocks;
    uint64_t count, capacity;
};

/* Adds the blocks of a tile that have samples to a list, by a raster with one sample a texel, whose
 * patches are blocks. */
static int count_tile(struct bake_job *job, uint32_t tile, uint32_t **samples,
                      struct block_list *list)
{
    const struct bake_tile *of = &job->tiles[tile];
    const struct bake_raster_options options = {.width = of->options.width,
                                                .height = of->options.height,
                                                .samples = 1,
                                                .patch_side = of->blocks.side,
                                                .first = of->udim.first,
                                                .count = of->udim.count};
    struct bake_raster_report counts = {0};
    struct bake_raster *raster = NULL;
    int status;
    BSQ_TRY(bake_raster_create(job->ctx, &job->mesh, &options, &counts, &raster));
    job->report->degenerate_uv_triangles += counts.degenerate_triangles;
    bake_raster_kernel_triangles(raster, job->surface.translation, job->surface.unit,
                                 job->triangles);
    const uint32_t found = bake_raster_patch_count(raster);
    BSQ_TRY(BSQ_GROW(job->ctx, "blocks", list->count + found, &list->blocks, &list->capacity));
    if (found == 0)
        goto done;
    struct bake_share_block *added = list->blocks + list->count;
    struct counting counting = {job, raster, &of->blocks, added, tile, samples};
    BSQ_TRY(bsq_parallel_for(job->ctx, found, count_block, &counting));
    for (uint32_t i = 0; i < found; i++)
        if (added[i].samples > 0)
            list->blocks[list->count++] = added[i];
done:
    bake_raster_free(raster);
    return status;
}

/* ---- dividing ---- */

static int compare_blocks(const void *a, const void *b)
{
    const struct bake_share_block *x = a, *y = b;
    if (x->index != y->index)
        return x->index < y->index ? -1 : 1;
    if (x->tile != y->tile)
        return x->tile < y->tile ? -1 : 1;
    return (x->block > y->block) - (x->block < y->block);
}

/* Returns the work in a block: its samples, and what each block costs. */
static uint64_t weight_of(const struct bake_job *job, const struct bake_share_block *block)
{
    const uint32_t side = job->tiles[block->tile].blocks.side;
    return block->samples + side * side / 16u;
}

/* Gives blocks without samples of their own the share of the block before, as samples near an edge
 * may lie in them. */
static void fill_rest(struct bake_tile *tile)
{
    uint32_t share = 0;
    for (uint64_t b = 0; b < (uint64_t)tile->blocks.columns * tile->blocks.rows; b++) {
        if (tile->shares[b] == NO_SHARE)
            tile->shares[b] = share;
        share = tile->shares[b];
    }
}

void bake_share_out(struct bake_job *job, struct bake_share_block *blocks, uint64_t count)
{
    uint64_t all = 0, before = 0;
    bsq_sort(blocks, count, sizeof *blocks, compare_blocks);
    for (uint64_t i = 0; i < count; i++)
        all += weight_of(job, &blocks[i]);
    for (uint64_t i = 0; i < count; i++) {
        const struct bake_share_block *block = &blocks[i];
        const uint64_t weight = weight_of(job, block);
        const uint32_t share =
            (uint32_t)((unsigned __int128)(before + weight / 2) * job->options->parts / all);
        job->tiles[block->tile].shares[block->block] = share;
        job->texels += block->samples;
        job->part_texels += share + 1 == job->options->part ? block->samples : 0;
        before += weight;
    }
    for (uint32_t t = 0; t < job->udim.count; t++)
        fill_rest(&job->tiles[t]);
}

int bake_divide(struct bake_job *job)
{
    const unsigned workers = bsq_threads(job->ctx);
    struct block_list list = {0};
    uint32_t **samples;
    int status;
    BSQ_TRY(BSQ_CALLOC(job->ctx, "samples of blocks", workers, &samples));
    for (unsigned w = 0; w < workers; w++)
        BSQ_TRY(BSQ_ALLOC(job->ctx, "samples of blocks", LARGEST_SIDE * LARGEST_SIDE, &samples[w]));
    BSQ_TRY(bake_arrange_triangles(job));
    BSQ_TRY(bake_cut_blocks(job));
    for (uint32_t t = 0; t < job->udim.count; t++)
        BSQ_TRY(count_tile(job, t, samples, &list));
    bake_share_out(job, list.blocks, list.count);
    status = bsq_check(job->ctx);
done:
    for (unsigned w = 0; samples && w < workers; w++)
        bsq_free(job->ctx, samples[w]);
    BSQ_FREE(job->ctx, samples, list.blocks);
    return status;
}

int bake_take_share(struct bake_job *job, struct bake_tile *tile)
{
    struct bake_blocks *blocks = &tile->blocks;
    const uint64_t count = (uint64_t)blocks->columns * blocks->rows;
    uint32_t *places;
    BSQ_PASS(BSQ_ALLOC(job->ctx, "blocks of a tile", count, &places));
    tile->in_blocks = true;
    blocks->places = places;
    for (uint64_t b = 0; b < count; b++)
        places[b] = tile->shares[b] + 1 == job->options->part ? blocks->count++ : BAKE_NO_PLACE;
    if (blocks->count > UINT32_MAX / blocks->side)
        return bsq_fail(job->ctx, BSQ_EUSAGE, "part %u of %u has too many texels: make more parts",
                        job->options->part, job->options->parts);
    return 0;
}
