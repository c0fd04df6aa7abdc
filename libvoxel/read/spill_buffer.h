/* spill_buffer.h - bytes that only grow, in memory or in a temporary file.
 *
 * Appended bytes are kept in segments of equal size. vox_spill_spill() moves all of them to a
 * temporary file and keeps one segment as write buffer. Elements do not straddle segments if the
 * segment size is a multiple of theirs. One thread at a time may append, any thread may read.
 *
 * The system takes longer to find and clear new memory than this code takes to fill it, so other
 * threads prefault it shortly before (vox_spill_touch_ahead()). */
#ifndef VOX_READ_SPILL_BUFFER_H
#define VOX_READ_SPILL_BUFFER_H

#include <pthread.h>

#include "base/file.h"

struct spill_buffer {
    struct bsq_ctx *ctx;
    const char *what;   /* for messages */
    const char *beside; /* output path, for the temporary file's place */
    uint64_t segment_bytes;
    uint64_t bytes; /* appended so far */
    uint8_t **segments;
    uint64_t segment_count, segment_capacity;
    struct bsq_file file;
    bool spilled;
    /* What of the last segment nobody has touched, as far as is known, and where the next bytes go.
     */
    pthread_mutex_t lock; /* of these */
    uint8_t *untouched, *untouched_end, *head;
};

void vox_spill_init(struct spill_buffer *spill, struct bsq_ctx *ctx, const char *what,
                    const char *beside, uint64_t segment_bytes);
void vox_spill_free(struct spill_buffer *spill);

/* Bytes of memory that the next vox_spill_room() will allocate. */
uint64_t vox_spill_room_cost(const struct spill_buffer *spill);

/* Contiguous room for at least one byte at the end; vox_spill_advance() says how much was used. */
int vox_spill_room(struct spill_buffer *spill, uint8_t **at, uint64_t *room);
void vox_spill_advance(struct spill_buffer *spill, uint64_t bytes);

/* Touches some of the memory that is to be filled next. From any thread while one appends. */
void vox_spill_touch_ahead(struct spill_buffer *spill);

/* Moves the content to a temporary file and frees all but one segment. */
int vox_spill_spill(struct spill_buffer *spill);
/* Writes what is still buffered; call once after the last append. Frees the buffer if spilled. */
int vox_spill_finish(struct spill_buffer *spill);

uint64_t vox_spill_memory(const struct spill_buffer *spill);

/* Copies bytes [offset, offset + size) out. A spilled spill must be finished. */
int vox_spill_read(const struct spill_buffer *spill, uint64_t offset, uint64_t size, void *buffer);

#endif
