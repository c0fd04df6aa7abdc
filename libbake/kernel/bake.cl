/* bake.cl - the kernel's entry on devices, as OpenCL C or CUDA. A work item is a texel of a patch.
 */
#include "bk_sample.h"

/* `colors` begins with the linear values of the sRGB codes, as 256 floats. The words of transfer
 * maps follow (bk_grid.h), then colours, ids and further channels.
 *
 * Traces rows first_row to end_row - 1 of a patch; work item (x, y) is texel (x, first_row + y). Of
 * each texel it traces lines first_line to end_line - 1 of the samples. The launch with line 0
 * starts the texel's sums, later launches add to them. `texels` holds the whole patch. */
BK_KERNEL bake_patch(
    const BK_GLOBAL bk_ulong *BK_RESTRICT tiles, const BK_GLOBAL bk_ulong *BK_RESTRICT uppers,
    const BK_GLOBAL bk_ulong *BK_RESTRICT lowers, const BK_GLOBAL bk_ulong *BK_RESTRICT leaves,
    const BK_GLOBAL bk_uint *BK_RESTRICT normals, const BK_GLOBAL bk_uint *BK_RESTRICT planes,
    const BK_GLOBAL bk_uint *BK_RESTRICT colors, const BK_GLOBAL bk_uint *BK_RESTRICT seconds,
    const BK_GLOBAL bk_triangle *BK_RESTRICT triangles, bk_params params, bk_patch patch,
    bk_uint first_row, bk_uint end_row, bk_uint first_line, bk_uint end_line,
    const BK_GLOBAL bk_uint *BK_RESTRICT sample_triangles, BK_GLOBAL float *BK_RESTRICT texels)
{
    const bk_uint column = bk_work_x(), row = first_row + bk_work_y();
    bk_cache cache = bk_cache_empty();
    bk_grid grid;

    if (column >= patch.width || row >= end_row)
        return;
    bk_grid_from_params(&grid, &params);
    grid.tiles = tiles;
    grid.uppers = uppers;
    grid.lowers = lowers;
    grid.leaves = leaves;
    grid.normals = normals;
    grid.planes = planes;
    grid.srgb = (const BK_GLOBAL float *)colors;
    grid.transfers = colors + 256;
    grid.colors = grid.transfers + bk_transfers(params.maps);
    grid.seconds = seconds;
    texels += ((bk_ulong)row * patch.width + column) * bk_texel_floats(params.maps);
    if (first_line == 0)
        bk_clear_texel(params.maps, texels);
    bk_sample_texel(&grid, &params, &cache, triangles, &patch, sample_triangles, column, row,
                    first_line, end_line, texels);
}
