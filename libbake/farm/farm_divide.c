/* farm_divide.c - divides the blocks of a bake's maps among tasks.
 *
 * Blocks are ordered along a curve through the scan, and cut into runs with about as many samples.
 * So neighbours in space have one task, whatever the layout of the charts. */

#include "base/sort_array.h"
#include "libbake/farm/farm.h"

/* The last side keeps the overhead of a block small. A task has BLOCKS_A_TASK blocks or more, if
 * the maps are large enough. */
enum { LARGEST_SIDE = 256, SMALLEST_SIDE = 16, BLOCKS_A_TASK = 64 };

#define NO_TASK UINT32_MAX

static uint64_t blocks_of(const struct bake_baked_tile *tiles, uint32_t tile_count, uint32_t side)
{
    uint64_t blocks = 0;
    for (uint32_t i = 0; i < tile_count; i++)
        blocks += ((tiles[i].width - 1) / side + UINT64_C(1)) *
                  ((tiles[i].height - 1) / side + UINT64_C(1));
    return blocks;
}

uint32_t bake_farm_block_side(const struct bake_baked_tile *tiles, uint32_t tile_count,
                              uint32_t tasks)
{
    uint32_t side = LARGEST_SIDE;
    while (side > SMALLEST_SIDE &&
           blocks_of(tiles, tile_count, side) < (uint64_t)BLOCKS_A_TASK * tasks)
        side /= 2;
    return side;
}

static int compare_blocks(const void *a, const void *b)
{
    const struct bake_farm_block *x = a, *y = b;
    if (x->index != y->index)
        return x->index < y->index ? -1 : 1;
    if (x->tile != y->tile)
        return x->tile < y->tile ? -1 : 1;
    return (x->block > y->block) - (x->block < y->block);
}

/* Returns the work in a block: its samples, and what each block costs. */
static uint64_t weight_of(const struct bake_farm_plan *plan, const struct bake_farm_block *block)
{
    return block->samples + plan->block_side * plan->block_side / 16u;
}

/* Gives blocks without samples of their own the task of the block before, as samples near an edge
 * may lie in them. */
static void fill_rest(struct bake_farm_tile *tile)
{
    uint32_t task = 0;
    for (uint64_t b = 0; b < (uint64_t)tile->columns * tile->rows; b++) {
        if (tile->task_of[b] == NO_TASK)
            tile->task_of[b] = task;
        task = tile->task_of[b];
    }
}

int bake_farm_divide(struct bake_farm_plan *plan, struct bake_farm_block *blocks, uint64_t count)
{
    uint64_t all = 0, before = 0;
    bsq_sort(blocks, count, sizeof *blocks, compare_blocks);
    for (uint32_t t = 0; t < plan->tile_count; t++)
        for (uint64_t b = 0; b < (uint64_t)plan->tiles[t].columns * plan->tiles[t].rows; b++)
            plan->tiles[t].task_of[b] = NO_TASK;
    for (uint64_t i = 0; i < count; i++)
        all += weight_of(plan, &blocks[i]);
    for (uint64_t i = 0; i < count; i++) {
        const uint64_t weight = weight_of(plan, &blocks[i]);
        const uint32_t task =
            (uint32_t)((unsigned __int128)(before + weight / 2) * plan->tasks / all);
        plan->tiles[blocks[i].tile].task_of[blocks[i].block] = task;
        plan->expected[task].texels += blocks[i].samples;
        before += weight;
    }
    for (uint32_t t = 0; t < plan->tile_count; t++)
        fill_rest(&plan->tiles[t]);
    return bsq_check(plan->ctx);
}

int bake_farm_task_blocks(const struct bake_farm_plan *plan, uint32_t tile, uint32_t task,
                          struct bake_blocks *out)
{
    const struct bake_farm_tile *t = &plan->tiles[tile];
    const uint64_t blocks = (uint64_t)t->columns * t->rows;
    uint32_t *slots;
    *out = (struct bake_blocks){.side = plan->block_side, .columns = t->columns, .rows = t->rows};
    int status = bsq_alloc(plan->ctx, "blocks of a tile", blocks, sizeof *slots, &slots);
    if (status < 0)
        return status;
    out->slots = slots;
    for (uint64_t b = 0; b < blocks; b++)
        slots[b] = t->task_of[b] == task ? out->count++ : BAKE_NO_SLOT;
    if (out->count > UINT32_MAX / plan->block_side)
        return bsq_fail(plan->ctx, BSQ_EUSAGE,
                        "%s: task %u has too many texels: make a plan of more tasks", plan->path,
                        task);
    return 0;
}
