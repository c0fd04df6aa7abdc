/* kernel_cache.h - compiled kernels kept from one run to the next, in $XDG_CACHE_HOME/bisque or
 * ~/.cache/bisque.
 *
 * An entry belongs to a key: a text that names all that the code depends on. Nothing here fails: a
 * cache that cannot be read or written, and an entry that is damaged or belongs to another key, are
 * as if it were not there. Several processes may use it at once. Entries of sources and drivers
 * that are no longer used go when another one is put. */
#ifndef BAKE_DEVICE_OPENCL_KERNEL_CACHE_H
#define BAKE_DEVICE_OPENCL_KERNEL_CACHE_H

#include <stdbool.h>
#include <stdint.h>

/* Number that stands for some bytes in a key or a name: FNV-1a. */
uint64_t bake_kernel_hash(const void *data, uint64_t bytes);

/* An entry stays while it is used at least so often, and while it is among the last used that take
 * no more. */
enum { BAKE_KERNEL_CACHE_DAYS = 90, BAKE_KERNEL_CACHE_BYTES = 256 << 20 };

/* Gets the entry of a key, at most 64 MiB; the caller frees *out with free(). */
bool bake_kernel_cache_get(const char *key, void **out, uint64_t *bytes);

/* Puts or replaces the entry of a key. Others see it whole or not at all. */
void bake_kernel_cache_put(const char *key, const void *data, uint64_t bytes);

#endif
