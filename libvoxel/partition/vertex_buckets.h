/* vertex_buckets.h - private to the sorter: the cell of every vertex, where positions are in a
 * file.
 *
 * Triangles go to cells by their first corner. Two bytes a vertex tell its cell, a sixth of a
 * position, and so scans are scattered by index, in whatever order their faces are, long after
 * their positions have no room in memory. One byte has to do where there is less: cells are larger
 * then, and divided later. */
#ifndef VOX_PARTITION_VERTEX_BUCKETS_H
#define VOX_PARTITION_VERTEX_BUCKETS_H

#include "libvoxel/partition/morton.h"
#include "libvoxel/read/scan.h"

/* Levels of cells that two bytes name, and one. */
#define VERTEX_CELLS_WIDE_LEVELS   5u
#define VERTEX_CELLS_NARROW_LEVELS 2u

struct vertex_cells {
    /* Of each vertex; one of these, or none. */
    uint16_t *wide;
    uint8_t *narrow;
    bool have_order; /* vertices mostly are in the cell of the one before */
};

static inline uint64_t vertex_cells_bytes(uint64_t vertices, uint32_t levels)
{
    return vertices * (levels > VERTEX_CELLS_NARROW_LEVELS ? sizeof(uint16_t) : sizeof(uint8_t));
}

/* Levels that a table of at most `room` and `most` bytes names; 0: there is no room for one. */
static inline uint32_t vertex_cells_levels(uint64_t vertices, uint64_t room, uint64_t most)
{
    const uint64_t bytes = room < most ? room : most;
    if (vertex_cells_bytes(vertices, VERTEX_CELLS_WIDE_LEVELS) <= bytes)
        return VERTEX_CELLS_WIDE_LEVELS;
    return vertex_cells_bytes(vertices, VERTEX_CELLS_NARROW_LEVELS) <= bytes
               ? VERTEX_CELLS_NARROW_LEVELS
               : 0;
}

static inline uint32_t vertex_cell(const struct vertex_cells *cells, uint64_t vertex)
{
    return cells->wide ? cells->wide[vertex] : cells->narrow[vertex];
}

/* Where vertex_cell() looks. */
static inline const void *vertex_cell_place(const struct vertex_cells *cells, uint64_t vertex)
{
    return cells->wide ? (const void *)&cells->wide[vertex] : (const void *)&cells->narrow[vertex];
}

/* Reads the scan's positions, all of which are known. The first 3 * levels bits of a key name a
 * cell. Free with vox_vertex_buckets_free(), also after failure. */
int vox_vertex_buckets_make(const struct scan *scan, const struct morton_cube *cube,
                            uint32_t levels, struct vertex_cells *out);
void vox_vertex_buckets_free(const struct scan *scan, struct vertex_cells *cells);

#endif
