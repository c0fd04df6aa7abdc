/* native_lanes.c - traces a tile, or rays, or rays from hits, BK_WIDTH at a time. */
#include <string.h>

#include "base/simd/simd.h"
#define BK_WIDTH SIMD_FLOATS
#include "libbake/device/native/native_code.h"
#include "libbake/kernel/bk_sample.h"

/* A hit's ray on its way to be traced. slot: of its result, see struct batch. */
struct sorted_ray {
    float direction[3];
    uint32_t place, slot;
};

/* Samples, in groups of BK_WIDTH, whose rays from hits are traced together. */
struct batch {
    uint32_t capacity, count; /* groups */
    bk_uint opens, solids;    /* rays of a hit */
    bk_samples *groups;
    bk_uint *found;           /* lanes of a group with hits */
    bk_place_on_scan *places; /* BK_WIDTH of a group */
    float *slots;             /* results of bk_look(): of each place opens + solids */
    struct sorted_ray *rays;  /* of one kind */
};

struct group {
    const struct bk_grid *grid;
    const struct bk_params *params;
    const struct bk_triangle *triangles;
    bk_cache cache;
    bk_samples samples;
    uint32_t texel_floats;
    float places[BAKE_MAX_SAMPLES]; /* of a texel's samples along an axis, from its corner */
    struct batch batch;             /* capacity 0: hits send their rays at once */
};

/* ---- rays from hits of many samples ---- */

/* Rays are traced in the order of their directions, and of their places if these agree. So the rays
 * of a group go through the same nodes, and those of the next groups find them in the cache.
 * Directions agree if they are in the same cell of a square of CELLS x CELLS that the unit sphere
 * is mapped to (octahedral map). If places are farther apart than NEAR voxels on average, their
 * rays share little, and rays of one place share more. So do short rays: open ones are sorted if
 * they may be SORTED_LENGTH voxels long, and rays into the solid are not sorted. */
enum { CELLS_LOG2 = 5, CELLS = 1 << CELLS_LOG2 };
#define NEAR          16.0f
#define SORTED_LENGTH 256.0f

/* Divides memory among the arrays of a batch. */
static struct batch make_batch(const struct bk_params *params,
                               const struct bake_native_memory *memory)
{
    struct batch batch = {.opens = bk_open_rays(params), .solids = bk_solid_rays(params)};
    const uint64_t most = batch.opens > batch.solids ? batch.opens : batch.solids;
    const uint64_t lane_bytes = sizeof *batch.places +
                                (uint64_t)(batch.opens + batch.solids) * sizeof *batch.slots +
                                most * sizeof *batch.rays;
    const uint64_t capacity =
        memory->bytes / (sizeof *batch.groups + sizeof *batch.found + BK_WIDTH * lane_bytes);

    if (batch.opens == 0 || params->open_limit < SORTED_LENGTH || capacity == 0)
        return batch;
    batch.capacity = (uint32_t)capacity; /* a slot takes 4 bytes, so 32 bits number them */
    batch.groups = memory->data;
    batch.found = (bk_uint *)(void *)(batch.groups + batch.capacity);
    batch.places = (bk_place_on_scan *)(void *)(batch.found + batch.capacity);
    batch.slots = (float *)(void *)(batch.places + (uint64_t)batch.capacity * BK_WIDTH);
    batch.rays = (struct sorted_ray *)(void *)(batch.slots + (uint64_t)batch.capacity * BK_WIDTH *
                                                                 (batch.opens + batch.solids));
    return batch;
}

/* Puts zeros between the lowest 8 bits of each lane. */
static bk_iw spread_bits(bk_iw v)
{
    v = (v | v << 4) & 0x0f0f;
    v = (v | v << 2) & 0x3333;
    return (v | v << 1) & 0x5555;
}

/* Returns the cells of unit vectors, in Morton order. */
static void find_cells(bk_vec3w d, bk_int cells[BK_WIDTH])
{
    const bk_fw zero = bk_splat(0.0f), one = bk_splat(1.0f), half = bk_splat(0.5f * CELLS);
    const bk_fw scale = 1.0f / (bk_absw(d.x) + bk_absw(d.y) + bk_absw(d.z));
    const bk_fw x = d.x * scale, y = d.y * scale, far_x = one - bk_absw(y),
                far_y = one - bk_absw(x);
    const bk_mask below = bk_less(d.z, zero);
    const bk_fw u = bk_select(below, bk_select(bk_less(d.x, zero), -far_x, far_x), x);
    const bk_fw v = bk_select(below, bk_select(bk_less(d.y, zero), -far_y, far_y), y);
    const bk_fw last = bk_splat((float)(CELLS - 1));
    const bk_iw column = bk_to_iw(bk_minw(bk_maxw((u + 1.0f) * half, zero), last));
    const bk_iw row = bk_to_iw(bk_minw(bk_maxw((v + 1.0f) * half, zero), last));

    bk_store_lanes(cells, spread_bits(column) | spread_bits(row) << 1);
}

/* Returns whether successive places are near each other. Single jumps do not matter. */
static bool are_near(const struct batch *batch)
{
    const bk_place_on_scan *last = NULL;
    float sum = 0.0f, count = 0.0f;

    for (uint32_t i = 0; i < batch->count * BK_WIDTH; i++) {
        const bk_place_on_scan *place = &batch->places[i];
        if (!(batch->found[i / BK_WIDTH] >> i % BK_WIDTH & 1))
            continue;
        if (last)
            sum += fminf(fabsf(place->position.x - last->position.x) +
                             fabsf(place->position.y - last->position.y) +
                             fabsf(place->position.z - last->position.z),
                         2.0f * NEAR);
        count += 1.0f;
        last = place;
    }
    return sum <= NEAR * count;
}

/* Visits rays of a kind: counts those of each cell, or puts them at ends[cell], which grows. */
static void visit_rays(const struct batch *batch, const bk_rays *kind, bool near, bool put,
                       uint32_t ends[CELLS * CELLS])
{
    for (uint32_t i = 0; i < batch->count * BK_WIDTH; i++) {
        const uint32_t slot = i * (batch->opens + batch->solids) + (kind->open ? 0 : batch->opens);
        if (!(batch->found[i / BK_WIDTH] >> i % BK_WIDTH & 1))
            continue;
        for (bk_uint first = 0; first < kind->count; first += BK_WIDTH) {
            const bk_vec3w d = bk_ray_directions(kind, &batch->places[i], first);
            bk_int cells[BK_WIDTH] = {0};
            if (near)
                find_cells(d, cells);
            for (bk_uint lane = 0; lane < BK_WIDTH && first + lane < kind->count; lane++) {
                struct sorted_ray *ray;
                const uint32_t at = ends[cells[lane]]++;
                if (!put)
                    continue;
                ray = &batch->rays[at];
                bk_copy_lane(&d, lane, ray->direction);
                ray->place = i;
                ray->slot = slot + first + lane;
            }
        }
    }
}

/* Sorts the rays of a kind. Returns their number. */
static uint32_t sort_rays(const struct batch *batch, const bk_rays *kind)
{
    const bool near = kind->open && are_near(batch);
    uint32_t ends[CELLS * CELLS] = {0}, count = 0;

    visit_rays(batch, kind, near, false, ends);
    for (uint32_t i = 0; i < CELLS * CELLS; i++) {
        const uint32_t begin = count;
        count += ends[i];
        ends[i] = begin;
    }
    visit_rays(batch, kind, near, true, ends);
    return count;
}

/* Traces the rays of a kind. */
static void trace_rays(struct group *group, bk_uint open)
{
    const struct batch *batch = &group->batch;
    const bk_rays kind = bk_rays_of(group->params, open);
    const uint32_t all = sort_rays(batch, &kind);

    for (uint32_t first = 0; first < all; first += BK_WIDTH) {
        const struct sorted_ray *rays = &batch->rays[first];
        const bk_uint count = all - first < BK_WIDTH ? all - first : BK_WIDTH;
        bk_vec3w start = bk_splat3(bk_v3(0.0f, 0.0f, 0.0f)), direction = start;
        bk_fw side = bk_splat(1.0f), found;
        for (bk_uint lane = 0; lane < count; lane++) {
            const bk_place_on_scan *from = &batch->places[rays[lane].place];
            const float *d = rays[lane].direction;
            bk_set_lane3(&start, lane, bk_ray_start(&kind, from));
            bk_set_lane3(&direction, lane, bk_v3(d[0], d[1], d[2]));
            bk_set_lane(side, lane, from->side);
        }
        found = bk_look(group->grid, group->params, &group->cache, &kind, start, direction, side,
                        (1u << count) - 1u);
        for (bk_uint lane = 0; lane < count; lane++)
            batch->slots[rays[lane].slot] = bk_lane(found, lane);
    }
}

/* Returns what the rays of a place found: what bk_look_around() returns. */
static bk_surroundings sum_slots(const struct group *group, uint32_t number)
{
    const struct batch *batch = &group->batch;
    const float *of_place = batch->slots + (uint64_t)number * (batch->opens + batch->solids);
    bk_surroundings sums = bk_no_surroundings();
    bk_uint counted = 0;

    for (bk_uint open = 2; open-- > 0;) {
        const bk_rays kind = bk_rays_of(group->params, open);
        const float *slots = of_place + (open ? 0 : batch->opens);
        for (bk_uint first = 0; first < kind.count; first += BK_WIDTH) {
            const bk_uint left = kind.count - first, count = left < BK_WIDTH ? left : BK_WIDTH;
            bk_fw found = bk_splat(0.0f);
            for (bk_uint lane = 0; lane < count; lane++)
                bk_set_lane(found, lane, slots[first + lane]);
            bk_add_looks(group->params, &kind, count, found,
                         bk_ray_directions(&kind, &batch->places[number], first), &sums, &counted);
        }
    }
    bk_mean_surroundings(group->params, batch->opens, counted, &sums);
    return sums;
}

static void add_samples(struct group *group, const bk_samples *samples, const bk_map_hits *hits)
{
    for (bk_uint lane = 0; lane < samples->count; lane++)
        bk_add_sample(group->params, hits, lane, samples->texel[lane]);
}

/* Traces the samples of a batch and the rays from their hits. Samples are traced twice, since hits
 * take much more memory than the few rays to them take time. */
static void trace_batch(struct group *group)
{
    struct batch *batch = &group->batch;
    bk_map_hits hits;
    bk_traced traced;

    for (uint32_t i = 0; i < batch->count; i++) {
        bk_samples samples = batch->groups[i];
        memset(samples.texel, 0, sizeof samples.texel); /* transfer maps get them once, below */
        bk_trace_hits(group->grid, group->params, &group->cache, group->triangles, &samples,
                      &traced, &hits);
        batch->found[i] = hits.found;
        for (bk_uint lane = 0; lane < samples.count; lane++)
            batch->places[i * BK_WIDTH + lane] =
                bk_place_of_hit(group->params, &samples, &traced, lane);
    }
    trace_rays(group, 1);
    trace_rays(group, 0);
    for (uint32_t i = 0; i < batch->count; i++) {
        const bk_samples *samples = &batch->groups[i];
        bk_surroundings sums[BK_WIDTH];
        bk_trace_hits(group->grid, group->params, &group->cache, group->triangles, samples, &traced,
                      &hits);
        for (bk_uint lane = 0; lane < BK_WIDTH; lane++)
            sums[lane] = hits.found >> lane & 1 ? sum_slots(group, i * BK_WIDTH + lane)
                                                : bk_no_surroundings();
        bk_surroundings_for_maps(group->params, &traced.points, sums, &hits);
        add_samples(group, samples, &hits);
    }
    batch->count = 0;
}

/* ---- tiles ---- */

static void trace_group(struct group *group)
{
    struct batch *batch = &group->batch;
    bk_map_hits hits;

    if (group->samples.count == 0)
        return;
    if (batch->capacity > 0) {
        batch->groups[batch->count++] = group->samples;
        if (batch->count == batch->capacity)
            trace_batch(group);
    } else {
        bk_trace_samples(group->grid, group->params, &group->cache, group->triangles,
                         &group->samples, &hits);
        add_samples(group, &group->samples, &hits);
    }
    group->samples.count = 0;
}

static void add_texel(struct group *group, const struct bk_tile *tile,
                      const uint32_t *sample_triangles, bk_uint column, bk_uint row, float *texel)
{
    const bk_uint n = group->params->samples;
    bk_samples *samples = &group->samples;

    bk_clear_texel(group->params->maps, texel);
    for (bk_uint j = 0; j < n; j++) {
        const bk_ulong first = bk_sample_index(tile, n, column, row, 0, j);
        const uint32_t *row_triangles = sample_triangles + first;
        const float y = (float)(tile->y + row) + group->places[j];
        for (bk_uint i = 0; i < n; i++) {
            if (row_triangles[i] == BK_NO_TRIANGLE)
                continue;
            samples->triangle[samples->count] = row_triangles[i];
            samples->x[samples->count] = (float)(tile->x + column) + group->places[i];
            samples->y[samples->count] = y;
            samples->skew[samples->count] =
                bk_sample_skew(group->params, tile, sample_triangles, first + i);
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

/* Adds a square of texels in Morton order (1966), so that the samples of a group are near each
 * other on both axes. */
static void add_square(struct group *group, const struct bk_tile *tile,
                       const uint32_t *sample_triangles, uint32_t x, uint32_t y, float *texels)
{
    for (uint32_t i = 0; i < BAKE_NATIVE_SQUARE * BAKE_NATIVE_SQUARE; i++) {
        const uint32_t column = x + even_bits(i), row = y + even_bits(i >> 1);
        if (column < tile->width && row < tile->height)
            add_texel(group, tile, sample_triangles, column, row,
                      texels + ((uint64_t)row * tile->width + column) * group->texel_floats);
    }
}

void BSQ_SIMD_NAME(bake_native_tile)(const struct bk_grid *grid, const struct bk_params *params,
                                     const struct bk_triangle *triangles,
                                     const struct bk_tile *tile, const uint32_t *sample_triangles,
                                     const struct bake_native_memory *memory, float *texels)
{
    struct group group = {.grid = grid,
                          .params = params,
                          .triangles = triangles,
                          .cache = bk_cache_empty(),
                          .texel_floats = bk_texel_floats(params->maps),
                          .batch = make_batch(params, memory)};

    for (bk_uint i = 0; i < params->samples; i++)
        group.places[i] = bk_sample_place(0, i, params->samples);
    for (uint32_t y = 0; y < tile->height; y += BAKE_NATIVE_SQUARE)
        for (uint32_t x = 0; x < tile->width; x += BAKE_NATIVE_SQUARE)
            add_square(&group, tile, sample_triangles, x, y, texels);
    trace_group(&group);
    if (group.batch.count > 0)
        trace_batch(&group);
}

/* ---- rays ---- */

static void get_hit(const bk_hits *hits, bk_uint lane, struct bk_hit *out)
{
    out->found = hits->found >> lane & 1;
    out->t = bk_lane(hits->t, lane);
    bk_copy_lane(&hits->normal, lane, out->normal);
    bk_copy_lane(&hits->color, lane, out->color);
}

void BSQ_SIMD_NAME(bake_native_rays)(const struct bk_grid *grid, const struct bk_params *params,
                                     const struct bake_ray_batch *rays, struct bk_hit *hits)
{
    const bk_fw zero = bk_splat(0.0f);
    bk_cache cache = bk_cache_empty();
    bk_hits found;

    for (uint64_t first = 0; first < rays->count; first += BK_WIDTH) {
        const uint64_t left = rays->count - first;
        bk_lines lines = {.count = left < BK_WIDTH ? (bk_uint)left : BK_WIDTH,
                          .origin = bk_v3w(zero, zero, zero),
                          .direction = bk_v3w(zero, zero, zero),
                          .t_min = bk_splat(rays->t_min),
                          .t_max = rays->t_max};
        for (bk_uint lane = 0; lane < lines.count; lane++) {
            const float *ray = rays->rays[first + lane];
            bk_set_lane3(&lines.origin, lane, bk_v3(ray[0], ray[1], ray[2]));
            bk_set_lane3(&lines.direction, lane, bk_v3(ray[3], ray[4], ray[5]));
            if (rays->starts)
                bk_set_lane(lines.t_min, lane, rays->starts[first + lane]);
        }
        if (!bk_bits(bk_less(zero, bk_dotw(lines.direction, lines.direction)))) {
            memset(&hits[first], 0, lines.count * sizeof *hits);
            continue;
        }
        lines.facing = bk_scalew(lines.direction, bk_splat(rays->facing));
        bk_trace(grid, params, &cache, &lines, &found);
        for (bk_uint lane = 0; lane < lines.count; lane++)
            get_hit(&found, lane, &hits[first + lane]);
    }
}

/* ---- rays from hits ---- */

struct view {
    const struct bk_grid *grid;
    const struct bk_params *params;
    struct bake_ray_states *states;
    double unit; /* of index space, in world units */
    bk_cache cache;
};

/* Rays of a place that are traced together: BK_WIDTH of them from ray `first` on. */
struct rays {
    uint64_t place;
    bool open;
    bk_uint first, count;
};

/* Returns the lanes of rays of which more can be known. */
static bk_uint wanted(const struct bake_ray_states *states, const struct rays *rays)
{
    const bk_uint lanes = (1u << rays->count) - 1;
    if (!rays->open || states->words == 0)
        return lanes;
    /* BK_WIDTH divides 64. */
    return lanes &
           ~(bk_uint)(bake_hidden_rays(states, rays->place)[rays->first / 64] >> rays->first % 64);
}

/* Notes what a ray met, after t voxels. */
static void note_hit(const struct view *view, const struct rays *rays, bk_uint lane, float t)
{
    const struct bake_ray_states *states = view->states;
    const bk_uint ray = rays->first + lane;
    if (rays->open && states->words > 0) {
        bake_hidden_rays(states, rays->place)[ray / 64] |= UINT64_C(1) << ray % 64;
        return;
    }
    float *distance = bake_ray_distances(states, rays->place, rays->open) + ray;
    *distance = fminf(*distance, (float)((double)t * view->unit));
}

static void trace_from(struct view *view, const struct bake_place *place, const struct rays *rays)
{
    const struct bk_params *params = view->params;
    const float side = rays->open ? 1.0f : -1.0f, facing = place->reversed ? -1.0f : 1.0f;
    const float limit = rays->open ? params->open_limit : params->thickness_limit;
    const float *from = rays->open ? place->open_from : place->solid_from;
    const float *n = place->normal, *f = place->facet;
    const bk_uint lanes = wanted(view->states, rays);
    if (lanes == 0)
        return;
    const bk_vec3w direction = bk_hemisphere(
        place->seed ^ (rays->open ? 0u : BK_SOLID_SEED),
        bk_v3(side * n[0], side * n[1], side * n[2]), bk_v3(side * f[0], side * f[1], side * f[2]),
        rays->first, rays->open ? view->states->opens : view->states->solids,
        rays->open ? params->open_sine2 : 1.0f);
    bk_walk walk;
    bk_walk_from(view->grid, params, &view->cache, bk_splat3(bk_v3(from[0], from[1], from[2])),
                 direction, bk_scalew(direction, bk_splat(facing)), lanes, rays->open, limit,
                 &walk);
    for (bk_uint lane = 0; lane < rays->count; lane++)
        if (bk_bits(walk.hit.found) >> lane & 1)
            note_hit(view, rays, lane, bk_min(bk_lane(walk.hit.t, lane), limit));
}

static void look_from(struct view *view, const struct bake_place *place, uint64_t index)
{
    const bk_uint opens = view->states->opens, solids = view->states->solids;
    for (bk_uint i = 0; i < opens + solids;) {
        const bool open = i < opens;
        const bk_uint left = (open ? opens : opens + solids) - i;
        const struct rays rays = {.place = index,
                                  .open = open,
                                  .first = open ? i : i - opens,
                                  .count = left < BK_WIDTH ? left : BK_WIDTH};
        trace_from(view, place, &rays);
        i += rays.count;
    }
}

void BSQ_SIMD_NAME(bake_native_look)(const struct bk_grid *grid, const struct bk_params *params,
                                     const struct bake_places *places, uint64_t begin, uint64_t end,
                                     struct bake_ray_states *states)
{
    struct view view = {.grid = grid,
                        .params = params,
                        .states = states,
                        .unit = places->unit,
                        .cache = bk_cache_empty()};
    struct bake_place place;

    for (uint64_t i = begin; i < end; i++)
        if (places->get(places->arg, i, &place))
            look_from(&view, &place, i);
}
