/* cuda_memory.h - arrays on a CUDA device.
 *
 * No allocation is longer than a limit. A longer array has several allocations at consecutive
 * addresses, so the kernel sees one array. */
#ifndef BAKE_DEVICE_CUDA_CUDA_MEMORY_H
#define BAKE_DEVICE_CUDA_CUDA_MEMORY_H

#include "libbake/device/cuda/cuda_api.h"

/* Arrays of all slots, and the low-poly mesh. */
enum { BAKE_CUDA_ARRAYS = BAKE_SLOTS * BAKE_SUBGRID_ARRAYS + 1 };

struct bake_cuda_memory {
    const struct bake_cuda_api *api;
    CUdevice device;
    uint64_t piece_bytes; /* limit for one allocation, a multiple of step_bytes */
    uint64_t step_bytes;  /* the driver's granularity; 0: no arrays of several pieces */
    struct bake_cuda_array {
        CUdeviceptr at;
        uint64_t bytes;
    } arrays[BAKE_CUDA_ARRAYS]; /* of several pieces */
};

/* Asks what the device can do; its context must be current. */
CUresult bake_cuda_memory_init(struct bake_cuda_memory *memory, const struct bake_cuda_api *api,
                               CUdevice device, uint64_t piece_bytes);
/* Returns the bytes of the longest array possible. */
uint64_t bake_cuda_memory_most(const struct bake_cuda_memory *memory);

/* Allocates an array. Only one thread may call this at a time. */
CUresult bake_cuda_memory_get(struct bake_cuda_memory *memory, uint64_t bytes, CUdeviceptr *out);
/* Frees an array; nothing on the device may use it any more. */
void bake_cuda_memory_give(struct bake_cuda_memory *memory, CUdeviceptr at);

#endif
