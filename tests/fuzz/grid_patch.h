/* grid_patch.h - small inputs that change a large file: patches of grids that are built in.
 *
 * The smallest grid file has 300 KB, most of them zeros that must stay zero. So an input is a
 * template's number, flags, and a list of changes; sums are made right again in most cases, so that
 * what lies behind them is reached, too. */
#ifndef FUZZ_GRID_PATCH_H
#define FUZZ_GRID_PATCH_H

#include "formats/grid/nvdb.h"

/* A file in memory. The sanitizer sees an access behind its last byte. */
struct patched_grid {
    uint8_t *bytes;
    uint64_t size;
    struct grid_template *of; /* NULL: a copy */
    bool verify;              /* goes through the whole file, which takes long */
};

/* Makes the file that an input says. An input that begins as a grid file does is one. */
void grid_patch_apply(const uint8_t *data, size_t size, struct patched_grid *out);
/* Takes the changes back. */
void grid_patch_revert(struct patched_grid *grid);

#endif
