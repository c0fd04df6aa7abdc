/* cells.h - private to the sorter: records collected by cell, in the order in which they came.
 *
 * Each cell fills a page; full pages stay in memory while that is allowed, then go to one temporary
 * file. Cells share pages' sizes, so record number r of a cell is in its page r / page_records.
 * Adding is for one thread at a time, reading for any. */
#ifndef VOX_CELLS_H
#define VOX_CELLS_H

#include "base/file.h"

#define CELLS_NONE UINT32_MAX

/* Bytes past the end of what cells_read() fills that may be overwritten or read by users. */
#define RECORD_SLACK 8

struct cell_page {
    uint64_t place; /* number of a page in memory, or CELLS_IN_FILE + offset */
    uint32_t next;  /* page of the same cell, or CELLS_NONE */
};
#define CELLS_IN_FILE ((uint64_t)1 << 63)

struct cell {
    uint8_t *buffer;      /* page in memory being filled, or NULL */
    uint64_t buffer_page; /* its number */
    uint32_t fill;        /* records in it */
    uint32_t first_page, last_page;
    uint64_t records;
};

struct cells {
    struct bsq_ctx *ctx;
    uint32_t cell_count, record_bytes, page_records;
    struct cell *list;
    struct cell_page *pages;
    uint64_t page_count, page_capacity;
    /* Memory comes in slabs of pages. A full page may stay only if all cells can still get one. */
    uint8_t **slabs;
    uint64_t slab_count, slab_capacity;
    uint64_t slab_pages, page_limit, pages_taken, cells_without;
    struct bsq_file file;
    const char *beside;
};

/* page_memory: bytes of pages in memory; at least one page a cell is used whatever it says. */
int cells_init(struct cells *cells, struct bsq_ctx *ctx, const char *beside, uint32_t cell_count,
               uint32_t record_bytes, uint64_t page_bytes, uint64_t page_memory);
void cells_free(struct cells *cells);

/* Adds `count` records to a cell. */
int cells_add(struct cells *cells, uint32_t cell, const uint8_t *records, uint64_t count);

/* Copies records [first, first + count) of a cell to `to`. `cursor` remembers the place between
 * calls that go on where the last one ended; start with {0}. */
struct cell_cursor {
    uint64_t page_number; /* of the cell */
    uint32_t page;
    bool valid;
};
int cells_read(const struct cells *cells, uint32_t cell, uint64_t first, uint64_t count, void *to,
               struct cell_cursor *cursor);

#endif
