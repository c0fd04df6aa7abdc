/* exact_look.c - traces rays from hits out of core.
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

enum { BLOCK = 64 /* places that a thread traces at a time */ };

struct bake_exact_look {
    struct bake_exact *exact;
    const struct bk_params *params;
    uint32_t opens, solids; /* rays of a place */
    float lift;             /* start of open rays above the triangle */
    struct exact_slots memory;
    struct exact_group group; /* the chunks in memory */
    uint32_t loaded;          /* of them */
    bool whole;               /* they are all of the scan's */
    struct exact_box *boxes;  /* of the slots' chunks */
    void *tree_memory, *tree_scratch;
    uint32_t *reached; /* chunks that the current batch can reach */
    /* The state of the rays of a batch of `capacity` places. */
    uint64_t capacity, words; /* words: of hidden[], for a place */
    uint32_t lengths;         /* of distances[], for a place */
    uint64_t *hidden;         /* a bit for each open ray */
    float *distances;         /* of nearest hits: open rays if they fall off, rays into the solid */
    uint64_t loads;
};

/* What a batch has in common. */
struct pass {
    struct bake_exact_look *look;
    const struct bake_exact_places *places;
    struct bk_surroundings *out;
    uint64_t first, count; /* of the places */
    uint64_t steps, step;  /* of the progress: groups of the batch; those before this one */
};

/* ---- rays ---- */

static bool falls_off(const struct bake_exact_look *look)
{
    return look->params->flags & BK_OPEN_FALLOFF;
}

/* Returns ray `number` of a place: an open one, or one into the solid. */
static struct bake_exact_ray ray_of(const struct bake_exact_look *look,
                                    const struct bake_exact_places *places, uint64_t place,
                                    bool open, uint32_t number)
{
    const struct bake_exact_ray *from = &places->rays[place];
    const struct bake_exact_hit *hit = &places->hits[place];
    const float side = open ? 1.0f : -1.0f, lift = open ? look->lift : 0.0f;
    const bk_vec3 n = bk_v3(side * hit->normal[0], side * hit->normal[1], side * hit->normal[2]);
    const bk_vec3 facet = bk_v3(side * hit->facet[0], side * hit->facet[1], side * hit->facet[2]);
    const bk_uint seed = places->seeds[place] ^ (open ? 0u : BK_SOLID_SEED);
    const bk_vec3w cone = bk_cone_directions(seed, number, open ? look->opens : look->solids,
                                             open ? look->params->open_sine2 : 1.0f);
    const bk_vec3w around = bk_around(cone, n);
    bk_vec3 d = bk_lane3(&around, 0);
    const float above = bk_dot(d, facet);
    struct bake_exact_ray ray;
    if (above < 0.0f)
        d = bk_add_scaled(d, -2.0f * above, facet);
    for (int k = 0; k < 3; k++)
        ray.origin[k] = (float)((double)from->origin[k] + hit->t * (double)from->direction[k] +
                                (double)lift * (double)hit->facet[k]);
    ray.direction[0] = d.x;
    ray.direction[1] = d.y;
    ray.direction[2] = d.z;
    return ray;
}

struct bake_exact_ray bake_exact_open_ray(const struct bake_exact_look *look,
                                          const struct bake_exact_places *places, uint64_t place,
                                          uint32_t number)
{
    return ray_of(look, places, place, true, number);
}

/* ---- tracing ---- */

/* Traces the open rays of a place that are not hidden yet. */
static void trace_open(const struct pass *pass, uint64_t place)
{
    const struct bake_exact_look *look = pass->look;
    uint64_t *hidden = look->hidden + (place - pass->first) * look->words;
    const struct exact_limits limits = {
        .t_max = (double)look->params->open_limit, .two_sided = true, .any = true};
    for (uint32_t i = 0; i < look->opens; i++) {
        struct exact_best best = {.triangle = BAKE_EXACT_NONE};
        if (hidden[i / 64] >> (i % 64) & 1)
            continue;
        const struct bake_exact_ray ray = ray_of(look, pass->places, place, true, i);
        const bool found = bake_exact_group_trace(&look->group, &ray, &limits, &best);
        hidden[i / 64] |= (uint64_t)found << (i % 64);
    }
}

/* Shortens the distances of `count` rays of a place to their nearest hits. */
static void trace_nearest(const struct pass *pass, uint64_t place, bool open, uint32_t count,
                          float *distances)
{
    const struct bake_exact_look *look = pass->look;
    struct exact_limits limits = {.two_sided = open,
                                  .facing_origin = pass->places->hits[place].reversed};
    for (uint32_t i = 0; i < count; i++) {
        struct exact_best best = {.triangle = BAKE_EXACT_NONE};
        const struct bake_exact_ray ray = ray_of(look, pass->places, place, open, i);
        const float most = open ? look->params->open_limit : look->params->thickness_limit;
        limits.t_max = (double)fminf(distances[i], most);
        if (bake_exact_group_trace(&look->group, &ray, &limits, &best))
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
    const struct bake_exact_look *look = pass->look;
    const uint64_t begin = index * BLOCK, left = pass->count - begin;
    const uint64_t end = begin + (left < BLOCK ? left : BLOCK);
    for (uint64_t i = begin; i < end; i++) {
        const uint64_t place = pass->first + i;
        float *distances = look->distances + i * look->lengths;
        if (pass->places->hits[place].triangle == BAKE_EXACT_NONE)
            continue;
        if (look->words > 0)
            trace_open(pass, place);
        else if (look->opens > 0)
            trace_nearest(pass, place, true, look->opens, distances);
        trace_nearest(pass, place, false, look->solids,
                      distances + (look->words > 0 ? 0 : look->opens));
    }
    add_progress(pass, begin, end);
    return 0;
}

/* ---- sums ---- */

/* Returns the t at which a ray leaves the bounds of the scan. */
static double leaving(const struct bake_exact *exact, const struct bake_exact_ray *ray)
{
    double t = INFINITY;
    for (int k = 0; k < 3; k++) {
        const double d = (double)ray->direction[k], o = (double)ray->origin[k];
        const double wall =
            (double)(d > 0 ? exact->header->bounds_max : exact->header->bounds_min)[k];
        if (d != 0)
            t = fmin(t, (wall - o) / d);
    }
    return t;
}

static void sum_open(const struct pass *pass, uint64_t place, struct bk_surroundings *sums)
{
    const struct bake_exact_look *look = pass->look;
    const uint64_t i = place - pass->first;
    for (uint32_t r = 0; r < look->opens; r++) {
        const struct bake_exact_ray ray = ray_of(look, pass->places, place, true, r);
        const bk_vec3 d = bk_v3(ray.direction[0], ray.direction[1], ray.direction[2]);
        const float t = look->words > 0 ? 0.0f : look->distances[i * look->lengths + r];
        const bool found =
            look->words > 0 ? look->hidden[i * look->words + r / 64] >> (r % 64) & 1 : t < INFINITY;
        bk_add_open(look->params, found, t, d, sums);
    }
}

/* Returns how many rays count. */
static uint32_t sum_solid(const struct pass *pass, uint64_t place, struct bk_surroundings *sums)
{
    const struct bake_exact_look *look = pass->look;
    const float limit = look->params->thickness_limit;
    const float *distances = look->distances + (place - pass->first) * look->lengths +
                             (look->words > 0 ? 0 : look->opens);
    uint32_t counted = 0;
    for (uint32_t r = 0; r < look->solids; r++) {
        const struct bake_exact_ray ray = ray_of(look, pass->places, place, false, r);
        if (!(distances[r] < INFINITY) && leaving(look->exact, &ray) < (double)limit)
            continue;
        sums->thickness += fminf(distances[r], limit);
        counted++;
    }
    return counted;
}

static int sum_block(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct pass *pass = arg;
    const struct bake_exact_look *look = pass->look;
    const uint64_t begin = index * BLOCK, left = pass->count - begin;
    for (uint64_t i = begin; i < begin + (left < BLOCK ? left : BLOCK); i++) {
        const uint64_t place = pass->first + i;
        bk_surroundings sums = bk_no_surroundings();
        if (pass->places->hits[place].triangle != BAKE_EXACT_NONE) {
            sum_open(pass, place, &sums);
            bk_mean_surroundings(look->params, look->opens, sum_solid(pass, place, &sums), &sums);
        }
        pass->out[place] = sums;
    }
    return 0;
}

/* ---- chunks ---- */

/* Finds the chunks that rays from these places can reach. Returns their count. */
static uint32_t find_reached(const struct pass *pass)
{
    const struct bake_exact_look *look = pass->look;
    const float open = look->opens > 0 ? look->params->open_limit : 0.0f;
    const float solid = look->solids > 0 ? look->params->thickness_limit : 0.0f;
    /* Directions are unit vectors up to rounding. */
    const float far = 1.001f * fmaxf(open, solid) + 2.0f * look->lift;
    struct exact_box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    for (uint64_t i = pass->first; i < pass->first + pass->count; i++) {
        const struct bake_exact_ray *ray = &pass->places->rays[i];
        const struct bake_exact_hit *hit = &pass->places->hits[i];
        for (int k = 0; hit->triangle != BAKE_EXACT_NONE && k < 3; k++) {
            const float p = (float)((double)ray->origin[k] + hit->t * (double)ray->direction[k]);
            box.low[k] = fminf(box.low[k], p - far);
            box.high[k] = fmaxf(box.high[k], p + far);
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

static int trace_places(struct pass *pass)
{
    struct bake_exact_look *look = pass->look;
    const uint32_t slots = look->memory.count;
    uint32_t count = look->exact->chunk_count;
    int status = 0;
    memset(look->hidden, 0, pass->count * look->words * sizeof *look->hidden);
    for (uint64_t i = 0; i < pass->count * look->lengths; i++)
        look->distances[i] = INFINITY;
    if (look->whole)
        for (uint32_t c = 0; c < count; c++)
            look->reached[c] = c;
    else
        count = find_reached(pass);
    pass->step = 0;
    pass->steps = (count + slots - 1) / slots;
    for (uint32_t c = 0; c < count && status == 0; c += slots)
        status = trace_group(pass, look->reached + c, count - c < slots ? count - c : slots);
    return status == 0 ? bsq_parallel_for(look->exact->ctx, (pass->count + BLOCK - 1) / BLOCK,
                                          sum_block, pass)
                       : status;
}

int bake_exact_look_around(struct bake_exact_look *look, const struct bake_exact_places *places,
                           struct bk_surroundings *out)
{
    int status = 0;
    for (uint64_t at = 0; at < places->count && status == 0; at += look->capacity) {
        const uint64_t left = places->count - at;
        struct pass pass = {.look = look,
                            .places = places,
                            .out = out,
                            .first = at,
                            .count = left < look->capacity ? left : look->capacity};
        status = trace_places(&pass);
    }
    return status;
}

uint64_t bake_exact_look_loads(const struct bake_exact_look *look)
{
    return look->loads;
}

/* ---- memory ---- */

/* Returns the distance above a triangle that exceeds the rounding errors of a hit's position. Each
 * coordinate is off by at most 2^-24 of its value, so a position by sqrt(3) times that. */
static float lift_of(const struct bake_exact *exact)
{
    double most = 0;
    for (int k = 0; k < 3; k++)
        most = fmax(most, fmax(fabs((double)exact->header->bounds_min[k]),
                               fabs((double)exact->header->bounds_max[k])));
    return (float)(most * 0x1p-22);
}

/* Chooses how much of its state a place has, and how many places fit `memory` bytes. */
static void plan_states(struct bake_exact_look *look, uint64_t places, uint64_t memory)
{
    look->opens = bk_open_rays(look->params);
    look->solids = bk_solid_rays(look->params);
    look->words = falls_off(look) ? 0 : (look->opens + 63) / 64;
    look->lengths = look->solids + (falls_off(look) ? look->opens : 0);
    const uint64_t bytes =
        look->words * sizeof *look->hidden + look->lengths * sizeof *look->distances;
    look->capacity = bytes == 0 || places < memory / bytes ? places : memory / bytes;
    look->capacity = look->capacity < 1 ? 1 : look->capacity;
}

static int allocate_states(struct bake_exact_look *look)
{
    struct bsq_ctx *ctx = look->exact->ctx;
    int status = bsq_alloc(ctx, "rays from hits", look->capacity * look->words + 1,
                           sizeof *look->hidden, &look->hidden);
    if (status == 0)
        status = bsq_alloc(ctx, "rays from hits", look->capacity * look->lengths + 1,
                           sizeof *look->distances, &look->distances);
    return status;
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
    const uint64_t left = bsq_memory_left(ctx);
    struct bake_exact_look *look;
    *out = NULL;
    int status = bsq_calloc(ctx, "rays from hits", 1, sizeof *look, &look);
    if (status < 0)
        return status;
    look->exact = exact;
    look->params = params;
    look->lift = lift_of(exact);
    plan_states(look, places, left / 8);
    status = allocate_states(look);
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
    bsq_free(ctx, look->hidden);
    bsq_free(ctx, look->distances);
    bsq_free(ctx, look);
}
