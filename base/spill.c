/* spill.c - see spill.h. */
#include "base/spill.h"

#include <assert.h>
#include <string.h>

/* Returns the size of a slab of pages: a huge page if there is much memory. */
static uint64_t slab_bytes(uint64_t memory)
{
    return memory >= (uint64_t)64 << 20 ? (uint64_t)2 << 20 : (uint64_t)256 << 10;
}

int bsq_spill_init(struct bsq_spill *spill, struct bsq_ctx *ctx, const char *what,
                   const char *beside, uint32_t stream_count, uint32_t used_count,
                   uint64_t page_bytes, uint64_t memory)
{
    *spill = (struct bsq_spill){.ctx = ctx,
                                .what = what,
                                .beside = beside,
                                .stream_count = stream_count,
                                .page_bytes = (uint32_t)page_bytes,
                                .slab_pages = slab_bytes(memory) / page_bytes,
                                .page_limit = memory / page_bytes,
                                .streams_without_page = used_count,
                                .file = BSQ_FILE_CLOSED};
    if (spill->slab_pages == 0 || stream_count == 1)
        spill->slab_pages = 1;
    int status = BSQ_CALLOC(ctx, what, stream_count, &spill->list);
    for (uint32_t i = 0; status == 0 && i < stream_count; i++)
        spill->list[i].first_page = spill->list[i].last_page = BSQ_SPILL_NONE;
    return status;
}

static void free_slabs(struct bsq_spill *spill)
{
    for (uint64_t i = 0; i < spill->slab_count; i++)
        bsq_free(spill->ctx, spill->slabs[i]);
    spill->slab_count = 0;
}

void bsq_spill_free(struct bsq_spill *spill)
{
    if (!spill->ctx)
        return;
    free_slabs(spill);
    BSQ_FREE(spill->ctx, spill->slabs, spill->pages, spill->list);
    bsq_file_close(spill->ctx, &spill->file);
    memset(spill, 0, sizeof *spill);
}

/* ---- pages ---- */

static uint8_t *memory_page(const struct bsq_spill *spill, uint64_t number)
{
    return spill->slabs[number / spill->slab_pages] +
           number % spill->slab_pages * spill->page_bytes;
}

/* Gives a stream an empty page of memory to fill. */
static int take_page(struct bsq_spill *spill, struct bsq_spill_stream *stream)
{
    if (spill->pages_taken == spill->slab_count * spill->slab_pages) {
        BSQ_PASS(BSQ_GROW(spill->ctx, spill->what, spill->slab_count + 1, &spill->slabs,
                          &spill->slab_capacity));
        BSQ_PASS(bsq_alloc(spill->ctx, spill->what, spill->slab_pages, spill->page_bytes,
                           &spill->slabs[spill->slab_count]));
        spill->slab_count++;
    }
    stream->buffer_page = spill->pages_taken++;
    stream->buffer = memory_page(spill, stream->buffer_page);
    spill->streams_without_page--;
    return 0;
}

/* Appends the page being filled, which is at `place`, to the stream's list of pages. */
static int list_page(struct bsq_spill *spill, struct bsq_spill_stream *stream, uint64_t place)
{
    if (spill->page_count >= BSQ_SPILL_NONE)
        return bsq_fail(spill->ctx, BSQ_ENOMEM,
                        "%s: too many pages of %u bytes; more memory is needed", spill->what,
                        spill->page_bytes);
    BSQ_PASS(BSQ_GROW(spill->ctx, spill->what, spill->page_count + 1, &spill->pages,
                      &spill->page_capacity));
    uint32_t number = (uint32_t)spill->page_count++;
    spill->pages[number] = (struct bsq_spill_page){.place = place, .next = BSQ_SPILL_NONE};
    if (stream->last_page == BSQ_SPILL_NONE)
        stream->first_page = number;
    else
        spill->pages[stream->last_page].next = number;
    stream->last_page = number;
    stream->fill = 0;
    return 0;
}

static int open_file(struct bsq_spill *spill)
{
    return spill->file.fd >= 0
               ? 0
               : bsq_file_temp(spill->ctx, spill->beside, spill->what, &spill->file);
}

/* Appends a page to the file, and sets *place to where it is. */
static int write_page(struct bsq_spill *spill, const uint8_t *page, uint64_t size, uint64_t *place)
{
    int status = open_file(spill);
    *place = BSQ_SPILL_IN_FILE + spill->file.size;
    return status < 0 ? status : bsq_file_append(spill->ctx, &spill->file, page, size);
}

/* Keeps a full page in memory if all streams without a page can still get one; else writes it to
 * the file and fills it again. */
static int retire_page(struct bsq_spill *spill, struct bsq_spill_stream *stream)
{
    uint64_t place = stream->buffer_page;
    int status = 0;
    if (spill->pages_taken + spill->streams_without_page < spill->page_limit) {
        stream->buffer = NULL;
        spill->streams_without_page++;
    } else {
        status = write_page(spill, stream->buffer, spill->page_bytes, &place);
    }
    return status < 0 ? status : list_page(spill, stream, place);
}

/* ---- appending ---- */

int bsq_spill_reserve(struct bsq_spill *spill, uint32_t number, uint8_t **at, uint64_t *capacity)
{
    struct bsq_spill_stream *stream = &spill->list[number];
    BSQ_PASS(stream->buffer ? 0 : take_page(spill, stream));
    *at = stream->buffer + stream->fill;
    *capacity = spill->page_bytes - stream->fill;
    return 0;
}

int bsq_spill_advance(struct bsq_spill *spill, uint32_t number, uint64_t bytes)
{
    struct bsq_spill_stream *stream = &spill->list[number];
    stream->bytes += bytes;
    stream->fill += (uint32_t)bytes;
    return stream->fill == spill->page_bytes ? retire_page(spill, stream) : 0;
}

int bsq_spill_add(struct bsq_spill *spill, uint32_t number, const void *bytes, uint64_t size)
{
    struct bsq_spill_stream *stream = &spill->list[number];
    const uint8_t *from = bytes;
    int status = 0;
    stream->bytes += size;
    while (status == 0 && size > 0) {
        if (!stream->buffer && (status = take_page(spill, stream)) < 0)
            return status;
        const uint64_t space = spill->page_bytes - stream->fill, step = size < space ? size : space;
        memcpy(stream->buffer + stream->fill, from, step);
        stream->fill += (uint32_t)step;
        from += step;
        size -= step;
        if (stream->fill == spill->page_bytes)
            status = retire_page(spill, stream);
    }
    return status;
}

/* ---- eviction ---- */

int bsq_spill_evict(struct bsq_spill *spill, bool end)
{
    assert(spill->slab_pages == 1);
    BSQ_PASS(open_file(spill));
    spill->page_limit = 0;
    for (uint64_t i = 0; i < spill->page_count; i++) {
        struct bsq_spill_page *page = &spill->pages[i];
        if (page->place & BSQ_SPILL_IN_FILE)
            continue;
        uint8_t **slab = &spill->slabs[page->place];
        BSQ_PASS(write_page(spill, *slab, spill->page_bytes, &page->place));
        bsq_free(spill->ctx, *slab);
        *slab = NULL;
    }
    for (uint32_t i = 0; i < spill->stream_count && end; i++) {
        struct bsq_spill_stream *stream = &spill->list[i];
        uint64_t place;
        if (stream->fill > 0) {
            BSQ_PASS(write_page(spill, stream->buffer, stream->fill, &place));
            BSQ_PASS(list_page(spill, stream, place));
        }
        stream->buffer = NULL;
    }
    if (end)
        free_slabs(spill);
    return 0;
}

/* ---- reading ---- */

/* Returns the number of a stream's page; BSQ_SPILL_NONE: it is being filled. */
static uint32_t find_page(const struct bsq_spill *spill, const struct bsq_spill_stream *stream,
                          uint64_t wanted, struct bsq_spill_cursor *cursor)
{
    if (spill->stream_count == 1) /* its pages follow each other */
        return wanted < spill->page_count ? (uint32_t)wanted : BSQ_SPILL_NONE;
    if (!cursor->valid)
        *cursor = (struct bsq_spill_cursor){.page = stream->first_page, .valid = true};
    for (; cursor->page_number < wanted; cursor->page_number++)
        cursor->page = spill->pages[cursor->page].next;
    return cursor->page;
}

static int read_page(const struct bsq_spill *spill, uint64_t place, uint64_t offset, uint64_t size,
                     uint8_t *to)
{
    if (place & BSQ_SPILL_IN_FILE)
        return bsq_file_read(spill->ctx, &spill->file, to, size,
                             place - BSQ_SPILL_IN_FILE + offset);
    memcpy(to, memory_page(spill, place) + offset, size);
    return 0;
}

int bsq_spill_read(const struct bsq_spill *spill, uint32_t number, uint64_t offset, uint64_t size,
                   void *to, struct bsq_spill_cursor *cursor)
{
    const struct bsq_spill_stream *stream = &spill->list[number];
    uint8_t *at = to;
    int status = 0;
    for (uint64_t step; status == 0 && size > 0; at += step, offset += step, size -= step) {
        const uint64_t within = offset % spill->page_bytes, space = spill->page_bytes - within;
        const uint32_t page = find_page(spill, stream, offset / spill->page_bytes, cursor);
        step = size < space ? size : space;
        if (page == BSQ_SPILL_NONE)
            memcpy(at, stream->buffer + within, step);
        else
            status = read_page(spill, spill->pages[page].place, within, step, at);
    }
    return status;
}
