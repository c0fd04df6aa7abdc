/* radix_sort.h - sorts triangles by key, and cuts a sorted sequence into chunks. */
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

/* Returns the number of entries of the first chunk, from half of FMT_TRIS_CHUNK_TRIANGLES to all of
 * it. Cuts at the end of the largest Morton cell: between the two neighbours whose keys differ in
 * the highest bit, or the first such pair. There must be more than FMT_TRIS_CHUNK_TRIANGLES sorted
 * entries. */
uint32_t vox_radix_cut(const struct entry *entries);

#endif
