/* radix_sort.h - sorts triangles by key. */
#ifndef VOX_CHUNK_RADIX_SORT_H
#define VOX_CHUNK_RADIX_SORT_H

#include <stdint.h>

struct entry {
    uint64_t key;
    uint32_t record; /* number in the batch */
    uint32_t unused;
};

/* Sorts by key; entries with equal keys keep their order. Keys may differ only in their low `bits`
 * bits. scratch: n entries. */
void vox_radix_sort(struct entry *entries, struct entry *scratch, uint64_t n, uint32_t bits);

#endif
