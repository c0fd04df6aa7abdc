/* chunk_cell.h - private to voxelizing: the voxels that a chunk's points are in. */
#ifndef VOX_VOXELIZE_CACHE_CHUNK_CELL_H
#define VOX_VOXELIZE_CACHE_CHUNK_CELL_H

#include "libvoxel/voxelize/lanes/lanes.h"

/* The cell of a point, and a number that does not matter. Points are not below the lattice, but
 * what lies on its upper bounds has its floor just above and is counted to the last. */
LANES_INLINE four_ints vox_cell(struct row point, const int32_t last_cell[4])
{
    return four_min(row_floor(point), four_load(last_cell));
}

#endif
