/* opencl_drivers.c - looks for drivers by the names of their libraries. */
#include "libbake/device/opencl/opencl_drivers.h"

#include <dlfcn.h>
#include <limits.h>
#include <link.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/device/driver_library.h"

/* NVIDIA, AMD, Intel, Mesa, PoCL. */
static const char *const names[] = {"libnvidia-opencl.so.1", "libamdocl64.so",     "libigdrcl.so",
                                    "libRusticlOpenCL.so.1", "libMesaOpenCL.so.1", "libpocl.so.2"};

/* Khronos' loader takes files from one variable, ocl-icd from another. Both tell who they are since
 * 2021; before, only ocl-icd did. */
static const char *variable(void *loader)
{
    enum { CL_ICDL_VENDOR = 4 };
    typedef int loader_info(unsigned what, size_t size, void *value, size_t *needed);
    void *(*address)(const char *name) = NULL;
    loader_info *info = NULL;
    char vendor[128] = "";

    *(void **)&address = dlsym(loader, "clGetExtensionFunctionAddress");
    if (address)
        *(void **)&info = address("clGetICDLoaderInfoOCLICD");
    if (!info || info(CL_ICDL_VENDOR, sizeof vendor - 1, vendor, NULL) != 0 ||
        strstr(vendor, "Khronos"))
        return "OCL_ICD_FILENAMES";
    return "OCL_ICD_VENDORS";
}

/* The file that a handle was loaded from. */
static bool path_of(void *library, char *path, size_t bytes)
{
    struct link_map *map = NULL;

    return dlinfo(library, RTLD_DI_LINKMAP, &map) == 0 && map->l_name[0] == '/' &&
           (size_t)snprintf(path, bytes, "%s", map->l_name) < bytes;
}

/* Loads a driver, through the dynamic linker's places or ours. False where it is not there, is no
 * driver, does not load, or was loaded before. */
static bool find_idle(const char *name, char *path, size_t bytes)
{
    void *library = dlopen(name, RTLD_LAZY | RTLD_LOCAL | RTLD_NOLOAD);
    const char *directory;

    if (library)
        return false;
    library =
        bake_driver_library(name, RTLD_LAZY | RTLD_LOCAL, bake_driver_directories, &directory);
    return library && dlsym(library, "clGetExtensionFunctionAddress") &&
           path_of(library, path, bytes);
}

void bake_opencl_idle_drivers(void *loader, void (*fn)(void *arg, const char *line), void *arg)
{
    char path[PATH_MAX], line[2 * PATH_MAX + 200];

    if (getenv("OCL_ICD_VENDORS") || getenv("OCL_ICD_FILENAMES"))
        return;
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        if (!find_idle(names[i], path, sizeof path))
            continue;
        if (loader)
            snprintf(line, sizeof line,
                     "OpenCL's driver %s is not used, since no .icd file names it; this does it: "
                     "export %s=%s",
                     path, variable(loader), path);
        else
            snprintf(
                line, sizeof line,
                "OpenCL's driver %s is not used, since libOpenCL.so.1 is not installed (Debian: "
                "ocl-icd-libopencl1)",
                path);
        fn(arg, line);
    }
}
