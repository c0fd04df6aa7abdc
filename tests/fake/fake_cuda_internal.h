/* fake_cuda_internal.h - what the parts of the fake driver share: its state, the start of its
 * functions, and the work of streams. */
#ifndef FAKE_CUDA_INTERNAL_H
#define FAKE_CUDA_INTERNAL_H

#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>

#include "libbake/device/cuda/cuda_api.h"
#include "libbake/kernel/bk_meet.h"

/* Exported functions must have the types that the program calls them with. */
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
    NOT_READY = CUDA_ERROR_NOT_READY,
    STICKY = 700
};

#define DEVICE_ADDRESS (1ull << 62)

enum { MAX_STREAMS = 256 };

struct allocation {
    char *memory;
    size_t bytes;
    struct allocation *next;
    unsigned uses[MAX_STREAMS], writes[MAX_STREAMS]; /* by pending work of each stream */
};

struct fake_cuda {
    pthread_mutex_t lock; /* protects all below */
    int device_count, capability;
    int live;   /* objects that exist */
    int sticky; /* the code with which all further calls fail */
    size_t memory_bytes, used_bytes;
    size_t local_bytes; /* taken by the first launch */
    struct allocation *allocations;
    double sample_seconds, virtual_now, hours;
};
extern struct fake_cuda fake;
extern _Thread_local CUcontext fake_current;

/* Returns the code with which a call must fail, or 0. */
CUresult fake_begin(const char *call);
#define BEGIN                                                                                      \
    do {                                                                                           \
        CUresult begin_code = fake_begin(__func__);                                                \
        if (begin_code != CUDA_SUCCESS)                                                            \
            return begin_code;                                                                     \
    } while (0)

/* Fails if the thread has no context. */
#define BEGIN_IN_CONTEXT                                                                           \
    BEGIN;                                                                                         \
    if (!fake_current)                                                                             \
    return 201

/* Starts calls that free something. They need a context, but work after a failure, so that leaks
 * are found then too. */
#define NEED_CONTEXT                                                                               \
    if (!fake_current)                                                                             \
    return 201

void fake_count_live(int change);
bool fake_is_device(CUdevice device);

/* ---- memory ---- */

bool fake_take_bytes(size_t bytes);
/* Under the lock. */
struct allocation *fake_find_allocation(CUdeviceptr address);
/* Returns the host address of device memory; NULL if the bytes are not all in one allocation. */
void *fake_device_memory(CUdeviceptr address, size_t bytes);
bool fake_is_locked(const void *memory, size_t bytes);

/* ---- streams ---- */

enum { GRID_ARRAYS = 10 };

/* Arguments of a launch: those of bake_patch(), and some that the other kernels have. */
struct arguments {
    int kernel;       /* number in the list of fake_kernel.c */
    CUdeviceptr area; /* of bake_meet() and bake_first(), whose rays are `texels` */
    CUdeviceptr arrays[GRID_ARRAYS], triangles, samples, points, found, texels;
    bk_params params;
    bk_patch patch;
    bk_batch batch;
    bk_uint stage, point_count, place;
    bk_limits limits;
    bk_single_rays rays;
};

struct work {
    enum { COPY, LAUNCH, RECORD } kind;
    void *to;
    const void *from;
    size_t bytes;
    struct arguments arguments;
    unsigned grid[2], block[2];
    CUdeviceptr used[GRID_ARRAYS + 6]; /* the last `written` of them are written */
    unsigned use_count, written;
    CUevent event;
    struct work *next;
};

/* Enqueues work on a stream. */
CUresult fake_append(CUstream stream, const struct work *work);
/* Does the work of all streams. */
void fake_run_streams(void);
void fake_run_kernel(const struct work *work);

#endif
