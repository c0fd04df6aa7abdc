/* radix_sort.h - sorts by key, and finds where a sorted sequence is cut into chunks. */
#ifndef VOX_CHUNK_RADIX_SORT_H
#define VOX_CHUNK_RADIX_SORT_H

#include <stdint.h>

struct entry {
    uint64_t key;
    uint32_t record; /* number in the batch */
    uint32_t unused;
};

/* Sorts by key; entries with equal keys keep their order. Keys differ in their low `bits` bits
 * only. scratch: room for n entries. */
void vox_radix_sort(struct entry *entries, struct entry *scratch, uint64_t n, uint32_t bits);

/* Number of the sorted entries that the first chunk takes, n > FMT_TRIS_CHUNK_TRIANGLES: the first
 * position in the upper half of a chunk's size where neighbours differ in the highest bit, that is,
 * where the coarsest bucket ends. */
uint32_t vox_radix_cut(const struct entry *entries);

#endif
