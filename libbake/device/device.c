/* device.c - chooses a device by name; falls back from a GPU to native threads where it may. */
#include "libbake/device/device.h"

#include <errno.h>
#include <inttypes.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/device/backend.h"

struct bake_device {
    struct bsq_ctx *ctx;
    struct bake_backend *backend;
    struct bake_backend
        *fallback;    /* native, where the device was chosen automatically; else NULL */
    atomic_bool lost; /* backend failed, fallback goes on */
    unsigned slot;    /* that tiles are traced from */
};

/* Parses "KIND" (*index stays) or "KIND:N". */
static bool parse(const char *name, const char *kind, int64_t *index)
{
    size_t length = strlen(kind);
    char *end;
    unsigned long number;

    if (strncmp(name, kind, length) != 0)
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

/* A kind of devices with GPUs among them. */
struct kind {
    const char *name;
    int (*open)(struct bsq_ctx *ctx, int64_t index, const struct bake_job *job,
                struct bake_backend **out);
    int (*list)(struct bsq_ctx *ctx, void (*fn)(void *arg, const struct bake_device_info *device),
                void *arg);
    int64_t (*next_gpu)(struct bsq_ctx *ctx, int64_t after);
    /* Fails where loading the drivers would be of no use, or end the process; NULL: never. */
    int (*check)(struct bsq_ctx *ctx);
    int64_t first; /* number that the name alone stands for */
};

/* In the order in which "auto" looks for a GPU. */
static const struct kind kinds[] = {
    {"cuda", bake_cuda_open, bake_cuda_list, bake_cuda_next_gpu, NULL, 0},
    {"opencl", bake_opencl_open, bake_opencl_list, bake_opencl_next_gpu, bake_opencl_check,
     BAKE_OPENCL_FIRST},
};
enum { KINDS = sizeof kinds / sizeof kinds[0] };

/* Loads the whole grid where there is room; else it is traced in passes. */
static int load_grid(struct bsq_ctx *ctx, const struct bake_job *job, struct bake_backend *backend)
{
    char why[BAKE_WHY_BYTES] = "";
    struct bake_part whole;
    uint64_t total = 0;
    int status;

    if (!backend->load)
        return 0;
    bake_part_whole(job->grid, &job->params, &whole);
    for (int i = 0; i < BAKE_PART_ARRAYS; i++) {
        total += whole.bytes[i];
        if (whole.bytes[i] > backend->buffer_bytes)
            return 0;
    }
    if (total > backend->memory_bytes)
        return 0;
    status = backend->load(backend, 0, &whole, why);
    backend->holds_grid = status == 0;
    if (status == BSQ_ENODEVICE && backend->lacked_memory)
        return 0;
    return status < 0 ? bsq_fail(ctx, status, "%s: %s", backend->name, why) : 0;
}

static int open_loaded(struct bsq_ctx *ctx, const struct kind *kind, int64_t index,
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

/* Opens the first GPU of a kind that works; *out stays NULL where there is none. */
static int open_gpu(struct bsq_ctx *ctx, const struct kind *kind, const struct bake_job *job,
                    struct bake_backend **out)
{
    int64_t number = -1;

    while ((number = kind->next_gpu(ctx, number)) >= 0) {
        int status = open_loaded(ctx, kind, number, job, out);
        if (status == BSQ_OK || status == BSQ_EINTR)
            return status;
        bsq_warn(ctx, "%s:%" PRId64 " is not used: %s", kind->name, number, bsq_error(ctx));
        bsq_clear_error(ctx);
    }
    bsq_clear_error(ctx); /* not even the search worked */
    return 0;
}

bool bake_is_device_name(const char *name)
{
    int64_t index;

    for (int i = 0; i < KINDS; i++)
        if (parse(name, kinds[i].name, &index))
            return true;
    return strcmp(name, "cpu") == 0 || strcmp(name, "auto") == 0;
}

static int open_backends(struct bake_device *device, const char *name, const struct bake_job *job)
{
    struct bsq_ctx *ctx = device->ctx;

    if (!bake_is_device_name(name))
        return bsq_fail(ctx, BSQ_EUSAGE, "device \"%s\" is not " BAKE_DEVICE_NAMES, name);
    if (strcmp(name, "cpu") == 0)
        return bake_native_open(ctx, job, &device->backend);
    for (int i = 0; i < KINDS; i++) {
        int64_t index = kinds[i].first;
        int status = 0;
        if (!parse(name, kinds[i].name, &index))
            continue;
        if (kinds[i].check)
            status = kinds[i].check(ctx);
        return status < 0 ? status : open_loaded(ctx, &kinds[i], index, job, &device->backend);
    }
    for (int i = 0; i < KINDS && !device->backend; i++) {
        int status = open_gpu(ctx, &kinds[i], job, &device->backend);
        if (status < 0)
            return status;
    }
    return bake_native_open(ctx, job, device->backend ? &device->fallback : &device->backend);
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
    atomic_init(&device->lost, false);
    status = open_backends(device, name, job);
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

bool bake_device_holds_grid(const struct bake_device *device, uint64_t *part_bytes,
                            uint64_t *buffer_bytes, uint64_t *other_bytes)
{
    const struct bake_backend *backend = device->backend;

    *part_bytes = backend->memory_bytes / BAKE_SLOTS;
    *buffer_bytes = backend->buffer_bytes;
    *other_bytes = backend->other_bytes;
    return !backend->load || backend->holds_grid || atomic_load(&device->lost);
}

bool bake_device_give_up(struct bake_device *device, const char *why)
{
    if (!device->fallback)
        return false;
    if (!atomic_exchange(&device->lost, true))
        bsq_warn(device->ctx, "%s: %s; going on with %s", device->backend->name, why,
                 device->fallback->name);
    return true;
}

int bake_device_load(struct bake_device *device, unsigned slot, const struct bake_part *part)
{
    char why[BAKE_WHY_BYTES] = "";
    struct bake_backend *backend = device->backend;
    int status;

    if (atomic_load(&device->lost))
        return 0;
    status = backend->load(backend, slot, part, why);
    if (status == 0)
        return 0;
    if (status != BSQ_EINTR && bake_device_give_up(device, why)) {
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
                      const uint32_t *sample_triangles, struct bk_texel *texels, unsigned worker)
{
    char why[BAKE_WHY_BYTES] = "";
    struct bake_backend *backend = device->backend;
    int status;

    if (atomic_load(&device->lost))
        backend = device->fallback;
    status = backend->trace(backend, device->slot, tile, sample_triangles, texels, worker, why);
    if (status == BSQ_OK)
        return 0;
    if (status == BSQ_EINTR || backend == device->fallback || !bake_device_give_up(device, why))
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
    struct bake_device_info info;

    bake_native_info(ctx, &info);
    fn(arg, &info);
    for (int i = 0; i < KINDS; i++) {
        int status = kinds[i].list(ctx, fn, arg);
        if (status < 0)
            return status;
    }
    return 0;
}
