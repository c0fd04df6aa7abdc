/* backend.h - what each kind of device (a folder beside this one) implements for device.c.
 *
 * A kind exports one struct bake_device_kind; device.c has a row for it. Takes a job and, on
 * devices with memory of their own, subgrids; gives texels. */
#ifndef BAKE_DEVICE_BACKEND_BACKEND_H
#define BAKE_DEVICE_BACKEND_BACKEND_H

#include "libbake/bake.h"
#include "libbake/device/job/job.h"
#include "libbake/device/subgrid/subgrid.h"

/* Subgrids that a device holds at a time: one is traced while the next goes up. */
enum { BAKE_SLOTS = 2 };

enum { BAKE_WHY_BYTES = 512 };

/* Limit for one allocation on a device: some promise more than they can give in one piece. */
#define BAKE_MAX_BUFFER_BYTES (UINT64_C(1) << 30)

/* What a device did since it was opened, in seconds. */
struct bake_device_times {
    double upload;  /* of the grid, wall time */
    double copies;  /* of samples to the device and of texels back, on the device's clock */
    double kernels; /* likewise; kernels that run at the same time count once */
    uint64_t launches;
};

/* An opened device; the kind's own structure begins with it. */
struct bake_backend {
    char name[128];
    /* If load is not NULL: device memory for all loaded subgrids together, and for one array. */
    uint64_t memory_bytes, buffer_bytes;
    uint64_t other_bytes; /* device memory that the job uses besides */
    bool holds_grid;      /* slot 0 has the whole grid; set by device.c */
    /* Loading the whole grid found less memory than memory_bytes said; memory_bytes is lower now
     * and subgrids may still fit. */
    bool lacked_memory;
    /* Replaces what a slot holds by a subgrid. One thread calls this at a time; others may trace
     * tiles from the other slot. NULL: the device reads the mapped file. Failures as for trace().
     */
    int (*load)(struct bake_backend *backend, unsigned slot, const struct bake_subgrid *subgrid,
                char *why);
    /* Does what bake_device_trace() does, from one slot. Describes a failure in `why`
     * (BAKE_WHY_BYTES) instead of recording it, since the caller may fall back to another device.
     */
    int (*trace)(struct bake_backend *backend, unsigned slot, const struct bk_tile *tile,
                 const uint32_t *sample_triangles, float *texels, unsigned worker, char *why);
    /* Must not be called while tiles are traced. NULL: the device is the processor. */
    void (*times)(struct bake_backend *backend, struct bake_device_times *out);
    void (*close)(struct bake_backend *backend);
};

/* Device number that stands for the kind's own choice. */
enum { BAKE_ANY_DEVICE = -1 };

/* A kind of device. */
struct bake_device_kind {
    const char *name; /* as in "--device name" or "--device name:N" */
    /* Opens device number `index` or BAKE_ANY_DEVICE for a job, without loading the grid.
     * Errors: BSQ_ENODEVICE, BSQ_ENOMEM. */
    int (*open)(struct bsq_ctx *ctx, int64_t index, const struct bake_job *job,
                struct bake_backend **out);
    /* Calls fn for each device in the order of their numbers; not at all if no driver is installed.
     * Warns of drivers that do not work. Errors: BSQ_ENODEVICE, BSQ_ENOMEM. */
    int (*list)(struct bsq_ctx *ctx, void (*fn)(void *arg, const struct bake_device_info *device),
                void *arg);
    /* Returns the number of the first GPU above `after` (-1: of all), or a negative number. NULL:
     * the kind has a single device, which is no GPU. */
    int64_t (*next_gpu)(struct bsq_ctx *ctx, int64_t after);
    /* Fails with BSQ_ENODEVICE if open() would find no device or a driver would crash. NULL: open()
     * is safe. */
    int (*check)(struct bsq_ctx *ctx);
};

#endif
