/* buckets.c - see buckets.h. */
#include "libvoxel/partition/buckets.h"

#include <string.h>

/* Returns the size of a slab of pages: a huge page if there is much memory. */
static uint64_t slab_bytes(uint64_t page_memory)
{
    return page_memory >= (uint64_t)64 << 20 ? (uint64_t)2 << 20 : (uint64_t)256 << 10;
}

int vox_buckets_init(struct buckets *buckets, struct bsq_ctx *ctx, const char *beside,
                     uint32_t bucket_count, uint32_t used_count, uint64_t page_bytes,
                     uint64_t page_memory)
{
    memset(buckets, 0, sizeof *buckets);
    buckets->ctx = ctx;
    buckets->beside = beside;
    buckets->file = (struct bsq_file)BSQ_FILE_CLOSED;
    buckets->bucket_count = bucket_count;
    buckets->page_bytes = (uint32_t)page_bytes;
    buckets->slab_pages = slab_bytes(page_memory) / page_bytes;
    if (buckets->slab_pages == 0)
        buckets->slab_pages = 1;
    buckets->page_limit = page_memory / page_bytes;
    buckets->buckets_without_page = used_count;
    int status = bsq_calloc(ctx, "buckets", bucket_count, sizeof *buckets->list, &buckets->list);
    for (uint32_t i = 0; status == 0 && i < bucket_count; i++)
        buckets->list[i].first_page = buckets->list[i].last_page = BUCKET_NONE;
    return status;
}

void vox_buckets_free(struct buckets *buckets)
{
    if (!buckets->ctx)
        return;
    for (uint64_t i = 0; i < buckets->slab_count; i++)
        bsq_free(buckets->ctx, buckets->slabs[i]);
    bsq_free(buckets->ctx, buckets->slabs);
    bsq_free(buckets->ctx, buckets->pages);
    bsq_free(buckets->ctx, buckets->list);
    bsq_file_close(buckets->ctx, &buckets->file);
    memset(buckets, 0, sizeof *buckets);
}

/* ---- pages ---- */

static uint8_t *memory_page(const struct buckets *buckets, uint64_t number)
{
    return buckets->slabs[number / buckets->slab_pages] +
           number % buckets->slab_pages * buckets->page_bytes;
}

/* Gives a bucket an empty page of memory to fill. */
static int take_page(struct buckets *buckets, struct bucket *bucket)
{
    int status = 0;
    if (buckets->pages_taken == buckets->slab_count * buckets->slab_pages) {
        status = bsq_grow(buckets->ctx, "buckets", buckets->slab_count + 1, sizeof *buckets->slabs,
                          &buckets->slabs, &buckets->slab_capacity);
        if (status == 0)
            status = bsq_alloc(buckets->ctx, "buckets", buckets->slab_pages, buckets->page_bytes,
                               &buckets->slabs[buckets->slab_count]);
        if (status < 0)
            return status;
        buckets->slab_count++;
    }
    bucket->buffer_page = buckets->pages_taken++;
    bucket->buffer = memory_page(buckets, bucket->buffer_page);
    buckets->buckets_without_page--;
    return 0;
}

/* Appends the full buffer, which is at `place`, to the bucket's list of pages. */
static int list_page(struct buckets *buckets, struct bucket *bucket, uint64_t place)
{
    if (buckets->page_count >= BUCKET_NONE)
        return bsq_fail(buckets->ctx, BSQ_ENOMEM,
                        "the scan is too large for pages of %u bytes; more memory is needed",
                        buckets->page_bytes);
    int status = bsq_grow(buckets->ctx, "buckets", buckets->page_count + 1, sizeof *buckets->pages,
                          &buckets->pages, &buckets->page_capacity);
    if (status < 0)
        return status;
    uint32_t number = (uint32_t)buckets->page_count++;
    buckets->pages[number] = (struct bucket_page){.place = place, .next = BUCKET_NONE};
    if (bucket->last_page == BUCKET_NONE)
        bucket->first_page = number;
    else
        buckets->pages[bucket->last_page].next = number;
    bucket->last_page = number;
    return 0;
}

/* Keeps a full page in memory if all buckets without a page can still get one; else writes it to
 * the file and fills it again. */
static int retire_page(struct buckets *buckets, struct bucket *bucket)
{
    int status;
    if (buckets->pages_taken + buckets->buckets_without_page < buckets->page_limit) {
        status = list_page(buckets, bucket, bucket->buffer_page);
        bucket->buffer = NULL;
        buckets->buckets_without_page++;
    } else {
        if (buckets->file.fd < 0 && (status = bsq_file_temp(buckets->ctx, buckets->beside,
                                                            "sorted tuples", &buckets->file)) < 0)
            return status;
        status = list_page(buckets, bucket, BUCKET_IN_FILE + buckets->file.size);
        if (status == 0)
            status =
                bsq_file_append(buckets->ctx, &buckets->file, bucket->buffer, buckets->page_bytes);
    }
    bucket->fill = 0;
    return status;
}

int vox_buckets_add(struct buckets *buckets, uint32_t number, const void *bytes, uint64_t size,
                    uint64_t items)
{
    struct bucket *bucket = &buckets->list[number];
    const uint8_t *from = bytes;
    int status = 0;
    bucket->bytes += size;
    bucket->items += items;
    while (status == 0 && size > 0) {
        if (!bucket->buffer && (status = take_page(buckets, bucket)) < 0)
            return status;
        uint64_t space = buckets->page_bytes - bucket->fill, part = size < space ? size : space;
        memcpy(bucket->buffer + bucket->fill, from, part);
        bucket->fill += (uint32_t)part;
        from += part;
        size -= part;
        if (bucket->fill == buckets->page_bytes)
            status = retire_page(buckets, bucket);
    }
    return status;
}

/* ---- reading ---- */

static int read_page(const struct buckets *buckets, uint64_t place, uint64_t offset, uint64_t size,
                     uint8_t *to)
{
    if (place & BUCKET_IN_FILE)
        return bsq_file_read(buckets->ctx, &buckets->file, to, size,
                             place - BUCKET_IN_FILE + offset);
    memcpy(to, memory_page(buckets, place) + offset, size);
    return 0;
}

int vox_buckets_read(const struct buckets *buckets, uint32_t number, uint64_t offset, uint64_t size,
                     void *to, struct bucket_cursor *cursor)
{
    const struct bucket *bucket = &buckets->list[number];
    uint8_t *at = to;
    int status = 0;
    if (!cursor->valid)
        *cursor = (struct bucket_cursor){.page = bucket->first_page, .valid = true};
    while (status == 0 && size > 0) {
        uint64_t wanted = offset / buckets->page_bytes, within = offset % buckets->page_bytes;
        uint64_t space = buckets->page_bytes - within, part = size < space ? size : space;
        for (; cursor->page_number < wanted; cursor->page_number++)
            cursor->page = buckets->pages[cursor->page].next;
        if (cursor->page == BUCKET_NONE)
            memcpy(at, bucket->buffer + within, part);
        else
            status = read_page(buckets, buckets->pages[cursor->page].place, within, part, at);
        at += part;
        offset += part;
        size -= part;
    }
    return status;
}
