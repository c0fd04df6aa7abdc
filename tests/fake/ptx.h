/* ptx.h - runs the kernel's PTX on the processor, warp by warp, to test without a GPU the text that
 * a GPU's driver gets. Knows the part of PTX (NVIDIA, "PTX ISA", 2013-2025) that compilers use for
 * libbake's kernel, and refuses the rest: ptx_table.c lists the instructions. */
#ifndef FAKE_PTX_H
#define FAKE_PTX_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct ptx;

/* Reads the entry `name`. Returns NULL, with a message on standard error, if the text has anything
 * unknown. */
struct ptx *ptx_read(const char *text, const char *name);
void ptx_free(struct ptx *ptx);

struct ptx_launch {
    unsigned grid_x, grid_y, block_x, block_y;
    void **parameters; /* as for cuLaunchKernel() */
    /* Returns the host address of device memory, NULL if it is not allocated. */
    void *(*memory)(unsigned long long address, size_t bytes);
    uint64_t instructions; /* adds those that warps executed, with any number of threads */
};

/* Runs a block. Returns false, with a message, if a thread accesses memory that is not allocated.
 */
bool ptx_run(const struct ptx *ptx, struct ptx_launch *launch);

#endif
