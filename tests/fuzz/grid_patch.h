/* grid_patch.h - turns small fuzz inputs into grid files: changes to built-in templates.
 *
 * The smallest grid file has 300 KB, most of them zeros that must stay zero. So an input is the
 * number of a template, flags, and a list of changes. Most inputs get correct checksums, so that
 * changes reach the checks after them. */
#ifndef FUZZ_GRID_PATCH_H
#define FUZZ_GRID_PATCH_H

#include "formats/grid/nvdb.h"

/* A file in memory. The sanitizer sees an access beyond its last byte. */
struct patched_grid {
    uint8_t *bytes;
    uint64_t size;
    struct grid_template *of; /* NULL: a copy of the input */
    bool verify;              /* also verify the whole file, which takes long */
};

/* Makes the file of an input. An input with the magic number of a grid file is used as it is. */
void grid_patch_apply(const uint8_t *data, size_t size, struct patched_grid *out);
/* Makes the template of an input as it is; then makes the input's changes to it, all of the same
 * size, and leaves the checksums wrong. An input that is a grid file has no changes. */
void grid_patch_begin(const uint8_t *data, size_t size, struct patched_grid *out);
void grid_patch_overwrite(const uint8_t *data, size_t size, struct patched_grid *grid);
/* Reverts the changes. */
void grid_patch_revert(struct patched_grid *grid);

#endif
