/* curvature.c - measures mean curvature with rays from around each hit.
 *
 * Let n be the normal field of a surface. In a direction e of the tangent plane the normal
 * curvature is dn . e, and the mean of it over all directions is the mean curvature (Euler 1760).
 * Between two points of the surface, a and b, (n_b - n_a) . (b - a) / |b - a|^2 approximates it; on
 * a sphere it is exact for any two points. Four pairs of points on opposite sides of the hit give
 * the mean over eight directions, which is exact for quadratic surfaces. The error grows with the
 * square of the radius: on a torus it is below 3 % if the radius is a fifth of the tube's.
 *
 * Rays parallel to the hit's normal find the points. At an edge such a ray passes beside the
 * surface or is inside of the solid. Then one that leans outwards finds the far side of a convex
 * edge, and one that leans inwards that of a concave edge. The pairs have different distances, so
 * that the influence of an edge fades with the distance to it. */
#include "libbake/curvature/curvature.h"

#include <math.h>
#include <string.h>

#include "base/parallel.h"
#include "base/geometry/vec.h"

enum {
    PROBES = 8, /* of a texel: 2 k and 2 k + 1 are on opposite sides */
    TEXELS_A_TASK = 256,
    PROBES_A_TASK = 1024,
    NORMAL = 3 /* the offset of the normal from the position in a texel's values */
};

/* Directions of the pairs in the tangent plane, and distances in radii. Pairs 0 and 2 are
 * perpendicular, as are 1 and 3. */
static const float pair_directions[PROBES / 2][2] = {
    {1, 0}, {0.70710678f, 0.70710678f}, {0, 1}, {-0.70710678f, 0.70710678f}};
static const float pair_distances[PROBES / 2] = {1, 0.75f, 0.875f, 0.625f};

/* A point on the scan near a hit, relative to the hit. */
struct probe {
    struct bsq_vec3 at, normal; /* world units */
    bool found;
};

struct work {
    struct bsq_ctx *ctx;
    const struct bake_curvature *curvature;
    struct bake_curvature_counts counts;
    unsigned worker; /* that does it, with a device; without one, all do it together */
    uint32_t channels;
    uint64_t most; /* texels that are traced together */
    /* Of these texels, which follow each other in the image: */
    float *texels;
    struct probe *probes; /* PROBES a texel */
    /* Probes that have found nothing, and the rays of some of them: one, or two that lean outwards
     * and inwards. */
    uint32_t *listed, *ray_objects, each;
    struct bake_ray *rays;
    struct bake_hit *hits;
};

/* ---- rays ---- */

static struct bsq_vec3 curvature_add(struct bsq_vec3 a, float s, struct bsq_vec3 b)
{
    return bsq_v3(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}

static struct bsq_vec3 normal_of(const struct work *work, uint64_t texel)
{
    return bsq_load3(work->texels + texel * work->channels + work->curvature->offset + NORMAL);
}

static bool curvature_is_valid(const struct work *work, uint64_t texel)
{
    return work->texels[texel * work->channels] > 0.0f;
}

/* Returns the unit direction of a probe in the tangent plane. The frame follows from the normal. */
static struct bsq_vec3 outwards(struct bsq_vec3 n, uint32_t number)
{
    const struct bsq_vec3 axis = fabsf(n.x) < 0.6f   ? bsq_v3(1, 0, 0)
                                 : fabsf(n.y) < 0.6f ? bsq_v3(0, 1, 0)
                                                     : bsq_v3(0, 0, 1);
    const struct bsq_vec3 a = bsq_unit3(bsq_cross3(axis, n)), b = bsq_cross3(n, a);
    const float *direction = pair_directions[number / 2], sign = number & 1 ? -1.0f : 1.0f;
    return curvature_add(
        bsq_v3(sign * direction[0] * a.x, sign * direction[0] * a.y, sign * direction[0] * a.z),
        sign * direction[1], b);
}

static float distance_of(const struct work *work, uint32_t number)
{
    return (float)work->curvature->radius * pair_distances[number / 2];
}

/* Makes the ray of a probe, which leans outwards by 45 degrees if `lean` is 1, inwards if -1. */
static struct bake_ray probe_ray(const struct work *work, uint64_t probe, float lean)
{
    const uint64_t texel = probe / PROBES;
    const uint32_t number = (uint32_t)(probe % PROBES);
    const double unit = work->curvature->surface->unit;
    const float *position = work->texels + texel * work->channels + work->curvature->offset;
    const struct bsq_vec3 n = normal_of(work, texel), out = outwards(n, number);
    const struct bsq_vec3 d = bsq_unit3(curvature_add(n, lean, out));
    const float distance = distance_of(work, number);
    return (struct bake_ray){{(float)((double)(position[0] + distance * out.x) / unit),
                              (float)((double)(position[1] + distance * out.y) / unit),
                              (float)((double)(position[2] + distance * out.z) / unit)},
                             {d.x, d.y, d.z}};
}

/* Sets a probe to the hit of its ray, unless the surface there faces the other way. */
static void curvature_take_hit(const struct work *work, uint64_t probe, const struct bake_ray *ray,
                               const struct bake_hit *hit)
{
    const uint32_t number = (uint32_t)(probe % PROBES);
    const struct bsq_vec3 d = bsq_load3(ray->direction);
    const struct bsq_vec3 normal = bsq_load3(hit->normal);
    const struct bsq_vec3 out = outwards(normal_of(work, probe / PROBES), number);
    const float distance = distance_of(work, number);
    if (hit->triangle == BAKE_NO_HIT || !(bsq_dot3(normal, d) > 0.0f))
        return;
    work->probes[probe] =
        (struct probe){curvature_add(bsq_v3(distance * out.x, distance * out.y, distance * out.z),
                                     (float)hit->t, d),
                       normal, true};
}

/* ---- listed probes ---- */

/* Probes whose rays are in memory. */
struct task {
    struct work *work;
    const uint32_t *probes;
};

/* Runs a step for [0, count) on the threads that do the work. */
static int run_step(const struct work *work, uint64_t count, uint64_t step,
                    int (*fn)(void *arg, uint64_t begin, uint64_t end, unsigned worker), void *arg)
{
    if (!work->curvature->device)
        return bsq_parallel_ranges(work->ctx, count, step, fn, arg);
    return fn(arg, 0, count, work->worker);
}

static int cast_probes(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    (void)worker;
    const struct task *task = arg;
    const struct work *work = task->work;
    const uint32_t each = work->each;
    for (uint64_t i = begin * each; i < end * each; ++i) {
        const uint32_t probe = task->probes[i / each];
        work->rays[i] = probe_ray(work, probe, each == 1 ? 0.0f : i & 1 ? -1.0f : 1.0f);
        if (work->ray_objects)
            memcpy(&work->ray_objects[i],
                   work->texels + (probe / PROBES + UINT64_C(1)) * work->channels - 1,
                   sizeof *work->ray_objects);
    }
    return 0;
}

static int take_probes(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    (void)worker;
    const struct task *task = arg;
    const struct work *work = task->work;
    for (uint64_t i = begin; i < end; ++i) {
        const uint64_t outer = work->each * i;
        const struct bake_hit *hits = &work->hits[outer];
        const bool inner = work->each == 2 && hits[1].triangle != BAKE_NO_HIT &&
                           (hits[0].triangle == BAKE_NO_HIT || fabs(hits[1].t) < fabs(hits[0].t));
        curvature_take_hit(work, task->probes[i], &work->rays[outer + inner], &hits[inner]);
    }
    return 0;
}

static int curvature_trace_rays(const struct work *work, const struct bake_ray_batch *rays)
{
    const struct bake_curvature *curvature = work->curvature;
    if (!curvature->device)
        return bake_surface_trace(curvature->surface, rays);
    return bake_device_trace_rays(curvature->device, rays, curvature->surface->unit, work->worker);
}

/* Traces the probes of valid texels that have found nothing yet. range: how far their rays reach on
 * either side. */
static int trace_missing(struct work *work, uint64_t texels, uint32_t each, double range)
{
    const uint64_t most = work->most * PROBES / each;
    uint64_t listed = 0;
    work->each = each;
    for (uint64_t i = 0; i < texels * PROBES; ++i)
        if (!work->probes[i].found && curvature_is_valid(work, i / PROBES))
            work->listed[listed++] = (uint32_t)i;
    for (uint64_t at = 0; at < listed; at += most) {
        const uint64_t count = listed - at < most ? listed - at : most;
        struct task task = {work, work->listed + at};
        const struct bake_ray_batch rays = {.rays = work->rays,
                                            .hits = work->hits,
                                            .count = count * each,
                                            .t_min = -range,
                                            .t_max = range,
                                            .objects = work->ray_objects};
        BSQ_PASS(run_step(work, count, PROBES_A_TASK, cast_probes, &task));
        BSQ_PASS(curvature_trace_rays(work, &rays));
        BSQ_PASS(run_step(work, count, PROBES_A_TASK, take_probes, &task));
    }
    return 0;
}

/* ---- curvature ---- */

/* Returns the normal curvature between two points. */
static double between(const struct probe *a, const struct probe *b)
{
    const struct bsq_vec3 step = curvature_add(b->at, -1.0f, a->at),
                          turn = curvature_add(b->normal, -1.0f, a->normal);
    const double square = (double)bsq_dot3(step, step);
    return square > 0.0 ? (double)bsq_dot3(turn, step) / square : 0.0;
}

static float curvature_of(const struct work *work, uint64_t texel)
{
    const struct probe *probes = &work->probes[texel * PROBES];
    const struct probe hit = {.normal = normal_of(work, texel), .found = true};
    double sum = 0;
    uint32_t count = 0;
    for (uint32_t i = 0; i < PROBES; i += 2) {
        const struct probe *a = probes[i].found ? &probes[i] : &hit;
        const struct probe *b = probes[i + 1].found ? &probes[i + 1] : &hit;
        if (a == b)
            continue;
        sum += between(a, b);
        ++count;
    }
    return count > 0 ? (float)(sum / count) : 0.0f;
}

/* Counts the texels with hits, and those of which no ray around the hit found the scan. */
static void curvature_count_texels(struct work *work, uint64_t texels)
{
    for (uint64_t i = 0; i < texels; ++i) {
        bool found = false;
        for (uint32_t k = 0; k < PROBES; ++k)
            found |= work->probes[i * PROBES + k].found;
        work->counts.texels += curvature_is_valid(work, i);
        work->counts.alone += curvature_is_valid(work, i) && !found;
    }
}

static int resolve_texels(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    (void)worker;
    const struct work *work = arg;
    for (uint64_t i = begin; i < end; ++i)
        if (curvature_is_valid(work, i))
            work->texels[i * work->channels + work->curvature->offset] = curvature_of(work, i);
    return 0;
}

/* ---- texels that are traced together ---- */

static int trace_texels(struct work *work, uint64_t texels)
{
    const struct bake_curvature *curvature = work->curvature;
    memset(work->probes, 0, texels * PROBES * sizeof *work->probes);
    BSQ_PASS(trace_missing(work, texels, 1, curvature->radius));
    BSQ_PASS(trace_missing(work, texels, 2, sqrt(2.0) * curvature->radius));
    curvature_count_texels(work, texels);
    BSQ_PASS(run_step(work, texels, TEXELS_A_TASK, resolve_texels, work));
    BSQ_PASS(bake_surface_check(curvature->surface));
    bsq_progress_add(work->ctx, texels);
    return 0;
}

/* Rows of the image. */
struct band {
    struct work *works;
    float *texels;
};

static int trace_part(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    const struct band *band = arg;
    struct work *work = &band->works[worker];
    work->texels = band->texels + begin * work->channels;
    return trace_texels(work, end - begin);
}

/* Traces rows in parts: each worker by itself with a device, else all together one after the other.
 */
static int trace_band(void *arg, uint32_t first_row, uint32_t rows, float *texels)
{
    struct band band = {arg, texels};
    const struct work *work = band.works;
    const uint64_t count = (uint64_t)work->curvature->image->width * rows;
    int status = 0;
    (void)first_row;
    if (work->curvature->device)
        return bsq_parallel_ranges(work->ctx, count, work->most, trace_part, &band);
    for (uint64_t at = 0; at < count && status == 0; at += work->most)
        status = trace_part(&band, at, count - at < work->most ? count : at + work->most, 0);
    return status;
}

/* ---- memory ---- */

/* Allocates memory for `most` texels that are traced together. */
static int curvature_allocate(struct work *work, uint64_t most)
{
    struct bsq_ctx *ctx = work->ctx;
    const uint64_t rays = most * PROBES;
    work->channels = work->curvature->image->channels;
    work->most = most;
    BSQ_PASS(BSQ_ALLOC(ctx, "rays", rays, &work->rays));
    BSQ_PASS(BSQ_ALLOC(ctx, "hits", rays, &work->hits));
    BSQ_PASS(BSQ_ALLOC(ctx, "points", rays, &work->probes));
    BSQ_PASS(BSQ_ALLOC(ctx, "points", rays, &work->listed));
    if (!work->curvature->by_objects)
        return 0;
    return BSQ_ALLOC(ctx, "objects of rays", rays, &work->ray_objects);
}

int bake_curvature_trace(struct bsq_ctx *ctx, const struct bake_curvature *curvature,
                         struct bake_curvature_counts *counts)
{
    struct bake_device *device = curvature->device;
    const uint64_t all = (uint64_t)curvature->image->width * curvature->image->height;
    const unsigned works = device ? bsq_threads(ctx) : 1;
    /* Half of the rays that a caller should hold leave the other buffers enough of the budget. */
    uint64_t rays = bake_surface_capacity(curvature->surface, 0) / 2 / works;
    if (device && rays > bake_device_most_rays(device))
        rays = bake_device_most_rays(device);
    const uint64_t most = rays < PROBES ? 1 : rays / PROBES < all ? rays / PROBES : all;
    const uint32_t width = curvature->image->width, rows = device ? UINT32_MAX
                                                           : most < width
                                                               ? 1
                                                               : (uint32_t)(most / width);
    struct work *work;
    int status;
    bsq_progress_begin(ctx, "measuring curvature", "texels", all);
    BSQ_TRY(BSQ_CALLOC(ctx, "workers", works, &work));
    for (unsigned w = 0; w < works; w++) {
        work[w] = (struct work){.ctx = ctx, .curvature = curvature, .worker = w};
        BSQ_TRY(curvature_allocate(&work[w], most));
    }
    status = bake_image_bands(ctx, curvature->image, rows, true, trace_band, work);
done:
    bsq_progress_end(ctx);
    for (unsigned w = 0; work && w < works; w++) {
        counts->texels += work[w].counts.texels;
        counts->alone += work[w].counts.alone;
        BSQ_FREE(ctx, work[w].ray_objects, work[w].listed, work[w].probes, work[w].hits,
                 work[w].rays);
    }
    bsq_free(ctx, work);
    return status;
}

/* ---- the usual radius ---- */

double bake_curvature_radius(const struct bake_surface *surface, const struct bake_options *options,
                             const struct bake_lowmesh *mesh, const struct bake_udim *udim)
{
    const double two_texels = 2.0 * bake_udim_texel(options, mesh, udim);
    const double least = (!surface->grids ? 0.01 : 2.0) * surface->detail;
    return isfinite(two_texels) ? fmax(two_texels, least) : least;
}
