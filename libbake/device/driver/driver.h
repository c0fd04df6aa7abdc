/* driver.h - finds GPU drivers' libraries, and asks drivers for their devices without risk.
 *
 * Takes a library's name, or the name of a driver; gives the library, or the devices. */
#ifndef BAKE_DEVICE_DRIVER_DRIVER_H
#define BAKE_DEVICE_DRIVER_DRIVER_H

#include <stdbool.h>
#include <stdint.h>

#include "libbake/bake.h"

enum { BAKE_DEVICES_MAX = 64, BAKE_WARNING_BYTES = 512 };

/* The devices of a driver; more than BAKE_DEVICES_MAX are left out. */
struct bake_device_list {
    struct bake_device_info devices[BAKE_DEVICES_MAX];
    uint32_t count;
    char why[BAKE_WARNING_BYTES]; /* "", or why there are none, or fewer than there should be */
    bool faulty;                  /* `why` is a fault of something that is installed */
};

/* Directories that containers, WSL and distributions put drivers into; ends with NULL. Containers
 * often mount a GPU's driver without telling the dynamic linker. */
extern const char *const bake_driver_directories[];

/* Opens a library like dlopen(name, flags), or else from the directories (which end with NULL).
 * *found: the directory that it is from, NULL if the dynamic linker knew it. Returns NULL if there
 * is no such library or it does not load. Thread-safe. */
void *bake_driver_library(const char *name, int flags, const char *const directories[],
                          const char **found);

/* Lists the devices of a driver, in another process: drivers may crash, hang,
 * print, or keep hundreds of megabytes, and CUDA does not work in a process that was forked from
 * one that uses it (docs/decisions/0014-drivers-that-misbehave.md). The process runs the program
 * bisque-devices, which is installed in lib/bisque. name, title: of the driver. Errors:
 * BSQ_ENODEVICE if it crashes or takes more than 30 s, or without that program; BSQ_EINTR;
 * BSQ_ENOMEM. */
int bake_probe(struct bsq_ctx *ctx, const char *name, const char *title,
               struct bake_device_list *out);

/* The part of bisque-devices: writes a list to the file `to`, for bake_probe(). Returns false if it
 * cannot. */
bool bake_probe_answer(int to, const struct bake_device_list *list);

#endif
