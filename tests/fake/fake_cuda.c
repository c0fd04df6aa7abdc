/* fake_cuda.c - a libcuda.so.1 without a GPU: what libbake/cuda_api_internal.h uses of the driver,
 * with the kernel compiled as C, or its PTX run by ptx.c. It is stricter than a driver, so that
 * tests find what a GPU would forgive on most days:
 *  - work in streams happens only when somebody waits for it, or frees memory;
 *  - streams must not use the same memory without waiting for each other, unless all only read;
 *  - device addresses are no host addresses, and copies are held against the allocations;
 *  - the host's side of a copy has to be page-locked, where a driver would silently wait;
 *  - a thread without a context can do nothing, not even free;
 *  - the first launch takes a 32nd of the memory, for what is not in registers;
 *  - the PTX's entry has to have the parameters that launches pass;
 *  - whatever is not freed at the end is counted on standard error.
 * It obeys the environment, read by cuInit():
 *  - FAKE_CUDA_DEVICES=N: how many there are (1);
 *  - FAKE_CUDA_MEMORY=BYTES: of each (1 GiB);
 *  - FAKE_CUDA_CAPABILITY=NN: of each (90);
 *  - FAKE_CUDA_FAIL=CALL:N:CODE: the Nth call of a function fails so, and if CODE is 700 or more
 *    all calls after it;
 *  - FAKE_CUDA_NS=N: a sample takes N nanoseconds of the time that events tell, else that is real;
 *  - FAKE_CUDA_HOURS=N: so many went by on that clock before the first kernel;
 *  - FAKE_CUDA_HOLD=N: the first kernel ends only once a copy was put into a stream that is older
 *    than its own and was waited for N times before; after 20 seconds it fails;
 *  - FAKE_CUDA_MAPS=0: no memory can be mapped to addresses;
 *  - FAKE_CUDA_PTX=1: kernels are the PTX that was loaded;
 *  - FAKE_CUDA_COUNT=1: the end tells how many of its instructions warps went through. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "base/clock.h"
#include "libbake/cuda_api_internal.h"
#include "libbake/kernel/bk_sample.h"
#include "tests/fake/ptx.h"

/* What is exported has the types that the program calls it with. */
#define DECLARE(name, symbol, parameters) CUresult symbol parameters;
BAKE_CUDA_FUNCTIONS(DECLARE)
#undef DECLARE

enum {
    INVALID_VALUE = 1,
    NOT_INITIALIZED = 3,
    NO_DEVICE = CUDA_ERROR_NO_DEVICE,
    INVALID_DEVICE = 101,
    INVALID_PTX = 218,
    INVALID_HANDLE = 400,
    NOT_FOUND = 500,
    NOT_READY = 600,
    STICKY = 700
};

#define DEVICE_ADDRESS (1ull << 62)

enum { MOST_STREAMS = 256 };

struct allocation {
    char *memory;
    size_t bytes;
    struct allocation *next;
    bool mapped, open; /* a piece of a reservation; it may be read and written */
    unsigned uses[MOST_STREAMS],
        writes[MOST_STREAMS]; /* by work that each stream has not done yet */
};

/* What a launch passes, in the kernel's order. */
struct arguments {
    CUdeviceptr arrays[9];
    bk_params params;
    bk_tile tile;
    bk_uint first_row, end_row, first_line, end_line;
    CUdeviceptr samples, texels;
};
static const size_t argument_bytes[] = {
    8, 8, 8, 8, 8, 8, 8, 8, 8, sizeof(bk_params), sizeof(bk_tile), 4, 4, 4, 4, 8, 8};
enum { ARGUMENTS = sizeof argument_bytes / sizeof argument_bytes[0] };

struct work {
    enum { COPY, LAUNCH, RECORD } kind;
    void *to;
    const void *from;
    size_t bytes;
    struct arguments arguments;
    unsigned grid[2], block[2];
    CUdeviceptr used[11]; /* the last `written` are written to */
    unsigned use_count, written;
    CUevent event;
    struct work *next;
};

struct CUstream_st {
    pthread_mutex_t lock;         /* of the work and its execution */
    unsigned number;              /* in the order of their making, from 1 */
    unsigned waits, copies_since; /* how often it was waited for; copies put in after the waits that
                                     `hold` asks for */
    struct work *first, *last;
    CUstream next;
};

struct CUevent_st {
    CUstream stream; /* recorded there */
    int pending;
    double at;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER; /* of all below */
static struct allocation *allocations;
static CUstream streams;
static struct CUstream_st default_stream = {.lock = PTHREAD_MUTEX_INITIALIZER};
static int device_count = -1, capability, live, failing_code, sticky;
static size_t memory_bytes, used_bytes;
static double sample_seconds, virtual_now, hours;
static size_t local_bytes; /* that the first launch took */
static unsigned streams_made;
static unsigned hold; /* the waits that the first kernel's end is held for; 0: it is not held */
static bool runs_ptx;
static int maps_memory;
static struct ptx *ptx;       /* loaded, where it is run */
static uint64_t instructions; /* of warps */
static pthread_cond_t released = PTHREAD_COND_INITIALIZER;
static char failing_call[64];
static unsigned calls_left;

static unsigned long long setting(const char *name, unsigned long long otherwise)
{
    const char *text = getenv(name);
    return text ? strtoull(text, NULL, 10) : otherwise;
}

/* The code that a call has to fail with, or 0. */
static CUresult begin(const char *call)
{
    CUresult code = CUDA_SUCCESS;
    pthread_mutex_lock(&lock);
    if (device_count < 0)
        code = NOT_INITIALIZED;
    else if (sticky)
        code = sticky;
    else if (calls_left > 0 && strcmp(call, failing_call) == 0 && --calls_left == 0)
        code = failing_code;
    if (code >= STICKY)
        sticky = code;
    pthread_mutex_unlock(&lock);
    return code;
}
#define BEGIN                                                                                      \
    do {                                                                                           \
        CUresult begin_code = begin(__func__);                                                     \
        if (begin_code != CUDA_SUCCESS)                                                            \
            return begin_code;                                                                     \
    } while (0)

static void count_live(int change)
{
    pthread_mutex_lock(&lock);
    live += change;
    pthread_mutex_unlock(&lock);
}

/* Objects that exist, for tests in the same process. */
int fake_cuda_live(void);
int fake_cuda_live(void)
{
    return live;
}

__attribute__((destructor)) static void report(void)
{
    if (live)
        fprintf(stderr, "fake CUDA: %d objects are left\n", live);
    if (getenv("FAKE_CUDA_COUNT"))
        fprintf(stderr, "fake CUDA: %llu instructions of warps\n",
                (unsigned long long)instructions);
}

/* ---- devices ---- */

static const struct {
    CUresult code;
    const char *name, *text;
} errors[] = {
    {INVALID_VALUE, "CUDA_ERROR_INVALID_VALUE", "invalid argument"},
    {CUDA_ERROR_OUT_OF_MEMORY, "CUDA_ERROR_OUT_OF_MEMORY", "out of memory"},
    {NO_DEVICE, "CUDA_ERROR_NO_DEVICE", "no CUDA-capable device is detected"},
    {INVALID_PTX, "CUDA_ERROR_INVALID_PTX", "a PTX JIT compilation failed"},
    {719, "CUDA_ERROR_LAUNCH_FAILED", "unspecified launch failure"},
    {803, "CUDA_ERROR_SYSTEM_DRIVER_MISMATCH",
     "system has unsupported display driver / cuda driver combination"},
};

static const char *find_error(CUresult code, int text)
{
    for (size_t i = 0; i < sizeof errors / sizeof errors[0]; i++)
        if (errors[i].code == code)
            return text ? errors[i].text : errors[i].name;
    return NULL;
}

CUresult cuGetErrorName(CUresult code, const char **text)
{
    *text = find_error(code, 0);
    return *text ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuGetErrorString(CUresult code, const char **text)
{
    *text = find_error(code, 1);
    return *text ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuInit(unsigned flags)
{
    const char *fail = getenv("FAKE_CUDA_FAIL");

    pthread_mutex_lock(&lock);
    device_count = (int)setting("FAKE_CUDA_DEVICES", 1);
    memory_bytes = setting("FAKE_CUDA_MEMORY", 1u << 30);
    capability = (int)setting("FAKE_CUDA_CAPABILITY", 90);
    sample_seconds = 1e-9 * (double)setting("FAKE_CUDA_NS", 0);
    hours = (double)setting("FAKE_CUDA_HOURS", 0);
    runs_ptx = setting("FAKE_CUDA_PTX", 0);
    maps_memory = (int)setting("FAKE_CUDA_MAPS", 1);
    hold = (unsigned)setting("FAKE_CUDA_HOLD", 0);
    sticky = 0;
    calls_left = 0;
    if (fail && sscanf(fail, "%63[^:]:%u:%d", failing_call, &calls_left, &failing_code) != 3)
        abort();
    pthread_mutex_unlock(&lock);
    BEGIN;
    if (device_count == 0)
        return NO_DEVICE;
    return flags == 0 ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuDeviceGetCount(int *count)
{
    BEGIN;
    *count = device_count;
    return CUDA_SUCCESS;
}

CUresult cuDeviceGet(CUdevice *device, int number)
{
    BEGIN;
    *device = 100 + number; /* no number, lest they be mixed up */
    return number >= 0 && number < device_count ? CUDA_SUCCESS : INVALID_DEVICE;
}

static int is_device(CUdevice device)
{
    return device >= 100 && device < 100 + device_count;
}

CUresult cuDeviceGetName(char *name, int bytes, CUdevice device)
{
    BEGIN;
    snprintf(name, (size_t)bytes, "Fake GPU %d", device - 100);
    return is_device(device) ? CUDA_SUCCESS : INVALID_DEVICE;
}

CUresult cuDeviceTotalMem_v2(size_t *bytes, CUdevice device)
{
    BEGIN;
    *bytes = memory_bytes;
    return is_device(device) ? CUDA_SUCCESS : INVALID_DEVICE;
}

CUresult cuDeviceGetAttribute(int *value, int attribute, CUdevice device)
{
    BEGIN;
    if (attribute == CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR)
        *value = capability / 10;
    else if (attribute == CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR)
        *value = capability % 10;
    else if (attribute == CU_DEVICE_ATTRIBUTE_VIRTUAL_MEMORY_MANAGEMENT_SUPPORTED)
        *value = maps_memory;
    else
        return INVALID_VALUE;
    return is_device(device) ? CUDA_SUCCESS : INVALID_DEVICE;
}

static _Thread_local CUcontext current;

CUresult cuDevicePrimaryCtxRetain(CUcontext *context, CUdevice device)
{
    BEGIN;
    *context = (CUcontext)&device_count;
    count_live(1);
    return is_device(device) ? CUDA_SUCCESS : INVALID_DEVICE;
}

CUresult cuDevicePrimaryCtxRelease_v2(CUdevice device)
{
    pthread_mutex_lock(&lock);
    used_bytes -= local_bytes;
    local_bytes = 0;
    pthread_mutex_unlock(&lock);
    count_live(-1);
    return is_device(device) ? CUDA_SUCCESS : INVALID_DEVICE;
}

CUresult cuCtxSetCurrent(CUcontext context)
{
    current = context;
    BEGIN;
    return CUDA_SUCCESS;
}

/* Of a thread that has no context. */
#define BEGIN_IN_CONTEXT                                                                           \
    BEGIN;                                                                                         \
    if (!current)                                                                                  \
    return 201

/* ---- memory ---- */

CUresult cuMemGetInfo_v2(size_t *free_bytes, size_t *total)
{
    BEGIN_IN_CONTEXT;
    pthread_mutex_lock(&lock);
    *free_bytes = memory_bytes - used_bytes;
    pthread_mutex_unlock(&lock);
    *total = memory_bytes;
    return CUDA_SUCCESS;
}

static bool take_bytes(size_t bytes)
{
    pthread_mutex_lock(&lock);
    bool fits = bytes <= memory_bytes - used_bytes;
    used_bytes += fits ? bytes : 0;
    pthread_mutex_unlock(&lock);
    return fits;
}

CUresult cuMemAlloc_v2(CUdeviceptr *memory, size_t bytes)
{
    struct allocation *allocation;

    BEGIN_IN_CONTEXT;
    if (bytes == 0)
        return INVALID_VALUE;
    if (!take_bytes(bytes))
        return CUDA_ERROR_OUT_OF_MEMORY;
    allocation = calloc(1, sizeof *allocation);
    allocation->memory = malloc(bytes);
    allocation->bytes = bytes;
    memset(allocation->memory, 0xa5, bytes);
    pthread_mutex_lock(&lock);
    allocation->next = allocations;
    allocations = allocation;
    pthread_mutex_unlock(&lock);
    count_live(1);
    *memory = (CUdeviceptr)(uintptr_t)allocation->memory + DEVICE_ADDRESS;
    return CUDA_SUCCESS;
}

static struct allocation *find_allocation(CUdeviceptr address)
{
    const char *at =
        (char *)(uintptr_t)(address - DEVICE_ADDRESS); // NOLINT: the fake's own addresses
    struct allocation *a = allocations;

    while (a && !(at >= a->memory && at < a->memory + a->bytes))
        a = a->next;
    return a;
}

/* Host address of `bytes` bytes of device memory; NULL where they are not all of one allocation or
 * of pieces of one reservation. */
static void *device_memory(CUdeviceptr address, size_t bytes)
{
    bool found = true;

    pthread_mutex_lock(&lock);
    for (size_t done = 0; done < bytes && found;) {
        const struct allocation *a = find_allocation(address + done);
        found = a && (!a->mapped || a->open);
        if (found) /* mapped pieces may go on one behind the other */
            done = (size_t)(a->memory + a->bytes - (char *)(uintptr_t)(address - DEVICE_ADDRESS));
        if (found && done < bytes)
            found = a->mapped;
    }
    pthread_mutex_unlock(&lock);
    return found ? (char *)(uintptr_t)(address - DEVICE_ADDRESS) : NULL; // NOLINT: as above
}

/* Addresses that were reserved; pieces of memory are mapped there one by one, each of which is an
 * allocation then. */
struct reservation {
    char *memory;
    size_t bytes, mapped;
    struct reservation *next;
};
static struct reservation *reservations; /* under the lock */
enum { STEP_BYTES = 64 << 10, MOST_PIECES = 1000 };
static size_t pieces[MOST_PIECES]; /* made and not mapped yet, by handle */

static void run_stream(CUstream stream, CUevent until);

/* Frees work after a failure too, so that what is left over is told; but not without a context. */
#define NEED_CONTEXT                                                                               \
    if (!current)                                                                                  \
    return 201

CUresult cuMemFree_v2(CUdeviceptr memory)
{
    char *at = device_memory(memory, 1);

    NEED_CONTEXT;
    for (CUstream stream = streams; stream; stream = stream->next)
        run_stream(stream, NULL);
    pthread_mutex_lock(&lock);
    for (struct allocation **link = &allocations; *link; link = &(*link)->next) {
        struct allocation *gone = *link;
        if (gone->memory != at || gone->mapped)
            continue;
        *link = gone->next;
        used_bytes -= gone->bytes;
        live--;
        free(gone->memory);
        free(gone);
        pthread_mutex_unlock(&lock);
        return CUDA_SUCCESS;
    }
    pthread_mutex_unlock(&lock);
    return INVALID_VALUE;
}

static bool is_on_device(const struct bake_cuda_allocation *a)
{
    return a->type == CU_MEM_ALLOCATION_TYPE_PINNED && a->handle_types == 0 &&
           a->location_type == CU_MEM_LOCATION_TYPE_DEVICE && is_device(a->location_id) &&
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
    struct reservation *r;

    BEGIN;
    if (bytes == 0 || bytes % STEP_BYTES || alignment || wanted || flags)
        return INVALID_VALUE;
    r = calloc(1, sizeof *r);
    *r = (struct reservation){.memory = aligned_alloc(STEP_BYTES, bytes), .bytes = bytes};
    memset(r->memory, 0xa5, bytes);
    pthread_mutex_lock(&lock);
    r->next = reservations;
    reservations = r;
    live++;
    pthread_mutex_unlock(&lock);
    *at = (CUdeviceptr)(uintptr_t)r->memory + DEVICE_ADDRESS;
    return CUDA_SUCCESS;
}

CUresult cuMemAddressFree(CUdeviceptr at, size_t bytes)
{
    const char *memory = (char *)(uintptr_t)(at - DEVICE_ADDRESS); // NOLINT: as above
    CUresult code = INVALID_VALUE;

    pthread_mutex_lock(&lock);
    for (struct reservation **link = &reservations; *link; link = &(*link)->next) {
        struct reservation *gone = *link;
        if (gone->memory != memory || gone->bytes != bytes || gone->mapped)
            continue;
        *link = gone->next;
        free(gone->memory);
        free(gone);
        live--;
        code = CUDA_SUCCESS;
        break;
    }
    pthread_mutex_unlock(&lock);
    return code;
}

CUresult cuMemCreate(unsigned long long *handle, size_t bytes,
                     const struct bake_cuda_allocation *allocation, unsigned long long flags)
{
    BEGIN;
    if (bytes == 0 || bytes % STEP_BYTES || !is_on_device(allocation) || flags)
        return INVALID_VALUE;
    if (!take_bytes(bytes))
        return CUDA_ERROR_OUT_OF_MEMORY;
    pthread_mutex_lock(&lock);
    for (*handle = 1; pieces[*handle]; ++*handle)
        if (*handle == MOST_PIECES - 1)
            abort();
    pieces[*handle] = bytes;
    live++;
    pthread_mutex_unlock(&lock);
    return CUDA_SUCCESS;
}

/* A piece that is mapped has become an allocation. */
CUresult cuMemRelease(unsigned long long handle)
{
    if (handle >= 2 * MOST_PIECES)
        return INVALID_HANDLE;
    pthread_mutex_lock(&lock);
    if (handle < MOST_PIECES && pieces[handle]) {
        used_bytes -= pieces[handle];
        pieces[handle] = 0;
        live--;
    }
    pthread_mutex_unlock(&lock);
    return CUDA_SUCCESS;
}

static struct reservation *find_reservation(const char *memory, size_t bytes)
{
    struct reservation *r = reservations;

    while (r && !(memory >= r->memory && memory + bytes <= r->memory + r->bytes))
        r = r->next;
    return r;
}

CUresult cuMemMap(CUdeviceptr at, size_t bytes, size_t offset, unsigned long long handle,
                  unsigned long long flags)
{
    char *memory = (char *)(uintptr_t)(at - DEVICE_ADDRESS); // NOLINT: as above
    struct allocation *allocation;
    struct reservation *r;

    BEGIN;
    if (handle >= MOST_PIECES || pieces[handle] != bytes || offset || flags || at % STEP_BYTES)
        return INVALID_VALUE;
    pthread_mutex_lock(&lock);
    r = find_reservation(memory, bytes);
    if (r) {
        allocation = calloc(1, sizeof *allocation);
        *allocation = (struct allocation){
            .memory = memory, .bytes = bytes, .mapped = true, .next = allocations};
        allocations = allocation;
        r->mapped += bytes;
        pieces[handle] = 0;
    }
    pthread_mutex_unlock(&lock);
    return r ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuMemSetAccess(CUdeviceptr at, size_t bytes, const struct bake_cuda_access *access,
                        size_t count)
{
    struct allocation *a;

    BEGIN;
    pthread_mutex_lock(&lock);
    a = find_allocation(at);
    if (a && a->bytes == bytes && a->mapped && count == 1 && is_device(access->location_id) &&
        access->location_type == CU_MEM_LOCATION_TYPE_DEVICE &&
        access->flags == CU_MEM_ACCESS_FLAGS_PROT_READWRITE)
        a->open = true;
    pthread_mutex_unlock(&lock);
    return a && a->open ? CUDA_SUCCESS : INVALID_VALUE;
}

/* Unlike freeing, this does not wait for the device. */
CUresult cuMemUnmap(CUdeviceptr at, size_t bytes)
{
    const char *memory = (char *)(uintptr_t)(at - DEVICE_ADDRESS); // NOLINT: as above
    CUresult code = INVALID_VALUE;

    pthread_mutex_lock(&lock);
    for (struct allocation **link = &allocations; *link; link = &(*link)->next) {
        struct allocation *gone = *link;
        bool used = false;
        if (gone->memory != memory || gone->bytes != bytes || !gone->mapped)
            continue;
        for (int s = 0; s < MOST_STREAMS; s++)
            used |= gone->uses[s] > 0;
        if (used)
            fputs("fake CUDA: memory is unmapped while it is used\n", stderr);
        find_reservation(memory, bytes)->mapped -= bytes;
        *link = gone->next;
        used_bytes -= bytes;
        live--;
        free(gone);
        code = used ? INVALID_VALUE : CUDA_SUCCESS;
        break;
    }
    pthread_mutex_unlock(&lock);
    return code;
}

/* Page-locked memory of the host. */
struct locked {
    char *memory;
    size_t bytes;
    struct locked *next;
};
static struct locked *page_locked; /* under the lock */

CUresult cuMemAllocHost_v2(void **memory, size_t bytes)
{
    struct locked *locked;

    BEGIN_IN_CONTEXT;
    if (bytes == 0)
        return INVALID_VALUE;
    locked = malloc(sizeof *locked);
    *locked = (struct locked){.memory = *memory = malloc(bytes), .bytes = bytes};
    pthread_mutex_lock(&lock);
    locked->next = page_locked;
    page_locked = locked;
    live++;
    pthread_mutex_unlock(&lock);
    return CUDA_SUCCESS;
}

CUresult cuMemFreeHost(void *memory)
{
    CUresult code = INVALID_VALUE;

    NEED_CONTEXT;
    pthread_mutex_lock(&lock);
    for (struct locked **link = &page_locked; *link; link = &(*link)->next) {
        struct locked *gone = *link;
        if (gone->memory != memory)
            continue;
        *link = gone->next;
        free(gone->memory);
        free(gone);
        live--;
        code = CUDA_SUCCESS;
        break;
    }
    pthread_mutex_unlock(&lock);
    return code;
}

static bool is_locked(const void *memory, size_t bytes)
{
    const char *at = memory;
    bool found = false;

    pthread_mutex_lock(&lock);
    for (const struct locked *l = page_locked; l && !found; l = l->next)
        found = at >= l->memory && at + bytes <= l->memory + l->bytes;
    pthread_mutex_unlock(&lock);
    return found;
}

/* ---- streams ---- */

/* Under the lock: notes that a stream has or has not work to do that uses memory. False where
 * another stream has work to do with the same memory, and either writes: nothing tells which comes
 * first. */
static bool note_uses(const struct work *work, CUstream stream, int change)
{
    bool alone = true;

    for (unsigned i = 0; i < work->use_count; i++) {
        struct allocation *a = find_allocation(work->used[i]);
        const bool writes = i + work->written >= work->use_count;
        if (!a) /* an empty array */
            continue;
        a->uses[stream->number] += (unsigned)change;
        a->writes[stream->number] += writes ? (unsigned)change : 0;
        for (unsigned s = 0; s < MOST_STREAMS; s++)
            if (s != stream->number && (writes ? a->uses[s] : a->writes[s]))
                alone = false;
    }
    return alone;
}

/* Puts work into a stream. */
static CUresult append(CUstream stream, const struct work *work)
{
    struct work *copy = malloc(sizeof *copy);
    bool alone;

    *copy = *work;
    copy->next = NULL;
    pthread_mutex_lock(&lock);
    alone = note_uses(work, stream, 1);
    if (work->kind == COPY && hold && stream->waits >= hold) {
        stream->copies_since++;
        pthread_cond_broadcast(&released);
    }
    pthread_mutex_unlock(&lock);
    pthread_mutex_lock(&stream->lock);
    if (stream->last)
        stream->last->next = copy;
    else
        stream->first = copy;
    stream->last = copy;
    pthread_mutex_unlock(&stream->lock);
    if (!alone)
        fputs("fake CUDA: two streams use the same memory at the same time\n", stderr);
    return alone ? CUDA_SUCCESS : INVALID_VALUE;
}

/* Keeps the first kernel from ending before the copy that it is held for. */
static CUresult hold_kernel(CUstream own)
{
    struct timespec end;
    int late = 0;
    bool copied = false;

    clock_gettime(CLOCK_REALTIME, &end);
    end.tv_sec += 20;
    pthread_mutex_lock(&lock);
    while (hold && !copied && !late) {
        for (CUstream s = streams; s && !copied; s = s->next)
            copied = s->number < own->number && s->copies_since > 0;
        if (!copied)
            late = pthread_cond_timedwait(&released, &lock, &end);
    }
    hold = 0;
    if (late)
        sticky = 702; /* CUDA_ERROR_LAUNCH_TIMEOUT */
    pthread_mutex_unlock(&lock);
    return late ? 702 : CUDA_SUCCESS;
}

/* Where each of the kernel's arguments is. */
static void place_arguments(struct arguments *a, void *to[ARGUMENTS])
{
    void *const places[ARGUMENTS] = {
        &a->arrays[0], &a->arrays[1],  &a->arrays[2], &a->arrays[3], &a->arrays[4], &a->arrays[5],
        &a->arrays[6], &a->arrays[7],  &a->arrays[8], &a->params,    &a->tile,      &a->first_row,
        &a->end_row,   &a->first_line, &a->end_line,  &a->samples,   &a->texels};

    memcpy(to, places, sizeof places);
}

#define ARRAY(type, n) ((const type *)device_memory(a->arrays[n], 1))

static void run_c(const struct work *work)
{
    const struct arguments *a = &work->arguments;
    const unsigned width = work->grid[0] * work->block[0];
    const unsigned height = work->grid[1] * work->block[1];
    const bk_uint *samples = device_memory(a->samples, 1);
    bk_texel *texels = device_memory(a->texels, 1);
    bk_grid grid;

    bk_grid_from_params(&grid, &a->params);
    grid.tiles = ARRAY(bk_ulong, 0);
    grid.uppers = ARRAY(bk_ulong, 1);
    grid.lowers = ARRAY(bk_ulong, 2);
    grid.leaves = ARRAY(bk_ulong, 3);
    grid.normals = ARRAY(bk_uint, 4);
    grid.planes = ARRAY(bk_uint, 5);
    grid.colors = a->arrays[6] ? ARRAY(bk_uint, 6) : NULL;
    grid.seconds = ARRAY(bk_uint, 7);
    for (bk_uint y = 0; y < height; y++)
        for (bk_uint x = 0; x < width; x++) {
            bk_cache cache = bk_cache_empty();
            bk_uint row = a->first_row + y;
            bk_texel *to = texels + (size_t)row * a->tile.width + x;
            if (x >= a->tile.width || row >= a->end_row)
                continue;
            if (a->first_line == 0)
                *to = bk_texel_empty();
            bk_sample_texel(&grid, &a->params, &cache, ARRAY(bk_triangle, 8), &a->tile, samples, x,
                            row, a->first_line, a->end_line, to);
        }
}

static void run_ptx(struct work *work)
{
    void *parameters[ARGUMENTS];
    struct ptx_launch launch = {.grid_x = work->grid[0],
                                .grid_y = work->grid[1],
                                .block_x = work->block[0],
                                .block_y = work->block[1],
                                .parameters = parameters,
                                .memory = device_memory};
    bool fine;

    place_arguments(&work->arguments, parameters);
    fine = ptx_run(ptx, &launch);
    pthread_mutex_lock(&lock);
    instructions += launch.instructions;
    if (!fine)
        sticky = STICKY; /* CUDA_ERROR_ILLEGAL_ADDRESS */
    pthread_mutex_unlock(&lock);
}

static void run_kernel(struct work *work)
{
    const struct arguments *a = &work->arguments;

    if (ptx)
        run_ptx(work);
    else
        run_c(work);
    if (sample_seconds > 0) {
        uint64_t lines = (uint64_t)(a->end_row - a->first_row) * (a->end_line - a->first_line);
        pthread_mutex_lock(&lock);
        virtual_now += sample_seconds * (double)(lines * a->tile.width * a->params.samples);
        pthread_mutex_unlock(&lock);
    }
}

static void run_work(struct work *work)
{
    if (work->kind == COPY) {
        memcpy(work->to, work->from, work->bytes);
    } else if (work->kind == LAUNCH) {
        run_kernel(work);
    } else {
        pthread_mutex_lock(&lock);
        work->event->at = sample_seconds > 0 ? virtual_now : bsq_seconds_now();
        pthread_mutex_unlock(&lock);
        work->event->pending = 0;
    }
}

/* Does a stream's work, up to an event where one is given. */
static void run_stream(CUstream stream, CUevent until)
{
    pthread_mutex_lock(&stream->lock);
    while (stream->first && !(until && !until->pending)) {
        struct work *work = stream->first;
        stream->first = work->next;
        if (!stream->first)
            stream->last = NULL;
        run_work(work);
        if (work->kind == LAUNCH)
            hold_kernel(stream);
        pthread_mutex_lock(&lock);
        note_uses(work, stream, -1);
        pthread_mutex_unlock(&lock);
        free(work);
    }
    pthread_mutex_unlock(&stream->lock);
}

CUresult cuStreamCreate(CUstream *stream, unsigned flags)
{
    BEGIN_IN_CONTEXT;
    *stream = calloc(1, sizeof **stream);
    pthread_mutex_init(&(*stream)->lock, NULL);
    pthread_mutex_lock(&lock);
    (*stream)->next = streams;
    streams = *stream;
    (*stream)->number = ++streams_made % MOST_STREAMS;
    live++;
    pthread_mutex_unlock(&lock);
    return flags <= CU_STREAM_NON_BLOCKING ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuStreamSynchronize(CUstream stream)
{
    run_stream(stream, NULL);
    pthread_mutex_lock(&lock);
    stream->waits++;
    pthread_mutex_unlock(&lock);
    BEGIN_IN_CONTEXT;
    return CUDA_SUCCESS;
}

CUresult cuStreamDestroy_v2(CUstream stream)
{
    NEED_CONTEXT;
    run_stream(stream, NULL);
    pthread_mutex_lock(&lock);
    for (CUstream *link = &streams; *link; link = &(*link)->next)
        if (*link == stream) {
            *link = stream->next;
            break;
        }
    live--;
    pthread_mutex_unlock(&lock);
    pthread_mutex_destroy(&stream->lock);
    free(stream);
    return CUDA_SUCCESS;
}

CUresult cuMemcpyHtoDAsync_v2(CUdeviceptr to, const void *from, size_t bytes, CUstream stream)
{
    struct work work = {.kind = COPY,
                        .to = device_memory(to, bytes),
                        .from = from,
                        .bytes = bytes,
                        .used = {to},
                        .use_count = 1,
                        .written = 1};

    BEGIN_IN_CONTEXT;
    if (!work.to || !is_locked(from, bytes))
        return INVALID_VALUE;
    return append(stream, &work);
}

CUresult cuMemcpyDtoHAsync_v2(void *to, CUdeviceptr from, size_t bytes, CUstream stream)
{
    struct work work = {.kind = COPY,
                        .to = to,
                        .from = device_memory(from, bytes),
                        .bytes = bytes,
                        .used = {from},
                        .use_count = 1};

    BEGIN_IN_CONTEXT;
    if (!work.from || !is_locked(to, bytes))
        return INVALID_VALUE;
    return append(stream, &work);
}

CUresult cuEventCreate(CUevent *event, unsigned flags)
{
    BEGIN_IN_CONTEXT;
    *event = calloc(1, sizeof **event);
    count_live(1);
    return flags <= CU_EVENT_BLOCKING_SYNC ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuEventDestroy_v2(CUevent event)
{
    NEED_CONTEXT;
    free(event);
    count_live(-1);
    return CUDA_SUCCESS;
}

CUresult cuEventRecord(CUevent event, CUstream stream)
{
    struct work work = {.kind = RECORD, .event = event};

    BEGIN_IN_CONTEXT;
    event->stream = stream ? stream : &default_stream;
    event->pending = 1;
    return append(event->stream, &work);
}

CUresult cuEventSynchronize(CUevent event)
{
    if (event->pending)
        run_stream(event->stream, event);
    BEGIN_IN_CONTEXT;
    return CUDA_SUCCESS;
}

CUresult cuEventElapsedTime(float *milliseconds, CUevent from, CUevent to)
{
    BEGIN_IN_CONTEXT;
    if (!from->stream || !to->stream)
        return INVALID_HANDLE;
    if (from->pending || to->pending)
        return NOT_READY;
    *milliseconds = (float)(1e3 * (to->at - from->at));
    return CUDA_SUCCESS;
}

/* ---- kernels ---- */

/* Whether the entry's parameters have the sizes of argument_bytes. */
static int entry_fits(const char *kernel)
{
    const char *at = strstr(kernel, ".entry bake_tile(");
    const char *end = at ? strchr(at, ')') : NULL;

    for (int i = 0; i < ARGUMENTS; i++) {
        char type[8], declaration[200] = "";
        size_t bytes = 1;
        if (!at || !(at = strstr(at, ".param ")) || at > end)
            return 0;
        at += strlen(".param ");
        sscanf(at, "%199[^,)]", declaration);
        if (sscanf(declaration, ".align %*d .b8 %*[^[][%zu", &bytes) == 1)
            ;
        else if (sscanf(declaration, ".u%7[0-9]", type) == 1)
            bytes = strtoul(type, NULL, 10) / 8;
        if (bytes != argument_bytes[i])
            return 0;
    }
    at = strstr(at, ".param ");
    return !at || at > end;
}

CUresult cuModuleLoadDataEx(CUmodule *module, const void *image, unsigned count, int *options,
                            void **values)
{
    const char *text = image, *target = strstr(text, ".target sm_");
    char *log = NULL;

    BEGIN_IN_CONTEXT;
    for (unsigned i = 0; i < count; i++)
        if (options[i] == CU_JIT_ERROR_LOG_BUFFER)
            log = values[i];
    if (!target || atoi(target + strlen(".target sm_")) > capability || !entry_fits(text)) {
        if (log)
            strcpy(log, "ptxas fatal\nnot for this GPU");
        return INVALID_PTX;
    }
    if (runs_ptx && !(ptx = ptx_read(image, "bake_tile")))
        return INVALID_PTX;
    *module = (CUmodule)&allocations;
    count_live(1);
    return CUDA_SUCCESS;
}

CUresult cuModuleUnload(CUmodule module)
{
    NEED_CONTEXT;
    ptx_free(ptx);
    ptx = NULL;
    count_live(-1);
    return module ? CUDA_SUCCESS : INVALID_HANDLE;
}

CUresult cuModuleGetFunction(CUfunction *function, CUmodule module, const char *name)
{
    BEGIN_IN_CONTEXT;
    *function = (CUfunction)module;
    return strcmp(name, "bake_tile") == 0 ? CUDA_SUCCESS : NOT_FOUND;
}

/* For what is not in registers, with the first launch; and the clock goes on. */
static bool take_local_memory(void)
{
    bool taken = true;

    if (local_bytes == 0) {
        local_bytes = memory_bytes / 32;
        taken = take_bytes(local_bytes);
        pthread_mutex_lock(&lock);
        virtual_now += 3600 * hours;
        pthread_mutex_unlock(&lock);
    }
    return taken;
}

CUresult cuLaunchKernel(CUfunction function, unsigned grid_x, unsigned grid_y, unsigned grid_z,
                        unsigned block_x, unsigned block_y, unsigned block_z, unsigned shared_bytes,
                        CUstream stream, void **parameters, void **extra)
{
    struct work work = {.kind = LAUNCH, .grid = {grid_x, grid_y}, .block = {block_x, block_y}};
    struct arguments *a = &work.arguments;
    void *to[ARGUMENTS];

    BEGIN_IN_CONTEXT;
    if (!function || grid_x * grid_y != grid_x * grid_y * grid_z ||
        block_x * block_y * block_z > 1024 || block_x * block_y * block_z % 32 != 0 ||
        grid_y > 65535 || shared_bytes || extra)
        return INVALID_VALUE;
    place_arguments(a, to);
    for (int i = 0; i < ARGUMENTS; i++)
        memcpy(to[i], parameters[i], argument_bytes[i]);
    for (int i = 0; i < 9; i++)
        work.used[work.use_count++] = a->arrays[i];
    work.used[work.use_count++] = a->samples;
    work.used[work.use_count++] = a->texels;
    work.written = 1;
    if (!take_local_memory())
        return CUDA_ERROR_OUT_OF_MEMORY;
    return append(stream, &work);
}
