/* compute.h - what devices with memory and queues of their own have in common,
 * whatever the API that they are spoken to with: the grid goes up through a ring of two pieces of
 * host memory, workers trace tiles in slices of rows, and the device's clock tells how long it
 * took. An API brings struct bake_compute_calls. */
#ifndef BAKE_DEVICE_COMPUTE_H
#define BAKE_DEVICE_COMPUTE_H

#include <pthread.h>

#include "libbake/device/time_spans.h"
#include "libbake/device/backend.h"
#include "libbake/device/launch_batches.h"
#include "libbake/device/staging_buffer.h"

/* Device memory, as the API names it; 0: none. */
typedef uint64_t bake_memory;

/* A part of the grid on the device. */
struct bake_compute_part {
    bake_memory arrays[BAKE_PART_ARRAYS];
    struct bk_params params;
    uint64_t reserved_bytes; /* of host memory, on devices that share it */
};

/* What the device did for a tile, on its own clock. */
struct bake_tile_times {
    struct bake_span samples, kernels, texels;
};

struct bake_compute;

enum { BAKE_COMPUTE_TEXT = 192 };

/* Each call but those without a result leaves 0 or the API's error in *code; where it returns a
 * name, that is the API's function that failed. */
struct bake_compute_calls {
    /* Text of an error. buffer: BAKE_COMPUTE_TEXT bytes. */
    const char *(*describe)(const struct bake_compute *compute, int code, char *buffer);
    /* Whether an error says that the device has no memory left. */
    bool (*lacks_memory)(int code);
    /* Makes the calling thread one that may use the device; NULL where any may. */
    const char *(*attach)(struct bake_compute *compute, int *code);

    /* Memory; `bytes` may be 0 for arrays that are never read. */
    void (*allocate)(struct bake_compute *compute, uint64_t bytes, bake_memory *out, int *code);
    /* How much the job may use besides what it has; NULL where there is no asking. */
    uint64_t (*room)(struct bake_compute *compute);
    void (*release)(struct bake_compute *compute, bake_memory memory);
    /* Begins to copy a piece of the stage to a place in memory, waits until one may be filled
     * again, or until all are copied. */
    void (*send)(struct bake_compute *compute, unsigned piece, uint64_t bytes, bake_memory to,
                 uint64_t at, int *code);
    void (*wait_for_piece)(struct bake_compute *compute, unsigned piece, int *code);
    void (*drain)(struct bake_compute *compute, int *code);

    /* A worker's queue and memory for tiles; what was opened is closed, also after a failure. */
    const char *(*open_worker)(struct bake_compute *compute, unsigned worker, int *code);
    void (*close_worker)(struct bake_compute *compute, unsigned worker);
    /* A tile: puts its samples, slices of it in order, and its texels into the worker's queue; the
     * last waits for all of it. */
    const char *(*write)(struct bake_compute *compute, unsigned worker,
                         const struct bake_compute_part *part, const struct bk_tile *tile,
                         const uint32_t *sample_triangles, uint64_t bytes, int *code);
    const char *(*launch)(struct bake_compute *compute, unsigned worker,
                          const struct bake_compute_part *part, const struct bk_tile *tile,
                          const struct bake_slice *slice, int *code);
    const char *(*read)(struct bake_compute *compute, unsigned worker, struct bk_texel *texels,
                        uint64_t bytes, int *code);
    const char *(*times)(struct bake_compute *compute, unsigned worker, struct bake_tile_times *out,
                         int *code);
    /* After a tile, `code` what came of it: the host's memory is no longer used. */
    void (*leave)(struct bake_compute *compute, unsigned worker, int code);
};

struct bake_compute_worker {
    bool open;
    struct bake_slices slices;
    struct bake_tile_times times; /* of its last tile */
    uint64_t launches;
};

/* The structure of an API begins with it. */
struct bake_compute {
    struct bake_backend base;
    struct bsq_ctx *ctx;
    const struct bake_compute_calls *calls;
    char device_name[128]; /* for messages */
    bool shares_memory;    /* with the host: what is on it counts for the job's budget */
    bake_memory triangles;
    struct bake_compute_part parts[BAKE_SLOTS];
    struct bk_params params;
    uint32_t tile_texels;
    unsigned worker_count;
    struct bake_compute_worker *workers;
    struct bake_stage stage; /* the API makes its pieces */
    bake_memory upload_to;
    uint64_t upload_at;
    int upload_code; /* of the call that failed */
    double upload_seconds;
    uint64_t reserved_bytes; /* of host memory, for the whole job */
    pthread_mutex_t lock;    /* of what follows */
    struct bake_busy copies, kernels;
};

/* Begins a structure that is zero. `close` has to end with bake_compute_free(), also after a
 * failure. */
void bake_compute_init(struct bake_compute *compute, struct bsq_ctx *ctx,
                       const struct bake_compute_calls *calls,
                       void (*close)(struct bake_backend *backend));
/* Takes over what the job says and makes the workers' common part. */
int bake_compute_prepare(struct bake_compute *compute, const struct bake_job *job);

/* Bytes of the largest tile's samples and texels. */
uint64_t bake_compute_sample_bytes(const struct bake_compute *compute);
uint64_t bake_compute_texel_bytes(const struct bake_compute *compute);

/* Sets aside what is on the device for the whole job; the rest of `limit` is for the grid.
 * buffer_bytes: the largest buffer. Errors: BSQ_ENODEVICE where that is not enough, BSQ_ENOMEM. */
int bake_compute_share_memory(struct bake_compute *compute, const struct bake_job *job,
                              uint64_t limit, uint64_t buffer_bytes);
/* Takes bytes of the host's budget until the device is closed. */
int bake_compute_reserve(struct bake_compute *compute, const char *what, uint64_t bytes);
/* Sends the low mesh up; the stage has its pieces. */
int bake_compute_send_triangles(struct bake_compute *compute, const struct bake_job *job);

/* Records what failed while the device was opened: BSQ_ENODEVICE. */
int bake_compute_fail(const struct bake_compute *compute, const char *what, int code);

/* Releases workers and memory on the device; then what the host has. */
void bake_compute_unload(struct bake_compute *compute);
void bake_compute_free(struct bake_compute *compute);

#endif
