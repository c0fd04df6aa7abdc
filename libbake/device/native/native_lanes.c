/* native_lanes.c - traces a patch, or rays, BK_WIDTH at a time. */
#include <string.h>

#include "base/simd/simd.h"
#define BK_WIDTH SIMD_FLOATS
#include "libbake/device/native/native_code.h"
#include "libbake/grid_tree/tree_rays.h"
#include "libbake/kernel/bk_sample.h"

_Static_assert(BK_WIDTH <= BAKE_NATIVE_HITS, "the hits of a group have results");

struct group {
    const struct bk_grid *grid;
    const struct bk_params *params;
    const struct bk_triangle *triangles;
    bk_cache cache;
    bk_samples samples;
    uint32_t texel_floats;
    float offsets[BAKE_MAX_SAMPLES]; /* of a texel's samples along an axis, from its corner */
    struct bake_native_memory memory;
};

/* ---- secondary rays ---- */

/* Traces the samples of a group and the rays from their hits. */
static void trace_secondary(struct group *group, bk_map_hits *hits)
{
    const struct bake_native_memory *memory = &group->memory;
    const struct bk_params *params = group->params;
    const bk_uint opens = bk_open_rays(params), rays = opens + bk_solid_rays(params);
    bk_surroundings sums[BK_WIDTH];
    bk_viewpoint points[BK_WIDTH];
    uint32_t count = 0;
    bk_traced traced;

    bk_trace_hits(group->grid, params, &group->cache, group->triangles, &group->samples, &traced,
                  hits);
    for (bk_uint lane = 0; lane < BK_WIDTH; lane++)
        if (hits->found >> lane & 1)
            points[count++] = bk_viewpoint_of_hit(params, &group->samples, &traced, lane);
    for (bk_uint open = 0; open < 2; open++) {
        const bk_rays kind = bk_rays_of(params, open);
        BSQ_SIMD_NAME(bake_tree_look)
        (group->grid, params, memory->tree, &kind, points, count,
         memory->results + (open ? 0 : opens), rays, memory->stream);
    }
    count = 0;
    for (bk_uint lane = 0; lane < BK_WIDTH; lane++) {
        sums[lane] = bk_no_surroundings();
        if (hits->found >> lane & 1) {
            sums[lane] =
                bk_add_up(params, &points[count], memory->results + (uint64_t)count * rays);
            count++;
        }
    }
    bk_surroundings_for_maps(params, &traced.points, sums, hits);
}

/* ---- patches ---- */

static void trace_group(struct group *group)
{
    bk_map_hits hits;
    bk_traced traced;

    if (group->samples.count == 0)
        return;
    if (group->memory.tree)
        trace_secondary(group, &hits);
    else
        bk_trace_hits(group->grid, group->params, &group->cache, group->triangles, &group->samples,
                      &traced, &hits);
    for (bk_uint lane = 0; lane < group->samples.count; lane++)
        bk_add_sample(group->params, &hits, lane, group->samples.texel[lane]);
    group->samples.count = 0;
}

static void add_texel(struct group *group, const struct bk_patch *patch,
                      const uint32_t *sample_triangles, bk_uint column, bk_uint row, float *texel)
{
    const bk_uint n = group->params->samples;
    bk_samples *samples = &group->samples;

    bk_clear_texel(group->params->maps, texel);
    for (bk_uint j = 0; j < n; j++) {
        const bk_ulong first = bk_sample_index(patch, n, column, row, 0, j);
        const uint32_t *row_triangles = sample_triangles + first;
        const float y = (float)(patch->y + row) + group->offsets[j];
        for (bk_uint i = 0; i < n; i++) {
            if (row_triangles[i] == BK_NO_TRIANGLE)
                continue;
            samples->triangle[samples->count] = row_triangles[i];
            samples->x[samples->count] = (float)(patch->x + column) + group->offsets[i];
            samples->y[samples->count] = y;
            samples->skew[samples->count] =
                bk_sample_skew(group->params, patch, sample_triangles, first + i);
            samples->texel[samples->count] = texel;
            if (++samples->count == BK_WIDTH)
                trace_group(group);
        }
    }
}

/* Returns bits 0, 2 and 4 of a six-bit number, packed. */
_Static_assert(BAKE_NATIVE_SQUARE == 8, "six bits number the texels of a square");
static uint32_t even_bits(uint32_t bits)
{
    return (bits & 1) | (bits >> 1 & 2) | (bits >> 2 & 4);
}

/* Adds a square of texels before row end_row in Morton order (1966), so that the samples of a group
 * are near each other on both axes. */
static void add_square(struct group *group, const struct bk_patch *patch, uint32_t end_row,
                       const uint32_t *sample_triangles, uint32_t x, uint32_t y, float *texels)
{
    for (uint32_t i = 0; i < BAKE_NATIVE_SQUARE * BAKE_NATIVE_SQUARE; i++) {
        const uint32_t column = x + even_bits(i), row = y + even_bits(i >> 1);
        if (column < patch->width && row < end_row)
            add_texel(group, patch, sample_triangles, column, row,
                      texels + ((uint64_t)row * patch->width + column) * group->texel_floats);
    }
}

void BSQ_SIMD_NAME(bake_native_patch)(const struct bk_grid *grid, const struct bk_params *params,
                                      const struct bk_triangle *triangles,
                                      const struct bk_patch *patch, uint32_t first_row,
                                      uint32_t end_row, const uint32_t *sample_triangles,
                                      const struct bake_native_memory *memory, float *texels)
{
    struct group group = {.grid = grid,
                          .params = params,
                          .triangles = triangles,
                          .cache = bk_cache_empty(),
                          .texel_floats = bk_texel_floats(params->maps),
                          .memory = *memory};

    for (bk_uint i = 0; i < params->samples; i++)
        group.offsets[i] = bk_sample_position(0, i, params->samples);
    for (uint32_t y = first_row; y < end_row; y += BAKE_NATIVE_SQUARE)
        for (uint32_t x = 0; x < patch->width; x += BAKE_NATIVE_SQUARE)
            add_square(&group, patch, end_row, sample_triangles, x, y, texels);
    trace_group(&group);
}

/* ---- rays ---- */

/* Fills lines with rays `first` and following ones of a batch, BK_WIDTH at most. */
static void load_lines(const struct bk_params *params, double unit,
                       const struct bake_ray_batch *batch, uint64_t first, uint64_t end,
                       bk_lines *lines)
{
    const uint64_t channels = (uint64_t)BK_TRANSFER_VALUES * bk_transfers(params->maps);
    const bk_fw zero = bk_splat(0.0f);
    *lines = (bk_lines){.count = end - first < BK_WIDTH ? (bk_uint)(end - first) : BK_WIDTH,
                        .origin = bk_v3w(zero, zero, zero),
                        .direction = bk_v3w(zero, zero, zero),
                        .reach = zero,
                        .t_min = bk_splat((float)(batch->t_min / unit)),
                        .gap = batch->gap > 0 ? BK_NEXT_SHEET : 0.0f,
                        .t_max = bk_splat((float)(batch->t_max / unit))};
    for (bk_uint lane = 0; lane < lines->count; lane++) {
        const float *o = batch->rays[first + lane].origin, *d = batch->rays[first + lane].direction;
        bk_set_lane3(&lines->origin, lane, bk_v3(o[0], o[1], o[2]));
        bk_set_lane3(&lines->direction, lane, bk_v3(d[0], d[1], d[2]));
        if (batch->reaches)
            bk_set_lane(lines->reach, lane, (float)((double)batch->reaches[first + lane] / unit));
        if (batch->channels) {
            lines->sums[lane] = batch->channels + (first + lane) * channels;
            memset(lines->sums[lane], 0, channels * sizeof *batch->channels);
        }
    }
    if (batch->from_reach)
        lines->t_max = lines->reach;
    lines->facing = bk_scalew(lines->direction, bk_splat(batch->facing_origin ? -1.0f : 1.0f));
}

static void get_hit(const bk_hits *hits, bk_uint lane, double unit, struct bake_hit *out)
{
    *out = (struct bake_hit){.triangle = hits->found >> lane & 1 ? 0 : BAKE_NO_HIT,
                             .t = (double)bk_lane(hits->t, lane) * unit,
                             .id = (bk_uint)bk_lane(hits->id, lane),
                             .reversed = hits->reversed >> lane & 1,
                             .crowded = (uint8_t)bk_crowded_by(hits, lane)};
    bk_copy_lane(&hits->normal, lane, out->normal);
    bk_copy_lane(&hits->color, lane, out->color);
    if (out->crowded == BK_CROWDED_BY_WALL)
        bk_copy_lane(&hits->up, lane, out->facet);
}

void BSQ_SIMD_NAME(bake_native_rays)(const struct bk_grid *grid, const struct bk_params *params,
                                     double unit, const struct bake_ray_batch *batch,
                                     uint64_t begin, uint64_t end)
{
    const bk_fw zero = bk_splat(0.0f);
    bk_cache cache = bk_cache_empty();
    bk_lines lines;
    bk_hits found;

    for (; begin < end; begin += lines.count) {
        load_lines(params, unit, batch, begin, end, &lines);
        memset(&found, 0, sizeof found);
        if (bk_bits(bk_less(zero, bk_dotw(lines.direction, lines.direction))))
            bk_trace(grid, params, &cache, &lines, &found);
        for (bk_uint lane = 0; lane < lines.count; lane++)
            get_hit(&found, lane, unit, &batch->hits[begin + lane]);
    }
}
