/* buckets.h - byte strings that are appended to, one for each bucket.
 *
 * Each bucket fills a page. Full pages stay in memory up to a limit, and then go to one temporary
 * file. All pages have the same size, so byte i of a bucket is in its page i / page_bytes. One
 * thread at a time may add, any thread may read. */
#ifndef VOX_PARTITION_BUCKETS_H
#define VOX_PARTITION_BUCKETS_H

#include "base/file.h"

#define BUCKET_NONE UINT32_MAX

struct bucket_page {
    uint64_t place; /* number of a page in memory, or BUCKET_IN_FILE + offset */
    uint32_t next;  /* next page of the same bucket, or BUCKET_NONE */
};
#define BUCKET_IN_FILE ((uint64_t)1 << 63)

struct bucket {
    uint8_t *buffer;      /* page in memory being filled, or NULL */
    uint64_t buffer_page; /* its number */
    uint32_t fill;        /* bytes in it */
    uint32_t first_page, last_page;
    uint64_t bytes, items; /* added so far */
};

struct buckets {
    struct bsq_ctx *ctx;
    uint32_t bucket_count, page_bytes;
    struct bucket *list;
    struct bucket_page *pages;
    uint64_t page_count, page_capacity;
    /* Slabs of `slab_pages` pages. A full page stays only if all buckets can still get one. */
    uint8_t **slabs;
    uint64_t slab_count, slab_capacity;
    uint64_t slab_pages, page_limit, pages_taken, buckets_without_page;
    struct bsq_file file;
    const char *beside; /* output path, next to which the temporary file may be */
};

/* Makes empty buckets. used_count: those that anything is added to, at most. page_memory: limit in
 * bytes for pages in memory, but each used bucket gets one page in any case. Free them with
 * vox_buckets_free(), also after failure. */
int vox_buckets_init(struct buckets *buckets, struct bsq_ctx *ctx, const char *beside,
                     uint32_t bucket_count, uint32_t used_count, uint64_t page_bytes,
                     uint64_t page_memory);
void vox_buckets_free(struct buckets *buckets);

/* Appends `size` bytes, which encode `items` items, to a bucket. */
int vox_buckets_add(struct buckets *buckets, uint32_t bucket, const void *bytes, uint64_t size,
                    uint64_t items);

/* Remembers the page that was read last. Starts as {0}; offsets must not decrease between calls. */
struct bucket_cursor {
    uint64_t page_number; /* within the bucket */
    uint32_t page;
    bool valid;
};
/* Copies bytes [offset, offset + size) of a bucket to `to`. */
int vox_buckets_read(const struct buckets *buckets, uint32_t bucket, uint64_t offset, uint64_t size,
                     void *to, struct bucket_cursor *cursor);

#endif
