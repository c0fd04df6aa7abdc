/* xxh3.h - XXH3 checksums, by the widest instructions that the processor has.
 *
 * On x86 the plain header calls code for SSE2, which hashes 17 GB/s; AVX2 hashes 40. */
#ifndef BSQ_XXH3_H
#define BSQ_XXH3_H

#ifdef __x86_64__
#include <xxh_x86dispatch.h>
#else
#include <xxhash.h>
#endif

#endif
