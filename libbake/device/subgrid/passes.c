/* passes.c - fills passes with tiles while the nodes that these need fit the device.
 *
 * All threads find the nodes of tiles; a serial step adds tile after tile to a pass. Tiles come in
 * Z-order (Morton 1966) of their position in space: charts that are neighbours in the map rarely
 * are neighbours on the surface. */

#include <inttypes.h>

#include "base/parallel.h"
#include "base/sort_array.h"
#include "base/space_curve.h"
#include "libbake/device/subgrid/leaf_set.h"
#include "libbake/raster/raster.h"

enum {
    STACK = 64, /* a tile is halved at most once for each bit of its sides */
    STRIDE = 61 /* every 61st sample of a tile gives its position in space */
};

struct tile_key {
    uint32_t key, tile;
};

struct slot {
    uint32_t tile;
    struct bake_leaf_set nodes;
};

struct planner {
    struct bsq_ctx *ctx;
    const struct bake_plan_options *options;
    struct bake_plan *plan;
    struct bake_leaf_set pass; /* nodes of the pass that is being filled */
    uint64_t first_piece;      /* of that pass */
    uint32_t **samples;        /* of a tile, for each worker and for the serial step */
    unsigned workers;
    struct tile_key *order;
    struct slot *slots;
    unsigned slot_count;
    struct bake_leaf_set split; /* nodes of a piece of a tile */
    /* Limit of a subgrid. After a texel did not fit, the need of the largest one so far: planning
     * goes on only to tell how much memory is needed. */
    uint64_t subgrid_bytes;
};

/* Returns whether the pass still fits the device with these nodes added. */
static bool fits(const struct planner *p, const struct bake_leaf_set *nodes)
{
    struct bake_leaf_set counts;
    uint64_t bytes[BAKE_SUBGRID_ARRAYS], largest;
    bake_leaf_set_preview(&p->pass, nodes, &counts);
    bake_subgrid_sizes(p->pass.grid, &counts, bytes);
    return bake_subgrid_total(bytes, &largest) <= p->subgrid_bytes &&
           largest <= p->options->buffer_bytes;
}

static int end_pass(struct planner *p)
{
    struct bake_plan *plan = p->plan;
    if (plan->piece_count == p->first_piece)
        return 0;
    int status = bsq_grow(p->ctx, "passes", plan->pass_count + 1, sizeof *plan->passes,
                          &plan->passes, &plan->pass_capacity);
    if (status < 0)
        return status;
    struct bake_pass *pass = &plan->passes[plan->pass_count++];
    *pass = (struct bake_pass){.first_piece = p->first_piece,
                               .piece_count = plan->piece_count - p->first_piece};
    status = bake_subgrid_create(p->ctx, &p->pass, &p->options->job->params, &pass->subgrid);
    p->first_piece = plan->piece_count;
    bake_leaf_set_clear(&p->pass);
    return status;
}

/* Adds a piece to this pass or to a new one. *placed is false if it does not fit any. */
static int place(struct planner *p, uint32_t tile, const struct bake_rectangle *texels,
                 const struct bake_leaf_set *nodes, bool *placed)
{
    struct bake_plan *plan = p->plan;
    int status = 0;
    *placed = fits(p, nodes);
    if (!*placed) {
        status = end_pass(p);
        *placed = status == 0 && fits(p, nodes);
    }
    if (status < 0 || !*placed)
        return status;
    status = bsq_grow(p->ctx, "pieces of the map", plan->piece_count + 1, sizeof *plan->pieces,
                      &plan->pieces, &plan->piece_capacity);
    if (status == 0)
        status = bake_leaf_set_add(p->ctx, &p->pass, nodes);
    if (status == 0)
        plan->pieces[plan->piece_count++] = (struct bake_piece){tile, *texels};
    return status;
}

/* Notes what a single texel needs that does not fit. */
static int note_too_small(struct planner *p)
{
    uint64_t bytes[BAKE_SUBGRID_ARRAYS], largest, needed;
    bake_subgrid_sizes(p->pass.grid, &p->split, bytes);
    needed = bake_subgrid_total(bytes, &largest);
    if (largest > p->options->buffer_bytes)
        return bsq_fail(
            p->ctx, BSQ_ENODEVICE,
            "a buffer of the device holds %" PRIu64
            " bytes, the part of the grid that a texel's rays reach needs one of %" PRIu64,
            p->options->buffer_bytes, largest);
    p->subgrid_bytes = needed;
    return 0;
}

static int fail_too_small(const struct planner *p)
{
    return bsq_fail(p->ctx, BSQ_ENODEVICE,
                    "the device's memory leaves %" PRIu64
                    " bytes for a part of the grid, a texel's rays reach %" PRIu64
                    ": at least --gpu-memory %" PRIu64 ", or shorter rays",
                    p->options->subgrid_bytes, p->subgrid_bytes,
                    p->options->other_bytes + p->options->slots * p->subgrid_bytes);
}

/* Halves a tile that does not fit a pass until its pieces do. */
static int place_split(struct planner *p, uint32_t index)
{
    const struct bk_tile tile = bake_raster_tile(p->options->raster, index);
    uint32_t *samples = p->samples[p->workers];
    struct bake_rectangle stack[STACK] = {{0, 0, tile.width, tile.height}};
    uint64_t overlaps;
    unsigned depth = 1;
    int status = bake_raster_fill(p->options->raster, index, samples, &overlaps);
    while (depth > 0 && status == 0) {
        const struct bake_rectangle whole = stack[--depth];
        struct bake_rectangle first = whole, second = whole;
        bool placed = false;
        bake_leaf_set_clear(&p->split);
        status = bake_leaf_set_add_rays(p->ctx, &p->split, p->options->job, &tile, samples, &whole);
        if (status == 0)
            status = place(p, index, &whole, &p->split, &placed);
        if (status < 0 || placed)
            continue;
        if (whole.width == 1 && whole.height == 1) {
            status = note_too_small(p);
            continue;
        }
        if (whole.width >= whole.height) {
            first.width /= 2;
            second.x += first.width;
            second.width -= first.width;
        } else {
            first.height /= 2;
            second.y += first.height;
            second.height -= first.height;
        }
        stack[depth++] = second;
        stack[depth++] = first;
    }
    return status;
}

/* ---- the order of tiles ---- */

static uint32_t morton(const struct bk_params *params, const double at[3])
{
    uint32_t cell[3];
    double side = 1;
    for (int k = 0; k < 3; k++) {
        const double length = (double)params->index_max[k] - (double)params->index_min[k] + 1;
        side = length > side ? length : side;
    }
    for (int k = 0; k < 3; k++) {
        const double place = (at[k] - (double)params->index_min[k]) / side * 1024;
        cell[2 - k] = place > 0 ? place < 1023 ? (uint32_t)place : 1023 : 0;
    }
    return (uint32_t)bsq_morton_key(cell);
}

/* Computes the Z-order key of a tile: the mean centre of the triangles of a few samples. */
static int find_key(void *arg, uint64_t index, unsigned worker)
{
    struct planner *p = arg;
    const struct bake_job *job = p->options->job;
    const struct bk_tile tile = bake_raster_tile(p->options->raster, (uint32_t)index);
    const uint32_t n = job->params.samples, *samples = p->samples[worker];
    uint64_t overlaps, count = 0;
    double at[3] = {0};
    int status =
        bake_raster_fill(p->options->raster, (uint32_t)index, p->samples[worker], &overlaps);
    if (status < 0)
        return status;
    for (uint64_t i = 0; i < (uint64_t)tile.width * n * tile.height * n; i += STRIDE) {
        if (samples[i] == BK_NO_TRIANGLE)
            continue;
        count++;
        for (int corner = 0; corner < 3; corner++)
            for (int k = 0; k < 3; k++)
                at[k] += (double)job->triangles[samples[i]].position[corner][k] / 3;
    }
    for (int k = 0; k < 3 && count > 0; k++)
        at[k] /= (double)count;
    p->order[index] = (struct tile_key){morton(&job->params, at), (uint32_t)index};
    return 0;
}

static int by_key(const void *a, const void *b)
{
    const struct tile_key *x = a, *y = b;
    if (x->key != y->key)
        return x->key < y->key ? -1 : 1;
    return (x->tile > y->tile) - (x->tile < y->tile);
}

static int order_tiles(struct planner *p)
{
    const uint32_t count = bake_raster_tile_count(p->options->raster);
    int status =
        bsq_alloc(p->ctx, "order of tiles", count + UINT64_C(1), sizeof *p->order, &p->order);
    if (status == 0)
        status = bsq_parallel_for(p->ctx, count, find_key, p);
    if (status == 0)
        bsq_sort(p->order, count, sizeof *p->order, by_key);
    return status;
}

/* ---- the pipeline ---- */

static int next_tile(void *arg, void *slot, uint64_t sequence)
{
    const struct planner *p = arg;
    if (sequence >= bake_raster_tile_count(p->options->raster))
        return 0;
    ((struct slot *)slot)->tile = p->order[sequence].tile;
    return 1;
}

static int find_nodes(void *arg, void *data, uint64_t sequence, unsigned worker)
{
    const struct planner *p = arg;
    struct slot *slot = data;
    const struct bk_tile tile = bake_raster_tile(p->options->raster, slot->tile);
    const struct bake_rectangle all = {0, 0, tile.width, tile.height};
    uint64_t overlaps;
    (void)sequence;
    int status = bake_raster_fill(p->options->raster, slot->tile, p->samples[worker], &overlaps);
    if (status < 0)
        return status;
    bake_leaf_set_clear(&slot->nodes);
    return bake_leaf_set_add_rays(p->ctx, &slot->nodes, p->options->job, &tile, p->samples[worker],
                                  &all);
}

static int place_tile(void *arg, void *data, uint64_t sequence)
{
    struct planner *p = arg;
    struct slot *slot = data;
    const struct bk_tile tile = bake_raster_tile(p->options->raster, slot->tile);
    const struct bake_rectangle all = {0, 0, tile.width, tile.height};
    bool placed;
    (void)sequence;
    int status = place(p, slot->tile, &all, &slot->nodes, &placed);
    if (status == 0 && !placed)
        status = place_split(p, slot->tile);
    bsq_progress_add(p->ctx, 1);
    return status;
}

static int allocate(struct planner *p)
{
    const struct bake_job *job = p->options->job;
    const uint64_t samples = bake_raster_texel_entries(&job->params);
    p->workers = bsq_threads(p->ctx);
    const unsigned slots = 2 * p->workers;
    int status = bsq_calloc(p->ctx, "planning", p->workers + 1, sizeof *p->samples, &p->samples);
    for (unsigned i = 0; i <= p->workers && status == 0; i++)
        status = bsq_alloc(p->ctx, "samples of a tile", job->tile_texels * samples,
                           sizeof **p->samples, &p->samples[i]);
    if (status == 0)
        status = bsq_calloc(p->ctx, "planning", slots, sizeof *p->slots, &p->slots);
    for (; p->slot_count < slots && status == 0; p->slot_count++)
        status = bake_leaf_set_create(p->ctx, job->grid, &p->slots[p->slot_count].nodes);
    if (status == 0)
        status = bake_leaf_set_create(p->ctx, job->grid, &p->pass);
    if (status == 0)
        status = bake_leaf_set_create(p->ctx, job->grid, &p->split);
    return status;
}

static void release(struct planner *p)
{
    for (unsigned i = 0; p->samples && i <= p->workers; i++)
        bsq_free(p->ctx, p->samples[i]);
    for (unsigned i = 0; i < p->slot_count; i++)
        bake_leaf_set_free(p->ctx, &p->slots[i].nodes);
    bake_leaf_set_free(p->ctx, &p->pass);
    bake_leaf_set_free(p->ctx, &p->split);
    bsq_free(p->ctx, p->samples);
    bsq_free(p->ctx, p->slots);
    bsq_free(p->ctx, p->order);
}

/* Fails if rays that start at hits reach across the whole grid: then no part of it is enough. */
static int check_reach(struct bsq_ctx *ctx, const struct bake_plan_options *options)
{
    const struct bk_params *params = &options->job->params;
    const float reach = bake_secondary_reach(params);
    bool across = reach > 0;
    for (int k = 0; k < 3; k++)
        across = across && (double)reach >= (double)params->index_max[k] - params->index_min[k];
    return across ? bsq_fail(ctx, BSQ_ENODEVICE,
                             "rays that start on the scan reach all of the grid, and the device's "
                             "memory leaves %" PRIu64
                             " bytes for it: more --gpu-memory, or a shorter --distance ao and "
                             "thickness",
                             options->subgrid_bytes * options->slots)
                  : 0;
}

int bake_plan_passes(struct bsq_ctx *ctx, const struct bake_plan_options *options,
                     struct bake_plan *out)
{
    struct planner p = {
        .ctx = ctx, .options = options, .plan = out, .subgrid_bytes = options->subgrid_bytes};
    *out = (struct bake_plan){0};
    int status = check_reach(ctx, options);
    if (status == 0)
        status = allocate(&p);
    if (status == 0)
        status = order_tiles(&p);
    if (status == 0) {
        const struct bsq_pipeline pipeline = {.produce = next_tile,
                                              .work = find_nodes,
                                              .emit = place_tile,
                                              .arg = &p,
                                              .slots = p.slots,
                                              .slot_size = sizeof *p.slots,
                                              .slot_count = p.slot_count};
        bsq_progress_begin(ctx, "planning", "tiles", bake_raster_tile_count(options->raster));
        status = bsq_pipeline_run(ctx, &pipeline);
        bsq_progress_end(ctx);
    }
    if (status == 0 && p.subgrid_bytes > options->subgrid_bytes)
        status = fail_too_small(&p);
    if (status == 0)
        status = end_pass(&p);
    release(&p);
    return status;
}

void bake_plan_free(struct bsq_ctx *ctx, struct bake_plan *plan)
{
    for (uint64_t i = 0; i < plan->pass_count; i++)
        bake_subgrid_free(ctx, &plan->passes[i].subgrid);
    bsq_free(ctx, plan->passes);
    bsq_free(ctx, plan->pieces);
    *plan = (struct bake_plan){0};
}
