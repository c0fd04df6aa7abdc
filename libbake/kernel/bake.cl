/* bake.cl - the kernel's entries on devices, as OpenCL C or CUDA. */
#include "bk_meet.h"
#include "bk_sample.h"

/* The arrays of a grid. `colors` begins with the linear values of the sRGB codes, as 256 floats.
 * The words of transfer maps follow (bk_grid.h), then colours, ids and further channels. nodes,
 * blocks: the tree around the leaves. An array that no map needs is missing. */
#define BK_GRID_ARRAYS                                                                             \
    const BK_GLOBAL bk_ulong *BK_RESTRICT root_tiles,                                              \
        const BK_GLOBAL bk_ulong *BK_RESTRICT uppers,                                              \
        const BK_GLOBAL bk_ulong *BK_RESTRICT lowers,                                              \
        const BK_GLOBAL bk_ulong *BK_RESTRICT leaves,                                              \
        const BK_GLOBAL bk_uint *BK_RESTRICT normals, const BK_GLOBAL bk_uint *BK_RESTRICT planes, \
        const BK_GLOBAL bk_uint *BK_RESTRICT colors, const BK_GLOBAL bk_uint *BK_RESTRICT seconds, \
        const BK_GLOBAL bk_ulong2 *BK_RESTRICT nodes, const BK_GLOBAL bk_ulong *BK_RESTRICT blocks

/* Sets a grid to the arrays of a kernel. */
#define BK_SET_GRID(grid, params)                                                                  \
    do {                                                                                           \
        bk_grid_from_params(&(grid), &(params));                                                   \
        (grid).root_tiles = root_tiles;                                                            \
        (grid).uppers = uppers;                                                                    \
        (grid).lowers = lowers;                                                                    \
        (grid).leaves = leaves;                                                                    \
        (grid).normals = normals;                                                                  \
        (grid).planes = planes;                                                                    \
        (grid).srgb = (const BK_GLOBAL float *)colors;                                             \
        (grid).transfers = colors + 256;                                                           \
        (grid).colors = (grid).transfers + bk_transfers((params).maps);                            \
        (grid).seconds = seconds;                                                                  \
        (grid).nodes = nodes;                                                                      \
        (grid).blocks = blocks;                                                                    \
    } while (0)

/* Traces the samples of a batch, see bk_batch; work item (x, y) is texel (first_column + x,
 * first_row + y). The batch with line 0 starts the texel's sums, later ones add to them. `texels`
 * holds the whole patch. stage: BK_ADD if no rays start at hits; else BK_POINTS, which stores
 * viewpoints in `points`, and then BK_ADD_FOUND, which takes what bake_look() found. */
BK_KERNEL bake_patch(BK_GRID_ARRAYS, bk_params params,
                     const BK_GLOBAL bk_triangle *BK_RESTRICT triangles, bk_patch patch,
                     bk_batch batch, bk_uint stage,
                     const BK_GLOBAL bk_uint *BK_RESTRICT sample_triangles,
                     BK_GLOBAL bk_viewpoint *BK_RESTRICT points,
                     const BK_GLOBAL float *BK_RESTRICT found, BK_GLOBAL float *BK_RESTRICT texels)
{
    const bk_uint column = batch.first_column + bk_work_x(), row = batch.first_row + bk_work_y();
    bk_cache cache = bk_cache_empty();
    bk_looks looks;
    bk_grid grid;

    if (column >= batch.end_column || row >= batch.end_row)
        return;
    BK_SET_GRID(grid, params);
    looks.stage = stage;
    looks.points = points;
    looks.found = found;
    texels += ((bk_ulong)row * patch.width + column) * bk_texel_floats(params.maps);
    if (batch.first_line == 0 && stage != BK_POINTS)
        bk_clear_texel(params.maps, texels);
    bk_sample_texel(&grid, &params, &cache, triangles, &patch, &batch, sample_triangles, column,
                    row, &looks, texels);
}

/* Traces the rays of the viewpoints that BK_POINTS stored; work item (x, y) is ray x of viewpoint y
 * of `count`. found: the value of each ray. */
BK_KERNEL bake_look(BK_GRID_ARRAYS, bk_params params,
                    const BK_GLOBAL bk_viewpoint *BK_RESTRICT points, bk_uint count,
                    BK_GLOBAL float *BK_RESTRICT found)
{
    const bk_uint ray = bk_work_x(), point = bk_work_y();
    bk_grid grid;

    if (ray >= bk_ray_count(&params) || point >= count)
        return;
    BK_SET_GRID(grid, params);
    bk_look_from(&grid, &params, &points[point], ray,
                 &found[(bk_ulong)point * bk_ray_count(&params) + ray]);
}

/* Traces single rays; work item (x, y) is ray y * columns + x. */
BK_KERNEL bake_rays(BK_GRID_ARRAYS, bk_params params, bk_single_rays rays,
                    const BK_GLOBAL float *BK_RESTRICT values, BK_GLOBAL float *BK_RESTRICT hits)
{
    const bk_ulong ray = (bk_ulong)bk_work_y() * rays.columns + bk_work_x();
    bk_grid grid;

    if (bk_work_x() >= rays.columns || ray >= rays.count)
        return;
    BK_SET_GRID(grid, params);
    bk_trace_single(&grid, &params, &rays, values + ray * BK_RAY_FLOATS,
                    hits + ray * BK_HIT_FLOATS);
}

#ifdef BK_DOUBLE

/* Traces the rays of viewpoints through the group of chunks in an area; work item (x, y) is ray x
 * of viewpoint y of `count`. state: of all of them the words of bits, then the distances, then
 * where they are, see struct bake_ray_states and struct bk_viewpoint. */
BK_KERNEL bake_meet(const BK_GLOBAL bk_float4 *BK_RESTRICT area, bk_params params, bk_uint count,
                    BK_GLOBAL bk_uint *BK_RESTRICT state)
{
    const bk_uint ray = bk_work_x(), point = bk_work_y();
    const bk_uint words = 2u * bk_state_words(&params), lengths = bk_state_lengths(&params);
    BK_GLOBAL bk_uint *distances = state + (bk_ulong)count * words;

    if (ray >= bk_ray_count(&params) || point >= count)
        return;
    bk_meet_from(area, &params,
                 (const BK_GLOBAL bk_viewpoint *)(distances + (bk_ulong)count * lengths) + point,
                 ray, state + (bk_ulong)point * words,
                 (BK_GLOBAL float *)distances + (bk_ulong)point * lengths);
}

/* Traces first rays through a chunk that is in an area as a group of its own, from byte 64 * place
 * on; work item (x, y) is ray 32 y + x. values: of `count` rays the hits, then the rays. */
BK_KERNEL bake_first(const BK_GLOBAL bk_float4 *BK_RESTRICT area, bk_uint place, bk_limits limits,
                     bk_uint count, BK_GLOBAL bk_first_hit *BK_RESTRICT values)
{
    const bk_uint ray = 32u * bk_work_y() + bk_work_x();

    if (bk_work_x() >= 32u || ray >= count)
        return;
    bk_meet_first(area + (bk_ulong)place * BK_CHUNK_UNIT, &limits,
                  (const BK_GLOBAL bk_first_ray *)(values + count) + ray, values + ray);
}

#endif
