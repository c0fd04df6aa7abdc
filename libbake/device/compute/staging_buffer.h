/* staging_buffer.h - two halves of host memory through which data goes up to a device.
 *
 * One half is filled while the device copies the other, so the host never copies anything larger.
 * The API allocates the halves and sends them. Only one thread at a time may use a buffer. */
#ifndef BAKE_DEVICE_COMPUTE_STAGING_BUFFER_H
#define BAKE_DEVICE_COMPUTE_STAGING_BUFFER_H

#include <stdint.h>

struct bsq_ctx;

struct bake_staging_buffer {
    char *halves[2]; /* of half_bytes each */
    uint64_t half_bytes;
    unsigned filling; /* the half that is being filled */
    uint64_t used;    /* bytes of it */
    /* Sends `bytes` of a half to the device, after the bytes sent before. Returns when the other
     * half may be filled: 0 or a negative status, which the functions below pass on. */
    int (*send)(void *device, unsigned half, uint64_t bytes);
    void *device;
    /* Its threads fill a half together: one thread reads a mapped file several times slower than a
     * device empties the buffer. NULL: the calling thread alone, while the others trace. */
    struct bsq_ctx *ctx;
};

/* Appends data, and sends each half that is full. staging: a struct bake_staging_buffer, so that
 * this can be the sink of bake_subgrid_send(). */
int bake_staging_put(void *staging, const void *data, uint64_t bytes);

/* Sends the half that is being filled. */
int bake_staging_flush(struct bake_staging_buffer *staging);

#endif
