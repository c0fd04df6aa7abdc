/* exact_look.c - traces secondary rays out of core.
 *
 * A hemisphere reaches chunks everywhere. So chunks pass through memory in groups, as many at a
 * time as fit, and each group is traced by all rays that still need it. Between groups, a ray is
 * only its state: a bit if any hit will do, a distance if the nearest counts. The ray itself is
 * computed again. So a batch has millions of rays and loads each chunk once; and a scan that fits
 * into memory is loaded once for all batches. Chunks out of reach of a batch are not loaded.
 *
 * Rays are those of bk_secondary.h, with two differences. Triangles have no planes that disagree,
 * so open rays start above the triangle by no more than rounding errors. And normals are
 * interpolated, so some of the directions around them point through the triangle of the hit; these
 * are mirrored at it. So a convex body is open everywhere. */
#include "libbake/exact/exact_scene.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "libbake/kernel/bk_secondary.h"
#include "libbake/secondary/secondary.h"

enum { BLOCK = 64 /* places that a thread traces at a time */ };

struct bake_exact_look {
    struct bake_exact *exact;
    const struct bk_params *params;
    float lift; /* start of open rays above the triangle */
    struct exact_slots memory;
    struct exact_group group; /* the chunks in memory */
    uint32_t loaded;          /* of them */
    bool whole;               /* they are all of the scan's */
    struct exact_box *boxes;  /* of the slots' chunks */
    void *tree_memory, *tree_scratch;
    uint32_t *reached;             /* chunks that the current batch can reach */
    struct bake_ray_states states; /* of a batch of bake_exact_look_around() */
    uint64_t loads;
};

/* What a batch has in common. */
struct pass {
    struct bake_exact_look *look;
    const struct bake_places *places;
    struct bake_ray_states *states; /* of the batch's places */
    struct bk_surroundings *out;    /* of all places */
    uint64_t first, count;          /* of the batch's places */
    uint64_t steps, step; /* of the progress: groups of the batch; those before this one */
};

/* ---- places ---- */

/* Hits, and who looks around from them. */
struct hit_places {
    const struct bake_exact_look *look;
    const struct bake_exact_places *hits;
};

static bool get_place(const void *arg, uint64_t index, struct bake_place *out)
{
    const struct hit_places *from = arg;
    const struct bake_exact_ray *ray = &from->hits->rays[index];
    const struct bake_exact_hit *hit = &from->hits->hits[index];
    if (hit->triangle == BAKE_EXACT_NONE)
        return false;
    for (int k = 0; k < 3; k++) {
        const double p = (double)ray->origin[k] + hit->t * (double)ray->direction[k];
        out->solid_from[k] = (float)p;
        out->open_from[k] = (float)(p + (double)from->look->lift * (double)hit->facet[k]);
    }
    memcpy(out->normal, hit->normal, sizeof out->normal);
    memcpy(out->facet, hit->facet, sizeof out->facet);
    out->reversed = hit->reversed;
    out->seed = from->hits->seeds[index];
    return true;
}

static struct bake_exact_ray ray_of(const struct bake_exact_look *look,
                                    const struct bake_place *place, bool open, uint32_t number)
{
    struct bake_exact_ray ray = {0};
    bake_place_ray(look->params, place, open, number, ray.origin, ray.direction);
    return ray;
}

struct bake_exact_ray bake_exact_open_ray(const struct bake_exact_look *look,
                                          const struct bake_exact_places *places, uint64_t place,
                                          uint32_t number)
{
    const struct hit_places from = {look, places};
    struct bake_place at = {0};
    get_place(&from, place, &at);
    return ray_of(look, &at, true, number);
}

/* ---- tracing ---- */

/* Traces the open rays of a place that are not hidden yet. */
static void trace_open(const struct pass *pass, const struct bake_place *place, uint64_t *hidden)
{
    const struct bake_exact_look *look = pass->look;
    const struct exact_limits limits = {
        .t_max = (double)look->params->open_limit, .two_sided = true, .any = true};
    for (uint32_t i = 0; i < pass->states->opens; i++) {
        struct exact_best best = {.triangle = BAKE_EXACT_NONE};
        if (hidden[i / 64] >> (i % 64) & 1)
            continue;
        const struct bake_exact_ray ray = ray_of(look, place, true, i);
        const bool found = BSQ_SIMD_PICK(look->exact->simd, bake_exact_group_trace)(
            &look->group, &ray, &limits, &best);
        hidden[i / 64] |= (uint64_t)found << (i % 64);
    }
}

/* Shortens the distances of `count` rays of a place to their nearest hits. */
static void trace_nearest(const struct pass *pass, const struct bake_place *place, bool open,
                          uint32_t count, float *distances)
{
    const struct bake_exact_look *look = pass->look;
    struct exact_limits limits = {.two_sided = open, .facing_origin = place->reversed};
    for (uint32_t i = 0; i < count; i++) {
        struct exact_best best = {.triangle = BAKE_EXACT_NONE};
        const struct bake_exact_ray ray = ray_of(look, place, open, i);
        const float most = open ? look->params->open_limit : look->params->thickness_limit;
        limits.t_max = (double)fminf(distances[i], most);
        if (BSQ_SIMD_PICK(look->exact->simd, bake_exact_group_trace)(&look->group, &ray, &limits,
                                                                     &best))
            distances[i] = fminf(distances[i], (float)best.t);
    }
}

/* Spreads the progress of the places evenly over blocks and groups. */
static void add_progress(const struct pass *pass, uint64_t begin, uint64_t end)
{
    const double each = (double)pass->places->progress / (double)pass->places->count;
    const double rays = (double)pass->count / (double)pass->steps;
    const double before = (double)pass->first + rays * (double)pass->step;
    const double share = 1 / (double)pass->steps;
    bsq_progress_add(pass->look->exact->ctx,
                     (uint64_t)(each * (before + share * (double)end)) -
                         (uint64_t)(each * (before + share * (double)begin)));
}

static int trace_block(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct pass *pass = arg;
    const struct bake_ray_states *states = pass->states;
    const uint64_t begin = index * BLOCK, left = pass->count - begin;
    const uint64_t end = begin + (left < BLOCK ? left : BLOCK);
    for (uint64_t i = begin; i < end; i++) {
        struct bake_place place;
        if (!pass->places->get(pass->places->arg, pass->first + i, &place))
            continue;
        if (states->words > 0)
            trace_open(pass, &place, bake_hidden_rays(states, i));
        else if (states->opens > 0)
            trace_nearest(pass, &place, true, states->opens, bake_ray_distances(states, i, true));
        trace_nearest(pass, &place, false, states->solids, bake_ray_distances(states, i, false));
    }
    add_progress(pass, begin, end);
    return 0;
}

static int sum_block(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct pass *pass = arg;
    const struct fmt_tris_header *header = pass->look->exact->header;
    const uint64_t begin = index * BLOCK, left = pass->count - begin;
    double low[3], high[3];
    for (int k = 0; k < 3; k++) {
        low[k] = (double)header->bounds_min[k];
        high[k] = (double)header->bounds_max[k];
    }
    for (uint64_t i = begin; i < begin + (left < BLOCK ? left : BLOCK); i++) {
        struct bk_surroundings *out = &pass->out[pass->first + i];
        struct bake_place place;
        *out = bk_no_surroundings();
        if (pass->places->get(pass->places->arg, pass->first + i, &place))
            *out = bake_sum_rays(pass->states, pass->look->params, &place, i, low, high);
    }
    return 0;
}

/* ---- chunks ---- */

/* Finds the chunks that rays from these places can reach. Returns their count. */
static uint32_t find_reached(const struct pass *pass)
{
    const struct bake_exact_look *look = pass->look;
    const float open = pass->states->opens > 0 ? look->params->open_limit : 0.0f;
    const float solid = pass->states->solids > 0 ? look->params->thickness_limit : 0.0f;
    /* Directions are unit vectors up to rounding. */
    const float far = 1.001f * fmaxf(open, solid) + 2.0f * look->lift;
    struct exact_box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    for (uint64_t i = pass->first; i < pass->first + pass->count; i++) {
        struct bake_place place;
        if (!pass->places->get(pass->places->arg, i, &place))
            continue;
        for (int k = 0; k < 3; k++) {
            box.low[k] = fminf(box.low[k], fminf(place.open_from[k], place.solid_from[k]) - far);
            box.high[k] = fmaxf(box.high[k], fmaxf(place.open_from[k], place.solid_from[k]) + far);
        }
    }
    /* A box without end would overlap the tree's empty boxes. */
    for (int k = 0; k < 3; k++)
        box.low[k] = fmaxf(box.low[k], -FLT_MAX);
    return bake_exact_tree_overlapping(&look->exact->tree, &box, look->reached);
}

static int load_slot(void *arg, uint64_t index, unsigned worker)
{
    struct bake_exact_look *look = arg;
    struct exact_slot *slot = &look->memory.slots[index];
    const struct fmt_tris_chunk_info *chunk = &look->exact->chunks[slot->number];
    /* If there are fewer scratches than threads, there are as many as slots. */
    const bool one_each = look->memory.preparers < bsq_threads(look->exact->ctx);
    int status = bake_exact_slot_load(look->exact, slot->number, slot);
    if (status < 0)
        return status;
    bake_exact_slot_build(slot, &look->memory.scratches[one_each ? index : worker]);
    memcpy(look->boxes[index].low, chunk->bounds_min, sizeof look->boxes[index].low);
    memcpy(look->boxes[index].high, chunk->bounds_max, sizeof look->boxes[index].high);
    return 0;
}

/* Loads chunks into slots 0 to count - 1, and builds the tree over them. */
static int load_group(struct bake_exact_look *look, const uint32_t *chunks, uint32_t count)
{
    for (uint32_t s = 0; s < count; s++)
        look->memory.slots[s].number = chunks[s];
    look->loaded = 0;
    int status = bsq_parallel_for(look->exact->ctx, count, load_slot, look);
    if (status < 0)
        return status;
    look->loaded = count;
    look->loads += count;
    bake_exact_tree_build(&look->group.tree, count, look->boxes, look->tree_memory,
                          look->tree_scratch);
    return 0;
}

static int trace_group(struct pass *pass, const uint32_t *chunks, uint32_t count)
{
    struct bake_exact_look *look = pass->look;
    int status = 0;
    if (!look->whole || look->loaded == 0)
        status = load_group(look, chunks, count);
    if (status == 0)
        status = bsq_parallel_for(look->exact->ctx, (pass->count + BLOCK - 1) / BLOCK, trace_block,
                                  pass);
    pass->step++;
    return status;
}

/* Traces the rays of a batch through all chunks that they can reach. */
static int trace_places(struct pass *pass)
{
    struct bake_exact_look *look = pass->look;
    const uint32_t slots = look->memory.count;
    uint32_t count = look->exact->chunk_count;
    int status = 0;
    if (look->whole)
        for (uint32_t c = 0; c < count; c++)
            look->reached[c] = c;
    else
        count = find_reached(pass);
    pass->step = 0;
    pass->steps = (count + slots - 1) / slots;
    for (uint32_t c = 0; c < count && status == 0; c += slots)
        status = trace_group(pass, look->reached + c, count - c < slots ? count - c : slots);
    return status;
}

int bake_exact_look_from(struct bake_exact_look *look, const struct bake_places *places,
                         struct bake_ray_states *states)
{
    struct pass pass = {.look = look, .places = places, .states = states, .count = places->count};
    return trace_places(&pass);
}

int bake_exact_look_around(struct bake_exact_look *look, const struct bake_exact_places *hits,
                           struct bk_surroundings *out)
{
    const struct hit_places from = {look, hits};
    const struct bake_places places = {.get = get_place,
                                       .arg = &from,
                                       .count = hits->count,
                                       .unit = 1,
                                       .progress = hits->progress};
    int status = 0;
    for (uint64_t at = 0; at < places.count && status == 0; at += look->states.capacity) {
        const uint64_t left = places.count - at;
        struct pass pass = {.look = look,
                            .places = &places,
                            .states = &look->states,
                            .out = out,
                            .first = at,
                            .count = left < look->states.capacity ? left : look->states.capacity};
        bake_ray_states_clear(pass.states, pass.count);
        status = trace_places(&pass);
        if (status == 0)
            status = bsq_parallel_for(look->exact->ctx, (pass.count + BLOCK - 1) / BLOCK, sum_block,
                                      &pass);
    }
    return status;
}

uint64_t bake_exact_look_loads(const struct bake_exact_look *look)
{
    return look->loads;
}

/* ---- memory ---- */

/* Each coordinate of a hit is off by at most 2^-24 of its value, so a position by sqrt(3) times
 * that. */
float bake_exact_lift(const struct bake_exact *exact)
{
    double most = 0;
    for (int k = 0; k < 3; k++)
        most = fmax(most, fmax(fabs((double)exact->header->bounds_min[k]),
                               fabs((double)exact->header->bounds_max[k])));
    return (float)(most * 0x1p-22);
}

/* Returns how many places fit `memory` bytes. */
static uint64_t choose_capacity(const struct bk_params *params, uint64_t places, uint64_t memory)
{
    const uint64_t bytes = bake_ray_state_bytes(params);
    const uint64_t capacity = bytes == 0 || places < memory / bytes ? places : memory / bytes;
    return capacity < 1 ? 1 : capacity;
}

static int allocate_tree(struct bake_exact_look *look)
{
    struct bsq_ctx *ctx = look->exact->ctx;
    const uint32_t slots = look->memory.count;
    int status =
        bsq_alloc(ctx, "tree of chunks", bake_exact_tree_bytes(slots), 1, &look->tree_memory);
    if (status == 0)
        status = bsq_alloc(ctx, "tree of chunks", bake_exact_tree_scratch_bytes(slots), 1,
                           &look->tree_scratch);
    if (status == 0)
        status = bsq_alloc(ctx, "tree of chunks", slots, sizeof *look->boxes, &look->boxes);
    if (status == 0)
        status = bsq_alloc(ctx, "chunks near rays", look->exact->chunk_count, sizeof *look->reached,
                           &look->reached);
    return status;
}

int bake_exact_look_create(struct bake_exact *exact, const struct bk_params *params,
                           uint64_t places, struct bake_exact_look **out)
{
    struct bsq_ctx *ctx = exact->ctx;
    const uint64_t left = bsq_memory_share(ctx, "secondary rays of chunks", 1);
    struct bake_exact_look *look;
    *out = NULL;
    int status = bsq_calloc(ctx, "secondary rays", 1, sizeof *look, &look);
    if (status < 0)
        return status;
    look->exact = exact;
    look->params = params;
    look->lift = bake_exact_lift(exact);
    if (places > 0)
        status = bake_ray_states_create(ctx, params, choose_capacity(params, places, left / 8),
                                        &look->states);
    if (status == 0)
        status = bake_exact_slots_create(exact, exact->chunk_count, left / 3, &look->memory);
    if (status == 0)
        status = allocate_tree(look);
    look->group = (struct exact_group){.exact = exact, .slots = look->memory.slots};
    look->whole = look->memory.count == exact->chunk_count;
    if (status < 0)
        bake_exact_look_free(look);
    else
        *out = look;
    return status;
}

void bake_exact_look_free(struct bake_exact_look *look)
{
    if (!look)
        return;
    struct bsq_ctx *ctx = look->exact->ctx;
    bake_exact_slots_free(ctx, &look->memory);
    bsq_free(ctx, look->tree_memory);
    bsq_free(ctx, look->tree_scratch);
    bsq_free(ctx, look->boxes);
    bsq_free(ctx, look->reached);
    bake_ray_states_free(ctx, &look->states);
    bsq_free(ctx, look);
}
