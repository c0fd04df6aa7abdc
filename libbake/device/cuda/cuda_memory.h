/* cuda_memory.h - arrays on a CUDA device. No piece of memory that is asked of the driver
 * is longer than a limit: a longer array is made of several, which lie one behind the other for the
 * kernel. */
#ifndef BAKE_DEVICE_CUDA_CUDA_MEMORY_H
#define BAKE_DEVICE_CUDA_CUDA_MEMORY_H

#include "libbake/device/cuda/cuda_api.h"
#include "libbake/device/subgrid/subgrid.h"

enum { BAKE_CUDA_ARRAYS = 2 * BAKE_PART_ARRAYS + 1 /* of two slots, and the low mesh */ };

struct bake_cuda_memory {
    const struct bake_cuda_api *api;
    CUdevice device;
    uint64_t piece_bytes; /* at most; for arrays of several a multiple of what the driver asks */
    uint64_t step_bytes;  /* 0: the device has no arrays of several pieces */
    struct bake_cuda_array {
        CUdeviceptr at;
        uint64_t bytes;
    } arrays[BAKE_CUDA_ARRAYS]; /* of several pieces */
};

/* Finds out what the device can do; its context is current. */
CUresult bake_cuda_memory_init(struct bake_cuda_memory *memory, const struct bake_cuda_api *api,
                               CUdevice device, uint64_t piece_bytes);
/* Longest array. */
uint64_t bake_cuda_memory_most(const struct bake_cuda_memory *memory);

/* One thread at a time. */
CUresult bake_cuda_memory_get(struct bake_cuda_memory *memory, uint64_t bytes, CUdeviceptr *out);
/* Nothing on the device may use the array any more. */
void bake_cuda_memory_give(struct bake_cuda_memory *memory, CUdeviceptr at);

#endif
