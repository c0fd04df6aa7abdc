/* fake_memory.c - the fake driver's device memory, and page-locked host memory. */
#include <stdlib.h>
#include <string.h>

#include "tests/fake/fake_cuda_internal.h"

CUresult cuMemGetInfo_v2(size_t *free_bytes, size_t *total)
{
    BEGIN_IN_CONTEXT;
    pthread_mutex_lock(&fake.lock);
    *free_bytes = fake.memory_bytes - fake.used_bytes - fake.others_bytes;
    fake.others_bytes += fake.taken_bytes;
    fake.taken_bytes = 0;
    pthread_mutex_unlock(&fake.lock);
    *total = fake.memory_bytes;
    return CUDA_SUCCESS;
}

bool fake_take_bytes(size_t bytes)
{
    pthread_mutex_lock(&fake.lock);
    bool fits = bytes <= fake.memory_bytes - fake.used_bytes - fake.others_bytes;
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
    bool found = true;

    pthread_mutex_lock(&fake.lock);
    for (size_t done = 0; done < bytes && found;) {
        const struct allocation *a = fake_find_allocation(address + done);
        found = a && (!a->mapped || a->open);
        if (found) /* mapped pieces may be consecutive */
            done = (size_t)(a->memory + a->bytes - (char *)(uintptr_t)(address - DEVICE_ADDRESS));
        if (found && done < bytes)
            found = a->mapped;
    }
    pthread_mutex_unlock(&fake.lock);
    return found ? (char *)(uintptr_t)(address - DEVICE_ADDRESS) : NULL; // NOLINT: as above
}

CUresult cuMemFree_v2(CUdeviceptr memory)
{
    char *at = fake_device_memory(memory, 1);

    NEED_CONTEXT;
    fake_run_streams();
    pthread_mutex_lock(&fake.lock);
    for (struct allocation **link = &fake.allocations; *link; link = &(*link)->next) {
        struct allocation *gone = *link;
        if (gone->memory != at || gone->mapped)
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

/* ---- blocks ---- */

void fake_hand_out(struct fake_block **list, char *memory, size_t bytes)
{
    struct fake_block *block = malloc(sizeof *block);

    pthread_mutex_lock(&fake.lock);
    *block = (struct fake_block){.memory = memory, .bytes = bytes, .next = *list};
    *list = block;
    fake.live++;
    pthread_mutex_unlock(&fake.lock);
}

CUresult fake_take_back(struct fake_block **list, const void *memory, size_t bytes)
{
    CUresult code = INVALID_VALUE;

    pthread_mutex_lock(&fake.lock);
    for (struct fake_block **link = list; *link; link = &(*link)->next) {
        struct fake_block *gone = *link;
        if (gone->memory != memory || (bytes != SIZE_MAX && gone->bytes != bytes) || gone->mapped)
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

static struct fake_block *page_locked; /* memory of the host */

CUresult cuMemAllocHost_v2(void **memory, size_t bytes)
{
    BEGIN_IN_CONTEXT;
    if (bytes == 0)
        return INVALID_VALUE;
    *memory = malloc(bytes);
    fake_hand_out(&page_locked, *memory, bytes);
    return CUDA_SUCCESS;
}

CUresult cuMemFreeHost(void *memory)
{
    NEED_CONTEXT;
    return fake_take_back(&page_locked, memory, SIZE_MAX);
}

bool fake_is_locked(const void *memory, size_t bytes)
{
    const char *at = memory;
    bool found = false;

    pthread_mutex_lock(&fake.lock);
    for (const struct fake_block *l = page_locked; l && !found; l = l->next)
        found = at >= l->memory && at + bytes <= l->memory + l->bytes;
    pthread_mutex_unlock(&fake.lock);
    return found;
}
