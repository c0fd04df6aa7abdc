/* probes.c - see probes.h. */
#include "libbake/fit/probes.h"

#include <math.h>
#include <string.h>

#include "base/sort_array.h"
#include "base/geometry/vec.h"

const char *bake_fit_scan(const struct fit *fit)
{
    return fit->options->more_scan_count > 0 ? "the scans" : fit->options->scan_path;
}

static float fraction(double v)
{
    return (float)(v - floor(v));
}

static void set_probe(const struct fit *fit, uint64_t triangle, const float weights[3],
                      struct probe *out)
{
    double(*positions)[3] = fit->mesh->positions[triangle];
    float(*directions)[3] = fit->mesh->directions[triangle];
    out->reach = 0;
    for (int k = 0; k < 3; ++k) {
        double p = 0, n = 0;
        for (int c = 0; c < 3; ++c) {
            /* Subtracts the translation first: far from the origin, the rounding of the weights'
             * sum would move the point by a long way. */
            p += (double)weights[c] * (positions[c][k] - fit->surface->translation[k]);
            n += (double)weights[c] * (double)directions[c][k];
        }
        out->at[k] = p;
        out->normal[k] = (float)n;
        out->reach += weights[k] * fit->mesh->reaches[triangle][k];
    }
    out->object = fit->mesh->object_of ? fit->mesh->object_of[triangle] : 0;
}

static int compare_probes(const void *a, const void *b)
{
    const struct probe *x = a, *y = b;
    return (x->order > y->order) - (x->order < y->order);
}

/* Sorts the probes along the curve, so that neighbours cross few chunks. */
static void sort_probes(const struct fit *fit)
{
    for (uint32_t i = 0; i < fit->count; ++i) {
        struct probe *probe = &fit->probes[i];
        float at[3];
        for (int k = 0; k < 3; ++k)
            at[k] = (float)(probe->at[k] / fit->surface->unit);
        probe->order = bake_surface_curve_index(fit->surface, at) * PROBES + i;
    }
    bsq_sort(fit->probes, fit->count, sizeof *fit->probes, compare_probes);
}

/* Spreads the probes over the triangles in equal steps of area, and inside them by a
 * low-discrepancy sequence (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences",
 * 2018). */
void bake_fit_spread(const struct fit *fit)
{
    const struct bake_lowmesh *mesh = fit->mesh;
    double total = 0, passed = 0;
    for (uint64_t t = 0; t < mesh->triangle_count; ++t)
        total += bake_lowmesh_area(mesh, t);
    uint64_t next = 0, placed = 0;
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
            if (fit->count == PROBES || next / RUN % (PROBES / FEW) == 0)
                set_probe(fit, t, (const float[3]){1.0f - u - v, u, v}, &fit->probes[placed++]);
        }
    }
    sort_probes(fit);
}

void bake_fit_set_ray(const struct fit *fit, const struct probe *probe, const struct pose *pose,
                      uint64_t index)
{
    const struct bake_surface *surface = fit->surface;
    struct bake_ray *ray = &fit->rays[index];
    struct bsq_vec3 n = bsq_load3(probe->normal);
    double at[3];
    memcpy(at, probe->at, sizeof at);
    if (pose) {
        const double(*turn)[3] = pose->transform.turn;
        const double normal[3] = {(double)n.x, (double)n.y, (double)n.z};
        for (int k = 0; k < 3; ++k)
            at[k] += surface->translation[k];
        bake_transform_point(&pose->transform, at, at);
        for (int k = 0; k < 3; ++k)
            at[k] -= surface->translation[k];
        n = bsq_v3((float)bsq_dotd(turn[0], normal), (float)bsq_dotd(turn[1], normal),
                   (float)bsq_dotd(turn[2], normal));
    }
    n = bsq_unit3(n);
    fit->reaches[index] = pose ? 0 : probe->reach;
    *ray = (struct bake_ray){.direction = {n.x, n.y, n.z}};
    for (int k = 0; k < 3; ++k)
        ray->origin[k] = (float)(at[k] / surface->unit);
    if (fit->objects)
        fit->objects[index] = probe->object;
}

int bake_fit_trace(const struct fit *fit, uint64_t count, double from, double to, bool inverted)
{
    int status = 0;
    for (uint64_t at = 0; at < count && status == 0;) {
        const uint64_t most = bake_surface_capacity(fit->surface, 0), left = count - at;
        const struct bake_ray_batch probes = {.rays = fit->rays + at,
                                              .hits = fit->hits + at,
                                              .count = left < most ? left : most,
                                              .t_min = from,
                                              .t_max = to,
                                              .reaches = fit->reaches + at,
                                              .facing_origin = inverted,
                                              .distances_only = true,
                                              .sampled = true,
                                              .objects = fit->objects ? fit->objects + at : NULL};
        status = bake_surface_trace(fit->surface, &probes);
        at += probes.count;
    }
    return status == 0 ? bake_surface_check(fit->surface) : status;
}

struct score bake_fit_score(const struct fit *fit, uint64_t first, uint64_t count, double size)
{
    const double detail = fit->surface->detail;
    struct score score = {0};
    if (!(size > 8 * detail)) /* smaller than anything that the scan has */
        return (struct score){0, 1, FAR};
    for (uint64_t i = first; i < first + count; ++i) {
        const bool hit = fit->hits[i].triangle != BAKE_NO_HIT;
        const double distance = hit ? fabs(fit->hits[i].t) : INFINITY;
        score.near += distance <= NEAR * size + detail;
        score.far += distance > FAR * size + detail;
        score.distance += fmin(distance / size, FAR);
    }
    score.near /= (double)count;
    score.far /= (double)count;
    score.distance /= (double)count;
    return score;
}
