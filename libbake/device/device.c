/* device.c - chooses a device by name; falls back from a GPU to native threads, also if the grid
 * or a chunk does not fit the GPU. */
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
#include "libbake/device/opencl/opencl.h"

/* The drivers of GPUs, in the order in which "auto" looks for one. A new one is a folder beside
 * this file that exports a struct bake_driver, and a row here; BAKE_DEVICE_NAMES tells users its
 * name. */
static const struct bake_driver *const drivers[] = {
    &bake_cuda_driver,
    &bake_opencl_driver,
};
enum { DRIVERS = sizeof drivers / sizeof drivers[0] };

struct bake_device {
    struct bsq_ctx *ctx;
    struct bake_scene scene;
    struct bake_tree tree;      /* of the job's grid, for secondary rays */
    struct bake_gpu *gpu;       /* NULL: the processor traces */
    bool automatic;             /* the processor may go on if the GPU fails */
    pthread_mutex_t lock;       /* protects the opening of the processor then */
    struct bake_native *native; /* the processor; NULL until it is needed, and without a grid */
    atomic_bool lost;           /* the GPU failed; the processor goes on */
    char name[256];             /* of the GPU, and of the processor that went on */
};

enum { ANY_DEVICE = -1 };

/* Parses "NAME" or "NAME:N" of a driver. */
static bool device_parse(const char *name, const struct bake_driver *driver, int64_t *index)
{
    const size_t length = strlen(driver->name);
    char *end;
    unsigned long number;
    *index = ANY_DEVICE;
    if (strncmp(name, driver->name, length) != 0)
        return false;
    if (name[length] == '\0')
        return true;
    if (name[length] != ':' || name[length + 1] < '0' || name[length + 1] > '9')
        return false;
    errno = 0;
    number = strtoul(name + length + 1, &end, 10);
    if (*end || errno || number > INT32_MAX)
        return false;
    *index = (int64_t)number;
    return true;
}

/* Returns the driver that a device name belongs to, or NULL. */
static const struct bake_driver *find_driver(const char *name, int64_t *index)
{
    for (int i = 0; i < DRIVERS; i++)
        if (device_parse(name, drivers[i], index))
            return drivers[i];
    return NULL;
}

bool bake_is_device_name(const char *name)
{
    int64_t index;
    return strcmp(name, "auto") == 0 || strcmp(name, "cpu") == 0 || find_driver(name, &index);
}

/* Opens the processor, and writes its name. */
static int open_processor(struct bake_device *device, char *name, size_t size)
{
    const struct bake_scene *scene = &device->scene;
    snprintf(name, size, "cpu, %.100s%s", bake_native_describe(device->ctx).name,
             scene->grid ? "" : ", exact");
    return scene->grid ? bake_native_open(device->ctx, scene, &device->native) : 0;
}

/* ---- finding ---- */

/* Lists the devices of a driver. One that cannot be used is a warning. */
static int list_or_warn(struct bsq_ctx *ctx, const struct bake_driver *driver,
                        struct bake_device_list *out)
{
    *out = (struct bake_device_list){.count = 0};
    int status = bake_probe(ctx, driver->name, driver->title, out);
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
static uint32_t number_of(const struct bake_driver *driver, const struct bake_device_info *info)
{
    int64_t number;
    return device_parse(info->id, driver, &number) && number != ANY_DEVICE ? (uint32_t)number : 0;
}

/* Opens the first GPU of a driver that works and holds the grid; there may be none. */
static int open_gpu(struct bake_device *device, const struct bake_driver *driver)
{
    struct bsq_ctx *ctx = device->ctx;
    struct bake_device_list list;
    int status = list_or_warn(ctx, driver, &list);
    for (uint32_t i = 0; i < list.count && status == 0 && !device->gpu; i++) {
        if (!list.devices[i].is_gpu)
            continue;
        status = bake_gpu_open(ctx, driver, number_of(driver, &list.devices[i]), &device->scene,
                               &device->gpu);
        if (status == BSQ_OK || status == BSQ_EINTR)
            continue;
        bsq_warn(ctx, "%s is not used: %s", list.devices[i].id, bsq_error(ctx));
        bsq_clear_error(ctx);
        status = 0;
    }
    return status;
}

/* Opens the first GPU of any driver that works; without one, the processor. */
static int open_any(struct bake_device *device)
{
    int status = 0;
    for (int i = 0; i < DRIVERS && status == 0 && !device->gpu; i++)
        status = open_gpu(device, drivers[i]);
    device->automatic = device->gpu != NULL;
    return status;
}

/* Finds the device with a number in a list, or the one to prefer for ANY_DEVICE: a GPU if there is
 * one. The error lists the devices that exist. */
static int device_choose(struct bsq_ctx *ctx, const struct bake_driver *driver,
                         const struct bake_device_list *list, int64_t wanted, uint32_t *out)
{
    const struct bake_device_info *best = NULL;
    char there[400] = "";
    for (uint32_t i = 0; i < list->count; i++) {
        const struct bake_device_info *info = &list->devices[i];
        const size_t used = strlen(there);
        if (wanted == ANY_DEVICE ? !best || (info->is_gpu && !best->is_gpu)
                                 : number_of(driver, info) == wanted)
            best = info;
        snprintf(there + used, sizeof there - used, "%s %s %s", i ? "," : "", info->id, info->name);
    }
    if (!best && list->why[0])
        return bsq_fail(ctx, BSQ_ENODEVICE, "%s", list->why);
    if (!best)
        return bsq_fail(ctx, BSQ_ENODEVICE, "there is no device %s:%" PRId64 "; there is%s",
                        driver->name, wanted, there);
    *out = number_of(driver, best);
    return 0;
}

/* Opens a GPU by its name. If the grid does not fit it, there is none, after a warning. */
static int open_named(struct bake_device *device, const char *name)
{
    struct bsq_ctx *ctx = device->ctx;
    int64_t wanted;
    const struct bake_driver *driver = find_driver(name, &wanted);
    struct bake_device_list list = {.count = 0};
    uint32_t number = 0;
    int status;
    if (!driver)
        return bsq_fail(ctx, BSQ_EUSAGE, "device \"%s\" is not " BAKE_DEVICE_NAMES, name);
    BSQ_TRY(bake_probe(ctx, driver->name, driver->title, &list));
    BSQ_TRY(device_choose(ctx, driver, &list, wanted, &number));
    status = bake_gpu_open(ctx, driver, number, &device->scene, &device->gpu);
    if (status == BSQ_RETRY) {
        bsq_warn(ctx, "%s: the processor bakes it", bsq_error(ctx));
        bsq_clear_error(ctx);
        status = 0;
    }
done:
    return status;
}

/* Opens the device with a name, and without a GPU the processor. */
static int device_find(struct bake_device *device, const char *name)
{
    int status = 0;
    if (device->scene.grid && bk_ray_count(&device->scene.params) > 0) {
        BSQ_TRY(bake_tree_build(device->ctx, device->scene.grid, &device->tree));
        device->scene.tree = &device->tree;
    }
    if (strcmp(name, "cpu") != 0)
        BSQ_TRY(strcmp(name, "auto") == 0 ? open_any(device) : open_named(device, name));
    if (device->gpu)
        snprintf(device->name, sizeof device->name, "%s%s", device->gpu->name,
                 device->gpu->exact ? ", exact" : "");
    else
        status = open_processor(device, device->name, sizeof device->name);
done:
    return status;
}

int bake_device_open(struct bsq_ctx *ctx, const char *name, const struct bake_scene *scene,
                     struct bake_device **out)
{
    struct bake_device *device;
    int status;
    *out = NULL;
    status = BSQ_CALLOC(ctx, "device", 1, &device);
    if (status < 0)
        return status;
    device->ctx = ctx;
    device->scene = *scene;
    pthread_mutex_init(&device->lock, NULL);
    atomic_init(&device->lost, false);
    status = device_find(device, name);
    if (status < 0)
        bake_device_close(device);
    else
        *out = device;
    return status;
}

const char *bake_device_name(const struct bake_device *device)
{
    return device->name;
}

/* ---- patches ---- */

/* Opens the processor and goes on with it from now on, after a warning. Returns false if the device
 * was named, or the processor cannot be opened. */
static bool fall_back(struct bake_device *device, const char *why)
{
    char name[128];
    if (!device->automatic)
        return false;
    pthread_mutex_lock(&device->lock);
    if (!atomic_load(&device->lost) && open_processor(device, name, sizeof name) == 0) {
        bsq_warn(device->ctx, "%s: %s; going on with %s", device->gpu->name, why, name);
        snprintf(device->name, sizeof device->name, "%s, then %.100s", device->gpu->name, name);
        atomic_store(&device->lost, true);
    }
    pthread_mutex_unlock(&device->lock);
    return atomic_load(&device->lost);
}

/* Returns what a step of the GPU returned; BSQ_RETRY if it failed and the processor goes on. */
static int after_step(struct bake_device *device, int status, const char *why)
{
    if (status == 0)
        return 0;
    return fall_back(device, why) ? BSQ_RETRY
                                  : bsq_fail(device->ctx, status, "%s: %s", device->gpu->name, why);
}

unsigned bake_device_windows(const struct bake_device *device)
{
    return device->gpu ? device->gpu->windows : 1;
}

int bake_device_begin(struct bake_device *device, const struct bk_patch *patch,
                      const uint32_t *sample_triangles, unsigned worker, unsigned window)
{
    char why[BAKE_WHY_BYTES] = "";
    if (!device->gpu || atomic_load(&device->lost))
        return BSQ_RETRY;
    return after_step(
        device, bake_gpu_begin(device->gpu, patch, sample_triangles, worker, window, why), why);
}

int bake_device_end(struct bake_device *device, const struct bk_patch *patch, float *texels,
                    unsigned worker, unsigned window)
{
    char why[BAKE_WHY_BYTES] = "";
    return after_step(device, bake_gpu_end(device->gpu, patch, texels, worker, window, why), why);
}

int bake_device_trace(struct bake_device *device, const struct bk_patch *patch,
                      const uint32_t *sample_triangles, float *texels, unsigned worker)
{
    int status = bake_device_begin(device, patch, sample_triangles, worker, 0);
    if (status == 0)
        status = bake_device_end(device, patch, texels, worker, 0);
    if (status != BSQ_RETRY)
        return status;
    return bake_native_trace(device->native, patch, sample_triangles, texels, worker);
}

/* ---- single rays ---- */

/* What the processor's caches hold. */
enum { PROCESSOR_RAYS = 1 << 12 };

uint32_t bake_device_most_rays(const struct bake_device *device)
{
    return device->gpu ? BAKE_GPU_RAYS : PROCESSOR_RAYS;
}

static void device_take_hits(const float *hits, double unit, const struct bake_ray_batch *batch)
{
    for (uint64_t i = 0; i < batch->count; i++, hits += BK_HIT_FLOATS) {
        const bool found = hits[0] < BK_NOTHING;
        batch->hits[i] =
            (struct bake_hit){.triangle = found ? 0 : BAKE_NO_HIT, .t = (double)hits[0] * unit};
        if (found)
            memcpy(batch->hits[i].normal, hits + 1, sizeof batch->hits[i].normal);
    }
}

int bake_device_trace_rays(struct bake_device *device, const struct bake_ray_batch *batch,
                           double unit, unsigned worker)
{
    _Static_assert(sizeof *batch->rays == BK_RAY_FLOATS * sizeof(float), "devices read them");
    char why[BAKE_WHY_BYTES] = "";
    const float *hits;
    int status = BSQ_RETRY;
    if (device->gpu && !atomic_load(&device->lost))
        status =
            after_step(device,
                       bake_gpu_trace_rays(device->gpu, batch->rays->origin, (uint32_t)batch->count,
                                           (float)(batch->t_min / unit),
                                           (float)(batch->t_max / unit), &hits, worker, why),
                       why);
    if (status == 0)
        device_take_hits(hits, unit, batch);
    if (status != BSQ_RETRY)
        return status;
    bake_trace_rays(device->scene.grid, &device->scene.params, unit, batch, 0, batch->count);
    return 0;
}

/* ---- chunks of triangles ---- */

bool bake_device_has_areas(const struct bake_device *device)
{
    return device->gpu && device->gpu->exact && !atomic_load(&device->lost);
}

int bake_device_make_areas(struct bake_device *device, uint64_t whole, uint64_t least,
                           uint32_t *count, uint64_t *bytes)
{
    char why[BAKE_WHY_BYTES] = "";
    const int status = bake_gpu_make_areas(device->gpu, whole, least, why);
    *count = device->gpu->area_count;
    *bytes = device->gpu->area_bytes;
    return after_step(device, status, why);
}

int bake_device_make_wave(struct bake_device *device, uint64_t least, uint64_t *bytes)
{
    char why[BAKE_WHY_BYTES] = "";
    const int status = bake_gpu_make_wave(device->gpu, least, why);
    *bytes = device->gpu->wave_bytes;
    return after_step(device, status, why);
}

void bake_device_release_areas(struct bake_device *device)
{
    bake_gpu_release_areas(device->gpu);
}

int bake_device_send(struct bake_device *device, uint32_t area, uint64_t at, const void *from,
                     uint64_t bytes, unsigned worker)
{
    char why[BAKE_WHY_BYTES] = "";
    return after_step(device, bake_gpu_send(device->gpu, area, at, from, bytes, worker, why), why);
}

int bake_device_look(struct bake_device *device, uint32_t area, const struct bk_params *params,
                     const struct bake_viewpoints *viewpoints, uint64_t begin, uint64_t end,
                     unsigned worker, const struct bake_ray_states *states)
{
    char why[BAKE_WHY_BYTES] = "";
    const int status =
        bake_gpu_look(device->gpu, area, params, viewpoints, begin, end, worker, states, why);
    return after_step(device, status, why);
}

int bake_device_first(struct bake_device *device, uint64_t at, const bk_limits *limits,
                      const struct bake_first_rays *rays, const bk_first_hit **hits,
                      unsigned worker)
{
    char why[BAKE_WHY_BYTES] = "";
    const int status = bake_gpu_first(device->gpu, at, limits, rays, hits, worker, why);
    return after_step(device, status, why);
}

void bake_device_times(struct bake_device *device, struct bake_device_times *out)
{
    *out = (struct bake_device_times){0};
    if (device->gpu)
        *out = bake_gpu_times(device->gpu);
}

void bake_device_close(struct bake_device *device)
{
    if (!device)
        return;
    if (device->gpu)
        bake_gpu_close(device->gpu);
    bake_native_close(device->native);
    bake_tree_free(device->ctx, &device->tree);
    pthread_mutex_destroy(&device->lock);
    bsq_free(device->ctx, device);
}

int bake_list_devices(struct bsq_ctx *ctx,
                      void (*fn)(void *arg, const struct bake_device_info *device), void *arg)
{
    const struct bake_device_info processor = bake_native_describe(ctx);
    int status = 0;
    fn(arg, &processor);
    for (int i = 0; i < DRIVERS && status == 0; i++) {
        struct bake_device_list list;
        status = list_or_warn(ctx, drivers[i], &list);
        for (uint32_t n = 0; n < list.count; n++)
            fn(arg, &list.devices[n]);
    }
    return status;
}
