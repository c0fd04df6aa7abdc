/* opencl_program.c - the kernel compiled for an OpenCL device, or as an earlier run compiled it. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/device/opencl/kernel_cache.h"
#include "libbake/device/opencl/opencl_api.h"

/* The flattened kernel source. */
static const char kernel_source[] =
#include "kernel_source.inc"
    ;

struct program {
    struct bsq_ctx *ctx;
    const struct bake_opencl_api *api;
    const struct bake_opencl_device *device;
    cl_context context;
    cl_program program;
};

/* From the build log's first error on, if a line speaks of one; line breaks become " | ". */
static int fail_build(struct program *p, cl_int code)
{
    char *log = NULL, line[400] = "", number[32];
    size_t bytes = 0, used = 0;

    p->api->clGetProgramBuildInfo(p->program, p->device->id, CL_PROGRAM_BUILD_LOG, 0, NULL, &bytes);
    if (bytes && bsq_calloc(p->ctx, "build log", bytes + 1, 1, &log) == 0)
        p->api->clGetProgramBuildInfo(p->program, p->device->id, CL_PROGRAM_BUILD_LOG, bytes, log,
                                      NULL);
    const char *from = log ? strstr(log, "error") : NULL;
    while (from && from > log && from[-1] != '\n')
        from--;
    for (const char *c = from ? from : log; c && *c && used + 4 < sizeof line; c++) {
        const char *piece = *c == '\n' ? " | " : (char[2]){*c, '\0'};
        used += (size_t)snprintf(line + used, sizeof line - used, "%s", piece);
    }
    bsq_free(p->ctx, log);
    return bsq_fail(p->ctx, BSQ_ENODEVICE, "%s: clBuildProgram: %s: %s", p->device->name,
                    bake_opencl_error(code, number), line);
}

/* Makes the program from what an earlier run compiled. */
static bool build_from_cache(struct program *p, const char *key, const char *options)
{
    void *binary;
    uint64_t bytes;
    cl_int code, status = CL_SUCCESS;

    if (!bake_kernel_cache_get(key, &binary, &bytes))
        return false;
    p->program =
        p->api->clCreateProgramWithBinary(p->context, 1, &p->device->id, &(size_t){bytes},
                                          &(const unsigned char *){binary}, &status, &code);
    free(binary);
    if (code == CL_SUCCESS)
        code = status;
    if (code == CL_SUCCESS)
        code = p->api->clBuildProgram(p->program, 1, &p->device->id, options, NULL, NULL);
    if (code == CL_SUCCESS)
        return true;
    if (p->program)
        p->api->clReleaseProgram(p->program);
    p->program = NULL;
    return false;
}

static void keep_binary(struct program *p, const char *key)
{
    size_t bytes = 0;
    unsigned char *binary = NULL;

    if (p->api->clGetProgramInfo(p->program, CL_PROGRAM_BINARY_SIZES, sizeof bytes, &bytes, NULL) !=
            CL_SUCCESS ||
        bytes == 0)
        return;
    binary = malloc(bytes);
    if (binary && p->api->clGetProgramInfo(p->program, CL_PROGRAM_BINARIES, sizeof binary, &binary,
                                           NULL) == CL_SUCCESS)
        bake_kernel_cache_put(key, binary, bytes);
    free(binary);
}

static int build(struct program *p)
{
    const char *source = kernel_source;
    const char *options = p->device->rounds_correctly
                              ? "-cl-std=CL1.2 -cl-fp32-correctly-rounded-divide-sqrt"
                              : "-cl-std=CL1.2";
    char key[1024], number[32];
    cl_int code;

    snprintf(key, sizeof key, "%016" PRIx64 "\n%s\n%s\n%s",
             bake_kernel_hash(kernel_source, sizeof kernel_source), options, p->device->name,
             p->device->driver);
    if (build_from_cache(p, key, options))
        return 0;
    p->program = p->api->clCreateProgramWithSource(p->context, 1, &source, NULL, &code);
    if (code != CL_SUCCESS)
        return bsq_fail(p->ctx, BSQ_ENODEVICE, "%s: clCreateProgramWithSource: %s", p->device->name,
                        bake_opencl_error(code, number));
    code = p->api->clBuildProgram(p->program, 1, &p->device->id, options, NULL, NULL);
    if (code != CL_SUCCESS)
        return fail_build(p, code);
    keep_binary(p, key);
    return 0;
}

int bake_opencl_build(struct bsq_ctx *ctx, const struct bake_opencl_api *api,
                      const struct bake_opencl_device *device, cl_context context, cl_program *out)
{
    struct program program = {.ctx = ctx, .api = api, .device = device, .context = context};
    const int status = build(&program);

    *out = program.program;
    return status;
}
