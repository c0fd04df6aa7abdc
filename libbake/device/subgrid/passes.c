/* passes.c - fills passes with patches while the nodes that these need fit the device.
 *
 * All threads find the nodes of patches; then patch after patch is added to a pass. Patches come in
 * Z-order (Morton 1966) of their nodes in space: charts that are neighbours in the map rarely are
 * neighbours on the surface. */
#include <inttypes.h>
#include <pthread.h>

#include "base/parallel.h"
#include "base/sort_array.h"
#include "base/space_curve.h"
#include "libbake/device/subgrid/subgrid.h"
#include "libbake/kernel/bk_grid.h"
#include "libbake/raster/raster.h"

enum { STACK = 64 /* a patch is halved at most once for each bit of its sides */ };

/* The nodes that the rays of a patch look up: a range of planner.lowers. */
struct patch_nodes {
    uint64_t key;
    uint32_t patch;
    uint64_t first, count;
};

struct planner {
    struct bsq_ctx *ctx;
    const struct bake_plan_options *options;
    const struct fmt_nvdb_grid *grid;
    struct bake_plan *plan;
    /* Of each worker. The serial step uses those of worker 0 again. */
    uint32_t **samples;
    struct bake_lower_set *sets;
    unsigned workers;
    pthread_mutex_t lock; /* protects `lowers` */
    uint32_t *lowers;
    uint64_t lower_count, lower_capacity;
    uint64_t *keys; /* of each lower node of the grid */
    struct patch_nodes *patches;
    uint32_t patch_count;
    struct bake_lower_set pass; /* nodes of the pass that is being filled */
    struct bake_subgrid_counts counts;
    uint64_t first_piece; /* of that pass */
    /* Limits of a subgrid. After a texel did not fit, the need of the largest one so far: planning
     * goes on only to tell how much memory is needed. */
    uint64_t subgrid_bytes, largest_array;
};

/* Bytes of a subgrid. */
struct need {
    uint64_t total, largest; /* array */
};

/* ---- passes ---- */

/* Counts an empty subgrid, which has the value of the background. */
static struct bake_subgrid_counts no_nodes(void)
{
    return (struct bake_subgrid_counts){.values = 1};
}

/* Adds the nodes that the pass lacks to its counts. Returns whether it still fits the device. */
static bool fits(const struct planner *p, const uint32_t *lowers, uint64_t count,
                 struct bake_subgrid_counts *counts, struct need *need)
{
    uint64_t bytes[BAKE_SUBGRID_ARRAYS];
    *counts = p->counts;
    for (uint64_t i = 0; i < count; i++)
        if (!p->pass.has[lowers[i]])
            bake_subgrid_count(p->grid, lowers[i], counts);
    bake_subgrid_sizes(p->grid, counts, bytes);
    need->total = bake_subgrid_total(bytes, &need->largest);
    return need->total <= p->subgrid_bytes && need->largest <= p->largest_array;
}

static int end_pass(struct planner *p)
{
    struct bake_plan *plan = p->plan;
    int status = 0;
    if (plan->piece_count == p->first_piece)
        return 0;
    BSQ_TRY(bsq_grow(p->ctx, "passes", plan->pass_count + 1, sizeof *plan->passes, &plan->passes,
                     &plan->pass_capacity));
    struct bake_pass *pass = &plan->passes[plan->pass_count++];
    *pass = (struct bake_pass){.first_piece = p->first_piece,
                               .piece_count = plan->piece_count - p->first_piece};
    status = bake_subgrid_create(p->ctx, &p->pass, &p->options->job->params, &pass->subgrid);
    p->first_piece = plan->piece_count;
    bake_lower_set_clear(&p->pass);
    p->counts = no_nodes();
done:
    return status;
}

/* Adds a piece to this pass or to a new one. *placed is false if it does not fit any; *need is that
 * of a pass with this piece. */
static int place(struct planner *p, uint32_t patch, const struct bake_rectangle *texels,
                 const uint32_t *lowers, uint64_t count, struct need *need, bool *placed)
{
    struct bake_plan *plan = p->plan;
    struct bake_subgrid_counts counts;
    int status = 0;
    *placed = fits(p, lowers, count, &counts, need);
    if (!*placed) {
        BSQ_TRY(end_pass(p));
        *placed = fits(p, lowers, count, &counts, need);
    }
    if (!*placed)
        return 0;
    BSQ_TRY(bsq_grow(p->ctx, "pieces of the map", plan->piece_count + 1, sizeof *plan->pieces,
                     &plan->pieces, &plan->piece_capacity));
    for (uint64_t i = 0; i < count; i++)
        BSQ_TRY(bake_lower_set_add(p->ctx, &p->pass, lowers[i]));
    plan->pieces[plan->piece_count++] = (struct bake_piece){patch, *texels};
    p->counts = counts;
done:
    return status;
}

/* Divides a rectangle of more than one texel across its longer side. */
static void halve(const struct bake_rectangle *whole, struct bake_rectangle halves[2])
{
    halves[0] = halves[1] = *whole;
    if (whole->width >= whole->height) {
        halves[0].width /= 2;
        halves[1].x += halves[0].width;
        halves[1].width -= halves[0].width;
    } else {
        halves[0].height /= 2;
        halves[1].y += halves[0].height;
        halves[1].height -= halves[0].height;
    }
}

/* Halves a patch that does not fit a pass until its pieces do. Notes what a single texel needs that
 * does not fit. */
static int place_split(struct planner *p, uint32_t index)
{
    const struct bk_patch patch = bake_raster_patch(p->options->raster, index);
    struct bake_lower_set *set = &p->sets[0];
    struct bake_rectangle stack[STACK] = {{0, 0, patch.width, patch.height}};
    struct need need;
    uint64_t overlaps;
    unsigned depth = 1;
    int status;
    BSQ_TRY(bake_raster_fill(p->options->raster, index, p->samples[0], &overlaps));
    while (depth > 0) {
        const struct bake_rectangle whole = stack[--depth];
        struct bake_rectangle halves[2];
        bool placed;
        bake_lower_set_clear(set);
        BSQ_TRY(
            bake_lower_set_add_rays(p->ctx, set, p->options->job, &patch, p->samples[0], &whole));
        BSQ_TRY(place(p, index, &whole, set->lowers, set->count, &need, &placed));
        if (!placed && whole.width == 1 && whole.height == 1) {
            p->subgrid_bytes = need.total > p->subgrid_bytes ? need.total : p->subgrid_bytes;
            p->largest_array = need.largest > p->largest_array ? need.largest : p->largest_array;
        } else if (!placed) {
            halve(&whole, halves);
            stack[depth++] = halves[1];
            stack[depth++] = halves[0];
        }
    }
done:
    return status;
}

/* ---- nodes of patches ---- */

/* Notes the Morton key of a lower node. */
static int note_key(void *arg, uint32_t lower, const int32_t origin[3])
{
    const struct planner *p = arg;
    uint32_t cell[3];
    for (int k = 0; k < 3; k++)
        cell[2 - k] = ((uint32_t)origin[k] - (uint32_t)p->grid->index_min[k]) >> BK_LOWER_LOG2;
    p->keys[lower] = bsq_morton_key(cell);
    return 0;
}

/* Appends the nodes of a patch to the list of all. The patch has the key of its first node. */
static int note_nodes(struct planner *p, struct patch_nodes *patch,
                      const struct bake_lower_set *set)
{
    int status = 0;
    pthread_mutex_lock(&p->lock);
    BSQ_TRY(bsq_grow(p->ctx, "nodes of patches", p->lower_count + set->count, sizeof *p->lowers,
                     &p->lowers, &p->lower_capacity));
    patch->first = p->lower_count;
    patch->count = set->count;
    patch->key = UINT64_MAX;
    for (uint64_t i = 0; i < set->count; i++) {
        const uint64_t key = p->keys[set->lowers[i]];
        patch->key = key < patch->key ? key : patch->key;
        p->lowers[p->lower_count++] = set->lowers[i];
    }
done:
    pthread_mutex_unlock(&p->lock);
    return status;
}

static int find_nodes(void *arg, uint64_t index, unsigned worker)
{
    struct planner *p = arg;
    const struct bk_patch patch = bake_raster_patch(p->options->raster, (uint32_t)index);
    const struct bake_rectangle all = {0, 0, patch.width, patch.height};
    struct bake_lower_set *set = &p->sets[worker];
    uint64_t overlaps;
    int status;
    p->patches[index].patch = (uint32_t)index;
    bake_lower_set_clear(set);
    BSQ_TRY(bake_raster_fill(p->options->raster, (uint32_t)index, p->samples[worker], &overlaps));
    BSQ_TRY(
        bake_lower_set_add_rays(p->ctx, set, p->options->job, &patch, p->samples[worker], &all));
    status = note_nodes(p, &p->patches[index], set);
    bsq_progress_add(p->ctx, 1);
done:
    return status;
}

static int by_key(const void *a, const void *b)
{
    const struct patch_nodes *x = a, *y = b;
    if (x->key != y->key)
        return x->key < y->key ? -1 : 1;
    return (x->patch > y->patch) - (x->patch < y->patch);
}

/* ---- planning ---- */

static int allocate(struct planner *p)
{
    const struct bake_job *job = p->options->job;
    const uint64_t samples = job->patch_texels * bake_raster_texel_entries(&job->params);
    int status;
    p->workers = bsq_threads(p->ctx);
    BSQ_TRY(bsq_calloc(p->ctx, "planning", p->workers, sizeof *p->samples, &p->samples));
    BSQ_TRY(bsq_calloc(p->ctx, "planning", p->workers, sizeof *p->sets, &p->sets));
    for (unsigned i = 0; i < p->workers; i++) {
        BSQ_TRY(bake_lower_set_create(p->ctx, p->grid, &p->sets[i]));
        BSQ_TRY(
            bsq_alloc(p->ctx, "samples of a patch", samples, sizeof **p->samples, &p->samples[i]));
    }
    BSQ_TRY(bsq_calloc(p->ctx, "planning", p->grid->lower_count, sizeof *p->keys, &p->keys));
    BSQ_TRY(bsq_calloc(p->ctx, "planning", p->patch_count, sizeof *p->patches, &p->patches));
    status = bake_lower_set_create(p->ctx, p->grid, &p->pass);
done:
    return status;
}

static void release(struct planner *p)
{
    for (unsigned i = 0; p->samples && i < p->workers; i++)
        bsq_free(p->ctx, p->samples[i]);
    for (unsigned i = 0; p->sets && i < p->workers; i++)
        bake_lower_set_free(p->ctx, &p->sets[i]);
    bake_lower_set_free(p->ctx, &p->pass);
    bsq_free(p->ctx, p->samples);
    bsq_free(p->ctx, p->sets);
    bsq_free(p->ctx, p->keys);
    bsq_free(p->ctx, p->lowers);
    bsq_free(p->ctx, p->patches);
    pthread_mutex_destroy(&p->lock);
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

/* Fails if a texel did not fit. */
static int check_texels(const struct planner *p)
{
    const struct bake_plan_options *options = p->options;
    if (p->largest_array > options->buffer_bytes)
        return bsq_fail(
            p->ctx, BSQ_ENODEVICE,
            "a buffer of the device holds %" PRIu64
            " bytes, the part of the grid that a texel's rays reach needs one of %" PRIu64,
            options->buffer_bytes, p->largest_array);
    if (p->subgrid_bytes > options->subgrid_bytes)
        return bsq_fail(p->ctx, BSQ_ENODEVICE,
                        "the device's memory leaves %" PRIu64
                        " bytes for a part of the grid, a texel's rays reach %" PRIu64
                        ": at least --gpu-memory %" PRIu64 ", or shorter rays",
                        options->subgrid_bytes, p->subgrid_bytes,
                        options->other_bytes + options->slots * p->subgrid_bytes);
    return 0;
}

static int place_patch(struct planner *p, const struct patch_nodes *nodes)
{
    const struct bk_patch patch = bake_raster_patch(p->options->raster, nodes->patch);
    const struct bake_rectangle all = {0, 0, patch.width, patch.height};
    struct need need;
    bool placed;
    int status =
        place(p, nodes->patch, &all, p->lowers + nodes->first, nodes->count, &need, &placed);
    return status == 0 && !placed ? place_split(p, nodes->patch) : status;
}

int bake_plan_passes(struct bsq_ctx *ctx, const struct bake_plan_options *options,
                     struct bake_plan *out)
{
    struct planner p = {.ctx = ctx,
                        .options = options,
                        .grid = options->job->grid,
                        .plan = out,
                        .lock = PTHREAD_MUTEX_INITIALIZER,
                        .patch_count = bake_raster_patch_count(options->raster),
                        .counts = no_nodes(),
                        .subgrid_bytes = options->subgrid_bytes,
                        .largest_array = options->buffer_bytes};
    int status;
    *out = (struct bake_plan){0};
    BSQ_TRY(check_reach(ctx, options));
    BSQ_TRY(allocate(&p));
    (void)bake_visit_nodes(p.grid, p.grid->index_min, p.grid->index_max, note_key, &p);
    bsq_progress_begin(ctx, "planning", "patches", p.patch_count);
    status = bsq_parallel_for(ctx, p.patch_count, find_nodes, &p);
    bsq_progress_end(ctx);
    if (status < 0)
        goto done;
    bsq_sort(p.patches, p.patch_count, sizeof *p.patches, by_key);
    for (uint32_t i = 0; i < p.patch_count; i++)
        BSQ_TRY(place_patch(&p, &p.patches[i]));
    BSQ_TRY(check_texels(&p));
    status = end_pass(&p);
done:
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
