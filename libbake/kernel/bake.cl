/* bake.cl - the kernel's entry for OpenCL: one work item a texel of a tile. */
#include "bk_sample.h"

/* Work items are (column, row - first_row); `texels` holds the whole tile. */
__kernel void bake_tile(const __global ulong *tiles, const __global ulong *uppers,
                        const __global ulong *lowers, const __global ulong *leaves,
                        const __global uint *normals, const __global uint *planes,
                        const __global uint *colors, const __global uint *seconds,
                        const __global bk_triangle *triangles, bk_params params, bk_tile tile,
                        uint first_row, const __global uint *sample_triangles,
                        __global bk_texel *texels)
{
    const uint column = (uint)get_global_id(0), row = first_row + (uint)get_global_id(1);
    bk_cache cache = bk_cache_empty();
    bk_grid grid;

    if (column >= tile.width || row >= tile.height)
        return;
    bk_grid_from_params(&grid, &params);
    grid.tiles = tiles;
    grid.uppers = uppers;
    grid.lowers = lowers;
    grid.leaves = leaves;
    grid.normals = normals;
    grid.planes = planes;
    grid.colors = colors;
    grid.seconds = seconds;
    texels[(ulong)row * tile.width + column] =
        bk_sample_texel(&grid, &params, &cache, triangles, &tile, sample_triangles, column, row);
}
