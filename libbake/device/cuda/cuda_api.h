/* cuda_api.h - NVIDIA's driver API, opened at run time so that one binary serves machines with and
 * without it. The few types and functions that are used are declared here, so that neither build
 * nor run needs a toolkit. */
#ifndef BAKE_DEVICE_CUDA_CUDA_API_H
#define BAKE_DEVICE_CUDA_CUDA_API_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "libbake/device/driver/driver.h"

typedef int CUresult;
typedef int CUdevice;
typedef int CUdevice_attribute;
typedef int CUjit_option;
typedef unsigned long long CUdeviceptr;
typedef struct CUctx_st *CUcontext;
typedef struct CUmod_st *CUmodule;
typedef struct CUfunc_st *CUfunction;
typedef struct CUstream_st *CUstream;
typedef struct CUevent_st *CUevent;

/* Values of the driver's enumerations. */
enum {
    CUDA_SUCCESS = 0,
    CUDA_ERROR_OUT_OF_MEMORY = 2,
    CUDA_ERROR_NOT_INITIALIZED = 3,
    CUDA_ERROR_NO_DEVICE = 100,
    CUDA_ERROR_JIT_COMPILER_NOT_FOUND = 221,
    CUDA_ERROR_UNSUPPORTED_PTX_VERSION = 222,
    CUDA_ERROR_JIT_COMPILATION_DISABLED = 223,
    CUDA_ERROR_NOT_READY = 600,

    CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR = 75,
    CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR = 76,

    CU_STREAM_NON_BLOCKING = 1,
    CU_EVENT_BLOCKING_SYNC = 1, /* waiting threads sleep */

    CU_JIT_MAX_REGISTERS = 0,
    CU_JIT_ERROR_LOG_BUFFER = 5,
    CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES = 6
};

/* X(name, symbol in the library, parameters). The symbols of CUDA 11.0, which later drivers have
 * too. `make check-ptx` compares values and types with NVIDIA's header. */
#define BAKE_CUDA_FUNCTIONS(X)                                                                     \
    X(cuInit, cuInit, (unsigned flags))                                                            \
    X(cuDriverGetVersion, cuDriverGetVersion, (int *version))                                      \
    X(cuGetErrorName, cuGetErrorName, (CUresult code, const char **text))                          \
    X(cuGetErrorString, cuGetErrorString, (CUresult code, const char **text))                      \
    X(cuDeviceGetCount, cuDeviceGetCount, (int *count))                                            \
    X(cuDeviceGet, cuDeviceGet, (CUdevice * device, int number))                                   \
    X(cuDeviceGetName, cuDeviceGetName, (char *name, int bytes, CUdevice device))                  \
    X(cuDeviceTotalMem, cuDeviceTotalMem_v2, (size_t * bytes, CUdevice device))                    \
    X(cuDeviceGetAttribute, cuDeviceGetAttribute,                                                  \
      (int *value, CUdevice_attribute attribute, CUdevice device))                                 \
    X(cuDevicePrimaryCtxRetain, cuDevicePrimaryCtxRetain, (CUcontext * context, CUdevice device))  \
    X(cuDevicePrimaryCtxRelease, cuDevicePrimaryCtxRelease_v2, (CUdevice device))                  \
    X(cuCtxSetCurrent, cuCtxSetCurrent, (CUcontext context))                                       \
    X(cuMemGetInfo, cuMemGetInfo_v2, (size_t * free, size_t * total))                              \
    X(cuModuleLoadDataEx, cuModuleLoadDataEx,                                                      \
      (CUmodule * module, const void *image, unsigned count, CUjit_option *options,                \
       void **values))                                                                             \
    X(cuModuleUnload, cuModuleUnload, (CUmodule module))                                           \
    X(cuModuleGetFunction, cuModuleGetFunction,                                                    \
      (CUfunction * function, CUmodule module, const char *name))                                  \
    X(cuMemAlloc, cuMemAlloc_v2, (CUdeviceptr * memory, size_t bytes))                             \
    X(cuMemFree, cuMemFree_v2, (CUdeviceptr memory))                                               \
    X(cuMemAllocHost, cuMemAllocHost_v2, (void **memory, size_t bytes))                            \
    X(cuMemFreeHost, cuMemFreeHost, (void *memory))                                                \
    X(cuMemcpyHtoDAsync, cuMemcpyHtoDAsync_v2,                                                     \
      (CUdeviceptr to, const void *from, size_t bytes, CUstream stream))                           \
    X(cuMemcpyDtoHAsync, cuMemcpyDtoHAsync_v2,                                                     \
      (void *to, CUdeviceptr from, size_t bytes, CUstream stream))                                 \
    X(cuStreamCreate, cuStreamCreate, (CUstream * stream, unsigned flags))                         \
    X(cuStreamQuery, cuStreamQuery, (CUstream stream))                                             \
    X(cuStreamDestroy, cuStreamDestroy_v2, (CUstream stream))                                      \
    X(cuEventCreate, cuEventCreate, (CUevent * event, unsigned flags))                             \
    X(cuEventRecord, cuEventRecord, (CUevent event, CUstream stream))                              \
    X(cuEventSynchronize, cuEventSynchronize, (CUevent event))                                     \
    X(cuEventElapsedTime, cuEventElapsedTime, (float *milliseconds, CUevent from, CUevent to))     \
    X(cuEventDestroy, cuEventDestroy_v2, (CUevent event))                                          \
    X(cuLaunchKernel, cuLaunchKernel,                                                              \
      (CUfunction function, unsigned grid_x, unsigned grid_y, unsigned grid_z, unsigned block_x,   \
       unsigned block_y, unsigned block_z, unsigned shared_bytes, CUstream stream,                 \
       void **parameters, void **extra))

struct bake_cuda_api {
#define BAKE_CUDA_MEMBER(name, symbol, parameters) CUresult(*name) parameters;
    BAKE_CUDA_FUNCTIONS(BAKE_CUDA_MEMBER)
#undef BAKE_CUDA_MEMBER
};

/* Opens libcuda.so.1, from the dynamic linker's directories or else from bake_driver_directories,
 * and starts it. The library stays loaded. *count: number of devices. Returns false if CUDA cannot
 * be used, and writes to `why` (BAKE_WARNING_BYTES) why not; *faulty: the driver is there, but too
 * old or does not start. */
bool bake_cuda_load(struct bake_cuda_api *api, int *count, char *why, bool *faulty);

enum { BAKE_CUDA_TEXT = 192 };
/* Returns an error's name and text, "CUDA_ERROR_OUT_OF_MEMORY (out of memory)", in buffer
 * (BAKE_CUDA_TEXT bytes). */
const char *bake_cuda_error(const struct bake_cuda_api *api, CUresult code, char *buffer);

/* A device and what the program needs to know about it. */
struct bake_cuda_device {
    CUdevice device;
    char name[128];
    int capability; /* 10 * major + minor */
    uint64_t memory_bytes;
};

/* Describes device number `index` < count. */
CUresult bake_cuda_device(const struct bake_cuda_api *api, int index, struct bake_cuda_device *out);

/* The kernel for any device, ended by a zero; "" if the build had no compiler for it. */
extern const char bake_cuda_ptx[];
extern const char bake_cuda_no_kernel[]; /* says so */

/* Returns the version of CUDA, as 10 * major + minor, whose drivers take PTX of a version in the
 * same form. */
int bake_cuda_version_for_ptx(int ptx_version);

#endif
