/* spill.h - byte strings that only grow (streams), in memory and in one temporary file.
 *
 * Each stream fills a page. Full pages stay in memory up to a limit; after that, they go to a
 * temporary file. All pages have the same size, so byte i of a stream is in its page
 * i / page_bytes. One thread at a time may append, any thread may read. */
#ifndef BSQ_SPILL_H
#define BSQ_SPILL_H

#include "base/file.h"

#define BSQ_SPILL_NONE UINT32_MAX

struct bsq_spill_page {
    uint64_t place; /* number of a page in memory, or BSQ_SPILL_IN_FILE + offset */
    uint32_t next;  /* next page of the same stream, or BSQ_SPILL_NONE */
};
#define BSQ_SPILL_IN_FILE ((uint64_t)1 << 63)

struct bsq_spill_stream {
    uint8_t *buffer;      /* page in memory being filled, or NULL */
    uint64_t buffer_page; /* its number */
    uint32_t fill;        /* bytes in it */
    uint32_t first_page, last_page;
    uint64_t bytes; /* appended so far */
    uint64_t items; /* for the caller to count */
};

struct bsq_spill {
    struct bsq_ctx *ctx;
    const char *what;   /* for messages */
    const char *beside; /* output path, next to which the temporary file may be */
    uint32_t stream_count, page_bytes;
    struct bsq_spill_stream *list;
    struct bsq_spill_page *pages; /* full ones, in the order in which they became full */
    uint64_t page_count, page_capacity;
    /* Slabs of `slab_pages` pages in memory; of a single stream, each page is a slab. A full page
     * stays only if all streams can still get one. */
    uint8_t **slabs;
    uint64_t slab_count, slab_capacity;
    uint64_t slab_pages, page_limit, pages_taken, streams_without_page;
    struct bsq_file file; /* closed as long as all pages are in memory */
};

/* Makes empty streams. used_count: those that anything is appended to, at most. memory: limit in
 * bytes for pages in memory, but each used stream gets one page in any case. Free them with
 * bsq_spill_free(), also after failure. Errors: BSQ_ENOMEM. */
int bsq_spill_init(struct bsq_spill *spill, struct bsq_ctx *ctx, const char *what,
                   const char *beside, uint32_t stream_count, uint32_t used_count,
                   uint64_t page_bytes, uint64_t memory);
/* A spill of all zeros is allowed. */
void bsq_spill_free(struct bsq_spill *spill);

/* Returns in *at the end of a stream, with a contiguous *capacity of at least one byte. The caller
 * fills it and calls bsq_spill_advance(). Errors: BSQ_ENOMEM. */
int bsq_spill_reserve(struct bsq_spill *spill, uint32_t stream, uint8_t **at, uint64_t *capacity);
/* Appends the first `bytes` bytes of what was reserved. Errors: BSQ_ENOMEM; BSQ_ECANTCREAT and
 * BSQ_EIO of the temporary file. */
int bsq_spill_advance(struct bsq_spill *spill, uint32_t stream, uint64_t bytes);
/* Appends bytes to a stream. Errors: those of both functions above. */
int bsq_spill_add(struct bsq_spill *spill, uint32_t stream, const void *bytes, uint64_t size);

/* Moves all full pages to the file and frees their memory; later ones go there too. `end`: also
 * those that are not full, and nothing can be appended any more. The spill must have a single
 * stream, or pages of 256 KiB or more and a limit of 0. Errors: those of bsq_spill_advance(). */
int bsq_spill_evict(struct bsq_spill *spill, bool end);
/* Returns whether full pages go to the file. */
static inline bool bsq_spill_in_file(const struct bsq_spill *spill)
{
    return spill->ctx && spill->file.fd >= 0;
}

/* Remembers the page that was read last. Starts as {0}; offsets must not decrease between calls. */
struct bsq_spill_cursor {
    uint64_t page_number; /* within the stream */
    uint32_t page;
    bool valid;
};
/* Copies bytes [offset, offset + size) of a stream to `to`. `cursor` may be NULL for a single
 * stream. Errors: BSQ_EIO. */
int bsq_spill_read(const struct bsq_spill *spill, uint32_t stream, uint64_t offset, uint64_t size,
                   void *to, struct bsq_spill_cursor *cursor);

#endif
