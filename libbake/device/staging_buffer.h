/* staging_buffer.h - two pieces of host memory through which data goes up to a device: one is
 * filled while the device takes the other, so that nothing larger is copied on the host. Each kind
 * of device brings the pieces and the way to send one; one thread at a time. */
#ifndef BAKE_DEVICE_STAGING_BUFFER_H
#define BAKE_DEVICE_STAGING_BUFFER_H

#include <stdint.h>

struct bsq_ctx;

struct bake_stage {
    char *pieces[2]; /* of piece_bytes each */
    uint64_t piece_bytes;
    unsigned turn; /* which is filled */
    uint64_t used; /* bytes of it */
    /* Makes the device take `bytes` of a piece to where the bytes before went, and returns when the
     * other piece may be filled. 0 or a negative status, which the functions below pass on. */
    int (*send)(void *device, unsigned turn, uint64_t bytes);
    void *device;
    /* Whose threads fill a piece together: one thread takes a file's pages several times slower
     * than a device takes them from the piece. NULL: the calling thread, where the others are busy.
     */
    struct bsq_ctx *ctx;
};

/* Sends bytes of data behind those that were put there before. stage: a struct bake_stage, so that
 * bake_part_send() can call this. */
int bake_stage_put(void *stage, const void *data, uint64_t bytes);

/* Sends what is in the piece whose turn it is. */
int bake_stage_flush(struct bake_stage *stage);

#endif
