/* stream_pager.c - see stream_pager.h. The page to go is found by the clock method, an
 * approximation of least recently used that costs one store for each access (Corbato, "A Paging
 * Experiment with the Multics System", 1968). */
#include "libvoxel/read/stream_pager.h"

#include <assert.h>
#include <string.h>

static uint64_t page_bytes(const struct pager *pager)
{
    return (uint64_t)pager->column->element_bytes << PAGER_SHIFT;
}

int vox_pager_open(struct pager *pager, const struct column *column, uint64_t bytes)
{
    struct bsq_ctx *ctx = column->spool.ctx;
    int status;
    assert(column->element_bytes > 0);
    memset(pager, 0, sizeof *pager);
    pager->column = column;
    pager->page_count = (column_count(column) >> PAGER_SHIFT) + 1;
    pager->frame_count = bytes / page_bytes(pager);
    if (pager->frame_count > pager->page_count)
        pager->frame_count = pager->page_count;
    if (pager->frame_count < 2)
        pager->frame_count = 2;
    if ((status = bsq_alloc(ctx, "vertex pages", pager->page_count, 4, &pager->frame_of)) < 0 ||
        (status = bsq_alloc(ctx, "vertex pages", pager->frame_count, 8, &pager->page_of)) < 0 ||
        (status = bsq_calloc(ctx, "vertex pages", pager->frame_count, sizeof *pager->touched,
                             &pager->touched)) < 0 ||
        (status = bsq_alloc(ctx, "vertex pages", pager->frame_count, page_bytes(pager),
                            &pager->frames)) < 0)
        return status;
    memset(pager->frame_of, 0xff, pager->page_count * sizeof *pager->frame_of);
    memset(pager->page_of, 0xff, pager->frame_count * sizeof *pager->page_of);
    return 0;
}

void vox_pager_close(struct pager *pager)
{
    if (!pager->column)
        return;
    struct bsq_ctx *ctx = pager->column->spool.ctx;
    bsq_free(ctx, pager->frames);
    bsq_free(ctx, pager->touched);
    bsq_free(ctx, pager->page_of);
    bsq_free(ctx, pager->frame_of);
    memset(pager, 0, sizeof *pager);
}

static uint64_t free_frame(struct pager *pager)
{
    for (;;) {
        uint64_t frame = pager->hand;
        pager->hand = (frame + 1) % pager->frame_count;
        if (!pager->touched[frame])
            return frame;
        pager->touched[frame] = false;
    }
}

int vox_pager_load(struct pager *pager, uint64_t page)
{
    uint64_t frame = free_frame(pager), bytes = page_bytes(pager), offset = page * bytes;
    if (pager->page_of[frame] != UINT64_MAX)
        pager->frame_of[pager->page_of[frame]] = PAGER_NONE;
    pager->page_of[frame] = UINT64_MAX;
    if (bytes > pager->column->spool.bytes - offset)
        bytes = pager->column->spool.bytes - offset;
    int status = vox_spill_read(&pager->column->spool, offset, bytes,
                                pager->frames + frame * page_bytes(pager));
    if (status < 0)
        return status;
    pager->bytes_read += bytes;
    pager->page_of[frame] = page;
    pager->frame_of[page] = (uint32_t)frame;
    return 0;
}
