/* backend.h - what each kind of device (a folder beside this one) implements for device.c.
 *
 * A kind exports one struct bake_device_kind; device.c has a row for it. Takes a job and, on
 * devices with memory of their own, the arrays of its grid; gives texels. */
#ifndef BAKE_DEVICE_BACKEND_BACKEND_H
#define BAKE_DEVICE_BACKEND_BACKEND_H

#include "libbake/bake.h"
#include "libbake/device/job/job.h"

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
    /* If load is not NULL: device memory for the grid, and for one of its arrays. */
    uint64_t memory_bytes, buffer_bytes;
    /* Copies the grid to the device, once before patches are traced. NULL: the device reads the
     * mapped file. Failures as for trace(). */
    int (*load)(struct bake_backend *backend, const struct bake_grid_arrays *grid, char *why);
    /* Does what bake_device_trace() does. Describes a failure in `why` (BAKE_WHY_BYTES) instead of
     * recording it, since the caller may fall back to another device. */
    int (*trace)(struct bake_backend *backend, const struct bk_patch *patch,
                 const uint32_t *sample_triangles, float *texels, unsigned worker, char *why);
    /* Must not be called while patches are traced. NULL: the device is the processor. */
    void (*times)(struct bake_backend *backend, struct bake_device_times *out);
    void (*close)(struct bake_backend *backend);
};

enum { BAKE_DEVICES_MAX = 64, BAKE_WARNING_BYTES = 512 };

/* The devices of a kind; more than BAKE_DEVICES_MAX are left out. */
struct bake_device_list {
    struct bake_device_info devices[BAKE_DEVICES_MAX];
    uint32_t count;
    char why[BAKE_WARNING_BYTES]; /* "", or why there are none, or fewer than there should be */
    bool faulty;                  /* `why` is a fault of something that is installed */
};

/* A kind of device. */
struct bake_device_kind {
    const char *name; /* as in "--device name" or "--device name:N" */
    /* What its drivers are called in messages. NULL: it needs none and has a single device, which
     * is no GPU. */
    const char *drivers;
    /* Opens device `number`, which is in the list, for a job, without loading the grid. Errors:
     * BSQ_ENODEVICE, BSQ_ENOMEM. */
    int (*open)(struct bsq_ctx *ctx, uint32_t number, const struct bake_job *job,
                struct bake_backend **out);
    /* Fills a zeroed list with the devices in the order of their numbers, which their ids end with.
     * If the kind needs drivers, this runs in the program bisque-devices, with `ctx` NULL, and
     * bake_probe() gets the list from there. */
    void (*list)(struct bsq_ctx *ctx, struct bake_device_list *out);
};

#endif
