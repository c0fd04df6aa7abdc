/* ptx.h - runs the kernel's PTX on the processor, warp by warp: that part of PTX which compilers
 * make of libbake's kernel (NVIDIA, "PTX ISA", 2013-2025). So the text that goes to a GPU's driver
 * is tested without one, to the bit. */
#ifndef FAKE_PTX_H
#define FAKE_PTX_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct ptx;

/* Reads the entry `name`. NULL where the text has what is not known here, with a message on
 * standard error. */
struct ptx *ptx_read(const char *text, const char *name);
void ptx_free(struct ptx *ptx);

struct ptx_launch {
    unsigned grid_x, grid_y, block_x, block_y;
    void **parameters; /* as of cuLaunchKernel() */
    /* Host address of `bytes` bytes of device memory, NULL where they are nobody's. */
    void *(*memory)(unsigned long long address, size_t bytes);
    uint64_t instructions; /* added to: those that warps went through, however many of their threads
                              did */
};

/* False where a thread leaves the memory, with a message. */
bool ptx_run(const struct ptx *ptx, struct ptx_launch *launch);

#endif
