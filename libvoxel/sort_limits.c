/* sort_limits.c - divides the memory budget among the steps of sorting. */
#include "libvoxel/sort_limits.h"

#define MIB ((uint64_t)1 << 20)

uint64_t vox_memory_min(unsigned threads)
{
    return 44 * MIB + 8 * MIB * threads;
}

void vox_sort_limits_for(uint64_t budget, unsigned threads, struct sort_limits *limits)
{
    uint64_t least = vox_memory_min(threads);
    uint64_t rest = budget > least ? budget - least : 0;
    *limits = (struct sort_limits){
        .stream_bytes = 8 * MIB + rest / 4 * 3,
        .stream_shift = rest >= 256 * MIB ? STREAM_LARGE_SHIFT : STREAM_SMALL_SHIFT,
        .page_memory = 8 * MIB + (rest < 64 * MIB ? rest / 8 : 8 * MIB),
        .max_page_memory = UINT64_MAX,
        .vertex_bucket_bytes = UINT64_MAX,
        .reserve_bytes = 8 * MIB + MIB / 2 * threads,
        .batch_triangles = 2 << 20,
        .page_bytes = 32768,
        .bucket_levels = 5,
        .index_bytes = 4,
        .slots = 2 * threads,
    };
}

uint64_t vox_sort_memory_for(uint64_t stream_bytes, unsigned threads)
{
    /* The last segment of each stream may have only one element. */
    const uint64_t segments = (uint64_t)(12 + 4 + 8 + 4) << STREAM_LARGE_SHIFT;
    return vox_memory_min(threads) + (stream_bytes + segments) / 3 * 4;
}
