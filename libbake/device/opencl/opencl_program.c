/* opencl_program.c - compiles the kernel for an OpenCL device.
 *
 * Drivers keep what they compiled from one run to the next; see
 * docs/decisions/0020-no-kernel-cache-of-our-own.md. */
#include <stdio.h>
#include <string.h>

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

/* Records the build log from its first line with an error on, with " | " for line breaks. */
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
    return bsq_fail(p->ctx, BSQ_ENODEVICE, "%s: clBuildProgram: %s%s%s", p->device->name,
                    bake_opencl_error(code, number), *line ? ": " : "", line);
}

static int build(struct program *p)
{
    const char *source = kernel_source;
    const char *options = p->device->rounds_correctly
                              ? "-cl-std=CL1.2 -cl-fp32-correctly-rounded-divide-sqrt"
                              : "-cl-std=CL1.2";
    char number[32];
    cl_int code;

    p->program = p->api->clCreateProgramWithSource(p->context, 1, &source, NULL, &code);
    if (code != CL_SUCCESS)
        return bsq_fail(p->ctx, BSQ_ENODEVICE, "%s: clCreateProgramWithSource: %s", p->device->name,
                        bake_opencl_error(code, number));
    code = p->api->clBuildProgram(p->program, 1, &p->device->id, options, NULL, NULL);
    return code == CL_SUCCESS ? 0 : fail_build(p, code);
}

int bake_opencl_build(struct bsq_ctx *ctx, const struct bake_opencl_api *api,
                      const struct bake_opencl_device *device, cl_context context, cl_program *out)
{
    struct program program = {.ctx = ctx, .api = api, .device = device, .context = context};
    const int status = build(&program);

    *out = program.program;
    return status;
}
