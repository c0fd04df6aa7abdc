/* driver_library.c - opens libraries that the dynamic linker may not find. */
#include "libbake/device/driver/driver.h"

#include <dlfcn.h>
#include <limits.h>
#include <stdio.h>
#include <unistd.h>

const char *const bake_driver_directories[] = {"/usr/local/nvidia/lib64",
                                               "/usr/local/nvidia/lib",
                                               "/usr/lib/wsl/lib",
                                               "/run/opengl-driver/lib",
                                               "/opt/rocm/lib",
                                               "/usr/lib/x86_64-linux-gnu",
                                               "/usr/lib/aarch64-linux-gnu",
                                               "/usr/lib64",
                                               "/usr/lib/x86_64-linux-gnu/intel-opencl",
                                               "/usr/lib/aarch64-linux-gnu/intel-opencl",
                                               "/usr/lib64/intel-opencl",
                                               NULL};

void *bake_driver_library(const char *name, int flags, const char *const directories[],
                          const char **found)
{
    void *library = dlopen(name, flags);

    *found = NULL;
    for (; !library && *directories; directories++) {
        char path[PATH_MAX];
        const int length = snprintf(path, sizeof path, "%s/%s", *directories, name);
        if (length < 0 || (size_t)length >= sizeof path || access(path, R_OK) != 0)
            continue;
        library = dlopen(path, flags);
        *found = library ? *directories : NULL;
    }
    return library;
}
