/* nvidia_opencl.c - a libOpenCL.so.1 that starts CUDA when it is asked for its platforms, as
 * NVIDIA's driver does. It has one GPU, "Fake GPU", of which no context can be created; none if
 * CUDA does not start. Declares its functions itself, since most are here only to be found. */
#include <dlfcn.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum {
    SUCCESS = 0,
    DEVICE_NOT_AVAILABLE = -2,
    INVALID_VALUE = -30,
    PLATFORM_NAME = 0x902,
    DEVICE_TYPE = 0x1000,
    DEVICE_TYPE_GPU = 4,
    DEVICE_MAX_WORK_ITEM_SIZES = 0x1005,
    DEVICE_GLOBAL_MEM_SIZE = 0x101f,
    DEVICE_MAX_MEM_ALLOC_SIZE = 0x1010,
    DEVICE_ENDIAN_LITTLE = 0x1026,
    DEVICE_AVAILABLE = 0x1027,
    DEVICE_COMPILER_AVAILABLE = 0x1028,
    DEVICE_NAME = 0x102b
};

int clGetPlatformIDs(unsigned capacity, void **platforms, unsigned *count);
int clGetPlatformInfo(void *platform, unsigned what, size_t bytes, void *out, size_t *needed);
int clGetDeviceIDs(void *platform, uint64_t type, unsigned capacity, void **devices,
                   unsigned *count);
int clGetDeviceInfo(void *device, unsigned what, size_t bytes, void *out, size_t *needed);
void *clCreateContext(const void *properties, unsigned count, void *const *devices, void *notify,
                      void *arg, int *code);

static int platform, device;

int clGetPlatformIDs(unsigned capacity, void **platforms, unsigned *count)
{
    void *cuda = dlopen("libcuda.so.1", RTLD_NOW | RTLD_LOCAL);
    int (*start)(unsigned flags) = cuda ? (int (*)(unsigned))dlsym(cuda, "cuInit") : NULL;

    *count = start && start(0) == 0;
    if (*count && capacity)
        platforms[0] = &platform;
    return SUCCESS;
}

int clGetPlatformInfo(void *of, unsigned what, size_t bytes, void *out, size_t *needed)
{
    (void)of;
    (void)needed;
    if (what != PLATFORM_NAME)
        return INVALID_VALUE;
    snprintf(out, bytes, "Fake CUDA");
    return SUCCESS;
}

int clGetDeviceIDs(void *of, uint64_t type, unsigned capacity, void **devices, unsigned *count)
{
    (void)of;
    (void)type;
    *count = 1;
    if (capacity)
        devices[0] = &device;
    return SUCCESS;
}

int clGetDeviceInfo(void *of, unsigned what, size_t bytes, void *out, size_t *needed)
{
    const uint64_t number = what == DEVICE_TYPE ? DEVICE_TYPE_GPU : 1 << 30;
    const uint32_t yes = 1;
    const size_t sides[3] = {1024, 1024, 64};

    (void)of;
    (void)needed;
    if (what == DEVICE_NAME)
        snprintf(out, bytes, "Fake GPU");
    else if (what == DEVICE_TYPE || what == DEVICE_GLOBAL_MEM_SIZE ||
             what == DEVICE_MAX_MEM_ALLOC_SIZE)
        memcpy(out, &number, sizeof number);
    else if (what == DEVICE_AVAILABLE || what == DEVICE_COMPILER_AVAILABLE ||
             what == DEVICE_ENDIAN_LITTLE)
        memcpy(out, &yes, sizeof yes);
    else if (what == DEVICE_MAX_WORK_ITEM_SIZES)
        memcpy(out, sides, sizeof sides);
    else
        return INVALID_VALUE;
    return SUCCESS;
}

void *clCreateContext(const void *properties, unsigned count, void *const *devices, void *notify,
                      void *arg, int *code)
{
    (void)properties;
    (void)count;
    (void)devices;
    (void)notify;
    (void)arg;
    *code = DEVICE_NOT_AVAILABLE;
    return NULL;
}

/* Functions that are found but never called. */
#define FOUND(name)                                                                                \
    int name(void);                                                                                \
    int name(void)                                                                                 \
    {                                                                                              \
        return INVALID_VALUE;                                                                      \
    }
FOUND(clReleaseContext)
FOUND(clCreateCommandQueue)
FOUND(clReleaseCommandQueue)
FOUND(clCreateBuffer)
FOUND(clReleaseMemObject)
FOUND(clCreateProgramWithSource)
FOUND(clBuildProgram)
FOUND(clGetProgramBuildInfo)
FOUND(clReleaseProgram)
FOUND(clCreateKernel)
FOUND(clReleaseKernel)
FOUND(clGetKernelWorkGroupInfo)
FOUND(clSetKernelArg)
FOUND(clEnqueueWriteBuffer)
FOUND(clEnqueueMapBuffer)
FOUND(clEnqueueUnmapMemObject)
FOUND(clEnqueueReadBuffer)
FOUND(clEnqueueNDRangeKernel)
FOUND(clWaitForEvents)
FOUND(clGetEventInfo)
FOUND(clReleaseEvent)
FOUND(clGetEventProfilingInfo)
FOUND(clFlush)
FOUND(clFinish)
