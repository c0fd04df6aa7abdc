/* device.c - chooses a device by name; falls back from a GPU to native threads, also if the grid
 * does not fit the GPU. */
#include "libbake/device/device.h"

#include <errno.h>
#include <inttypes.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/device/cuda/cuda.h"
#include "libbake/device/driver/driver.h"
#include "libbake/device/native/native.h"
#include "libbake/device/opencl/opencl.h"

/* All kinds of device, in the order in which "auto" looks for a GPU. A new kind is a folder beside
 * this file that exports a struct bake_device_kind, and a row here; BAKE_DEVICE_NAMES tells users
 * its name. */
static const struct bake_device_kind *const kinds[] = {
    &bake_native_kind,
    &bake_cuda_kind,
    &bake_opencl_kind,
};
enum { KINDS = sizeof kinds / sizeof kinds[0] };

struct bake_device {
    struct bsq_ctx *ctx;
    struct bake_job job;
    struct bake_tree tree; /* of the job's grid, for secondary rays */
    struct bake_backend *backend;
    bool automatic;                /* the backend may be replaced by the fallback */
    pthread_mutex_t lock;          /* protects the opening of the fallback */
    struct bake_backend *fallback; /* native; NULL until it is needed */
    atomic_bool lost;              /* the backend failed; the fallback goes on */
    char name[256];                /* of the backend, and of the fallback that went on */
};

enum { ANY_DEVICE = -1 };

/* Parses "KIND", or "KIND:N" if the kind numbers its devices. */
static bool device_parse(const char *name, const struct bake_device_kind *kind, int64_t *index)
{
    const size_t length = strlen(kind->name);
    char *end;
    unsigned long number;
    *index = ANY_DEVICE;
    if (strncmp(name, kind->name, length) != 0)
        return false;
    if (name[length] == '\0')
        return true;
    if (!kind->drivers || name[length] != ':' || name[length + 1] < '0' || name[length + 1] > '9')
        return false;
    errno = 0;
    number = strtoul(name + length + 1, &end, 10);
    if (*end || errno || number > INT32_MAX)
        return false;
    *index = (int64_t)number;
    return true;
}

/* Returns the kind that a device name belongs to, or NULL. */
static const struct bake_device_kind *find_kind(const char *name, int64_t *index)
{
    for (int i = 0; i < KINDS; i++)
        if (device_parse(name, kinds[i], index))
            return kinds[i];
    return NULL;
}

bool bake_is_device_name(const char *name)
{
    int64_t index;
    return strcmp(name, "auto") == 0 || find_kind(name, &index);
}

static double mebibytes(uint64_t bytes)
{
    return (double)bytes / (1 << 20);
}

/* Fails with BSQ_RETRY if the grid does not fit an opened device. */
static int check_space(struct bsq_ctx *ctx, const struct bake_backend *backend,
                       const struct bake_grid_arrays *grid)
{
    if (grid->bytes > backend->memory_bytes)
        return bsq_fail(ctx, BSQ_RETRY, "the grid needs %.1f MiB of memory, %s has %.1f MiB for it",
                        mebibytes(grid->bytes), backend->name, mebibytes(backend->memory_bytes));
    if (grid->largest > backend->buffer_bytes)
        return bsq_fail(ctx, BSQ_RETRY,
                        "the grid needs a buffer of %.1f MiB, those of %s have at most %.1f MiB",
                        mebibytes(grid->largest), backend->name, mebibytes(backend->buffer_bytes));
    return 0;
}

/* Copies the grid to a device with memory of its own. */
static int device_load_grid(struct bsq_ctx *ctx, const struct bake_job *job,
                            struct bake_backend *backend)
{
    char why[BAKE_WHY_BYTES] = "";
    struct bake_grid_arrays grid;
    int status = 0;
    if (!backend->load)
        return 0;
    bake_list_arrays(job, &grid);
    BSQ_TRY(check_space(ctx, backend, &grid));
    status = backend->load(backend, &grid, why);
    if (status < 0)
        status = bsq_fail(ctx, status, "%s: %s", backend->name, why);
done:
    return status;
}

/* Opens a device and loads the grid. Errors: BSQ_RETRY if the grid does not fit; those of open()
 * and load(). */
static int open_loaded(struct bake_device *device, const struct bake_device_kind *kind,
                       uint32_t number)
{
    int status = kind->open(device->ctx, number, &device->job, &device->backend);
    if (status == 0)
        status = device_load_grid(device->ctx, &device->job, device->backend);
    if (status < 0 && device->backend) {
        device->backend->close(device->backend);
        device->backend = NULL;
    }
    return status;
}

static int open_processor(struct bake_device *device)
{
    return bake_native_kind.open(device->ctx, 0, &device->job, &device->backend);
}

/* ---- finding ---- */

/* Lists the devices of a kind. Errors: BSQ_ENODEVICE if a driver crashes or hangs; BSQ_EINTR;
 * BSQ_ENOMEM. */
static int list_kind(struct bsq_ctx *ctx, const struct bake_device_kind *kind,
                     struct bake_device_list *out)
{
    *out = (struct bake_device_list){.count = 0};
    if (kind->drivers)
        return bake_probe(ctx, kind, out);
    kind->list(ctx, out);
    return 0;
}

/* Lists the devices of a kind. Drivers that cannot be used are a warning. */
static int list_or_warn(struct bsq_ctx *ctx, const struct bake_device_kind *kind,
                        struct bake_device_list *out)
{
    int status = list_kind(ctx, kind, out);
    if (status == BSQ_ENODEVICE) {
        bsq_warn(ctx, "%s", bsq_error(ctx));
        bsq_clear_error(ctx);
        *out = (struct bake_device_list){.count = 0};
        return 0;
    }
    if (status == 0 && out->faulty)
        bsq_warn(ctx, "%s", out->why);
    return status;
}

/* Returns the number that a device's id ends with, 0 without one. */
static uint32_t number_of(const struct bake_device_kind *kind, const struct bake_device_info *info)
{
    int64_t number;
    return device_parse(info->id, kind, &number) && number != ANY_DEVICE ? (uint32_t)number : 0;
}

/* Opens the first GPU of a kind that works and holds the grid; there may be none. */
static int open_gpu(struct bake_device *device, const struct bake_device_kind *kind)
{
    struct bsq_ctx *ctx = device->ctx;
    struct bake_device_list list;
    int status = list_or_warn(ctx, kind, &list);
    for (uint32_t i = 0; i < list.count && status == 0 && !device->backend; i++) {
        if (!list.devices[i].is_gpu)
            continue;
        status = open_loaded(device, kind, number_of(kind, &list.devices[i]));
        if (status == BSQ_OK || status == BSQ_EINTR)
            continue;
        bsq_warn(ctx, "%s is not used: %s", list.devices[i].id, bsq_error(ctx));
        bsq_clear_error(ctx);
        status = 0;
    }
    return status;
}

/* Opens the first GPU of any kind that works; without one, the processor. */
static int open_any(struct bake_device *device)
{
    for (int i = 0; i < KINDS && !device->backend; i++) {
        int status = open_gpu(device, kinds[i]);
        if (status < 0)
            return status;
    }
    device->automatic = device->backend != NULL;
    return device->backend ? 0 : open_processor(device);
}

/* Finds the device with a number in a list, or the one to prefer for ANY_DEVICE: a GPU if there is
 * one. The error lists the devices that exist. */
static int device_choose(struct bsq_ctx *ctx, const struct bake_device_kind *kind,
                         const struct bake_device_list *list, int64_t wanted, uint32_t *out)
{
    const struct bake_device_info *best = NULL;
    char there[400] = "";
    for (uint32_t i = 0; i < list->count; i++) {
        const struct bake_device_info *info = &list->devices[i];
        const size_t used = strlen(there);
        if (wanted == ANY_DEVICE ? !best || (info->is_gpu && !best->is_gpu)
                                 : number_of(kind, info) == wanted)
            best = info;
        snprintf(there + used, sizeof there - used, "%s %s %s", i ? "," : "", info->id, info->name);
    }
    if (!best && list->why[0])
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s", list->why);
    if (!best)
        return bsq_fail(ctx, BSQ_ENODEVICE, "there is no device %s:%" PRId64 "; there is%s",
                        kind->name, wanted, there);
    *out = number_of(kind, best);
    return 0;
}

/* Opens a device by its name. If the grid does not fit it, opens the processor, after a warning. */
static int open_named(struct bake_device *device, const char *name)
{
    int64_t wanted;
    const struct bake_device_kind *kind = find_kind(name, &wanted);
    struct bake_device_list list;
    uint32_t number = 0;
    int status;
    if (!kind)
        return bsq_fail(device->ctx, BSQ_EUSAGE, "device \"%s\" is not " BAKE_DEVICE_NAMES, name);
    BSQ_TRY(list_kind(device->ctx, kind, &list));
    BSQ_TRY(device_choose(device->ctx, kind, &list, wanted, &number));
    status = open_loaded(device, kind, number);
    if (status == BSQ_RETRY) {
        bsq_warn(device->ctx, "%s: the processor bakes it", bsq_error(device->ctx));
        bsq_clear_error(device->ctx);
        status = open_processor(device);
    }
done:
    return status;
}

int bake_device_open(struct bsq_ctx *ctx, const char *name, const struct bake_job *job,
                     struct bake_device **out)
{
    struct bake_device *device;
    int status;
    *out = NULL;
    status = bsq_calloc(ctx, "device", 1, sizeof *device, &device);
    if (status < 0)
        return status;
    device->ctx = ctx;
    device->job = *job;
    pthread_mutex_init(&device->lock, NULL);
    atomic_init(&device->lost, false);
    if (bake_ray_count(&job->params) > 0) {
        status = bake_tree_build(ctx, job->grid, &device->tree);
        device->job.tree = &device->tree;
    }
    if (status == 0)
        status = strcmp(name, "auto") == 0 ? open_any(device) : open_named(device, name);
    if (status < 0) {
        bake_device_close(device);
        return status;
    }
    snprintf(device->name, sizeof device->name, "%s", device->backend->name);
    *out = device;
    return 0;
}

const char *bake_device_name(const struct bake_device *device)
{
    return device->name;
}

/* ---- patches ---- */

/* Opens the fallback and goes on with it from now on, after a warning. Returns false if the device
 * was named, or the processor cannot be opened. */
static bool fall_back(struct bake_device *device, const char *why)
{
    if (!device->automatic)
        return false;
    pthread_mutex_lock(&device->lock);
    if (!device->fallback &&
        bake_native_kind.open(device->ctx, 0, &device->job, &device->fallback) == 0) {
        bsq_warn(device->ctx, "%s: %s; going on with %s", device->backend->name, why,
                 device->fallback->name);
        snprintf(device->name, sizeof device->name, "%s, then %.100s", device->backend->name,
                 device->fallback->name);
        atomic_store(&device->lost, true);
    }
    pthread_mutex_unlock(&device->lock);
    return atomic_load(&device->lost);
}

int bake_device_trace(struct bake_device *device, const struct bk_patch *patch,
                      const uint32_t *sample_triangles, float *texels, unsigned worker)
{
    char why[BAKE_WHY_BYTES] = "";
    struct bake_backend *backend = device->backend;
    int status;
    if (atomic_load(&device->lost))
        backend = device->fallback;
    status = backend->trace(backend, patch, sample_triangles, texels, worker, why);
    if (status == BSQ_OK)
        return 0;
    if (status == BSQ_EINTR || backend == device->fallback || !fall_back(device, why))
        return bsq_fail(device->ctx, status, "%s: %s", backend->name, why);
    backend = device->fallback;
    return backend->trace(backend, patch, sample_triangles, texels, worker, why);
}

void bake_device_times(struct bake_device *device, struct bake_device_times *out)
{
    *out = (struct bake_device_times){0};
    if (device->backend->times)
        device->backend->times(device->backend, out);
}

void bake_device_close(struct bake_device *device)
{
    if (!device)
        return;
    if (device->backend)
        device->backend->close(device->backend);
    if (device->fallback)
        device->fallback->close(device->fallback);
    bake_tree_free(device->ctx, &device->tree);
    pthread_mutex_destroy(&device->lock);
    bsq_free(device->ctx, device);
}

int bake_list_devices(struct bsq_ctx *ctx,
                      void (*fn)(void *arg, const struct bake_device_info *device), void *arg)
{
    int status = 0;
    for (int i = 0; i < KINDS && status == 0; i++) {
        struct bake_device_list list;
        status = list_or_warn(ctx, kinds[i], &list);
        for (uint32_t n = 0; n < list.count; n++)
            fn(arg, &list.devices[n]);
    }
    return status;
}
