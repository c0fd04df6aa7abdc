/* crashing_driver.c - an OpenCL driver that aborts when it is asked for its platforms, as some do
 * if /sys is not mounted. */
#include <stddef.h>
#include <stdlib.h>

void *clGetExtensionFunctionAddress(const char *name);
int clIcdGetPlatformIDsKHR(unsigned capacity, void *platforms, unsigned *count);

int clIcdGetPlatformIDsKHR(unsigned capacity, void *platforms, unsigned *count)
{
    (void)capacity;
    (void)platforms;
    (void)count;
    abort();
}

void *clGetExtensionFunctionAddress(const char *name)
{
    (void)name;
    abort();
}
