/* fuzz_file.h - shared by the fuzz targets: turns inputs into files and reads them in a new
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

enum { FUZZ_MAX_FILES = 4 };

struct fuzz_input {
    const uint8_t *data;
    size_t size;
    const char *name;
};

typedef int fuzz_use(struct bsq_ctx *ctx, const char *const *paths, uint32_t count);

/* Calls `use` for files that hold the inputs' bytes, and checks its end as fuzz_in_context() does.
 * Most inputs become memory_files.h's files with these names, and are used on one thread. One of
 * 64, which the sum of all bytes chooses, become files of the system without a suffix, and are
 * used on several threads. Returns 0. */
int fuzz_files(const struct fuzz_input *inputs, uint32_t count, fuzz_use *use);

/* The same for one file of the system, on one thread: for formats that a library opens. */
int fuzz_system_file(const uint8_t *data, size_t size, const char *name, fuzz_use *use);

#ifdef __cplusplus
}
#endif
#endif
