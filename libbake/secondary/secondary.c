/* secondary.c - see secondary.h. */
#include "libbake/secondary/secondary.h"

#include <math.h>
#include <string.h>

#include "libbake/kernel/bk_secondary.h"

/* ---- rays ---- */

static bk_vec3 vector(const float v[3])
{
    return bk_v3(v[0], v[1], v[2]);
}

void bake_place_ray(const struct bk_params *params, const struct bake_place *place, bool open,
                    uint32_t number, float origin[3], float direction[3])
{
    const float side = open ? 1.0f : -1.0f;
    const bk_vec3w around = bk_hemisphere(
        place->seed ^ (open ? 0u : BK_SOLID_SEED), bk_scale(vector(place->normal), side),
        bk_scale(vector(place->facet), side), number,
        open ? bk_open_rays(params) : bk_solid_rays(params), open ? params->open_sine2 : 1.0f);
    const bk_vec3 d = bk_lane3(&around, 0);
    memcpy(origin, open ? place->open_from : place->solid_from, 3 * sizeof *origin);
    direction[0] = d.x;
    direction[1] = d.y;
    direction[2] = d.z;
}

/* ---- states ---- */

/* Sets how much of its state a place has. */
static struct bake_ray_states plan(const struct bk_params *params)
{
    const bool falls_off = params->flags & BK_OPEN_FALLOFF;
    struct bake_ray_states states = {.opens = bk_open_rays(params),
                                     .solids = bk_solid_rays(params)};
    states.words = falls_off ? 0 : (states.opens + 63) / 64;
    states.lengths = states.solids + (falls_off ? states.opens : 0);
    return states;
}

uint64_t bake_ray_state_bytes(const struct bk_params *params)
{
    const struct bake_ray_states states = plan(params);
    return states.words * sizeof *states.hidden + states.lengths * sizeof *states.distances;
}

int bake_ray_states_create(struct bsq_ctx *ctx, const struct bk_params *params, uint64_t capacity,
                           struct bake_ray_states *out)
{
    *out = plan(params);
    out->capacity = capacity;
    int status = bsq_alloc(ctx, "secondary rays", capacity * out->words + 1, sizeof *out->hidden,
                           &out->hidden);
    if (status == 0)
        status = bsq_alloc(ctx, "secondary rays", capacity * out->lengths + 1,
                           sizeof *out->distances, &out->distances);
    return status;
}

void bake_ray_states_free(struct bsq_ctx *ctx, struct bake_ray_states *states)
{
    bsq_free(ctx, states->hidden);
    bsq_free(ctx, states->distances);
    states->hidden = NULL;
    states->distances = NULL;
}

void bake_ray_states_clear(struct bake_ray_states *states, uint64_t count)
{
    memset(states->hidden, 0, count * states->words * sizeof *states->hidden);
    for (uint64_t i = 0; i < count * states->lengths; i++)
        states->distances[i] = INFINITY;
}

/* ---- sums ---- */

static void sum_open(const struct bake_ray_states *states, const struct bk_params *params,
                     const struct bake_place *place, uint64_t index, struct bk_surroundings *sums)
{
    const uint64_t *hidden = bake_hidden_rays(states, index);
    const float *distances = bake_ray_distances(states, index, true);
    for (uint32_t r = 0; r < states->opens; r++) {
        float origin[3], direction[3];
        const float t = states->words > 0 ? 0.0f : distances[r];
        const bool found = states->words > 0 ? hidden[r / 64] >> (r % 64) & 1 : t < INFINITY;
        bake_place_ray(params, place, true, r, origin, direction);
        bk_add_open(params, found, t, vector(direction), sums);
    }
}

/* Returns the t at which a ray from inside the bounds leaves them. */
static double leaving(const float origin[3], const float direction[3], const double low[3],
                      const double high[3])
{
    double t = INFINITY;
    for (int k = 0; k < 3; k++)
        if (direction[k] != 0.0f)
            t = fmin(t, ((direction[k] > 0 ? high : low)[k] - (double)origin[k]) /
                            (double)direction[k]);
    return t;
}

/* Returns how many rays count. */
static uint32_t sum_solid(const struct bake_ray_states *states, const struct bk_params *params,
                          const struct bake_place *place, uint64_t index, const double low[3],
                          const double high[3], struct bk_surroundings *sums)
{
    const float limit = params->thickness_limit;
    const float *distances = bake_ray_distances(states, index, false);
    uint32_t counted = 0;
    for (uint32_t r = 0; r < states->solids; r++) {
        float origin[3], direction[3];
        bake_place_ray(params, place, false, r, origin, direction);
        if (!(distances[r] < INFINITY) && leaving(origin, direction, low, high) < (double)limit)
            continue;
        sums->thickness += fminf(distances[r], limit);
        counted++;
    }
    return counted;
}

struct bk_surroundings bake_sum_rays(const struct bake_ray_states *states,
                                     const struct bk_params *params, const struct bake_place *place,
                                     uint64_t index, const double low[3], const double high[3])
{
    struct bk_surroundings sums = bk_no_surroundings();
    sum_open(states, params, place, index, &sums);
    const uint32_t counted = sum_solid(states, params, place, index, low, high, &sums);
    bk_mean_surroundings(params, states->opens, counted, &sums);
    return sums;
}
