/* gpu.h - traces patches on devices with memory and streams of their own, whatever their API.
 *
 * Takes a struct bake_driver from the API's folder and a job; gives texels. The grid goes up
 * through a staging buffer, workers trace patches in launch batches, and the device's clock tells
 * how long they took. */
#ifndef BAKE_DEVICE_GPU_GPU_H
#define BAKE_DEVICE_GPU_GPU_H

#include <pthread.h>

#include "libbake/device/driver/driver.h"
#include "libbake/device/scene/scene.h"
#include "libbake/kernel/bk_meet.h"
#include "libbake/ray/ray.h"

/* ---- launch batches: launches.c ---- */

/* How much of a patch one kernel launch traces.
 *
 * A device does nothing else during a launch, and desktop drivers abort launches that take seconds.
 * So a launch has at most BAKE_BATCH_SAMPLES samples, and BAKE_BATCH_RAYS rays from their hits: 4
 * ms on a fast GPU, 0.2 s on a slow one.
 *
 * One thread of the device traces the samples of a texel one after another. Each takes about 30 us
 * on any device, and a texel has up to 4096. If a texel has more than BAKE_BATCH_THREAD samples, a
 * launch takes some lines of the samples of many texels, and later launches continue. */
enum { BAKE_BATCH_SAMPLES = 1 << 17, BAKE_BATCH_THREAD = 1 << 8, BAKE_BATCH_RAYS = 1 << 22 };

/* Returns the most samples of a batch: at least a line of a texel's. */
uint32_t bake_batch_samples(const struct bk_params *params);
/* Returns the first batch of a patch, which has the size of all but the last ones. */
struct bk_batch bake_first_batch(const struct bk_params *params, const struct bk_patch *patch);
/* Moves a batch to the next samples of a patch: to other lines of the same texels, then to further
 * columns, then to further rows. Returns false after the last one. */
bool bake_next_batch(const struct bk_params *params, const struct bk_patch *patch,
                     const struct bk_batch *first, struct bk_batch *batch);

/* How many patches a worker starts before it waits for the first: two, so that copies and the
 * worker's own part run beside kernels; one if all workers' patches together had more than
 * BAKE_RAYS_STARTED rays, for which a slow GPU would take seconds after an interruption. */
enum { BAKE_WINDOWS_MAX = 2, BAKE_RAYS_STARTED = 1 << 27 };
unsigned bake_patch_windows(const struct bk_params *params, uint32_t patch_texels,
                            unsigned workers);

/* ---- times: launches.c ---- */

enum { BAKE_TIME_SPANS_MAX = 256 };

struct bake_span {
    double start, end; /* seconds on any one clock */
};

/* The union of time spans: kernels of several streams overlap, so their sum would exceed the time
 * that passed. Zero at first. Not thread-safe. */
struct bake_time_spans {
    double closed; /* length of the spans that have left the list */
    unsigned count;
    struct bake_span spans[BAKE_TIME_SPANS_MAX];
};

/* Adds a span. Spans may come in any order, as long as none comes after BAKE_TIME_SPANS_MAX later
 * ones that do not touch each other. */
void bake_time_spans_add(struct bake_time_spans *spans, const struct bake_span *span);

/* Returns the length of the union of all spans, in seconds. */
double bake_time_spans_seconds(const struct bake_time_spans *spans);

/* ---- devices: gpu.c ---- */

enum { BAKE_WHY_BYTES = 512 };

/* What a device did since it was opened, in seconds. */
struct bake_device_times {
    double upload;  /* of the grid, wall time */
    double copies;  /* of samples to the device and of texels back, on the device's clock */
    double kernels; /* likewise; kernels that run at the same time count once */
    uint64_t launches;
};

/* Device memory, as the API names it; 0: none. */
typedef uint64_t bake_memory;

/* Steps of a patch, in the order in which a stream does them. */
enum { BAKE_SAMPLES, BAKE_KERNELS, BAKE_TEXELS, BAKE_STEPS };

/* Work that the device does in order, with host memory that it reads and writes by itself. Each
 * worker has a stream for each patch that it has started, and uploads have one. */
struct bake_stream {
    void *own; /* the API's part: `stream_bytes`, zero at first */
    /* The API allocates `host_count` pieces of host memory with host_bytes each. */
    char *host[2];
    unsigned host_count;
    uint64_t host_bytes;
    bool open;
    /* Of a worker: samples and texels of its patch on the device; or single rays and their hits.
     * Without a grid, viewpoints and what is known of their rays are in `texels`, or first rays and
     * their hits. */
    bake_memory samples, texels;
    /* With rays from hits: viewpoints of a batch, and what their rays found. */
    bake_memory points, found;
    struct bake_span times[BAKE_STEPS]; /* of its last patch, on the device's clock */
    uint64_t launches;
};

/* A call of the API that failed, and its error; code 0: none did. */
struct bake_failure {
    const char *call;
    int code;
};
#define BAKE_NO_FAILURE ((struct bake_failure){NULL, 0})

/* Returns the failure of a step from a function that returns a struct bake_failure. */
#define BAKE_TRY_CALL(step)                                                                        \
    do {                                                                                           \
        const struct bake_failure failure_ = (step);                                               \
        if (failure_.code)                                                                         \
            return failure_;                                                                       \
    } while (0)

/* The kernels of bake.cl. */
enum { BAKE_PATCH, BAKE_LOOK, BAKE_RAYS, BAKE_MEET, BAKE_FIRST, BAKE_KERNEL_COUNT };
extern const char *const bake_kernel_names[BAKE_KERNEL_COUNT];
struct bake_gpu;

/* Returns whether a job launches a kernel. */
bool bake_gpu_launches(const struct bake_gpu *gpu, int kernel);

struct bake_argument {
    uint64_t bytes;
    const void *value;
};

enum { BAKE_ARGUMENTS_MAX = 24 };

/* A launch of a kernel with work items of width x height. An argument that is memory of the device
 * is a bake_memory. */
struct bake_launch {
    int kernel;
    uint32_t width, height;
    /* Work items that are side by side in a warp: a power of two, 32 at most; 0: any. */
    uint32_t side;
    struct bake_argument arguments[BAKE_ARGUMENTS_MAX];
    uint32_t count;
};

enum { BAKE_GPU_TEXT = 192 };

/* An API. */
struct bake_driver {
    const char *name;  /* as in "--device name" or "--device name:N" */
    const char *title; /* in messages */
    /* Fills a zeroed list with the devices in the order of their numbers, which their ids end with.
     * Runs in the program bisque-devices, see bake_probe(). */
    void (*list)(struct bake_device_list *out);
    /* Opens device `number`, which is in the list, for the job of gpu->params and sets the names,
     * shares_memory, lacks, memory_bytes and buffer_bytes. close() follows, also after a failure,
     * and releases what is the API's. Errors: BSQ_ENODEVICE, BSQ_ENOMEM. */
    int (*open)(struct bake_gpu *gpu, uint32_t number);
    void (*close)(struct bake_gpu *gpu);
    uint64_t gpu_bytes, stream_bytes; /* of the API's structures, zero at first */

    /* Returns an error's text. buffer: BAKE_GPU_TEXT bytes. */
    const char *(*describe)(const struct bake_gpu *gpu, int code, char *buffer);
    /* Lets the calling thread use the device. NULL: every thread may. */
    struct bake_failure (*attach)(struct bake_gpu *gpu);

    /* `bytes` is 0 for arrays that the kernel does not read; *out may be 0 then. */
    struct bake_failure (*allocate)(struct bake_gpu *gpu, uint64_t bytes, bake_memory *out);
    void (*release)(struct bake_gpu *gpu, bake_memory memory);

    /* Creates a stream and its host memory. close_stream() follows, also after a failure; it waits
     * for the stream's work. */
    struct bake_failure (*open_stream)(struct bake_gpu *gpu, struct bake_stream *stream);
    void (*close_stream)(struct bake_gpu *gpu, struct bake_stream *stream);

    /* Steps on a stream, timed as step number `step`. Copies bytes of the stream's host memory to
     * device memory from `at` on, and back. launch() runs once for each batch. */
    struct bake_failure (*send)(struct bake_gpu *gpu, struct bake_stream *stream, const char *from,
                                uint64_t bytes, bake_memory to, uint64_t at, int step);
    struct bake_failure (*launch)(struct bake_gpu *gpu, struct bake_stream *stream,
                                  const struct bake_launch *launch);
    struct bake_failure (*fetch)(struct bake_gpu *gpu, struct bake_stream *stream, uint64_t bytes);
    /* Waits until the last copy with this number is over, asleep; until all steps are. */
    struct bake_failure (*wait)(struct bake_gpu *gpu, struct bake_stream *stream, int step);
    struct bake_failure (*finish)(struct bake_gpu *gpu, struct bake_stream *stream);
    /* Sets stream->times after a patch. */
    struct bake_failure (*times)(struct bake_gpu *gpu, struct bake_stream *stream);
};

enum { BAKE_AREAS = 2 /* for groups of chunks */, BAKE_WAVE /* that for first rays */ };

/* An opened device; the API's structure begins with it. */
struct bake_gpu {
    char name[128];        /* for users */
    char device_name[128]; /* for messages */
    struct bsq_ctx *ctx;
    const struct bake_driver *driver;
    bool shares_memory; /* with the host: allocations count for the job's budget */
    bool exact;         /* there is no grid: chunks of triangles are in `areas` */
    const char *lacks;  /* what the device lacks for these, or NULL */
    /* Memory that the job may use; from bake_gpu_open() on, for the grid. The largest buffer, and
     * the largest one for an array of the grid. */
    uint64_t memory_bytes, buffer_bytes, array_bytes;
    bake_memory triangles;
    bake_memory arrays[BAKE_GRID_ARRAYS];
    bake_memory areas[BAKE_WAVE + 1];
    uint64_t area_bytes; /* of each of BAKE_AREAS; 0: there are none */
    uint32_t area_count;
    uint64_t wave_bytes;     /* of area BAKE_WAVE */
    struct bk_params params; /* the job's, for these arrays */
    uint32_t patch_texels;
    unsigned worker_count, windows; /* see bake_patch_windows() */
    /* Of the workers, of the workers again for their second patches, and then that of uploads. */
    struct bake_stream *streams;
    char *stream_memory; /* the API's parts of them */
    /* Data goes up through two halves of host memory, those of the last stream: one is filled while
     * the device copies the other, so the host never copies anything larger. */
    unsigned filling;      /* the half that is being filled */
    uint64_t used;         /* bytes of it */
    bake_memory upload_to; /* array that is being sent, and the bytes sent so far */
    uint64_t upload_at;
    struct bake_failure upload_failure;
    double upload_seconds;
    struct bake_time_spans uploads; /* to areas */
    uint64_t reserved_bytes;        /* of host memory, for the whole job */
    pthread_mutex_t lock;           /* protects uploads, copies and kernels */
    pthread_mutex_t sending;        /* to areas: one copy at a time */
    struct bake_time_spans copies, kernels;
};

/* Opens a device and loads a job's triangles and grid. Patches and triangles take their share of
 * the device's memory, and the grid or the areas may have the rest. *out: NULL after a failure.
 * Errors: BSQ_RETRY if the grid or a chunk does not fit, or the device does not compute as chunks
 * need; BSQ_ENODEVICE if not even the rest fits or a call fails; BSQ_ENOMEM, BSQ_EINTR. */
int bake_gpu_open(struct bsq_ctx *ctx, const struct bake_driver *driver, uint32_t number,
                  const struct bake_scene *scene, struct bake_gpu **out);
void bake_gpu_close(struct bake_gpu *gpu);

/* Do what bake_device_begin() and bake_device_end() do. They describe a failure in `why`
 * (BAKE_WHY_BYTES) instead of recording it, since the caller may fall back to the processor. */
int bake_gpu_begin(struct bake_gpu *gpu, const struct bk_patch *patch,
                   const uint32_t *sample_triangles, unsigned worker, unsigned window, char *why);
int bake_gpu_end(struct bake_gpu *gpu, const struct bk_patch *patch, float *texels, unsigned worker,
                 unsigned window, char *why);

/* Traces `count` single rays, BAKE_GPU_RAYS at most, for a job with curvature. rays: BK_RAY_FLOATS
 * each. *hits: BK_HIT_FLOATS each, until the worker's next call. The worker must have no patch that
 * it has only started. Failures are those of bake_gpu_begin(). */
enum { BAKE_GPU_RAYS = 1 << 14 };
int bake_gpu_trace_rays(struct bake_gpu *gpu, const float *rays, uint32_t count, float t_min,
                        float t_max, const float **hits, unsigned worker, char *why);

/* ---- chunks of triangles: areas.c ---- */

/* Makes areas for groups of chunks, in place of those that are there: one of `whole` bytes, or if
 * that does not fit, two as large as fit, or one if two would be smaller than `least`. An area has
 * gpu->area_bytes then. Describes a failure in `why`. Must not be called from parallel work. */
int bake_gpu_make_areas(struct bake_gpu *gpu, uint64_t whole, uint64_t least, char *why);
void bake_gpu_release_areas(struct bake_gpu *gpu);

/* Makes area BAKE_WAVE, of gpu->wave_bytes; of a device that shares the host's memory, they may
 * become less, but not less than `least`. Otherwise likewise. */
int bake_gpu_make_wave(struct bake_gpu *gpu, uint64_t least, char *why);

/* Copies bytes to an area, from its byte `at` on. Returns when they are there. Workers may call
 * this at a time, also while rays meet what is in other areas or parts of them. */
int bake_gpu_send(struct bake_gpu *gpu, uint32_t area, uint64_t at, const void *from,
                  uint64_t bytes, unsigned worker, char *why);

/* Returns the most viewpoints of bake_gpu_look(). */
uint32_t bake_gpu_viewpoints(const struct bk_params *params);

/* Traces the rays of viewpoints begin to end - 1 through the group of an area, and notes in their
 * states what it adds. params: those of the job's scene, with the lengths of rays in its space. */
int bake_gpu_look(struct bake_gpu *gpu, uint32_t area, const struct bk_params *params,
                  const struct bake_viewpoints *viewpoints, uint64_t begin, uint64_t end,
                  unsigned worker, const struct bake_ray_states *states, char *why);

/* First rays by bundles. */
struct bake_first_rays {
    /* Writes the BAKE_RAY_BUNDLE rays of a bundle; one without a direction hits nothing. */
    void (*get)(void *arg, uint32_t bundle, bk_first_ray *out);
    void *arg;
    uint32_t bundles; /* BAKE_FIRST_BUNDLES at most */
};
enum { BAKE_FIRST_BUNDLES = 1 << 10 };

/* Traces first rays through the chunk at byte `at` of area BAKE_WAVE, a group of its own. *hits: of
 * each ray, see bk_meet_first(); until the worker's next call. */
int bake_gpu_first(struct bake_gpu *gpu, uint64_t at, const bk_limits *limits,
                   const struct bake_first_rays *rays, const bk_first_hit **hits, unsigned worker,
                   char *why);

/* Returns what the device did so far. Must not be called while patches are traced. */
struct bake_device_times bake_gpu_times(struct bake_gpu *gpu);

/* Records a failure of a call while the device is being opened. Returns BSQ_ENODEVICE; 0 if there
 * is none. */
int bake_gpu_fail(const struct bake_gpu *gpu, struct bake_failure failure);

#endif
