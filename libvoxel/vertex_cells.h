/* vertex_cells.h - private to the sorter: the cell of every vertex, where positions are in a file.
 *
 * Triangles go to cells by their first corner. Two bytes a vertex tell its cell, a sixth of a position, and so scans are
 * scattered by index, in whatever order their faces are, long after their positions have no room in memory. */
#ifndef VOX_VERTEX_CELLS_H
#define VOX_VERTEX_CELLS_H

#include "libvoxel/morton.h"
#include "libvoxel/scan.h"

#define VERTEX_CELLS_LEVELS 5u /* at most, as a cell's number has 16 bits */

struct vertex_cells {
    uint16_t *cells; /* of each vertex, or NULL */
    bool have_order; /* vertices mostly are in the cell of the one before */
};

static inline uint64_t vertex_cells_bytes(uint64_t vertices)
{
    return vertices * sizeof(uint16_t);
}

/* Reads the scan's positions, all of which are known. The first 3 * levels bits of a key name a cell. Free with
 * vertex_cells_free(), also after failure. */
int vertex_cells_make(const struct scan *scan, const struct morton_cube *cube, uint32_t levels,
                      struct vertex_cells *out);
void vertex_cells_free(const struct scan *scan, struct vertex_cells *cells);

#endif
