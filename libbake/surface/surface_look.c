/* surface_look.c - rays from hits: ambient occlusion, bent normals and thickness.
 *
 * A wall of one scan hides the floor of another. So these rays start when the nearest hit of each
 * sample is known. They are traced through one scan after the other, and between scans a ray is
 * only a bit or a distance (libbake/ray/ray.h). The rays are the same for all scans; in each, they
 * start as far above the surface as the coarser of the two scans needs, or on it in the grid that
 * was hit if the hit is crowded (bk_secondary.h). */
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
    struct bake_exact_look *only; /* of the only scan, if that has triangles */
    struct bake_tree *trees;      /* of each scan that is a grid */
    struct bake_native_workers workers;
    float *found; /* of each worker: what the rays of a hit found, see bk_add_up() */
};

/* Hits as one of the scans sees them. */
struct view {
    struct bake_look *look;
    const struct bake_look_hits *hits;
    uint64_t first, count;             /* of the hits whose states are known */
    uint32_t scan;                     /* the current one */
    struct bake_viewpoints viewpoints; /* for the current scan */
    struct bk_surroundings *out;       /* of all hits */
};

/* ---- viewpoints ---- */

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

/* Sets the viewpoint of a hit in a space given by its origin and its unit. own: of the scan that
 * was hit. */
static void set_viewpoint(const struct view *view, uint64_t index, const double translation[3],
                          double unit, bool own, double lift, bk_viewpoint *out)
{
    const struct bake_surface *surface = view->look->surface;
    const struct bake_ray *ray = &view->hits->rays[index];
    const struct bake_hit *hit = &view->hits->hits[index];
    const float *facet = hit->facet;
    const float *up = facet[0] != 0 || facet[1] != 0 || facet[2] != 0 ? facet : hit->normal;
    const bool walled = hit->crowded == BK_CROWDED_BY_WALL;
    const float *normal = walled ? facet : hit->normal;
    float on[3], above[3];
    for (int k = 0; k < 3; k++) {
        const double at =
            (double)ray->origin[k] * surface->unit + hit->t * (double)ray->direction[k];
        const double p = (at + (surface->translation[k] - translation[k])) / unit;
        on[k] = (float)p;
        above[k] = own && hit->crowded ? on[k] : (float)(p + lift / unit * (double)up[k]);
    }
    *out = (bk_viewpoint){.open_from = bk_v3(above[0], above[1], above[2]),
                          .solid_from = bk_v3(on[0], on[1], on[2]),
                          .normal = bk_v3(normal[0], normal[1], normal[2]),
                          .facet = walled ? bk_v3(0, 0, 0) : bk_v3(facet[0], facet[1], facet[2]),
                          .side = hit->reversed ? -1.0f : 1.0f,
                          .crowded = own ? hit->crowded : 0,
                          .share = view->hits->shares[index]};
}

static bool get_viewpoint(const void *arg, uint64_t index, bk_viewpoint *out)
{
    const struct view *view = arg;
    const struct bake_surface *surface = view->look->surface;
    const struct bake_scan *scan = &surface->scans[view->scan];
    const struct bake_hit *hit = &view->hits->hits[view->first + index];
    if (hit->triangle == BAKE_NO_HIT ||
        !bake_surface_sees(surface, view->hits->objects, view->first + index, view->scan))
        return false;
    set_viewpoint(view, view->first + index, scan->translation, scan->unit, view->scan == hit->scan,
                  fmax(lift_of(surface, view->scan), lift_of(surface, hit->scan)), out);
    return true;
}

/* ---- one scan ---- */

static int look_task(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    const struct view *view = arg;
    const struct bake_look *look = view->look;
    const struct bake_scan *scan = &look->surface->scans[view->scan];
    const struct bake_viewpoints *viewpoints = &view->viewpoints;
    const double count = (double)viewpoints->count;
    bake_trace_viewpoints(&scan->grid, &look->trees[view->scan], &scan->params, viewpoints, begin,
                          end, &look->workers, worker, &look->states);
    bsq_progress_add_share(scan->ctx, viewpoints->progress, (double)begin / count,
                           (double)end / count);
    return 0;
}

static int look_at_triangles(struct view *view, const struct bake_scan *scan)
{
    struct bake_look *look = view->look;
    struct bake_exact_look *exact = look->only;
    int status = 0;
    if (!exact)
        BSQ_TRY(bake_exact_look_create(scan->exact, &scan->params, &exact));
    status = bake_exact_look_from(exact, &view->viewpoints, &look->states);
done:
    if (!look->only)
        bake_exact_look_free(exact);
    return status;
}

static int look_at_scan(struct view *view, uint64_t progress)
{
    const struct bake_scan *scan = &view->look->surface->scans[view->scan];
    view->viewpoints = (struct bake_viewpoints){.get = get_viewpoint,
                                                .arg = view,
                                                .count = view->count,
                                                .unit = scan->unit,
                                                .progress = progress};
    return scan->exact ? look_at_triangles(view, scan)
                       : bsq_parallel_ranges(scan->ctx, view->count, HITS_A_TASK, look_task, view);
}

/* ---- sums ---- */

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

/* Returns what ray `number` of a viewpoint has found. A ray into the solid that leaves the bounds
 * of all scans within its limit has missed the solid's other side. */
static float found_by(const struct bake_ray_states *states, const bk_rays *kind,
                      const bk_viewpoint *viewpoint, uint64_t index, uint32_t number,
                      const double low[3], const double high[3])
{
    if (kind->open && states->words > 0)
        return bake_hidden_rays(states, index)[number / 64] >> (number % 64) & 1 ? 0.0f : -1.0f;
    const float t = bake_ray_distances(states, index, kind->open)[number];
    if (t < INFINITY)
        return kind->open ? t : fminf(t, kind->limit);
    if (kind->open)
        return -1.0f;
    const bk_vec3w d = bk_ray_directions(kind, viewpoint, number);
    const float from[3] = {viewpoint->solid_from.x, viewpoint->solid_from.y,
                           viewpoint->solid_from.z};
    return leaving(from, (float[3]){d.x, d.y, d.z}, low, high) < (double)kind->limit ? -1.0f
                                                                                     : kind->limit;
}

/* Sums what the rays of a viewpoint found. index: of its state. low, high: bounds of all scans that
 * it sees. The viewpoint, the bounds and the lengths of params are in world units. found: space for
 * a value of each ray. */
static bk_surroundings sum_rays(const struct bake_look *look, const bk_viewpoint *viewpoint,
                                uint64_t index, const double low[3], const double high[3],
                                float *found)
{
    uint32_t at = 0;
    for (uint32_t open = 2; open-- > 0;) {
        const bk_rays kind = bk_rays_of(&look->params, open);
        for (uint32_t r = 0; r < kind.count; r++)
            found[at++] = found_by(&look->states, &kind, viewpoint, index, r, low, high);
    }
    return bk_add_up(&look->params, viewpoint, found);
}

/* ---- all scans ---- */

static int sum_task(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    const struct view *view = arg;
    const struct bake_look *look = view->look;
    const struct bake_surface *surface = look->surface;
    float *found = look->found + worker * (uint64_t)bk_ray_count(&look->params);
    for (uint64_t i = begin; i < end; i++) {
        const uint64_t index = view->first + i;
        double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
        bk_viewpoint viewpoint;
        view->out[index] = bk_no_surroundings();
        if (view->hits->hits[index].triangle == BAKE_NO_HIT)
            continue;
        for (uint32_t s = 0; s < surface->scan_count; s++)
            for (int k = 0; k < 3 && bake_surface_sees(surface, view->hits->objects, index, s);
                 k++) {
                low[k] = fmin(low[k], surface->scans[s].scan_min[k] - surface->translation[k]);
                high[k] = fmax(high[k], surface->scans[s].scan_max[k] - surface->translation[k]);
            }
        set_viewpoint(view, index, surface->translation, 1, false, 0, &viewpoint);
        view->out[index] = sum_rays(look, &viewpoint, i, low, high, found);
        view->out[index].thickness /= (float)surface->unit;
    }
    return 0;
}

/* Forgets what is known of the first `count` viewpoints. */
static void clear_states(struct bake_ray_states *states, uint64_t count)
{
    memset(states->hidden, 0, count * states->words * sizeof *states->hidden);
    for (uint64_t i = 0; i < count * states->lengths; i++)
        states->distances[i] = INFINITY;
}

/* Traces the rays of the view's hits through all scans, and sums what they found. */
static int look_at_all(struct view *view, uint64_t progress)
{
    struct bake_look *look = view->look;
    const uint32_t n = look->surface->scan_count;
    clear_states(&look->states, view->count);
    for (view->scan = 0; view->scan < n; view->scan++)
        BSQ_PASS(look_at_scan(view, progress * (view->scan + 1) / n - progress * view->scan / n));
    BSQ_PASS(bsq_parallel_ranges(look->surface->ctx, view->count, HITS_A_TASK, sum_task, view));
    return bake_surface_check(look->surface);
}

int bake_look_around(struct bake_look *look, const struct bake_look_hits *hits,
                     struct bk_surroundings *out)
{
    struct view view = {.look = look, .hits = hits, .out = out};
    const double each = (double)hits->progress / (double)hits->count;
    for (; view.first < hits->count; view.first += view.count) {
        const uint64_t left = hits->count - view.first;
        view.count = left < look->states.capacity ? left : look->states.capacity;
        BSQ_PASS(look_at_all(&view, (uint64_t)(each * (double)(view.first + view.count)) -
                                        (uint64_t)(each * (double)view.first)));
    }
    return 0;
}

/* ---- memory ---- */

/* Makes the trees of scans that are grids, and the memory of workers. */
static int create_trees(struct bake_look *look)
{
    const struct bake_surface *surface = look->surface;
    struct bsq_ctx *ctx = surface->ctx;
    BSQ_PASS(BSQ_ALLOC(ctx, "results of rays",
                       bsq_threads(ctx) * (uint64_t)bk_ray_count(&look->params), &look->found));
    BSQ_PASS(BSQ_CALLOC(ctx, "trees of leaves", surface->scan_count, &look->trees));
    for (uint32_t s = 0; s < surface->scan_count; s++)
        if (!surface->scans[s].exact)
            BSQ_PASS(bake_tree_build(ctx, &surface->scans[s].grid, &look->trees[s]));
    if (surface->grids)
        return bake_native_workers_create(ctx, &look->params, &look->workers);
    return 0;
}

/* The states take an eighth of what is left, or as much as `most` hits need. */
static int create_states(struct bake_look *look, uint64_t most)
{
    struct bsq_ctx *ctx = look->surface->ctx;
    struct bake_ray_states *states = &look->states;
    states->opens = bk_open_rays(&look->params);
    states->solids = bk_solid_rays(&look->params);
    states->words = bk_state_words(&look->params);
    states->lengths = bk_state_lengths(&look->params);
    const uint64_t bytes =
        states->words * sizeof *states->hidden + states->lengths * sizeof *states->distances;
    const uint64_t share = bsq_memory_left(ctx) / 8;
    const uint64_t fitting = bytes == 0 || most < share / bytes ? most : share / bytes;
    states->capacity = fitting < 1 ? 1 : fitting;
    BSQ_PASS(
        BSQ_ALLOC(ctx, "secondary rays", states->capacity * states->words + 1, &states->hidden));
    return BSQ_ALLOC(ctx, "secondary rays", states->capacity * states->lengths + 1,
                     &states->distances);
}

int bake_look_create(const struct bake_surface *surface, uint64_t most, struct bake_look **out)
{
    const struct bake_scan *scan = surface->scans;
    struct bake_look *look;
    int status = 0;
    *out = NULL;
    BSQ_TRY(BSQ_CALLOC(surface->ctx, "secondary rays", 1, &look));
    look->surface = surface;
    look->params = surface->params;
    look->params.unit = 1;
    look->params.open_limit = (float)((double)look->params.open_limit * surface->unit);
    look->params.thickness_limit = (float)((double)look->params.thickness_limit * surface->unit);
    status = create_trees(look);
    if (status == 0)
        status = create_states(look, most);
    if (status == 0 && surface->scan_count == 1 && scan->exact)
        status = bake_exact_look_create(scan->exact, &scan->params, &look->only);
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
    bake_exact_look_free(look->only);
    for (uint32_t s = 0; look->trees && s < look->surface->scan_count; s++)
        bake_tree_free(ctx, &look->trees[s]);
    bsq_free(ctx, look->trees);
    bake_native_workers_free(ctx, &look->workers);
    BSQ_FREE(ctx, look->found, look->states.hidden, look->states.distances, look);
}
