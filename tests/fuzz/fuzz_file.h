/* fuzz_file.h - shared by the fuzz targets: turns an input into a file and reads it in a new
 * context. */
#ifndef FUZZ_FILE_H
#define FUZZ_FILE_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
/* A target may define the first function. The second belongs to the fuzzer; it is NULL in replays.
 */
size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned seed);
size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t max_size) __attribute__((weak));

/* Unless `good`, aborts with the reason, so that the fuzzer keeps the input. */
void require(bool good, const char *what);

/* Calls `use` in a context of one thread and 64 MiB; returns its status. Aborts if memory stays
 * allocated, or if a failure is not described in one line or is neither BSQ_EDATA, BSQ_ENOINPUT nor
 * BSQ_ENOMEM. */
int fuzz_in_context(int (*use)(struct bsq_ctx *ctx));

/* The same for a file in memory that holds the input's bytes. Returns 0. */
int fuzz_file(const uint8_t *data, size_t size, const char *name,
              int (*use)(struct bsq_ctx *ctx, const char *path));

#ifdef __cplusplus
}
#endif
#endif
