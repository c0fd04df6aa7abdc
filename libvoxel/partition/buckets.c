/* buckets.c - see buckets.h. */
#include "libvoxel/partition/buckets.h"

#include <string.h>

/* Memory comes in slabs of at least one page, huge pages where there is much of it. */
static uint64_t slab_bytes(uint64_t page_memory)
{
    return page_memory >= (uint64_t)64 << 20 ? (uint64_t)2 << 20 : (uint64_t)256 << 10;
}

int vox_buckets_init(struct cells *cells, struct bsq_ctx *ctx, const char *beside,
                     uint32_t cell_count, uint64_t page_bytes, uint64_t page_memory)
{
    memset(cells, 0, sizeof *cells);
    cells->ctx = ctx;
    cells->beside = beside;
    cells->file = (struct bsq_file)BSQ_FILE_CLOSED;
    cells->cell_count = cell_count;
    cells->page_bytes = (uint32_t)page_bytes;
    cells->slab_pages = slab_bytes(page_memory) / page_bytes;
    if (cells->slab_pages == 0)
        cells->slab_pages = 1;
    cells->page_limit = page_memory / page_bytes;
    cells->cells_without = cell_count;
    int status = bsq_calloc(ctx, "cells", cell_count, sizeof *cells->list, &cells->list);
    for (uint32_t i = 0; status == 0 && i < cell_count; i++)
        cells->list[i].first_page = cells->list[i].last_page = CELLS_NONE;
    return status;
}

void vox_buckets_free(struct cells *cells)
{
    if (!cells->ctx)
        return;
    for (uint64_t i = 0; i < cells->slab_count; i++)
        bsq_free(cells->ctx, cells->slabs[i]);
    bsq_free(cells->ctx, cells->slabs);
    bsq_free(cells->ctx, cells->pages);
    bsq_free(cells->ctx, cells->list);
    bsq_file_close(cells->ctx, &cells->file);
    memset(cells, 0, sizeof *cells);
}

/* ---- pages ---- */

static uint8_t *memory_page(const struct cells *cells, uint64_t number)
{
    return cells->slabs[number / cells->slab_pages] +
           number % cells->slab_pages * cells->page_bytes;
}

/* Gives a cell an empty page to fill. */
static int take_page(struct cells *cells, struct cell *cell)
{
    int status = 0;
    if (cells->pages_taken == cells->slab_count * cells->slab_pages) {
        status = bsq_grow(cells->ctx, "cells", cells->slab_count + 1, sizeof *cells->slabs,
                          &cells->slabs, &cells->slab_capacity);
        if (status == 0)
            status = bsq_alloc(cells->ctx, "cells", cells->slab_pages, cells->page_bytes,
                               &cells->slabs[cells->slab_count]);
        if (status < 0)
            return status;
        cells->slab_count++;
    }
    cell->buffer_page = cells->pages_taken++;
    cell->buffer = memory_page(cells, cell->buffer_page);
    cells->cells_without--;
    return 0;
}

/* Enters the cell's buffer as its next page, at `place`. */
static int list_page(struct cells *cells, struct cell *cell, uint64_t place)
{
    if (cells->page_count >= CELLS_NONE)
        return bsq_fail(cells->ctx, BSQ_EUSAGE,
                        "the scan is too large for pages of %u bytes; more memory is needed",
                        cells->page_bytes);
    int status = bsq_grow(cells->ctx, "cells", cells->page_count + 1, sizeof *cells->pages,
                          &cells->pages, &cells->page_capacity);
    if (status < 0)
        return status;
    uint32_t number = (uint32_t)cells->page_count++;
    cells->pages[number] = (struct cell_page){.place = place, .next = CELLS_NONE};
    if (cell->last_page == CELLS_NONE)
        cell->first_page = number;
    else
        cells->pages[cell->last_page].next = number;
    cell->last_page = number;
    return 0;
}

static int retire_page(struct cells *cells, struct cell *cell)
{
    int status;
    if (cells->pages_taken + cells->cells_without < cells->page_limit) {
        status = list_page(cells, cell, cell->buffer_page);
        cell->buffer = NULL;
        cells->cells_without++;
    } else {
        if (cells->file.fd < 0 &&
            (status = bsq_file_temp(cells->ctx, cells->beside, "sorted records", &cells->file)) < 0)
            return status;
        status = list_page(cells, cell, CELLS_IN_FILE + cells->file.size);
        if (status == 0)
            status = bsq_file_append(cells->ctx, &cells->file, cell->buffer, cells->page_bytes);
    }
    cell->fill = 0;
    return status;
}

int vox_buckets_add(struct cells *cells, uint32_t number, const void *bytes, uint64_t size,
                    uint64_t items)
{
    struct cell *cell = &cells->list[number];
    const uint8_t *from = bytes;
    int status = 0;
    cell->bytes += size;
    cell->items += items;
    while (status == 0 && size > 0) {
        if (!cell->buffer && (status = take_page(cells, cell)) < 0)
            return status;
        uint64_t room = cells->page_bytes - cell->fill, part = size < room ? size : room;
        memcpy(cell->buffer + cell->fill, from, part);
        cell->fill += (uint32_t)part;
        from += part;
        size -= part;
        if (cell->fill == cells->page_bytes)
            status = retire_page(cells, cell);
    }
    return status;
}

/* ---- reading ---- */

static int read_page(const struct cells *cells, uint64_t place, uint64_t offset, uint64_t size,
                     uint8_t *to)
{
    if (place & CELLS_IN_FILE)
        return bsq_file_read(cells->ctx, &cells->file, to, size, place - CELLS_IN_FILE + offset);
    memcpy(to, memory_page(cells, place) + offset, size);
    return 0;
}

int vox_buckets_read(const struct cells *cells, uint32_t number, uint64_t offset, uint64_t size,
                     void *to, struct cell_cursor *cursor)
{
    const struct cell *cell = &cells->list[number];
    uint8_t *at = to;
    int status = 0;
    if (!cursor->valid)
        *cursor = (struct cell_cursor){.page = cell->first_page, .valid = true};
    while (status == 0 && size > 0) {
        uint64_t wanted = offset / cells->page_bytes, within = offset % cells->page_bytes;
        uint64_t room = cells->page_bytes - within, part = size < room ? size : room;
        for (; cursor->page_number < wanted; cursor->page_number++)
            cursor->page = cells->pages[cursor->page].next;
        if (cursor->page == CELLS_NONE)
            memcpy(at, cell->buffer + within, part);
        else
            status = read_page(cells, cells->pages[cursor->page].place, within, part, at);
        at += part;
        offset += part;
        size -= part;
    }
    return status;
}
