/* fake_cuda.c - a libcuda.so.1 without a GPU, for the functions in cuda_api.h. It runs the kernel
 * that is compiled as C, and of the PTX that it is given it only checks the entry. It is stricter
 * than a driver, so that tests find errors that a GPU usually forgives:
 *  - streams do their work only when a call waits for it or frees memory;
 *  - streams must not use the same memory without waiting for each other, unless all only read;
 *  - device addresses are no host addresses, and copies must stay inside allocations;
 *  - the host's side of a copy must be page-locked; a driver would silently wait;
 *  - threads must sleep while they wait for an event;
 *  - a stream must be asked about a launch before its next launch, as WSL needs;
 *  - a thread without a context can do nothing, not even free;
 *  - the first launch takes a 32nd of the memory, as for spilled registers;
 *  - the PTX's entry must have the parameters that launches pass;
 *  - after fork() in a process that has started CUDA, all calls fail in the child;
 *  - objects that are not freed at exit are counted on standard error.
 * cuInit() reads these environment variables:
 *  - FAKE_CUDA_DEVICES=N: number of devices (1);
 *  - FAKE_CUDA_MEMORY=BYTES: memory of each (1 GiB);
 *  - FAKE_CUDA_CAPABILITY=NN: compute capability (90);
 *  - FAKE_CUDA_VERSION=N: CUDA's version, 1000 * major + 10 * minor (13000);
 *  - FAKE_CUDA_FAIL=CALL:N:CODE: the Nth call of a function fails with CODE; if CODE is 700 or
 * more, so do all later calls; if it is negative, the call raises that signal;
 *  - FAKE_CUDA_HANG=FILE: cuInit() writes the process's number to the file and never returns;
 *  - FAKE_CUDA_NS=N: a sample takes N nanoseconds of event time (default: real time);
 *  - FAKE_CUDA_LOG=FILE: gets a line for each copy, launch and wait: its kind and its stream's
 * number;
 *  - FAKE_CUDA_HOURS=N: hours of event time that pass before the first kernel. */
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "tests/fake/fake_cuda_internal.h"

struct fake_cuda fake = {.lock = PTHREAD_MUTEX_INITIALIZER, .device_count = -1};
_Thread_local CUcontext fake_current;

/* Requires the lock. */
static pid_t process; /* that called cuInit() first */
static int failing_code;
static char failing_call[64];
static unsigned calls_left;

static unsigned long long setting(const char *name, unsigned long long otherwise)
{
    const char *text = getenv(name);
    return text ? strtoull(text, NULL, 10) : otherwise;
}

CUresult fake_begin(const char *call)
{
    CUresult code = CUDA_SUCCESS;
    pthread_mutex_lock(&fake.lock);
    if (fake.device_count < 0 || process != getpid())
        code = NOT_INITIALIZED;
    else if (fake.sticky)
        code = fake.sticky;
    else if (calls_left > 0 && strcmp(call, failing_call) == 0 && --calls_left == 0)
        code = failing_code;
    if (code >= STICKY)
        fake.sticky = code;
    pthread_mutex_unlock(&fake.lock);
    if (code < 0)
        raise(-code);
    return code;
}

static void hang(const char *path)
{
    FILE *file = fopen(path, "w");

    if (file) {
        fprintf(file, "%d\n", (int)getpid());
        fclose(file);
    }
    for (;;)
        pause();
}

void fake_count_live(int change)
{
    pthread_mutex_lock(&fake.lock);
    fake.live += change;
    pthread_mutex_unlock(&fake.lock);
}

/* Returns the number of live objects, for tests in the same process. */
int fake_cuda_live(void);
int fake_cuda_live(void)
{
    return fake.live;
}

__attribute__((destructor)) static void report(void)
{
    if (fake.live)
        fprintf(stderr, "fake CUDA: %d objects are left\n", fake.live);
}

/* ---- devices ---- */

static const struct {
    CUresult code;
    const char *name, *text;
} errors[] = {
    {INVALID_VALUE, "CUDA_ERROR_INVALID_VALUE", "invalid argument"},
    {CUDA_ERROR_OUT_OF_MEMORY, "CUDA_ERROR_OUT_OF_MEMORY", "out of memory"},
    {NOT_INITIALIZED, "CUDA_ERROR_NOT_INITIALIZED", "initialization error"},
    {NO_DEVICE, "CUDA_ERROR_NO_DEVICE", "no CUDA-capable device is detected"},
    {INVALID_PTX, "CUDA_ERROR_INVALID_PTX", "a PTX JIT compilation failed"},
    {CUDA_ERROR_JIT_COMPILER_NOT_FOUND, "CUDA_ERROR_JIT_COMPILER_NOT_FOUND",
     "PTX JIT compiler library not found"},
    {CUDA_ERROR_UNSUPPORTED_PTX_VERSION, "CUDA_ERROR_UNSUPPORTED_PTX_VERSION",
     "the provided PTX was compiled with an unsupported toolchain."},
    {719, "CUDA_ERROR_LAUNCH_FAILED", "unspecified launch failure"},
    {803, "CUDA_ERROR_SYSTEM_DRIVER_MISMATCH",
     "system has unsupported display driver / cuda driver combination"},
};

static const char *find_error(CUresult code, int text)
{
    for (size_t i = 0; i < sizeof errors / sizeof errors[0]; i++)
        if (errors[i].code == code)
            return text ? errors[i].text : errors[i].name;
    return NULL;
}

CUresult cuGetErrorName(CUresult code, const char **text)
{
    *text = find_error(code, 0);
    return *text ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuGetErrorString(CUresult code, const char **text)
{
    *text = find_error(code, 1);
    return *text ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuInit(unsigned flags)
{
    const char *fail = getenv("FAKE_CUDA_FAIL");

    if (getenv("FAKE_CUDA_HANG"))
        hang(getenv("FAKE_CUDA_HANG"));
    pthread_mutex_lock(&fake.lock);
    process = process ? process : getpid();
    fake.device_count = (int)setting("FAKE_CUDA_DEVICES", 1);
    fake.memory_bytes = setting("FAKE_CUDA_MEMORY", 1u << 30);
    fake.capability = (int)setting("FAKE_CUDA_CAPABILITY", 90);
    fake.sample_seconds = 1e-9 * (double)setting("FAKE_CUDA_NS", 0);
    fake.hours = (double)setting("FAKE_CUDA_HOURS", 0);
    fake.sticky = 0;
    calls_left = 0;
    if (fail && sscanf(fail, "%63[^:]:%u:%d", failing_call, &calls_left, &failing_code) != 3)
        abort();
    pthread_mutex_unlock(&fake.lock);
    BEGIN;
    if (fake.device_count == 0)
        return NO_DEVICE;
    return flags == 0 ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuDriverGetVersion(int *version)
{
    *version = (int)setting("FAKE_CUDA_VERSION", 13000);
    return CUDA_SUCCESS;
}

CUresult cuDeviceGetCount(int *count)
{
    BEGIN;
    *count = fake.device_count;
    return CUDA_SUCCESS;
}

CUresult cuDeviceGet(CUdevice *device, int number)
{
    BEGIN;
    *device = 100 + number; /* unlike its number, so that tests notice a mix-up */
    return number >= 0 && number < fake.device_count ? CUDA_SUCCESS : INVALID_DEVICE;
}

bool fake_is_device(CUdevice device)
{
    return device >= 100 && device < 100 + fake.device_count;
}

CUresult cuDeviceGetName(char *name, int bytes, CUdevice device)
{
    BEGIN;
    snprintf(name, (size_t)bytes, "Fake GPU %d", device - 100);
    return fake_is_device(device) ? CUDA_SUCCESS : INVALID_DEVICE;
}

CUresult cuDeviceTotalMem_v2(size_t *bytes, CUdevice device)
{
    BEGIN;
    *bytes = fake.memory_bytes;
    return fake_is_device(device) ? CUDA_SUCCESS : INVALID_DEVICE;
}

CUresult cuDeviceGetAttribute(int *value, CUdevice_attribute attribute, CUdevice device)
{
    BEGIN;
    if (attribute == CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR)
        *value = fake.capability / 10;
    else if (attribute == CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR)
        *value = fake.capability % 10;
    else
        return INVALID_VALUE;
    return fake_is_device(device) ? CUDA_SUCCESS : INVALID_DEVICE;
}

CUresult cuDevicePrimaryCtxRetain(CUcontext *context, CUdevice device)
{
    BEGIN;
    *context = (CUcontext)&fake.device_count;
    fake_count_live(1);
    return fake_is_device(device) ? CUDA_SUCCESS : INVALID_DEVICE;
}

CUresult cuDevicePrimaryCtxRelease_v2(CUdevice device)
{
    pthread_mutex_lock(&fake.lock);
    fake.used_bytes -= fake.local_bytes;
    fake.local_bytes = 0;
    pthread_mutex_unlock(&fake.lock);
    fake_count_live(-1);
    return fake_is_device(device) ? CUDA_SUCCESS : INVALID_DEVICE;
}

CUresult cuCtxSetCurrent(CUcontext context)
{
    fake_current = context;
    BEGIN;
    return CUDA_SUCCESS;
}
