/* device.c - chooses a device by name; falls back from a GPU to native threads. */
#include "libbake/device/device.h"

#include <errno.h>
#include <inttypes.h>
#include <stdatomic.h>
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
    const struct bake_job *job;
    struct bake_backend *backend;
    struct bake_backend *fallback; /* native, if the device was chosen automatically; else NULL */
    atomic_bool lost;              /* the backend failed; the fallback goes on */
    unsigned slot;                 /* that tiles are traced from */
};

/* Parses "KIND", or "KIND:N" if the kind numbers its devices. */
static bool parse(const char *name, const struct bake_device_kind *kind, int64_t *index)
{
    const size_t length = strlen(kind->name);
    char *end;
    unsigned long number;

    *index = BAKE_ANY_DEVICE;
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
        if (parse(name, kinds[i], index))
            return kinds[i];
    return NULL;
}

bool bake_is_device_name(const char *name)
{
    int64_t index;

    return strcmp(name, "auto") == 0 || find_kind(name, &index);
}

/* Loads the whole grid if it fits; otherwise it is traced in passes. */
static int load_grid(struct bsq_ctx *ctx, const struct bake_job *job, struct bake_backend *backend)
{
    char why[BAKE_WHY_BYTES] = "";
    struct bake_subgrid whole;
    uint64_t largest, total;
    int status;

    if (!backend->load)
        return 0;
    bake_subgrid_whole(job->grid, &job->params, &whole);
    total = bake_subgrid_total(whole.bytes, &largest);
    if (total > backend->memory_bytes || largest > backend->buffer_bytes)
        return 0;
    status = backend->load(backend, 0, &whole, why);
    backend->holds_grid = status == 0;
    if (status == BSQ_ENODEVICE && backend->lacked_memory)
        return 0;
    return status < 0 ? bsq_fail(ctx, status, "%s: %s", backend->name, why) : 0;
}

static int open_loaded(struct bsq_ctx *ctx, const struct bake_device_kind *kind, int64_t index,
                       const struct bake_job *job, struct bake_backend **out)
{
    int status = kind->open(ctx, index, job, out);

    if (status == 0)
        status = load_grid(ctx, job, *out);
    if (status < 0 && *out) {
        (*out)->close(*out);
        *out = NULL;
    }
    return status;
}

/* ---- finding ---- */

/* Lists the devices of a kind. Errors: BSQ_ENODEVICE if a driver crashes or hangs; BSQ_EINTR;
 * BSQ_ENOMEM. */
static int list_kind(struct bsq_ctx *ctx, const struct bake_device_kind *kind,
                     struct bake_device_list *out)
{
    *out = (struct bake_device_list){0};
    return kind->drivers ? bake_probe(ctx, kind, out) : kind->list(ctx, out);
}

/* Lists the devices of a kind. Drivers that cannot be used are a warning. */
static int list_or_warn(struct bsq_ctx *ctx, const struct bake_device_kind *kind,
                        struct bake_device_list *out)
{
    int status = list_kind(ctx, kind, out);

    if (status == BSQ_ENODEVICE) {
        bsq_warn(ctx, "%s", bsq_error(ctx));
        bsq_clear_error(ctx);
        return 0;
    }
    if (status == 0 && out->warning[0])
        bsq_warn(ctx, "%s", out->warning);
    return status;
}

/* Opens the first GPU of a kind that works; *out stays NULL if there is none. */
static int open_gpu(struct bsq_ctx *ctx, const struct bake_device_kind *kind,
                    const struct bake_job *job, struct bake_backend **out)
{
    struct bake_device_list list;
    int status = list_or_warn(ctx, kind, &list);

    for (uint64_t i = 0; i < list.count && status == 0 && !*out; i++) {
        int64_t number;
        if (!list.devices[i].is_gpu || !parse(list.devices[i].id, kind, &number))
            continue;
        status = open_loaded(ctx, kind, number, job, out);
        if (status == BSQ_OK || status == BSQ_EINTR)
            continue;
        bsq_warn(ctx, "%s is not used: %s", list.devices[i].id, bsq_error(ctx));
        bsq_clear_error(ctx);
        status = 0;
    }
    bake_device_list_free(ctx, &list);
    return status;
}

/* Opens the first GPU of any kind that works, and the processor as its fallback; without a GPU, the
 * processor alone. */
static int open_any(struct bake_device *device)
{
    for (int i = 0; i < KINDS && !device->backend; i++) {
        int status = open_gpu(device->ctx, kinds[i], device->job, &device->backend);
        if (status < 0)
            return status;
    }
    return bake_native_kind.open(device->ctx, BAKE_ANY_DEVICE, device->job,
                                 device->backend ? &device->fallback : &device->backend);
}

/* Asks the drivers first: they may crash or hang. What they answer otherwise, open() finds too. */
static int open_named(struct bake_device *device, const char *name)
{
    int64_t index;
    const struct bake_device_kind *kind = find_kind(name, &index);
    struct bake_device_list list;
    int status;

    if (!kind)
        return bsq_fail(device->ctx, BSQ_EUSAGE, "device \"%s\" is not " BAKE_DEVICE_NAMES, name);
    status = list_kind(device->ctx, kind, &list);
    bake_device_list_free(device->ctx, &list);
    return status < 0 ? status
                      : open_loaded(device->ctx, kind, index, device->job, &device->backend);
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
    device->job = job;
    atomic_init(&device->lost, false);
    status = strcmp(name, "auto") == 0 ? open_any(device) : open_named(device, name);
    if (status < 0)
        bake_device_close(device);
    else
        *out = device;
    return status;
}

const char *bake_device_name(const struct bake_device *device)
{
    return device->backend->name;
}

const struct bake_backend *bake_device_backend(const struct bake_device *device)
{
    return device->backend;
}

/* ---- passes and tiles ---- */

bool bake_device_holds_grid(const struct bake_device *device)
{
    return !device->backend->load || device->backend->holds_grid || atomic_load(&device->lost);
}

/* Goes on with the fallback from now on, after a warning. Returns false if there is none. */
static bool fall_back(struct bake_device *device, const char *why)
{
    if (!device->fallback)
        return false;
    if (!atomic_exchange(&device->lost, true))
        bsq_warn(device->ctx, "%s: %s; going on with %s", device->backend->name, why,
                 device->fallback->name);
    return true;
}

int bake_device_plan(struct bake_device *device, const struct bake_raster *raster,
                     struct bake_plan *out)
{
    const struct bake_backend *backend = device->backend;
    const struct bake_plan_options options = {.raster = raster,
                                              .job = device->job,
                                              .subgrid_bytes = backend->memory_bytes / BAKE_SLOTS,
                                              .buffer_bytes = backend->buffer_bytes,
                                              .other_bytes = backend->other_bytes,
                                              .slots = BAKE_SLOTS};
    int status;

    *out = (struct bake_plan){0};
    if (bake_device_holds_grid(device))
        return 0;
    status = bake_plan_passes(device->ctx, &options, out);
    if (status != BSQ_ENODEVICE || !fall_back(device, bsq_error(device->ctx)))
        return status;
    bsq_clear_error(device->ctx);
    bake_plan_free(device->ctx, out);
    return 0;
}

int bake_device_load(struct bake_device *device, unsigned slot, const struct bake_subgrid *subgrid)
{
    char why[BAKE_WHY_BYTES] = "";
    struct bake_backend *backend = device->backend;
    int status;

    if (atomic_load(&device->lost))
        return 0;
    status = backend->load(backend, slot, subgrid, why);
    if (status == 0)
        return 0;
    if (status != BSQ_EINTR && fall_back(device, why)) {
        bsq_clear_error(device->ctx);
        return 0;
    }
    return bsq_fail(device->ctx, status, "%s: %s", backend->name, why);
}

void bake_device_use(struct bake_device *device, unsigned slot)
{
    device->slot = slot;
}

int bake_device_trace(struct bake_device *device, const struct bk_tile *tile,
                      const uint32_t *sample_triangles, float *texels, unsigned worker)
{
    char why[BAKE_WHY_BYTES] = "";
    struct bake_backend *backend = device->backend;
    int status;

    if (atomic_load(&device->lost))
        backend = device->fallback;
    status = backend->trace(backend, device->slot, tile, sample_triangles, texels, worker, why);
    if (status == BSQ_OK)
        return 0;
    if (status == BSQ_EINTR || backend == device->fallback || !fall_back(device, why))
        return bsq_fail(device->ctx, status, "%s: %s", backend->name, why);
    backend = device->fallback;
    return backend->trace(backend, device->slot, tile, sample_triangles, texels, worker, why);
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
    bsq_free(device->ctx, device);
}

int bake_list_devices(struct bsq_ctx *ctx,
                      void (*fn)(void *arg, const struct bake_device_info *device), void *arg)
{
    int status = 0;

    for (int i = 0; i < KINDS && status == 0; i++) {
        struct bake_device_list list;
        status = list_or_warn(ctx, kinds[i], &list);
        for (uint64_t n = 0; n < list.count; n++)
            fn(arg, &list.devices[n]);
        bake_device_list_free(ctx, &list);
    }
    return status;
}

void bake_trace_rays(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                     const struct bake_ray_batch *rays, struct bk_hit *hits)
{
    bake_native_trace_rays(grid, params, rays, hits);
}

void bake_trace_places(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                       const struct bake_places *places, uint64_t begin, uint64_t end,
                       struct bake_ray_states *states)
{
    bake_native_trace_places(grid, params, places, begin, end, states);
}
