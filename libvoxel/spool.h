/* spool.h - private to the sorter: bytes that only grow, in memory or in a temporary file.
 *
 * A spool keeps what is appended in segments of equal size; spool_spill() moves all of it to a
 * temporary file and keeps one segment as write buffer. Elements do not straddle segments when the
 * segment size is a multiple of theirs. Appending is for one thread at a time, reading for any. */
#ifndef VOX_SPOOL_H
#define VOX_SPOOL_H

#include "base/file.h"

struct spool {
    struct bsq_ctx *ctx;
    const char *what;   /* for messages */
    const char *beside; /* output path, for the temporary file's place */
    uint64_t segment_bytes;
    uint64_t bytes; /* appended so far */
    uint8_t **segments;
    uint64_t segment_count, segment_capacity;
    struct bsq_file file;
    bool spilled;
};

void spool_init(struct spool *spool, struct bsq_ctx *ctx, const char *what, const char *beside,
                uint64_t segment_bytes);
void spool_free(struct spool *spool);

/* Bytes of memory that the next spool_room() will allocate. */
uint64_t spool_room_cost(const struct spool *spool);

/* Contiguous room for at least one byte at the end; spool_advance() says how much was used. */
int spool_room(struct spool *spool, uint8_t **at, uint64_t *room);
void spool_advance(struct spool *spool, uint64_t bytes);

/* Moves the content to a temporary file and frees all but one segment. */
int spool_spill(struct spool *spool);
/* Writes what is still buffered; call once after the last append. Frees the buffer if spilled. */
int spool_finish(struct spool *spool);

uint64_t spool_memory(const struct spool *spool);

/* Copies bytes [offset, offset + size) out. A spilled spool must be finished. */
int spool_read(const struct spool *spool, uint64_t offset, uint64_t size, void *buffer);

#endif
