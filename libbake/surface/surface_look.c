/* surface_look.c - traces secondary rays against one of several scans. */
#include "base/parallel.h"
#include "libbake/kernel/bk_secondary.h"
#include "libbake/secondary/secondary.h"
#include "libbake/surface/surface.h"

enum { PLACES_A_TASK = 64 };

struct look {
    const struct bake_surface *surface;
    const struct bk_params *params;
    const struct bake_places *places;
    struct bake_ray_states *states;
};

static int trace_task(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    const struct look *look = arg;
    const struct bake_places *places = look->places;
    const uint64_t begin = task * PLACES_A_TASK, left = places->count - begin;
    const uint64_t end = begin + (left < PLACES_A_TASK ? left : PLACES_A_TASK);
    const double each = (double)places->progress / (double)places->count;
    bake_trace_places(&look->surface->grid, look->params, places, begin, end, look->states);
    bsq_progress_add(look->surface->ctx,
                     (uint64_t)(each * (double)end) - (uint64_t)(each * (double)begin));
    return 0;
}

static int look_exact(const struct look *look, uint64_t *chunk_loads)
{
    struct bake_exact_look *exact;
    int status = bake_exact_look_create(look->surface->exact, look->params, 0, &exact);
    if (status < 0)
        return status;
    status = bake_exact_look_from(exact, look->places, look->states);
    *chunk_loads += bake_exact_look_loads(exact);
    bake_exact_look_free(exact);
    return status;
}

int bake_surface_look(const struct bake_surface *surface, const struct bk_params *params,
                      const struct bake_places *places, struct bake_ray_states *states,
                      uint64_t *chunk_loads)
{
    struct look look = {surface, params, places, states};
    if (surface->exact)
        return look_exact(&look, chunk_loads);
    int status = bsq_parallel_for(surface->ctx, (places->count + PLACES_A_TASK - 1) / PLACES_A_TASK,
                                  trace_task, &look);
    return status < 0 ? status : bake_surface_check(surface);
}

/* Positions of hits on triangles were rounded again, so they get four times the distance. */
double bake_surface_lift(const struct bake_surface *surface)
{
    return surface->exact ? 4 * (double)bake_exact_lift(surface->exact)
                          : (double)BK_LIFT * surface->unit;
}
