/* fake_memory.c - the fake driver's device memory, and page-locked host memory. */
#include <stdlib.h>
#include <string.h>

#include "tests/fake/fake_cuda_internal.h"

CUresult cuMemGetInfo_v2(size_t *free_bytes, size_t *total)
{
    BEGIN_IN_CONTEXT;
    pthread_mutex_lock(&fake.lock);
    *free_bytes = fake.memory_bytes - fake.used_bytes;
    pthread_mutex_unlock(&fake.lock);
    *total = fake.memory_bytes;
    return CUDA_SUCCESS;
}

bool fake_take_bytes(size_t bytes)
{
    pthread_mutex_lock(&fake.lock);
    bool fits = bytes <= fake.memory_bytes - fake.used_bytes;
    fake.used_bytes += fits ? bytes : 0;
    pthread_mutex_unlock(&fake.lock);
    return fits;
}

CUresult cuMemAlloc_v2(CUdeviceptr *memory, size_t bytes)
{
    struct allocation *allocation;

    BEGIN_IN_CONTEXT;
    if (bytes == 0)
        return INVALID_VALUE;
    if (!fake_take_bytes(bytes))
        return CUDA_ERROR_OUT_OF_MEMORY;
    allocation = calloc(1, sizeof *allocation);
    allocation->memory = malloc(bytes);
    allocation->bytes = bytes;
    memset(allocation->memory, 0xa5, bytes);
    pthread_mutex_lock(&fake.lock);
    allocation->next = fake.allocations;
    fake.allocations = allocation;
    pthread_mutex_unlock(&fake.lock);
    fake_count_live(1);
    *memory = (CUdeviceptr)(uintptr_t)allocation->memory + DEVICE_ADDRESS;
    return CUDA_SUCCESS;
}

struct allocation *fake_find_allocation(CUdeviceptr address)
{
    const char *at =
        (char *)(uintptr_t)(address - DEVICE_ADDRESS); // NOLINT: the fake's own addresses
    struct allocation *a = fake.allocations;

    while (a && !(at >= a->memory && at < a->memory + a->bytes))
        a = a->next;
    return a;
}

void *fake_device_memory(CUdeviceptr address, size_t bytes)
{
    const struct allocation *a;
    char *at = (char *)(uintptr_t)(address - DEVICE_ADDRESS); // NOLINT: as above

    pthread_mutex_lock(&fake.lock);
    a = fake_find_allocation(address);
    pthread_mutex_unlock(&fake.lock);
    return a && at + bytes <= a->memory + a->bytes ? at : NULL;
}

CUresult cuMemFree_v2(CUdeviceptr memory)
{
    char *at = fake_device_memory(memory, 1);

    NEED_CONTEXT;
    fake_run_streams();
    pthread_mutex_lock(&fake.lock);
    for (struct allocation **link = &fake.allocations; *link; link = &(*link)->next) {
        struct allocation *gone = *link;
        if (gone->memory != at)
            continue;
        *link = gone->next;
        fake.used_bytes -= gone->bytes;
        fake.live--;
        free(gone->memory);
        free(gone);
        pthread_mutex_unlock(&fake.lock);
        return CUDA_SUCCESS;
    }
    pthread_mutex_unlock(&fake.lock);
    return INVALID_VALUE;
}

/* ---- page-locked memory of the host ---- */

struct locked {
    char *memory;
    size_t bytes;
    struct locked *next;
};
static struct locked *page_locked; /* requires the lock */

CUresult cuMemAllocHost_v2(void **memory, size_t bytes)
{
    struct locked *locked;

    BEGIN_IN_CONTEXT;
    if (bytes == 0)
        return INVALID_VALUE;
    *memory = malloc(bytes);
    locked = malloc(sizeof *locked);
    pthread_mutex_lock(&fake.lock);
    *locked = (struct locked){.memory = *memory, .bytes = bytes, .next = page_locked};
    page_locked = locked;
    fake.live++;
    pthread_mutex_unlock(&fake.lock);
    return CUDA_SUCCESS;
}

CUresult cuMemFreeHost(void *memory)
{
    CUresult code = INVALID_VALUE;

    NEED_CONTEXT;
    pthread_mutex_lock(&fake.lock);
    for (struct locked **link = &page_locked; *link; link = &(*link)->next) {
        struct locked *gone = *link;
        if (gone->memory != memory)
            continue;
        *link = gone->next;
        free(gone->memory);
        free(gone);
        fake.live--;
        code = CUDA_SUCCESS;
        break;
    }
    pthread_mutex_unlock(&fake.lock);
    return code;
}

bool fake_is_locked(const void *memory, size_t bytes)
{
    const char *at = memory;
    bool found = false;

    pthread_mutex_lock(&fake.lock);
    for (const struct locked *l = page_locked; l && !found; l = l->next)
        found = at >= l->memory && at + bytes <= l->memory + l->bytes;
    pthread_mutex_unlock(&fake.lock);
    return found;
}
