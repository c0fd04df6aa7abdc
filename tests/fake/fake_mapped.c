/* fake_mapped.c - the fake driver's virtual memory: reserved addresses, and pieces of memory mapped
 * to them. A mapped piece is an allocation. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/fake/fake_cuda_internal.h"

static struct fake_block *reservations;
enum { STEP_BYTES = 64 << 10, MAX_PIECES = 1000 };
static size_t pieces[MAX_PIECES]; /* bytes of pieces that are not mapped yet, by handle */

static bool is_on_device(const struct bake_cuda_allocation *a)
{
    return a->type == CU_MEM_ALLOCATION_TYPE_PINNED && a->handle_types == 0 &&
           a->location_type == CU_MEM_LOCATION_TYPE_DEVICE && fake_is_device(a->location_id) &&
           !a->windows && !a->compression && !a->direct && !a->usage;
}

CUresult cuMemGetAllocationGranularity(size_t *bytes, const struct bake_cuda_allocation *allocation,
                                       int option)
{
    BEGIN;
    *bytes = STEP_BYTES;
    return is_on_device(allocation) && option == CU_MEM_ALLOC_GRANULARITY_MINIMUM ? CUDA_SUCCESS
                                                                                  : INVALID_VALUE;
}

CUresult cuMemAddressReserve(CUdeviceptr *at, size_t bytes, size_t alignment, CUdeviceptr wanted,
                             unsigned long long flags)
{
    char *memory;

    BEGIN;
    if (bytes == 0 || bytes % STEP_BYTES || alignment || wanted || flags)
        return INVALID_VALUE;
    memory = aligned_alloc(STEP_BYTES, bytes);
    memset(memory, 0xa5, bytes);
    fake_hand_out(&reservations, memory, bytes);
    *at = (CUdeviceptr)(uintptr_t)memory + DEVICE_ADDRESS;
    return CUDA_SUCCESS;
}

CUresult cuMemAddressFree(CUdeviceptr at, size_t bytes)
{
    return fake_take_back(&reservations,
                          (char *)(uintptr_t)(at - DEVICE_ADDRESS), // NOLINT: as above
                          bytes);
}

CUresult cuMemCreate(unsigned long long *handle, size_t bytes,
                     const struct bake_cuda_allocation *allocation, unsigned long long flags)
{
    BEGIN;
    if (bytes == 0 || bytes % STEP_BYTES || !is_on_device(allocation) || flags)
        return INVALID_VALUE;
    if (!fake_take_bytes(bytes))
        return CUDA_ERROR_OUT_OF_MEMORY;
    pthread_mutex_lock(&fake.lock);
    for (*handle = 1; pieces[*handle]; ++*handle)
        if (*handle == MAX_PIECES - 1)
            abort();
    pieces[*handle] = bytes;
    fake.live++;
    pthread_mutex_unlock(&fake.lock);
    return CUDA_SUCCESS;
}

/* Releases a handle; a mapped piece stays an allocation. */
CUresult cuMemRelease(unsigned long long handle)
{
    if (handle >= 2 * MAX_PIECES)
        return INVALID_HANDLE;
    pthread_mutex_lock(&fake.lock);
    if (handle < MAX_PIECES && pieces[handle]) {
        fake.used_bytes -= pieces[handle];
        pieces[handle] = 0;
        fake.live--;
    }
    pthread_mutex_unlock(&fake.lock);
    return CUDA_SUCCESS;
}

static struct fake_block *find_reservation(const char *memory, size_t bytes)
{
    struct fake_block *r = reservations;

    while (r && !(memory >= r->memory && memory + bytes <= r->memory + r->bytes))
        r = r->next;
    return r;
}

CUresult cuMemMap(CUdeviceptr at, size_t bytes, size_t offset, unsigned long long handle,
                  unsigned long long flags)
{
    char *memory = (char *)(uintptr_t)(at - DEVICE_ADDRESS); // NOLINT: as above
    struct allocation *allocation;
    struct fake_block *r;

    BEGIN;
    if (handle >= MAX_PIECES || pieces[handle] != bytes || offset || flags || at % STEP_BYTES)
        return INVALID_VALUE;
    pthread_mutex_lock(&fake.lock);
    r = find_reservation(memory, bytes);
    if (r) {
        allocation = calloc(1, sizeof *allocation);
        *allocation = (struct allocation){
            .memory = memory, .bytes = bytes, .mapped = true, .next = fake.allocations};
        fake.allocations = allocation;
        r->mapped += bytes;
        pieces[handle] = 0;
    }
    pthread_mutex_unlock(&fake.lock);
    return r ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuMemSetAccess(CUdeviceptr at, size_t bytes, const struct bake_cuda_access *access,
                        size_t count)
{
    struct allocation *a;

    BEGIN;
    pthread_mutex_lock(&fake.lock);
    a = fake_find_allocation(at);
    if (a && a->bytes == bytes && a->mapped && count == 1 && fake_is_device(access->location_id) &&
        access->location_type == CU_MEM_LOCATION_TYPE_DEVICE &&
        access->flags == CU_MEM_ACCESS_FLAGS_PROT_READWRITE)
        a->open = true;
    pthread_mutex_unlock(&fake.lock);
    return a && a->open ? CUDA_SUCCESS : INVALID_VALUE;
}

/* Does not wait for the device, unlike cuMemFree(). */
CUresult cuMemUnmap(CUdeviceptr at, size_t bytes)
{
    const char *memory = (char *)(uintptr_t)(at - DEVICE_ADDRESS); // NOLINT: as above
    CUresult code = INVALID_VALUE;

    pthread_mutex_lock(&fake.lock);
    for (struct allocation **link = &fake.allocations; *link; link = &(*link)->next) {
        struct allocation *gone = *link;
        bool used = false;
        if (gone->memory != memory || gone->bytes != bytes || !gone->mapped)
            continue;
        for (int s = 0; s < MAX_STREAMS; s++)
            used |= gone->uses[s] > 0;
        if (used)
            fputs("fake CUDA: memory is unmapped while it is used\n", stderr);
        find_reservation(memory, bytes)->mapped -= bytes;
        *link = gone->next;
        fake.used_bytes -= bytes;
        fake.live--;
        free(gone);
        code = used ? INVALID_VALUE : CUDA_SUCCESS;
        break;
    }
    pthread_mutex_unlock(&fake.lock);
    return code;
}
