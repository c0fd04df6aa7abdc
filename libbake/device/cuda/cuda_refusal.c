/* cuda_refusal.c - says why a driver refused the kernel. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/device/cuda/cuda_api.h"

/* The first CUDA of each PTX version (NVIDIA, "PTX ISA", "Release Notes"). Versions after 7.0 that
 * are not listed came with the CUDA whose major version is higher by 4. */
int bake_cuda_version_for_ptx(int ptx_version)
{
    static const struct {
        int ptx, cuda;
    } known[] = {{40, 60}, {41, 65},  {42, 70},  {43, 75},  {50, 80},  {60, 90},  {61, 91},
                 {62, 92}, {63, 100}, {64, 101}, {65, 102}, {86, 127}, {87, 128}, {88, 129}};

    for (size_t i = 0; i < sizeof known / sizeof known[0]; i++)
        if (known[i].ptx == ptx_version)
            return known[i].cuda;
    return ptx_version + 40;
}

/* Returns the version of PTX that the kernel is in, as 10 * major + minor. */
static int kernel_version(void)
{
    const char *line = strstr(bake_cuda_ptx, ".version ");
    int major = 0, minor = 0;

    if (line)
        sscanf(line, ".version %d.%d", &major, &minor);
    return 10 * major + minor;
}

static void describe_old_driver(const struct bake_cuda_api *api, char *buffer)
{
    const int ptx = kernel_version(), needed = bake_cuda_version_for_ptx(ptx);
    int version = 0; /* 1000 * major + 10 * minor */

    if (api->cuDriverGetVersion(&version) != CUDA_SUCCESS)
        version = 0;
    snprintf(
        buffer, BAKE_CUDA_REASON,
        "NVIDIA's driver is too old: it is for CUDA %d.%d, and the program's kernel (PTX %d.%d) "
        "needs a driver for CUDA %d.%d",
        version / 1000, version % 1000 / 10, ptx / 10, ptx % 10, needed / 10, needed % 10);
}

void bake_cuda_refusal(const struct bake_cuda_api *api, CUresult code, const char *log,
                       char *buffer)
{
    const char *advice = "";
    char text[BAKE_CUDA_TEXT];

    if (code == CUDA_ERROR_UNSUPPORTED_PTX_VERSION) {
        describe_old_driver(api, buffer);
        return;
    }
    if (code == CUDA_ERROR_JIT_COMPILER_NOT_FOUND)
        advice = "; install libnvidia-ptxjitcompiler.so.1, a part of NVIDIA's driver";
    else if (code == CUDA_ERROR_JIT_COMPILATION_DISABLED)
        advice = "; CUDA_DISABLE_PTX_JIT must not be set";
    snprintf(buffer, BAKE_CUDA_REASON, "compiling the kernel: %s%s%s%s",
             bake_cuda_error(api, code, text), advice, *log ? ": " : "", log);
    for (char *p = buffer; *p; p++)
        if (*p == '\n')
            *p = ' ';
}
