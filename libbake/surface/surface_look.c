/* surface_look.c - rays from hits: ambient occlusion, bent normals and thickness.
 *
 * A wall of one scan hides the floor of another. So these rays start when the nearest hit of each
 * sample is known. They are traced through one scan after the other, and between scans a ray is
 * only a bit or a distance (libbake/secondary/). The rays are the same for all scans; in each, they
 * start as far above the surface as the coarser of the two scans needs. */
#include "libbake/surface/surface.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "libbake/kernel/bk_secondary.h"

enum { HITS_A_TASK = 64 };

struct bake_look {
    const struct bake_surface *surface;
    struct bk_params params; /* with lengths in world units */
    struct bake_ray_states states;
    struct bake_exact_look *kept; /* of the only scan, if that has triangles */
    uint64_t loads;
};

/* Hits as one of the scans sees them. */
struct view {
    struct bake_look *look;
    const struct bake_look_hits *hits;
    uint64_t first, count;       /* of the hits whose states are known */
    uint32_t scan;               /* the current one */
    struct bake_places places;   /* for the current scan */
    struct bk_surroundings *out; /* of all hits */
};

/* ---- places ---- */

/* Returns whether the ray of a hit sees a scan. */
static bool sees(const struct view *view, uint64_t index, uint32_t scan)
{
    const struct bake_surface *surface = view->look->surface;
    const uint32_t *objects = view->hits->objects;
    return !objects || surface->sees[(uint64_t)surface->scan_count * objects[index] + scan];
}

/* Returns the distance above a hit at which open rays start, so that a scan does not hide itself;
 * world units. Where rays were moved to the spaces of several scans, they were rounded again, so
 * triangles get four times the distance. */
static double lift_of(const struct bake_surface *surface, uint32_t scan)
{
    const struct bake_exact *exact = surface->scans[scan].exact;
    const double lift = exact ? (double)bake_exact_lift(exact) : 0;
    return exact ? (surface->scan_count > 1 ? 4 : 1) * lift
                 : (double)BK_LIFT * surface->scans[scan].unit;
}

/* Sets the place of a hit in a space given by its origin and its unit. */
static void set_place(const struct view *view, uint64_t index, const double translation[3],
                      double unit, double lift, struct bake_place *out)
{
    const struct bake_surface *surface = view->look->surface;
    const struct bake_exact_ray *ray = &view->hits->rays[index];
    const struct bake_exact_hit *hit = &view->hits->hits[index];
    const float *facet = hit->facet;
    const float *up = facet[0] != 0 || facet[1] != 0 || facet[2] != 0 ? facet : hit->normal;
    for (int k = 0; k < 3; k++) {
        const double at =
            (double)ray->origin[k] * surface->unit + hit->t * (double)ray->direction[k];
        const double p = (at + (surface->translation[k] - translation[k])) / unit;
        out->solid_from[k] = (float)p;
        out->open_from[k] = (float)(p + lift / unit * (double)up[k]);
    }
    memcpy(out->normal, hit->normal, sizeof out->normal);
    memcpy(out->facet, facet, sizeof out->facet);
    out->reversed = hit->reversed;
    out->seed = view->hits->seeds[index];
}

static bool get_place(const void *arg, uint64_t index, struct bake_place *out)
{
    const struct view *view = arg;
    const struct bake_surface *surface = view->look->surface;
    const struct bake_scan *scan = &surface->scans[view->scan];
    const struct bake_exact_hit *hit = &view->hits->hits[view->first + index];
    if (hit->triangle == BAKE_EXACT_NONE || !sees(view, view->first + index, view->scan))
        return false;
    set_place(view, view->first + index, scan->translation, scan->unit,
              fmax(lift_of(surface, view->scan), lift_of(surface, hit->scan)), out);
    return true;
}

/* ---- one scan ---- */

static int look_task(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    const struct view *view = arg;
    const struct bake_scan *scan = &view->look->surface->scans[view->scan];
    const struct bake_places *places = &view->places;
    const uint64_t begin = task * HITS_A_TASK, left = places->count - begin;
    const uint64_t end = begin + (left < HITS_A_TASK ? left : HITS_A_TASK);
    const double each = (double)places->progress / (double)places->count;
    bake_trace_places(&scan->grid, &scan->params, places, begin, end, &view->look->states);
    bsq_progress_add(scan->ctx, (uint64_t)(each * (double)end) - (uint64_t)(each * (double)begin));
    return 0;
}

static int look_at_triangles(struct view *view, const struct bake_scan *scan)
{
    struct bake_look *look = view->look;
    struct bake_exact_look *exact = look->kept;
    int status = 0;
    if (!exact)
        BSQ_TRY(bake_exact_look_create(scan->exact, &scan->params, &exact));
    status = bake_exact_look_from(exact, &view->places, &look->states, &look->loads);
done:
    if (!look->kept)
        bake_exact_look_free(exact);
    return status;
}

static int look_at_scan(struct view *view, uint64_t progress)
{
    const struct bake_scan *scan = &view->look->surface->scans[view->scan];
    view->places = (struct bake_places){.get = get_place,
                                        .arg = view,
                                        .count = view->count,
                                        .unit = scan->unit,
                                        .progress = progress};
    return scan->exact ? look_at_triangles(view, scan)
                       : bsq_parallel_for(scan->ctx, (view->count + HITS_A_TASK - 1) / HITS_A_TASK,
                                          look_task, view);
}

/* ---- all scans ---- */

static int sum_task(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    const struct view *view = arg;
    const struct bake_surface *surface = view->look->surface;
    const uint64_t begin = task * HITS_A_TASK, left = view->count - begin;
    for (uint64_t i = begin; i < begin + (left < HITS_A_TASK ? left : HITS_A_TASK); i++) {
        const uint64_t index = view->first + i;
        double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
        struct bake_place place;
        view->out[index] = bk_no_surroundings();
        if (view->hits->hits[index].triangle == BAKE_EXACT_NONE)
            continue;
        for (uint32_t s = 0; s < surface->scan_count; s++)
            for (int k = 0; k < 3 && sees(view, index, s); k++) {
                low[k] = fmin(low[k], surface->scans[s].scan_min[k] - surface->translation[k]);
                high[k] = fmax(high[k], surface->scans[s].scan_max[k] - surface->translation[k]);
            }
        set_place(view, index, surface->translation, 1, 0, &place);
        view->out[index] =
            bake_sum_rays(&view->look->states, &view->look->params, &place, i, low, high);
        view->out[index].thickness /= (float)surface->unit;
    }
    return 0;
}

/* Traces the rays of the view's hits through all scans, and sums what they found. */
static int look_at_all(struct view *view, uint64_t progress)
{
    struct bake_look *look = view->look;
    const uint32_t n = look->surface->scan_count;
    int status = 0;
    bake_ray_states_clear(&look->states, view->count);
    for (view->scan = 0; view->scan < n; view->scan++)
        BSQ_TRY(look_at_scan(view, progress * (view->scan + 1) / n - progress * view->scan / n));
    BSQ_TRY(bsq_parallel_for(look->surface->ctx, (view->count + HITS_A_TASK - 1) / HITS_A_TASK,
                             sum_task, view));
    BSQ_TRY(bake_surface_check(look->surface));
done:
    return status;
}

int bake_look_around(struct bake_look *look, const struct bake_look_hits *hits,
                     struct bk_surroundings *out)
{
    struct view view = {.look = look, .hits = hits, .out = out};
    const double each = (double)hits->progress / (double)hits->count;
    int status = 0;
    for (; view.first < hits->count && status == 0; view.first += view.count) {
        const uint64_t left = hits->count - view.first;
        view.count = left < look->states.capacity ? left : look->states.capacity;
        status = look_at_all(&view, (uint64_t)(each * (double)(view.first + view.count)) -
                                        (uint64_t)(each * (double)view.first));
    }
    return status;
}

uint64_t bake_look_loads(const struct bake_look *look)
{
    return look->loads;
}

/* ---- memory ---- */

/* The states take an eighth of what is left, or as much as `most` hits need. */
static int create_states(struct bake_look *look, uint64_t most)
{
    struct bsq_ctx *ctx = look->surface->ctx;
    const uint64_t bytes = bake_ray_state_bytes(&look->params);
    const uint64_t share = bsq_memory_share(ctx, "secondary rays", 8);
    const uint64_t capacity = bytes == 0 || most < share / bytes ? most : share / bytes;
    return bake_ray_states_create(ctx, &look->params, capacity < 1 ? 1 : capacity, &look->states);
}

int bake_look_create(const struct bake_surface *surface, uint64_t most, struct bake_look **out)
{
    const struct bake_scan *scan = surface->scans;
    struct bake_look *look;
    int status = 0;
    *out = NULL;
    BSQ_TRY(bsq_calloc(surface->ctx, "secondary rays", 1, sizeof *look, &look));
    look->surface = surface;
    look->params = surface->params;
    look->params.unit = 1;
    look->params.open_limit = (float)((double)look->params.open_limit * surface->unit);
    look->params.thickness_limit = (float)((double)look->params.thickness_limit * surface->unit);
    status = create_states(look, most);
    if (status == 0 && surface->scan_count == 1 && scan->exact)
        status = bake_exact_look_create(scan->exact, &scan->params, &look->kept);
    if (status < 0)
        bake_look_free(look);
    else
        *out = look;
done:
    return status;
}

void bake_look_free(struct bake_look *look)
{
    if (!look)
        return;
    struct bsq_ctx *ctx = look->surface->ctx;
    bake_exact_look_free(look->kept);
    bake_ray_states_free(ctx, &look->states);
    bsq_free(ctx, look);
}
