/* opencl_drivers.h - OpenCL drivers that are installed but not registered, as in
 * containers that get NVIDIA's libraries from the host without the .icd file that names them. */
#ifndef BAKE_DEVICE_OPENCL_OPENCL_DRIVERS_H
#define BAKE_DEVICE_OPENCL_OPENCL_DRIVERS_H

#include <stdbool.h>

/* Calls fn with one line for each such driver, with what to set so that libOpenCL uses it. To be
 * called after libOpenCL has been asked for its platforms, since it has loaded the registered ones
 * then; loads drivers. loader: libOpenCL's handle, or NULL where it is not installed. Says nothing
 * where OCL_ICD_VENDORS or OCL_ICD_FILENAMES is set: somebody has chosen already. */
void bake_opencl_idle_drivers(void *loader, void (*fn)(void *arg, const char *line), void *arg);

#endif
