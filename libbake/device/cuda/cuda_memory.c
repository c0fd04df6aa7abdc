/* cuda_memory.c - reserves the addresses of a long array at once and maps each piece to its place
 * (CUDA driver API, "Virtual Memory Management", since CUDA 10.2). */
#include "libbake/device/cuda/cuda_memory.h"

static struct bake_cuda_allocation on_device(const struct bake_cuda_memory *memory)
{
    return (struct bake_cuda_allocation){.type = CU_MEM_ALLOCATION_TYPE_PINNED,
                                         .location_type = CU_MEM_LOCATION_TYPE_DEVICE,
                                         .location_id = memory->device};
}

CUresult bake_cuda_memory_init(struct bake_cuda_memory *memory, const struct bake_cuda_api *api,
                               CUdevice device, uint64_t piece_bytes)
{
    struct bake_cuda_allocation allocation;
    size_t step = 0;
    int can = 0;
    CUresult code;

    *memory = (struct bake_cuda_memory){.api = api, .device = device, .piece_bytes = piece_bytes};
    allocation = on_device(memory);
    code = api->cuDeviceGetAttribute(&can, CU_DEVICE_ATTRIBUTE_VIRTUAL_MEMORY_MANAGEMENT_SUPPORTED,
                                     device);
    if (code != CUDA_SUCCESS || !can)
        return code;
    code = api->cuMemGetAllocationGranularity(&step, &allocation, CU_MEM_ALLOC_GRANULARITY_MINIMUM);
    if (code == CUDA_SUCCESS && step > 0 && step <= piece_bytes) {
        memory->step_bytes = step;
        memory->piece_bytes = piece_bytes / step * step;
    }
    return code;
}

uint64_t bake_cuda_memory_most(const struct bake_cuda_memory *memory)
{
    return memory->step_bytes ? UINT64_MAX : memory->piece_bytes;
}

static uint64_t piece_at(const struct bake_cuda_memory *memory, uint64_t bytes, uint64_t place)
{
    return bytes - place < memory->piece_bytes ? bytes - place : memory->piece_bytes;
}

/* Allocates and maps a piece. The mapping keeps it alive after its handle is released. */
static CUresult map_piece(const struct bake_cuda_memory *memory, CUdeviceptr at, uint64_t bytes)
{
    const struct bake_cuda_allocation allocation = on_device(memory);
    const struct bake_cuda_access access = {.location_type = CU_MEM_LOCATION_TYPE_DEVICE,
                                            .location_id = memory->device,
                                            .flags = CU_MEM_ACCESS_FLAGS_PROT_READWRITE};
    unsigned long long handle;
    CUresult code = memory->api->cuMemCreate(&handle, bytes, &allocation, 0);

    if (code != CUDA_SUCCESS)
        return code;
    code = memory->api->cuMemMap(at, bytes, 0, handle, 0);
    memory->api->cuMemRelease(handle);
    if (code != CUDA_SUCCESS)
        return code;
    code = memory->api->cuMemSetAccess(at, bytes, &access, 1);
    if (code != CUDA_SUCCESS)
        memory->api->cuMemUnmap(at, bytes);
    return code;
}

/* Frees an array whose first `mapped` bytes are mapped. */
static void unmap(const struct bake_cuda_memory *memory, const struct bake_cuda_array *array,
                  uint64_t mapped)
{
    for (uint64_t place = 0; place < mapped; place += memory->piece_bytes)
        memory->api->cuMemUnmap(array->at + place, piece_at(memory, array->bytes, place));
    memory->api->cuMemAddressFree(array->at, array->bytes);
}

static CUresult map(struct bake_cuda_memory *memory, struct bake_cuda_array *array, uint64_t bytes)
{
    const uint64_t whole = bsq_align_up(bytes, memory->step_bytes);
    CUresult code = memory->api->cuMemAddressReserve(&array->at, whole, 0, 0, 0);

    if (code != CUDA_SUCCESS)
        return code;
    array->bytes = whole;
    for (uint64_t place = 0; place < whole; place += memory->piece_bytes) {
        code = map_piece(memory, array->at + place, piece_at(memory, whole, place));
        if (code != CUDA_SUCCESS) {
            unmap(memory, array, place);
            *array = (struct bake_cuda_array){0};
            return code;
        }
    }
    return CUDA_SUCCESS;
}

CUresult bake_cuda_memory_get(struct bake_cuda_memory *memory, uint64_t bytes, CUdeviceptr *out)
{
    CUresult code;

    *out = 0;
    if (bytes == 0)
        return CUDA_SUCCESS;
    if (bytes <= memory->piece_bytes)
        return memory->api->cuMemAlloc(out, bytes);
    for (int i = 0; i < BAKE_CUDA_ARRAYS && memory->step_bytes; i++)
        if (memory->arrays[i].bytes == 0) {
            code = map(memory, &memory->arrays[i], bytes);
            *out = memory->arrays[i].at;
            return code;
        }
    return CUDA_ERROR_OUT_OF_MEMORY;
}

void bake_cuda_memory_give(struct bake_cuda_memory *memory, CUdeviceptr at)
{
    for (int i = 0; i < BAKE_CUDA_ARRAYS; i++)
        if (memory->arrays[i].bytes > 0 && memory->arrays[i].at == at) {
            unmap(memory, &memory->arrays[i], memory->arrays[i].bytes);
            memory->arrays[i] = (struct bake_cuda_array){0};
            return;
        }
    memory->api->cuMemFree(at);
}
