/* chunk_cell.h - private to voxelizing: the voxels that a chunk's points are in. */
#ifndef VOX_CHUNK_CELL_H
#define VOX_CHUNK_CELL_H

#include "libvoxel/lanes.h"
#include "libvoxel/scan_chunks.h"

/* The cell of a point, and a number that does not matter. Points are not below the lattice, but
 * what lies on its upper bounds has its floor just above and is counted to the last. */
LANES_INLINE four_ints vox_chunk_cell(const struct vox_chunk *chunk, struct row point)
{
    return four_min(row_floor(point), four_load(chunk->last_cell));
}

#endif
