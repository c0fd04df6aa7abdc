/* fit.c - see fit.h.
 *
 * Lengths follow a percentile, not the largest distance: through a hole in the scan, a ray hits
 * some other surface far away. Such rays are few, and short rays keep these hits out of the map. A
 * part of the scan may stand out farther than rays are tried at first, as a tower does from a
 * plane. Then most of the rays that found nothing find it farther outwards. Holes of the scan look
 * different: rays through them go inwards. */
#include "libbake/fit/fit.h"

#include <math.h>
#include <string.h>

#include "base/sort_array.h"
#include "base/geometry/vec.h"
#include "libbake/fit/probes.h"

/* Layers of a scan are at least this share of its size apart. */
#define NEARER 0.002

/* Shares of the points that may see several layers, or no other side of the solid, without a
 * warning. */
#define MOST_LAYERS 0.1
#define MOST_OPEN   0.01

/* How far rays are tried, as shares of the diagonal of the scan's bounds. */
#define USUAL_LIMIT 0.1
#define FAR_LIMIT   0.5

static double diagonal(const double low[3], const double high[3])
{
    double square = 0;
    for (int k = 0; k < 3; ++k)
        square += (high[k] - low[k]) * (high[k] - low[k]);
    return sqrt(square);
}

/* ---- lengths ---- */

/* Returns by how much a scan may stand out of its sample: a third of the side of a patch. */
static double sample_error(const struct bake_surface *surface)
{
    double error = 0;
    for (uint32_t s = 0; s < surface->scan_count; ++s) {
        const struct bake_scan *scan = &surface->scans[s];
        const struct fmt_tris_header *header = scan->exact ? bake_exact_header(scan->exact) : NULL;
        if (header && header->attributes & FMT_TRIS_SAMPLES)
            error = fmax(error, diagonal(scan->scan_min, scan->scan_max) * 11 / 3 /
                                    sqrt((double)header->triangle_count));
    }
    return error;
}

static int compare_floats(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* Returns the length of the rays on one side: sign 1 in front, -1 behind. Distances are sorted;
 * negative ones lie behind. */
static double side_length(const float *distances, size_t count, double sign, double more)
{
    size_t rank = (size_t)((double)(count - 1) * 0.999);
    double d = sign * (double)distances[sign > 0 ? rank : count - 1 - rank];
    return 1.5 * (d > 0 ? d : 0) + more;
}

/* Adds the distances of hits to `count` of them. Returns their number. */
static size_t add_distances(const struct fit *fit, uint32_t rays, size_t count)
{
    for (uint32_t i = 0; i < rays; ++i)
        if (fit->hits[i].triangle != BAKE_NO_HIT)
            fit->distances[count++] = (float)fit->hits[i].t;
    return count;
}

/* Looks farther outwards from where nothing was found. Takes what is there if most of these probes
 * find something. Replaces the hits. */
static int trace_farther(const struct fit *fit, size_t *count)
{
    const double detail = 2.0 * fit->surface->detail;
    uint32_t missing = 0;
    for (uint32_t i = 0; i < fit->count; ++i)
        if (isinf(fit->probes[i].t))
            bake_fit_set_ray(fit, &fit->probes[i], NULL, missing++);
    if (missing < PROBES / 1000 || *count < PROBES / 100)
        return 0;
    const int status = bake_fit_trace(fit, missing, USUAL_LIMIT * fit->scan_size + detail,
                                      FAR_LIMIT * fit->scan_size + 5.0 * detail, false);
    const size_t near = *count, all = status < 0 ? near : add_distances(fit, missing, near);
    if (2 * (all - near) < missing)
        return status;
    *count = all;
    bsq_warn(fit->surface->ctx,
             "%.1f %% of the low-poly mesh lies more than a tenth of the scan's diagonal below "
             "the scan: rays go as far as they need to, unless --front limits them",
             100.0 * (double)(all - near) / PROBES);
    return status;
}

/* Chooses the lengths that the options leave open by the hits of all probes. */
static int choose_lengths(const struct fit *fit, double *front, double *back)
{
    const struct bake_options *options = fit->options;
    size_t count = add_distances(fit, fit->count, 0);
    const int status = trace_farther(fit, &count);
    bsq_sort(fit->distances, count, sizeof *fit->distances, compare_floats);
    *front = *back = 0.05 * fit->scan_size;
    if (count >= PROBES / 100) {
        const double more = 2.0 * fit->surface->detail + sample_error(fit->surface);
        *front = side_length(fit->distances, count, 1, more);
        *back = side_length(fit->distances, count, -1, more);
    }
    if (options->front >= 0)
        *front = options->front;
    if (options->back >= 0)
        *back = options->back;
    return status;
}

/* ---- rays from hits ---- */

/* Writes ray number `index`, from the hit of a probe outwards, or into the solid. Returns whether
 * there is a hit; if not, the ray hits nothing. */
static bool set_ray_from_hit(const struct fit *fit, const struct probe *from, bool outwards,
                             uint32_t index)
{
    struct probe probe = *from;
    const bool found = !isinf(probe.t);
    const struct bsq_vec3 n = bsq_unit3(bsq_load3(probe.normal));
    const float way[3] = {n.x, n.y, n.z};
    for (int k = 0; k < 3; ++k) {
        probe.at[k] += found ? probe.t * (double)way[k] : 0;
        probe.normal[k] = !found ? 0 : outwards ? way[k] : -way[k];
    }
    probe.reach = 0;
    bake_fit_set_ray(fit, &probe, NULL, index);
    return found;
}

/* Finds the share of the points from whose hits outwards the rays reach another surface that faces
 * the same way, such as a coat over a body. */
static int measure_layers(struct fit *fit, double reach, double *share)
{
    const double least = NEARER * fit->scan_size + 2.0 * fit->surface->detail;
    uint32_t hits = 0, layered = 0;
    *share = 0;
    if (reach <= least)
        return 0;
    for (uint32_t i = 0; i < FEW; ++i)
        hits += set_ray_from_hit(fit, &fit->probes[i / RUN * (fit->count / FEW * RUN) + i % RUN],
                                 true, i);
    int status = bake_fit_trace(fit, FEW, least, reach, false);
    for (uint32_t i = 0; i < FEW && status == 0; ++i)
        layered += fit->hits[i].triangle != BAKE_NO_HIT;
    *share = hits > 0 ? (double)layered / hits : 0;
    return status;
}

/* Warns if rays from the hits straight into the solid leave it without meeting its other side, as
 * through a hole. Rays that may hit either side of a surface must not meet the one they leave. */
static int judge_openness(struct fit *fit)
{
    const double from = fit->options->two_sided ? 2.0 * fit->surface->detail : 0;
    uint32_t hits = 0, left = 0;
    for (uint32_t i = 0; i < FEW; ++i)
        hits += set_ray_from_hit(fit, &fit->probes[i * (fit->count / FEW)], false, i);
    int status = bake_fit_trace(fit, FEW, from, 2.0 * fit->scan_size, false);
    for (uint32_t i = 0; i < FEW && status == 0; ++i)
        left +=
            !isinf(fit->probes[i * (fit->count / FEW)].t) && fit->hits[i].triangle == BAKE_NO_HIT;
    if (left > MOST_OPEN * hits)
        bsq_warn(fit->surface->ctx,
                 "map thickness: %.0f %% of the rays straight into %s leave through holes or open "
                 "borders: close them, or set how far walls count with --distance thickness",
                 100.0 * left / hits, bake_fit_scan(fit));
    return status;
}

static int fit_allocate(struct fit *fit)
{
    struct bsq_ctx *ctx = fit->surface->ctx;
    BSQ_PASS(BSQ_ALLOC(ctx, "distances", fit->count, &fit->probes));
    BSQ_PASS(BSQ_ALLOC(ctx, "distances", fit->count, &fit->rays));
    BSQ_PASS(BSQ_ALLOC(ctx, "distances", fit->count, &fit->hits));
    BSQ_PASS(BSQ_ALLOC(ctx, "distances", fit->count, &fit->distances));
    BSQ_PASS(BSQ_ALLOC(ctx, "distances", fit->count, &fit->reaches));
    if (fit->surface->sees)
        BSQ_PASS(BSQ_ALLOC(ctx, "distances", fit->count, &fit->objects));
    return 0;
}

/* Traces all probes, for lengths and for the score of the mesh as it is. */
static int trace_probes(struct fit *fit)
{
    for (uint32_t i = 0; i < fit->count; ++i)
        bake_fit_set_ray(fit, &fit->probes[i], NULL, i);
    const double limit = USUAL_LIMIT * fit->scan_size + 2.0 * fit->surface->detail;
    int status = bake_fit_trace(fit, fit->count, -limit, limit, false);

    if (status == 0)
        fit->score = bake_fit_score(fit, 0, fit->count, fmin(fit->scan_size, fit->low_size));
    for (uint32_t i = 0; i < fit->count && status == 0; ++i)
        fit->probes[i].t = fit->hits[i].triangle == BAKE_NO_HIT ? INFINITY : fit->hits[i].t;
    return status;
}

int bake_fit(const struct bake_surface *surface, const struct bake_lowmesh *mesh,
             const struct bake_options *options, double *front, double *back)
{
    const bool measured = (options->front < 0 && !bake_has_cage(options)) || options->back < 0;
    const bool solid =
        surface->params.maps & BAKE_MAP_THICKNESS && !(options->thickness_distance > 0);
    struct fit fit = {.surface = surface,
                      .mesh = mesh,
                      .options = options,
                      .scan_size = diagonal(surface->scan_min, surface->scan_max),
                      .low_size = diagonal(mesh->bounds_min, mesh->bounds_max),
                      .measured = measured,
                      .count = measured || solid ? PROBES : FEW};
    double layers = 0, reach = 0;
    bool fits = true;
    int status = 0;
    *front = options->front;
    *back = options->back;
    if (!measured && options->as_is)
        return 0;
    BSQ_TRY(fit_allocate(&fit));
    bake_fit_spread(&fit);
    BSQ_TRY(trace_probes(&fit));
    if (measured) {
        BSQ_TRY(choose_lengths(&fit, front, back));
        /* The low-poly mesh may be in the middle between two layers. */
        reach = fmin(2 * fmax(*front, *back), USUAL_LIMIT * fit.scan_size);
        if (!options->as_is)
            BSQ_TRY(measure_layers(&fit, reach, &layers));
    }
    if (!options->as_is)
        BSQ_TRY(bake_fit_judge(&fit, &fits));
    if (fits && solid)
        BSQ_TRY(judge_openness(&fit));
    if (fits && layers > MOST_LAYERS)
        bsq_warn(surface->ctx,
                 "in front of %.0f %% of the nearest surface, %s has another layer within %g: the "
                 "nearest to the low-poly mesh is baked; a cage, or a shorter --front, chooses",
                 100 * layers, bake_fit_scan(&fit), reach);
done:
    BSQ_FREE(surface->ctx, fit.objects, fit.reaches, fit.distances, fit.hits, fit.rays, fit.probes);
    return status;
}
