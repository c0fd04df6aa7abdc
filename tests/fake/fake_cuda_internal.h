/* fake_cuda_internal.h - what the parts of the fake driver share: its state, how its functions
 * begin, and the work that streams have to do. */
#ifndef FAKE_CUDA_INTERNAL_H
#define FAKE_CUDA_INTERNAL_H

#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>

#include "libbake/device/cuda/cuda_api.h"
#include "libbake/kernel/bk_types.h"

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

struct fake_cuda {
    pthread_mutex_t lock; /* of all below */
    int device_count, capability;
    int live;   /* objects that exist */
    int sticky; /* what all calls fail with from now on */
    size_t memory_bytes, used_bytes;
    size_t taken_bytes, others_bytes; /* that another program is going to take, and has */
    size_t local_bytes;               /* that the first launch took */
    struct allocation *allocations;
    double sample_seconds, virtual_now, hours;
    unsigned hold; /* the waits that the first kernel's end is held for; 0: it is not held */
    bool runs_ptx;
    int maps_memory;
    uint64_t instructions; /* of warps */
};
extern struct fake_cuda fake;
extern _Thread_local CUcontext fake_current;

/* The code that a call has to fail with, or 0. */
CUresult fake_begin(const char *call);
#define BEGIN                                                                                      \
    do {                                                                                           \
        CUresult begin_code = fake_begin(__func__);                                                \
        if (begin_code != CUDA_SUCCESS)                                                            \
            return begin_code;                                                                     \
    } while (0)

/* Of a thread that has no context. */
#define BEGIN_IN_CONTEXT                                                                           \
    BEGIN;                                                                                         \
    if (!fake_current)                                                                             \
    return 201

/* Of calls that free something: they work after a failure too, so that what is left over is told;
 * but not without a context. */
#define NEED_CONTEXT                                                                               \
    if (!fake_current)                                                                             \
    return 201

void fake_count_live(int change);
bool fake_is_device(CUdevice device);

/* ---- memory ---- */

bool fake_take_bytes(size_t bytes);
/* Under the lock. */
struct allocation *fake_find_allocation(CUdeviceptr address);
/* Host address of `bytes` bytes of device memory; NULL where they are not all of one allocation or
 * of pieces of one reservation. */
void *fake_device_memory(CUdeviceptr address, size_t bytes);
bool fake_is_locked(const void *memory, size_t bytes);

/* Memory from malloc() that a call hands out as a whole and another takes back. Lists of them are
 * under the lock, which both functions take. */
struct fake_block {
    char *memory;
    size_t bytes, mapped; /* mapped: of them, by pieces; it cannot be taken back then */
    struct fake_block *next;
};
void fake_hand_out(struct fake_block **list, char *memory, size_t bytes);
/* bytes: as handed out; SIZE_MAX where the caller need not know. */
CUresult fake_take_back(struct fake_block **list, const void *memory, size_t bytes);

/* ---- streams ---- */

/* What a launch passes, in the kernel's order. */
struct arguments {
    CUdeviceptr arrays[9];
    bk_params params;
    bk_tile tile;
    bk_uint first_row, end_row, first_line, end_line;
    CUdeviceptr samples, texels;
};

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

/* Puts work into a stream. */
CUresult fake_append(CUstream stream, const struct work *work);
/* Does the work of all streams. */
void fake_run_streams(void);
void fake_run_kernel(const struct work *work);

#endif
