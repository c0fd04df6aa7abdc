/* packing.h - makes packed files for the tests of formats/input and of the mesh readers. */
#ifndef TEST_PACKING_H
#define TEST_PACKING_H

#include <stddef.h>
#include <stdint.h>

/* Bytes that grow. Free `data` with free(). */
struct packed {
    uint8_t *data;
    size_t size;
};

/* Append a gzip member, or a Zstandard frame, with these bytes. window_log: 0 for the usual one. */
void pack_gzip(struct packed *to, const void *from, size_t size, int level);
void pack_zstd(struct packed *to, const void *from, size_t size, int window_log);
void pack_bytes(struct packed *to, const void *from, size_t size);

#endif
