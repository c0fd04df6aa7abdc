/* driver_library.h - opens a driver's library where the dynamic linker does not look: containers
 * have a GPU's driver mounted, but not always a path that leads there. */
#ifndef BAKE_DEVICE_DRIVER_LIBRARY_H
#define BAKE_DEVICE_DRIVER_LIBRARY_H

#include <stddef.h>

/* Directories that containers, WSL and distributions put drivers into; the last is NULL. */
extern const char *const bake_driver_directories[];

/* As dlopen(name, flags), and else in the directories, the last of which is NULL. *found: the
 * directory, NULL where the dynamic linker knew. NULL where the library is not there or does not
 * load. Thread-safe. */
void *bake_driver_library(const char *name, int flags, const char *const directories[],
                          const char **found);

#endif
