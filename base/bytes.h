/* bytes.h - numbers of files whose byte order is little-endian, at any address. */
#ifndef BSQ_BYTES_H
#define BSQ_BYTES_H

#include <stdint.h>

/* Returns a number of up to 8 bytes. */
static inline uint64_t bsq_little(const void *from, unsigned bytes)
{
    const uint8_t *p = from;
    uint64_t value = 0;
    for (unsigned i = 0; i < bytes; i++)
        value |= (uint64_t)p[i] << 8 * i;
    return value;
}

#endif
