/* native.h - the processor as a device: the kernel as C on the calling thread, the reference for
 * all other devices. Takes a job; reads the grid from its mapped file. */
#ifndef BAKE_DEVICE_NATIVE_NATIVE_H
#define BAKE_DEVICE_NATIVE_NATIVE_H

#include "libbake/device/backend/backend.h"

extern const struct bake_device_kind bake_native_kind;

#endif
