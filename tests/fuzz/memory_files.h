/* memory_files.h - files in memory for fuzz targets, which take the place of the system's.
 *
 * Opening, reading and removing files, and starting a thread under AddressSanitizer, takes longer
 * than reading a small mesh. Between memory_files_begin() and memory_files_end(), calls of open(),
 * stat(), pread() and the like in Bisque's own code (the linker redirects them) reach only these
 * files. No thread can be started: the libraries then do all work on the calling thread. */
#ifndef FUZZ_MEMORY_FILES_H
#define FUZZ_MEMORY_FILES_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

void memory_files_begin(void);
/* Adds a file with the bytes at `data`, which are not copied. */
void memory_files_add(const char *path, const uint8_t *data, size_t size);
/* Aborts if a file is still open. */
void memory_files_end(void);

#ifdef __cplusplus
}
#endif
#endif
