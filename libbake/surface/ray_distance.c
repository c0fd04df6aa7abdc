/* ray_distance.c - chooses ray lengths by the distance between the low-poly mesh and the scan.
 *
 * Lengths follow a percentile, not the largest distance: through a hole in the scan, a ray hits
 * some other surface far away. Such rays are few, and short rays keep these hits out of the map. */
#include "libbake/surface/surface.h"

#include <math.h>

#include "base/sort_array.h"
#include "base/vec.h"

enum { PROBES = 16384 };

struct probe {
    uint64_t triangle;
    float weights[3]; /* barycentric */
};

static float fraction(double v)
{
    return (float)(v - floor(v));
}

static struct bake_exact_ray probe_ray(const struct bake_surface *surface,
                                       const struct bake_lowmesh *mesh, const struct probe *probe)
{
    double(*positions)[3] = mesh->positions[probe->triangle];
    float(*directions)[3] = mesh->directions[probe->triangle];
    struct bake_exact_ray ray;
    float normal[3];
    for (int k = 0; k < 3; ++k) {
        double p = 0, n = 0;
        for (int c = 0; c < 3; ++c) {
            /* Subtracts the translation first: far from the origin, the rounding of the weights'
             * sum would move the point by a long way. */
            p += (double)probe->weights[c] * (positions[c][k] - surface->translation[k]);
            n += (double)probe->weights[c] * (double)directions[c][k];
        }
        ray.origin[k] = (float)(p / surface->unit);
        normal[k] = (float)n;
    }
    struct bsq_vec3 unit = bsq_unit3(bsq_v3(normal[0], normal[1], normal[2]));
    ray.direction[0] = unit.x;
    ray.direction[1] = unit.y;
    ray.direction[2] = unit.z;
    return ray;
}

/* Writes rays and, unless `objects` is NULL, the objects that they start at. Spreads the probes
 * over the triangles in equal steps of area, and inside them by a low-discrepancy sequence
 * (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018). */
static void place_probes(const struct bake_surface *surface, const struct bake_lowmesh *mesh,
                         struct bake_exact_ray *rays, uint32_t *objects)
{
    double total = 0, passed = 0;
    for (uint64_t t = 0; t < mesh->triangle_count; ++t)
        total += bake_lowmesh_area(mesh, t);
    uint64_t next = 0;
    for (uint64_t t = 0; t < mesh->triangle_count; ++t) {
        passed += bake_lowmesh_area(mesh, t);
        bool last = t + 1 == mesh->triangle_count;
        for (; next < PROBES && (last || (double)next + 0.5 < passed / total * PROBES); ++next) {
            float u = fraction(0.7548776662466927 * (double)next);
            float v = fraction(0.5698402909980532 * (double)next);
            if (u + v > 1.0f) {
                u = 1.0f - u;
                v = 1.0f - v;
            }
            struct probe probe = {.triangle = t, .weights = {1.0f - u - v, u, v}};
            rays[next] = probe_ray(surface, mesh, &probe);
            if (objects)
                objects[next] = mesh->object_of[t];
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

/* Copies the distances of the hits and sorts them; returns their number. */
static size_t take_distances(const struct bake_exact_hit *hits, float *distances)
{
    size_t count = 0;
    for (size_t i = 0; i < PROBES; ++i)
        if (hits[i].triangle != BAKE_EXACT_NONE)
            distances[count++] = (float)hits[i].t;
    bsq_sort(distances, count, sizeof *distances, compare_floats);
    return count;
}

/* Traces the probes, as many at a time as memory allows. */
static int trace_probes(const struct bake_surface *surface, double limit,
                        const struct bake_exact_ray *rays, const uint32_t *objects,
                        struct bake_exact_hit *hits)
{
    int status = 0;
    for (uint64_t at = 0; at < PROBES && status == 0;) {
        const uint64_t most = bake_surface_capacity(surface, 0), left = PROBES - at;
        const struct bake_surface_rays probes = {.batch = {.rays = rays + at,
                                                           .hits = hits + at,
                                                           .count = left < most ? left : most,
                                                           .t_min = -limit,
                                                           .t_max = limit,
                                                           .distances_only = true},
                                                 .objects = objects ? objects + at : NULL};
        status = bake_surface_trace(surface, &probes);
        at += probes.batch.count;
    }
    return status;
}

int bake_measure_distances(const struct bake_surface *surface, const struct bake_lowmesh *mesh,
                           double *front, double *back)
{
    struct bsq_ctx *ctx = surface->ctx;
    const double diagonal = scan_diagonal(surface), limit = 0.1 * diagonal + 2.0 * surface->detail;
    struct bake_exact_ray *rays = NULL;
    struct bake_exact_hit *hits = NULL;
    float *distances = NULL;
    uint32_t *objects = NULL;
    *front = *back = 0.05 * diagonal;
    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "distances", PROBES, sizeof *rays, &rays));
    BSQ_TRY(bsq_alloc(ctx, "distances", PROBES, sizeof *hits, &hits));
    BSQ_TRY(bsq_alloc(ctx, "distances", PROBES, sizeof *distances, &distances));
    if (surface->sees)
        BSQ_TRY(bsq_alloc(ctx, "distances", PROBES, sizeof *objects, &objects));
    place_probes(surface, mesh, rays, objects);
    BSQ_TRY(trace_probes(surface, limit, rays, objects, hits));
    size_t count = take_distances(hits, distances);
    if (count >= PROBES / 100) {
        *front = side_length(distances, count, 1, surface->detail);
        *back = side_length(distances, count, -1, surface->detail);
    }
done:
    bsq_free(ctx, objects);
    bsq_free(ctx, distances);
    bsq_free(ctx, hits);
    bsq_free(ctx, rays);
    return status;
}
