/* ptx_reconverge.c - finds where diverged threads of a warp reconverge: at the branch's immediate
 * post-dominator, as on GPUs (Fung, Sham, Yuan, Aamodt, "Dynamic Warp Formation and Scheduling for
 * Efficient GPU Control Flow", 2007, section 2). */
#include <stdlib.h>
#include <string.h>

#include "tests/fake/ptx_internal.h"

/* A basic block: instructions from `first` on without a branch in or out between. */
struct block {
    unsigned first, end, next[2], next_count;
    uint8_t *
        after; /* for each block, whether all paths from here go through it; the last is the exit */
    unsigned after_count;
};

static unsigned split(const struct ptx *ptx, struct block *blocks, unsigned *block_of)
{
    uint8_t *begins = calloc(ptx->count + 1, 1);
    unsigned count = 0;

    begins[0] = 1;
    for (unsigned i = 0; i < ptx->count; i++)
        if (ptx->code[i].row->kind == BRANCH || ptx->code[i].row->kind == RETURN) {
            begins[i + 1] = 1;
            if (ptx->code[i].row->kind == BRANCH)
                begins[ptx->code[i].target] = 1;
        }
    for (unsigned i = 0; i < ptx->count; i++) {
        if (begins[i])
            blocks[count++].first = i;
        block_of[i] = count - 1;
    }
    block_of[ptx->count] = count;
    blocks[count].first = ptx->count;
    free(begins);
    return count;
}

static void link_blocks(const struct ptx *ptx, struct block *blocks, unsigned count,
                        const unsigned *block_of)
{
    for (unsigned b = 0; b < count; b++) {
        struct block *block = &blocks[b];
        const struct instruction *last;
        block->end = blocks[b + 1].first;
        last = &ptx->code[block->end - 1];
        if (last->row->kind == BRANCH)
            block->next[block->next_count++] = block_of[last->target];
        if (last->row->kind == RETURN)
            block->next[block->next_count++] = count;
        else if (last->row->kind != BRANCH || last->guard >= 0)
            block->next[block->next_count++] = b + 1;
    }
}

/* Finds the post-dominators of each block: starts with all and removes blocks until none changes.
 */
static void find_after(struct block *blocks, unsigned count)
{
    bool changed = true;

    while (changed) {
        changed = false;
        for (unsigned b = count; b-- > 0;)
            for (unsigned i = 0; i <= count; i++) {
                bool all = true;
                for (unsigned n = 0; n < blocks[b].next_count; n++)
                    all &= blocks[blocks[b].next[n]].after[i];
                if (i != b && blocks[b].after[i] && !all) {
                    blocks[b].after[i] = 0;
                    changed = true;
                }
            }
    }
    for (unsigned b = 0; b <= count; b++)
        for (unsigned i = 0; i <= count; i++)
            blocks[b].after_count += blocks[b].after[i];
}

void ptx_find_reconvergence(struct ptx *ptx)
{
    struct block *blocks = calloc(ptx->count + 1, sizeof *blocks);
    unsigned *block_of = calloc(ptx->count + 1, sizeof *block_of);
    const unsigned count = split(ptx, blocks, block_of);

    link_blocks(ptx, blocks, count, block_of);
    for (unsigned b = 0; b <= count; b++) {
        blocks[b].after = malloc(count + 1);
        memset(blocks[b].after, b < count, count + 1);
    }
    blocks[count].after[count] = 1;
    find_after(blocks, count);
    for (unsigned b = 0; b < count; b++) {
        unsigned first = count; /* the immediate one: all others come after it */
        for (unsigned i = 0; i < count; i++)
            if (i != b && blocks[b].after[i] && blocks[i].after_count > blocks[first].after_count)
                first = i;
        ptx->code[blocks[b].end - 1].reconverge = blocks[first].first;
    }
    for (unsigned b = 0; b <= count; b++)
        free(blocks[b].after);
    free(blocks);
    free(block_of);
}
