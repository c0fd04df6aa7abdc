/* ray_distance.c - chooses ray lengths by the distance between the low-poly mesh and the scan.
 *
 * Lengths follow a percentile, not the largest distance: through a hole in the scan, a ray hits
 * some other surface far away. Such rays are few, and short rays keep these hits out of the map.
 *
 * A part of the scan may stand out farther than rays are tried at first, as a tower does from a
 * plane. Then most of the rays that found nothing find it farther outwards. Holes of the scan look
 * different: rays through them go inwards. */
#include "libbake/surface/surface.h"

#include <math.h>

#include "base/sort_array.h"
#include "base/vec.h"

enum { PROBES = 16384 };

/* Shares of the diagonal of the scan's bounds. */
#define USUAL_LIMIT 0.1
#define FAR_LIMIT   0.5

struct probes {
    uint32_t count;
    struct bake_exact_ray *rays;
    struct bake_exact_hit *hits;
    float *reaches, *distances;
    uint32_t *objects; /* NULL: all see all scans */
};

static float fraction(double v)
{
    return (float)(v - floor(v));
}

/* Adds a probe of a triangle. weights: barycentric. */
static void add_probe(const struct bake_surface *surface, const struct bake_lowmesh *mesh,
                      uint64_t triangle, const float weights[3], struct probes *out)
{
    double(*positions)[3] = mesh->positions[triangle];
    float(*directions)[3] = mesh->directions[triangle], normal[3], reach = 0;
    struct bake_exact_ray *ray = &out->rays[out->count];
    for (int k = 0; k < 3; ++k) {
        double p = 0, n = 0;
        for (int c = 0; c < 3; ++c) {
            /* Subtracts the translation first: far from the origin, the rounding of the weights'
             * sum would move the point by a long way. */
            p += (double)weights[c] * (positions[c][k] - surface->translation[k]);
            n += (double)weights[c] * (double)directions[c][k];
        }
        ray->origin[k] = (float)(p / surface->unit);
        normal[k] = (float)n;
        reach += weights[k] * mesh->reaches[triangle][k];
    }
    const struct bsq_vec3 unit = bsq_unit3(bsq_v3(normal[0], normal[1], normal[2]));
    ray->direction[0] = unit.x;
    ray->direction[1] = unit.y;
    ray->direction[2] = unit.z;
    out->reaches[out->count] = reach;
    if (out->objects)
        out->objects[out->count] = mesh->object_of[triangle];
    out->count++;
}

/* Spreads the probes over the triangles in equal steps of area, and inside them by a
 * low-discrepancy sequence (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences",
 * 2018). */
static void place_probes(const struct bake_surface *surface, const struct bake_lowmesh *mesh,
                         struct probes *out)
{
    double total = 0, passed = 0;
    for (uint64_t t = 0; t < mesh->triangle_count; ++t)
        total += bake_lowmesh_area(mesh, t);
    for (uint64_t t = 0; t < mesh->triangle_count; ++t) {
        passed += bake_lowmesh_area(mesh, t);
        const bool last = t + 1 == mesh->triangle_count;
        while (out->count < PROBES && (last || out->count + 0.5 < passed / total * PROBES)) {
            float u = fraction(0.7548776662466927 * out->count);
            float v = fraction(0.5698402909980532 * out->count);
            if (u + v > 1.0f) {
                u = 1.0f - u;
                v = 1.0f - v;
            }
            add_probe(surface, mesh, t, (const float[3]){1.0f - u - v, u, v}, out);
        }
    }
}

static int compare_floats(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* Returns the length of the rays on one side: sign 1 in front, -1 behind. Distances are sorted;
 * negative ones lie behind. */
static double side_length(const float *distances, size_t count, double sign, double detail)
{
    size_t rank = (size_t)((double)(count - 1) * 0.999);
    double d = sign * (double)distances[sign > 0 ? rank : count - 1 - rank];
    return 1.5 * (d > 0 ? d : 0) + 2.0 * detail;
}

static double scan_diagonal(const struct bake_surface *surface)
{
    double square = 0;
    for (int k = 0; k < 3; ++k) {
        double side = surface->scan_max[k] - surface->scan_min[k];
        square += side * side;
    }
    return sqrt(square);
}

/* Traces the probes, as many at a time as memory allows. Appends the distances of the hits to the
 * `found` that there are, and keeps the probes that hit nothing. */
static int trace_probes(const struct bake_surface *surface, double t_min, double t_max,
                        struct probes *probes, size_t *found)
{
    const uint64_t count = probes->count;
    int status = 0;
    for (uint64_t at = 0; at < count && status == 0;) {
        const uint64_t most = bake_surface_capacity(surface, 0), left = count - at;
        const struct bake_surface_rays rays = {.batch = {.rays = probes->rays + at,
                                                         .hits = probes->hits + at,
                                                         .count = left < most ? left : most,
                                                         .t_min = t_min,
                                                         .t_max = t_max,
                                                         .reaches = probes->reaches + at,
                                                         .distances_only = true},
                                               .objects =
                                                   probes->objects ? probes->objects + at : NULL};
        status = bake_surface_trace(surface, &rays);
        at += rays.batch.count;
    }
    probes->count = 0;
    for (uint64_t i = 0; i < count; i++) {
        if (probes->hits[i].triangle != BAKE_EXACT_NONE) {
            probes->distances[(*found)++] = (float)probes->hits[i].t;
            continue;
        }
        probes->rays[probes->count] = probes->rays[i];
        probes->reaches[probes->count] = probes->reaches[i];
        if (probes->objects)
            probes->objects[probes->count] = probes->objects[i];
        probes->count++;
    }
    return status;
}

/* Looks farther outwards from where nothing was found. Takes what is there if most of these probes
 * find something. */
static int look_farther(const struct bake_surface *surface, double limit, struct probes *probes,
                        size_t *found)
{
    const size_t near = *found;
    const uint32_t missing = probes->count;
    if (missing < PROBES / 1000 || near < PROBES / 100)
        return 0;
    const int status = trace_probes(surface, limit, FAR_LIMIT / USUAL_LIMIT * limit, probes, found);
    if (2 * (*found - near) < missing)
        *found = near;
    else
        bsq_warn(surface->ctx,
                 "%.1f %% of the low-poly mesh lies more than a tenth of the scan's diagonal below "
                 "the scan: rays go as far as they need to, unless --front limits them",
                 100.0 * (double)(*found - near) / PROBES);
    return status;
}

int bake_measure_distances(const struct bake_surface *surface, const struct bake_lowmesh *mesh,
                           double *front, double *back)
{
    struct bsq_ctx *ctx = surface->ctx;
    const double diagonal = scan_diagonal(surface);
    const double limit = USUAL_LIMIT * diagonal + 2.0 * surface->detail;
    struct probes probes = {0};
    size_t found = 0;
    *front = *back = 0.05 * diagonal;
    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "distances", PROBES, sizeof *probes.rays, &probes.rays));
    BSQ_TRY(bsq_alloc(ctx, "distances", PROBES, sizeof *probes.hits, &probes.hits));
    BSQ_TRY(bsq_alloc(ctx, "distances", PROBES, sizeof *probes.reaches, &probes.reaches));
    BSQ_TRY(bsq_alloc(ctx, "distances", PROBES, sizeof *probes.distances, &probes.distances));
    if (surface->sees)
        BSQ_TRY(bsq_alloc(ctx, "distances", PROBES, sizeof *probes.objects, &probes.objects));
    place_probes(surface, mesh, &probes);
    BSQ_TRY(trace_probes(surface, -limit, limit, &probes, &found));
    BSQ_TRY(look_farther(surface, limit, &probes, &found));
    if (found >= PROBES / 100) {
        bsq_sort(probes.distances, found, sizeof *probes.distances, compare_floats);
        *front = side_length(probes.distances, found, 1, surface->detail);
        *back = side_length(probes.distances, found, -1, surface->detail);
    }
done:
    bsq_free(ctx, probes.objects);
    bsq_free(ctx, probes.distances);
    bsq_free(ctx, probes.reaches);
    bsq_free(ctx, probes.hits);
    bsq_free(ctx, probes.rays);
    return status;
}
