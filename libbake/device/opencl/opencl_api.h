/* opencl_api.h - libOpenCL, opened at run time so that one binary serves machines with and without
 * it. */
#ifndef BAKE_DEVICE_OPENCL_OPENCL_API_H
#define BAKE_DEVICE_OPENCL_OPENCL_API_H

#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <stdbool.h>

#include "libbake/device/gpu/gpu.h"

#define BAKE_OPENCL_FUNCTIONS(X)                                                                   \
    X(clGetPlatformIDs)                                                                            \
    X(clGetPlatformInfo)                                                                           \
    X(clGetDeviceIDs)                                                                              \
    X(clGetDeviceInfo)                                                                             \
    X(clCreateContext)                                                                             \
    X(clReleaseContext)                                                                            \
    X(clCreateCommandQueue)                                                                        \
    X(clReleaseCommandQueue)                                                                       \
    X(clCreateBuffer)                                                                              \
    X(clReleaseMemObject)                                                                          \
    X(clCreateProgramWithSource)                                                                   \
    X(clBuildProgram)                                                                              \
    X(clGetProgramBuildInfo)                                                                       \
    X(clReleaseProgram)                                                                            \
    X(clCreateKernel)                                                                              \
    X(clReleaseKernel)                                                                             \
    X(clGetKernelWorkGroupInfo)                                                                    \
    X(clSetKernelArg)                                                                              \
    X(clEnqueueWriteBuffer)                                                                        \
    X(clEnqueueMapBuffer)                                                                          \
    X(clEnqueueUnmapMemObject)                                                                     \
    X(clEnqueueReadBuffer)                                                                         \
    X(clEnqueueNDRangeKernel)                                                                      \
    X(clWaitForEvents)                                                                             \
    X(clGetEventInfo)                                                                              \
    X(clReleaseEvent)                                                                              \
    X(clGetEventProfilingInfo)                                                                     \
    X(clFlush)                                                                                     \
    X(clFinish)

struct bake_opencl_api {
#define BAKE_OPENCL_MEMBER(name) __typeof__(name) *name;
    BAKE_OPENCL_FUNCTIONS(BAKE_OPENCL_MEMBER)
#undef BAKE_OPENCL_MEMBER
};

/* Opens libOpenCL.so.1. Returns false if it or one of its functions is missing. The library stays
 * loaded, since drivers keep threads that run its code. */
bool bake_opencl_load(struct bake_opencl_api *api);

/* Returns the name of an error that devices and drivers give, or the number of another one, which
 * is a mistake in the call. buffer: 32 bytes. */
const char *bake_opencl_error(cl_int code, char *buffer);

/* A device and what the program needs to know about it. */
struct bake_opencl_device {
    cl_platform_id platform;
    cl_device_id id;
    char name[128];
    bool is_gpu, host_memory, rounds_correctly, has_double;
    uint64_t memory_bytes, buffer_bytes; /* of the device; limit for one buffer */
    size_t group_sides[2];               /* limits for a work group */
};

/* Chooses the sides of a work group: powers of two, 64 items unless kernel or device allow less.
 * width: of the group; 0: 8. One for all launches of a kernel, as some drivers compile for each. */
void bake_opencl_group(size_t most_items, const size_t most_sides[2], size_t width,
                       size_t sides[2]);

/* Describes device number `index`: platforms in the loader's order, devices in the platform's.
 * Skips devices that are unavailable, big-endian or without a compiler. Returns false if there are
 * no more. */
bool bake_opencl_device(const struct bake_opencl_api *api, uint32_t index,
                        struct bake_opencl_device *out);

/* Compiles the kernel. The caller releases *out if it is not NULL, also after a failure. Errors:
 * BSQ_ENODEVICE with the compiler's messages. */
int bake_opencl_build(struct bsq_ctx *ctx, const struct bake_opencl_api *api,
                      const struct bake_opencl_device *device, cl_context context, cl_program *out);

#endif
