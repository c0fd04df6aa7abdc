/* driver.h - finds GPU drivers' libraries, and asks drivers for their devices without risk.
 *
 * Takes a library's name or a function that calls a driver; gives the library, or the devices. */
#ifndef BAKE_DEVICE_DRIVER_DRIVER_H
#define BAKE_DEVICE_DRIVER_DRIVER_H

#include "libbake/bake.h"

/* Directories that containers, WSL and distributions put drivers into; ends with NULL. Containers
 * often mount a GPU's driver without telling the dynamic linker. */
extern const char *const bake_driver_directories[];

/* Opens a library like dlopen(name, flags), or else from the directories (which end with NULL).
 * *found: the directory that it is from, NULL if the dynamic linker knew it. Returns NULL if there
 * is no such library or it does not load. Thread-safe. */
void *bake_driver_library(const char *name, int flags, const char *const directories[],
                          const char **found);

/* For the asking function of bake_probe(): tell a device or a warning to the parent process. */
struct bake_probe_pipe;
void bake_probe_send_device(struct bake_probe_pipe *replies, const struct bake_device_info *device);
void bake_probe_send_warning(struct bake_probe_pipe *replies, const char *line);

/* Calls ask() in a forked process, since drivers may crash, hang, print, or keep hundreds of
 * megabytes (docs/decisions/0016-drivers-that-misbehave.md). After ask() has returned, calls fn
 * (may be NULL) for each device and bsq_warn() for each warning, in the order in which ask() sent
 * them. If ask() crashes or takes more than 30 s, there is one warning and no device. `what` names
 * the drivers in it. Errors: BSQ_ENODEVICE, BSQ_ENOMEM. */
int bake_probe(struct bsq_ctx *ctx, const char *what, void (*ask)(struct bake_probe_pipe *replies),
               void (*fn)(void *arg, const struct bake_device_info *device), void *arg);

#endif
