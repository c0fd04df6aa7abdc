/* sort_array.h - sorts an array in place. */
#ifndef BSQ_SORT_ARRAY_H
#define BSQ_SORT_ARRAY_H

#include <stddef.h>
#include <stdint.h>

/* Sorts `count` items of `size` bytes each. Does what qsort() does but allocates nothing, while
 * qsort() of glibc allocates a copy of the array, which no budget counts. The order of items that
 * compare equal is not specified, but always the same. */
void bsq_sort(void *items, uint64_t count, size_t size, int (*compare)(const void *, const void *));

#endif
