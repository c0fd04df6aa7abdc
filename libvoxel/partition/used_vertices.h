/* used_vertices.h - private to the sorter: a bit for each vertex, set where a face refers to it. */
#ifndef VOX_PARTITION_USED_VERTICES_H
#define VOX_PARTITION_USED_VERTICES_H

#include <stdatomic.h>
#include <stdint.h>

typedef atomic_uint_least64_t used_word;

static inline uint64_t used_words(uint64_t vertices)
{
    return vertices / 64 + 1;
}

/* From any thread. */
static inline void used_mark(used_word *used, uint64_t vertex)
{
    used_word *word = &used[vertex / 64];
    uint64_t bit = (uint64_t)1 << vertex % 64;
    if (!(atomic_load_explicit(word, memory_order_relaxed) & bit))
        atomic_fetch_or_explicit(word, bit, memory_order_relaxed);
}

static inline uint64_t used_count(const used_word *used, uint64_t vertices)
{
    uint64_t count = 0;
    for (uint64_t i = 0; i < used_words(vertices); i++)
        count +=
            (uint64_t)__builtin_popcountll(atomic_load_explicit(&used[i], memory_order_relaxed));
    return count;
}

#endif
