/* driver.h - finds GPU drivers' libraries, and asks drivers for their devices without risk.
 *
 * Takes a library's name, or the name of a kind of device; gives the library, or the devices. */
#ifndef BAKE_DEVICE_DRIVER_DRIVER_H
#define BAKE_DEVICE_DRIVER_DRIVER_H

#include "libbake/device/backend/backend.h"

/* Directories that containers, WSL and distributions put drivers into; ends with NULL. Containers
 * often mount a GPU's driver without telling the dynamic linker. */
extern const char *const bake_driver_directories[];

/* Opens a library like dlopen(name, flags), or else from the directories (which end with NULL).
 * *found: the directory that it is from, NULL if the dynamic linker knew it. Returns NULL if there
 * is no such library or it does not load. Thread-safe. */
void *bake_driver_library(const char *name, int flags, const char *const directories[],
                          const char **found);

/* Lists the devices of a kind as its `list` does, but in another process: drivers may crash, hang,
 * print, or keep hundreds of megabytes, and CUDA does not work in a process that was forked from
 * one that uses it (docs/decisions/0014-drivers-that-misbehave.md). The process runs the program
 * bisque-devices, which is installed in lib/bisque. Errors: BSQ_ENODEVICE if a driver crashes
 * or takes more than 30 s, or without that program; BSQ_EINTR; BSQ_ENOMEM. */
int bake_probe(struct bsq_ctx *ctx, const struct bake_device_kind *kind,
               struct bake_device_list *out);

/* The part of bisque-devices: writes a list to the file `to`, for bake_probe(). Returns false if it
 * cannot. */
bool bake_probe_answer(int to, const struct bake_device_list *list);

#endif
