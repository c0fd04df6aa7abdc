/* backend.h - what each kind of device implements for device.c. */
#ifndef BAKE_DEVICE_BACKEND_H
#define BAKE_DEVICE_BACKEND_H

#include "libbake/device/device.h"
#include "libbake/device/subgrid/subgrid.h"

/* An opened device of some kind; the kind's own structure begins with it. */
struct bake_backend {
    char name[128];
    /* Where load is not NULL: what parts of the grid may take of the device's memory, all arrays
     * together and each. */
    uint64_t memory_bytes, buffer_bytes;
    uint64_t other_bytes; /* of the device's memory that the job uses besides */
    bool holds_grid;      /* all of it, in slot 0; set by device.c */
    /* Loading all of it found less memory than memory_bytes said; that tells now what parts may
     * take. */
    bool lacked_memory;
    /* Puts a part of the grid into a slot, instead of what was there; its tiles can be traced from
     * then on. From one thread at a time, while other threads trace tiles of the other slot. NULL:
     * the device reads the mapped file. Failures as for trace(). */
    int (*load)(struct bake_backend *backend, unsigned slot, const struct bake_part *part,
                char *why);
    /* As bake_device_trace(). A failure is described in `why` (BAKE_WHY_BYTES) instead of being
     * recorded, since the caller may go on with another device. */
    int (*trace)(struct bake_backend *backend, unsigned slot, const struct bk_tile *tile,
                 const uint32_t *sample_triangles, struct bk_texel *texels, unsigned worker,
                 char *why);
    /* NULL where the device is the processor. Not while trace() runs. */
    void (*times)(struct bake_backend *backend, struct bake_device_times *out);
    void (*close)(struct bake_backend *backend);
};

enum { BAKE_WHY_BYTES = 512 };

/* Longest buffer that is asked of a device: some promise more than they can give in one piece. */
#define BAKE_BUFFER_MOST (UINT64_C(1) << 30)

/* Opens the native device. Errors: BSQ_ENOMEM. */
int bake_native_open(struct bsq_ctx *ctx, const struct bake_job *job, struct bake_backend **out);
void bake_native_info(struct bsq_ctx *ctx, struct bake_device_info *info);

/* Opens CUDA device number `index`; the grid is loaded afterwards. Errors: BSQ_ENODEVICE,
 * BSQ_ENOMEM.
 */
int bake_cuda_open(struct bsq_ctx *ctx, int64_t index, const struct bake_job *job,
                   struct bake_backend **out);
/* Calls fn for each CUDA device in the order of their numbers; not at all where there is no CUDA.
 * Warns of a driver that does not start. Errors: BSQ_ENOMEM, BSQ_ENODEVICE. */
int bake_cuda_list(struct bsq_ctx *ctx,
                   void (*fn)(void *arg, const struct bake_device_info *device), void *arg);

/* Number of the first CUDA device above `after` (-1: of all), or a negative number. */
int64_t bake_cuda_next_gpu(struct bsq_ctx *ctx, int64_t after);

/* Which OpenCL device to open. */
enum { BAKE_OPENCL_FIRST = -1 /* the first GPU, else the first device */ };

/* Opens OpenCL device number `index`, or BAKE_OPENCL_FIRST; the grid is loaded afterwards. Errors:
 * BSQ_ENODEVICE, BSQ_ENOMEM. */
int bake_opencl_open(struct bsq_ctx *ctx, int64_t index, const struct bake_job *job,
                     struct bake_backend **out);
/* Calls fn for each OpenCL device in the order of their numbers; not at all where there is no
 * OpenCL. Warns of drivers that crash or that libOpenCL does not know. Errors: BSQ_ENOMEM,
 * BSQ_ENODEVICE. */
int bake_opencl_list(struct bsq_ctx *ctx,
                     void (*fn)(void *arg, const struct bake_device_info *device), void *arg);

/* Errors: BSQ_ENODEVICE where there is no OpenCL device, or a driver crashes when it is asked for
 * them. */
int bake_opencl_check(struct bsq_ctx *ctx);

/* Number of the first GPU above `after` (-1: of all) among the OpenCL devices, or a negative
 * number. */
int64_t bake_opencl_next_gpu(struct bsq_ctx *ctx, int64_t after);

#endif
