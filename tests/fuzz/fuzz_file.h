/* fuzz_file.h - what the fuzz targets share: bytes become a file that is read in a fresh context.
 */
#ifndef FUZZ_FILE_H
#define FUZZ_FILE_H

#include "base/context.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
/* A target may have this one; the next is the fuzzer's, and not there where files are replayed. */
size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned seed);
size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t max_size) __attribute__((weak));

/* Stops the run with the reason, so that the fuzzer keeps the input. */
void require(bool good, const char *what);

/* Calls `use` in a context of one thread and 64 MiB, and returns its status. A failure must be bad
 * data, an input that is not there or too little memory, in one line; nothing may be left
 * allocated. */
int fuzz_in_context(int (*use)(struct bsq_ctx *ctx));

/* The same with a file in memory that holds the bytes. Returns 0. */
int fuzz_file(const uint8_t *data, size_t size, const char *name,
              int (*use)(struct bsq_ctx *ctx, const char *path));

#endif
