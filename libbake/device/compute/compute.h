/* compute.h - what all devices with memory and streams of their own share, whatever their API.
 *
 * Takes struct bake_compute_calls from the API's folder, a job and subgrids; gives a struct
 * bake_backend. The grid goes up through a staging buffer, workers trace tiles in launch batches,
 * and the device's clock tells how long they took. */
#ifndef BAKE_DEVICE_COMPUTE_COMPUTE_H
#define BAKE_DEVICE_COMPUTE_COMPUTE_H

#include <pthread.h>

#include "libbake/device/backend/backend.h"
#include "libbake/device/compute/launch_batches.h"
#include "libbake/device/compute/staging_buffer.h"
#include "libbake/device/compute/time_spans.h"

/* Device memory, as the API names it; 0: none. */
typedef uint64_t bake_memory;

/* A subgrid on the device. */
struct bake_compute_subgrid {
    bake_memory arrays[BAKE_SUBGRID_ARRAYS];
    bake_memory block; /* that has all arrays, if the API's `blocks` is set */
    uint64_t block_bytes;
    struct bk_params params;
    uint64_t reserved_bytes; /* of host memory, on devices that share it */
};

/* What the device did for a tile, on its own clock. */
struct bake_tile_times {
    struct bake_span samples, kernels, texels;
};

struct bake_compute;

enum { BAKE_COMPUTE_TEXT = 192 };

/* The API's part. A call with `code` sets it to 0 or to the API's error. A call that returns a
 * string names the API's function that failed. */
struct bake_compute_calls {
    /* Returns an error's text. buffer: BAKE_COMPUTE_TEXT bytes. */
    const char *(*describe)(const struct bake_compute *compute, int code, char *buffer);
    /* Returns whether an error says that the device's memory is exhausted. */
    bool (*lacks_memory)(int code);
    /* Lets the calling thread use the device. NULL: every thread may. */
    const char *(*attach)(struct bake_compute *compute, int *code);

    /* Memory is a number, to which offsets can be added, and allocating or freeing it waits for the
     * device. Then all arrays of a slot are in one block, which later subgrids reuse. */
    bool blocks;
    /* `bytes` is 0 for arrays that the kernel does not read; not if `blocks` is set. */
    void (*allocate)(struct bake_compute *compute, uint64_t bytes, bake_memory *out, int *code);
    void (*release)(struct bake_compute *compute, bake_memory memory);
    /* Returns the device memory that the job may still allocate. NULL: the API cannot tell. */
    uint64_t (*free_bytes)(struct bake_compute *compute);
    /* Starts to copy from a half of the staging buffer to `to` + `at`. */
    void (*send_half)(struct bake_compute *compute, unsigned half, uint64_t bytes, bake_memory to,
                      uint64_t at, int *code);
    /* Waits until a half is copied and may be filled again; until all halves are. */
    void (*wait_for_half)(struct bake_compute *compute, unsigned half, int *code);
    void (*finish_uploads)(struct bake_compute *compute, int *code);

    /* Creates a worker's stream and its memory for tiles. close_worker() follows, also after a
     * failure. */
    const char *(*open_worker)(struct bake_compute *compute, unsigned worker, int *code);
    void (*close_worker)(struct bake_compute *compute, unsigned worker);

    /* Steps of a tile, in this order on the worker's stream; launch() once for each batch. */
    const char *(*send_samples)(struct bake_compute *compute, unsigned worker,
                                const struct bake_compute_subgrid *subgrid,
                                const struct bk_tile *tile, const uint32_t *sample_triangles,
                                uint64_t bytes, int *code);
    const char *(*launch)(struct bake_compute *compute, unsigned worker,
                          const struct bake_compute_subgrid *subgrid, const struct bk_tile *tile,
                          const struct bake_launch_batch *batch, int *code);
    /* Waits until the texels are in host memory. */
    const char *(*fetch_texels)(struct bake_compute *compute, unsigned worker, float *texels,
                                uint64_t bytes, int *code);
    const char *(*times)(struct bake_compute *compute, unsigned worker, struct bake_tile_times *out,
                         int *code);
    /* Ends a tile, whose result was `code`: when it returns, the device no longer uses the caller's
     * memory. */
    void (*end_tile)(struct bake_compute *compute, unsigned worker, int code);
};

struct bake_compute_worker {
    bool open;
    struct bake_batch_sizer sizer;
    struct bake_tile_times times; /* of its last tile */
    uint64_t launches;
};

/* An opened device; the API's structure begins with it. */
struct bake_compute {
    struct bake_backend base;
    struct bsq_ctx *ctx;
    const struct bake_compute_calls *calls;
    char device_name[128]; /* for messages */
    bool shares_memory;    /* with the host: allocations count for the job's budget */
    bake_memory triangles;
    struct bake_compute_subgrid slots[BAKE_SLOTS];
    struct bk_params params;
    uint32_t tile_texels;
    unsigned worker_count;
    struct bake_compute_worker *workers;
    struct bake_staging_buffer staging; /* the API allocates its halves */
    bake_memory upload_to;              /* array that is being sent, and the bytes sent so far */
    uint64_t upload_at;
    int upload_code; /* of the call that failed */
    double upload_seconds;
    uint64_t reserved_bytes; /* of host memory, for the whole job */
    pthread_mutex_t lock;    /* protects copies and kernels */
    struct bake_time_spans copies, kernels;
};

/* Initialises a zeroed structure. `close` must end with bake_compute_free(), also after a failure.
 */
void bake_compute_init(struct bake_compute *compute, struct bsq_ctx *ctx,
                       const struct bake_compute_calls *calls,
                       void (*close)(struct bake_backend *backend));
/* Copies the job's parameters and allocates the workers. Errors: BSQ_ENOMEM. */
int bake_compute_prepare(struct bake_compute *compute, const struct bake_job *job);

/* Return the bytes of the largest tile's samples and texels. */
uint64_t bake_compute_sample_bytes(const struct bake_compute *compute);
uint64_t bake_compute_texel_bytes(const struct bake_compute *compute);

/* Divides `limit` bytes of device memory: tiles and the low-poly mesh take their share, the grid
 * gets the rest. buffer_bytes: limit for one array. Errors: BSQ_ENODEVICE if that is too little;
 * BSQ_ENOMEM. */
int bake_compute_share_memory(struct bake_compute *compute, const struct bake_job *job,
                              uint64_t limit, uint64_t buffer_bytes);
/* Reserves bytes of the host's budget until the device is closed. */
int bake_compute_reserve(struct bake_compute *compute, const char *what, uint64_t bytes);
/* Uploads the low-poly mesh; the staging buffer must have its halves. */
int bake_compute_send_triangles(struct bake_compute *compute, const struct bake_job *job);

/* Records a failure while the device is being opened. Returns BSQ_ENODEVICE. */
int bake_compute_fail(const struct bake_compute *compute, const char *what, int code);

/* Releases workers and memory on the device. */
void bake_compute_unload(struct bake_compute *compute);
/* Releases host memory, the structure included. */
void bake_compute_free(struct bake_compute *compute);

#endif
