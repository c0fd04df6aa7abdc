/* fit.c - see fit.h.
 *
 * Lengths follow a percentile, not the largest distance: through a hole in the scan, a ray hits
 * some other surface far away. Such rays are few, and short rays keep these hits out of the map. A
 * part of the scan may stand out farther than rays are tried at first, as a tower does from a
 * plane. Then most of the rays that found nothing find it farther outwards. Holes of the scan look
 * different: rays through them go inwards.
 *
 * A pair that fits costs no more than the measurement: other poses are traced only if the distances
 * are doubtful. A pose is scored by the share of points that have a surface near them, facing the
 * same way, and by the mean distance. Both must be much better than those of the mesh as it is, so
 * that symmetric shapes, rough meshes and meshes of a part of the scan pass. */
#include "libbake/fit/fit.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "base/sort_array.h"
#include "base/vec.h"

/* Points of the mesh; those of a pose, and all if lengths are given and thickness is not baked.
 * These come in runs, which cross few chunks of the scan. */
enum { PROBES = 16384, FEW = 1024, RUN = 64, MOST_POSES = 160, TURNS = 24 };

/* Shares of the size of the mesh or the scan, whichever is smaller: what is near, the distance that
 * all larger ones count as, and the mean distance below which nothing is doubtful. */
#define NEAR  0.02
#define FAR   0.05
#define DOUBT 0.004

/* Layers of a scan are at least this share of its size apart. */
#define NEARER 0.002

/* Shares of the points that may be far, see several layers, or see no other side of the solid,
 * without a warning. */
#define MOST_FAR    0.2
#define MOST_LAYERS 0.1
#define MOST_OPEN   0.01

/* How far rays are tried, as shares of the diagonal of the scan's bounds. */
#define USUAL_LIMIT 0.1
#define FAR_LIMIT   0.5

/* A point of the mesh. */
struct probe {
    double at[3]; /* relative to the surface's translation, world units */
    float normal[3], reach;
    uint32_t object;
    double t; /* of the hit of its ray; INFINITY: none */
};

/* How well a pose fits. */
struct score {
    double near;     /* share of the points that have a surface near them */
    double far;      /* share of those that have none up to FAR */
    double distance; /* mean, as a share of the size */
};

/* The mesh turned, scaled or shifted. */
struct pose {
    struct bake_placement place;
    unsigned turn;
    bool mirrored; /* along x, before the turn */
    bool other_scale, unit, shifted;
    struct score score;
};

struct fit {
    const struct bake_surface *surface;
    const struct bake_lowmesh *mesh;
    const struct bake_options *options;
    double scan_size, low_size; /* diagonals */
    bool measured;              /* lengths are chosen, by all probes */
    uint32_t count;             /* of probes, rays and hits: PROBES or FEW */
    struct probe *probes;
    struct bake_exact_ray *rays;
    struct bake_exact_hit *hits;
    uint32_t *objects; /* of rays; NULL: all see all scans */
    float *reaches;    /* of rays */
    float *distances;
    struct pose *poses;
    uint32_t pose_count;
    struct score score; /* of the mesh as it is */
};

static const char *scan_name(const struct fit *fit)
{
    return fit->options->more_scan_count > 0 ? "the scans" : fit->options->scan_path;
}

static double diagonal(const double low[3], const double high[3])
{
    double square = 0;
    for (int k = 0; k < 3; ++k)
        square += (high[k] - low[k]) * (high[k] - low[k]);
    return sqrt(square);
}

/* ---- probes ---- */

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

/* Spreads the probes over the triangles in equal steps of area, and inside them by a
 * low-discrepancy sequence (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences",
 * 2018). */
static void place_probes(const struct fit *fit)
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
}

/* Writes ray number `index`, from a probe that a pose moves; NULL: as it is. */
static void set_ray(const struct fit *fit, const struct probe *probe, const struct pose *pose,
                    uint64_t index)
{
    const struct bake_surface *surface = fit->surface;
    struct bake_exact_ray *ray = &fit->rays[index];
    struct bsq_vec3 n = bsq_v3(probe->normal[0], probe->normal[1], probe->normal[2]);
    double at[3];
    memcpy(at, probe->at, sizeof at);
    if (pose) {
        const double(*turn)[3] = pose->place.turn;
        const double normal[3] = {(double)n.x, (double)n.y, (double)n.z};
        for (int k = 0; k < 3; ++k)
            at[k] += surface->translation[k];
        bake_place(&pose->place, at, at);
        for (int k = 0; k < 3; ++k)
            at[k] -= surface->translation[k];
        n = bsq_v3((float)bsq_dotd(turn[0], normal), (float)bsq_dotd(turn[1], normal),
                   (float)bsq_dotd(turn[2], normal));
    }
    n = bsq_unit3(n);
    fit->reaches[index] = pose ? 0 : probe->reach;
    *ray = (struct bake_exact_ray){.direction = {n.x, n.y, n.z}};
    for (int k = 0; k < 3; ++k)
        ray->origin[k] = (float)(at[k] / surface->unit);
    if (fit->objects)
        fit->objects[index] = probe->object;
}

/* Traces rays over a range of distances, as many at a time as memory allows. inverted: surfaces
 * must face the other way. Nothing is said of hits on a scan that has changed. */
static int trace(const struct fit *fit, uint64_t count, double from, double to, bool inverted)
{
    int status = 0;
    for (uint64_t at = 0; at < count && status == 0;) {
        const uint64_t most = bake_surface_capacity(fit->surface, 0), left = count - at;
        const struct bake_surface_rays probes = {.batch = {.rays = fit->rays + at,
                                                           .hits = fit->hits + at,
                                                           .count = left < most ? left : most,
                                                           .t_min = from,
                                                           .t_max = to,
                                                           .reaches = fit->reaches + at,
                                                           .facing_origin = inverted,
                                                           .distances_only = true},
                                                 .objects =
                                                     fit->objects ? fit->objects + at : NULL};
        status = bake_surface_trace(fit->surface, &probes);
        at += probes.batch.count;
    }
    return status == 0 ? bake_surface_check(fit->surface) : status;
}

/* Scores the hits of rays from `first` on, of a mesh of this size. */
static struct score score_hits(const struct fit *fit, uint64_t first, uint64_t count, double size)
{
    const double detail = fit->surface->detail;
    struct score score = {0};
    if (!(size > 8 * detail)) /* smaller than anything that the scan has */
        return (struct score){0, 1, FAR};
    for (uint64_t i = first; i < first + count; ++i) {
        const bool hit = fit->hits[i].triangle != BAKE_EXACT_NONE;
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

/* ---- lengths ---- */

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

/* Adds the distances of hits to `count` of them. Returns their number. */
static size_t add_distances(const struct fit *fit, uint32_t rays, size_t count)
{
    for (uint32_t i = 0; i < rays; ++i)
        if (fit->hits[i].triangle != BAKE_EXACT_NONE)
            fit->distances[count++] = (float)fit->hits[i].t;
    return count;
}

/* Looks farther outwards from where nothing was found. Takes what is there if most of these probes
 * find something. Replaces the hits. */
static int look_farther(const struct fit *fit, size_t *count)
{
    const double detail = 2.0 * fit->surface->detail;
    uint32_t missing = 0;
    for (uint32_t i = 0; i < fit->count; ++i)
        if (isinf(fit->probes[i].t))
            set_ray(fit, &fit->probes[i], NULL, missing++);
    if (missing < PROBES / 1000 || *count < PROBES / 100)
        return 0;
    const int status = trace(fit, missing, USUAL_LIMIT * fit->scan_size + detail,
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
    const int status = look_farther(fit, &count);
    bsq_sort(fit->distances, count, sizeof *fit->distances, compare_floats);
    *front = *back = 0.05 * fit->scan_size;
    if (count >= PROBES / 100) {
        *front = side_length(fit->distances, count, 1, fit->surface->detail);
        *back = side_length(fit->distances, count, -1, fit->surface->detail);
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
    const struct bsq_vec3 n = bsq_unit3(bsq_v3(probe.normal[0], probe.normal[1], probe.normal[2]));
    const float way[3] = {n.x, n.y, n.z};
    for (int k = 0; k < 3; ++k) {
        probe.at[k] += found ? probe.t * (double)way[k] : 0;
        probe.normal[k] = !found ? 0 : outwards ? way[k] : -way[k];
    }
    probe.reach = 0;
    set_ray(fit, &probe, NULL, index);
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
    int status = trace(fit, FEW, least, reach, false);
    for (uint32_t i = 0; i < FEW && status == 0; ++i)
        layered += fit->hits[i].triangle != BAKE_EXACT_NONE;
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
    int status = trace(fit, FEW, from, 2.0 * fit->scan_size, false);
    for (uint32_t i = 0; i < FEW && status == 0; ++i)
        left += !isinf(fit->probes[i * (fit->count / FEW)].t) &&
                fit->hits[i].triangle == BAKE_EXACT_NONE;
    if (left > MOST_OPEN * hits)
        bsq_warn(fit->surface->ctx,
                 "map thickness: %.0f %% of the rays straight into %s leave through holes or open "
                 "borders: close them, or set how far walls count with --distance thickness",
                 100.0 * left / hits, scan_name(fit));
    return status;
}

/* ---- poses ---- */

/* Finds the bounds of the mesh in a pose. */
static void bounds_of(const struct fit *fit, const struct pose *pose, double low[3], double high[3])
{
    for (int corner = 0; corner < 8; ++corner) {
        double p[3];
        for (int k = 0; k < 3; ++k)
            p[k] = corner >> k & 1 ? fit->mesh->bounds_max[k] : fit->mesh->bounds_min[k];
        bake_place(&pose->place, p, p);
        for (int k = 0; k < 3; ++k) {
            low[k] = corner == 0 ? p[k] : fmin(low[k], p[k]);
            high[k] = corner == 0 ? p[k] : fmax(high[k], p[k]);
        }
    }
}

/* Returns by how much the bounds of the mesh in a pose differ from the scan's, as a share of its
 * size. inside: or by how much they reach out of them. */
static double bounds_differ(const struct fit *fit, const struct pose *pose, bool inside)
{
    const struct bake_surface *scan = fit->surface;
    double low[3], high[3], most = 0;
    bounds_of(fit, pose, low, high);
    for (int k = 0; k < 3; ++k) {
        const double below = scan->scan_min[k] - low[k], above = high[k] - scan->scan_max[k];
        most = fmax(most, inside ? below : fabs(below));
        most = fmax(most, inside ? above : fabs(above));
    }
    return most / fit->scan_size;
}

/* Moves a pose so that the middle of the mesh's bounds becomes that of the scan's. Returns the
 * distance. */
static double centre(const struct fit *fit, struct pose *pose)
{
    const struct bake_surface *scan = fit->surface;
    double low[3], high[3], square = 0;
    bounds_of(fit, pose, low, high);
    for (int k = 0; k < 3; ++k) {
        const double way = 0.5 * (scan->scan_min[k] + scan->scan_max[k]) - 0.5 * (low[k] + high[k]);
        pose->place.shift[k] += way;
        square += way * way;
    }
    pose->shifted = true;
    return sqrt(square);
}

static void add_pose(struct fit *fit, const struct pose *pose)
{
    if (fit->pose_count < MOST_POSES)
        fit->poses[fit->pose_count++] = *pose;
}

/* Adds the poses of a turn and a scale in which the mesh's bounds are like the scan's. A mesh in
 * its own units may be of a part of the scan. */
static void add_poses(struct fit *fit, struct pose pose)
{
    const double like = 0.06, close = 0.01;
    const bool same = pose.turn == 0 && !pose.mirrored && !pose.unit && !pose.other_scale;
    const double differ = bounds_differ(fit, &pose, false);
    if (!same && (differ < like ||
                  (!pose.unit && !pose.other_scale && bounds_differ(fit, &pose, true) < close)))
        add_pose(fit, &pose);
    if (centre(fit, &pose) > close * fit->scan_size && bounds_differ(fit, &pose, false) < like)
        add_pose(fit, &pose);
}

/* Adds all poses of a scale. */
static void add_turns(struct fit *fit, double scale, bool unit, bool other_scale)
{
    for (unsigned mirrored = 0; mirrored < 2; ++mirrored)
        for (unsigned turn = 0; turn < TURNS; ++turn) {
            struct pose pose = {.place.scale = scale,
                                .turn = turn,
                                .mirrored = mirrored,
                                .unit = unit,
                                .other_scale = other_scale};
            bake_turn_matrix(turn, pose.place.turn);
            for (int r = 0; r < 3 && mirrored; ++r)
                pose.place.turn[r][0] = -pose.place.turn[r][0];
            add_poses(fit, pose);
        }
}

static void list_poses(struct fit *fit)
{
    static const double units[] = {10,        100,        1000,      25.4,     0.3048,
                                   1.0 / 10., 1.0 / 100., 1.0 / 1e3, 1 / 25.4, 1 / 0.3048};
    const double ratio = fit->scan_size / fit->low_size, same = 0.03;
    bool known = fabs(ratio - 1) < same;
    add_turns(fit, 1, false, false);
    for (size_t i = 0; i < sizeof units / sizeof *units; ++i) {
        if (fabs(ratio / units[i] - 1) > 0.25) /* the bounds cannot be alike */
            continue;
        add_turns(fit, units[i], true, false);
        known |= fabs(ratio / units[i] - 1) < same;
    }
    if (!known)
        add_turns(fit, ratio, false, true);
}

/* Traces all poses and scores them. */
static int score_poses(struct fit *fit)
{
    int status = 0;
    for (uint32_t done = 0; done < fit->pose_count && status == 0; done += fit->count / FEW) {
        const uint32_t left = fit->pose_count - done;
        const uint32_t poses = left < fit->count / FEW ? left : fit->count / FEW;
        for (uint32_t p = 0; p < poses; ++p)
            for (uint32_t i = 0; i < FEW; ++i)
                set_ray(fit, &fit->probes[i * (fit->count / FEW)], &fit->poses[done + p],
                        (uint64_t)p * FEW + i);
        const double limit = FAR * fit->scan_size + fit->surface->detail;
        status = trace(fit, (uint64_t)poses * FEW, -limit, limit, false);
        for (uint32_t p = 0; p < poses && status == 0; ++p) {
            struct pose *pose = &fit->poses[done + p];
            pose->score = score_hits(fit, (uint64_t)p * FEW, FEW,
                                     fmin(fit->scan_size, pose->place.scale * fit->low_size));
        }
    }
    return status;
}

static bool fits_better(const struct score *a, const struct score *b)
{
    return a->near >= 0.85 && b->near < 0.95 && 1 - a->near <= 0.5 * (1 - b->near) &&
           a->distance <= 0.4 * b->distance;
}

/* Returns whether a pose is a mistake that programs make, and no matter of places. */
static bool is_mistake(const struct pose *pose)
{
    return pose->turn > 0 || pose->unit || pose->mirrored;
}

/* Counts what a pose changes; a mirrored mesh is the least likely. */
static int changes(const struct pose *pose)
{
    return (pose->turn > 0) + pose->unit + 2 * pose->other_scale + 2 * pose->shifted +
           3 * pose->mirrored;
}

/* Returns the pose in which the mesh fits much better than as it is, of several about equally good
 * ones the simplest; NULL: none. */
static const struct pose *best_pose(const struct fit *fit)
{
    const struct pose *best = NULL;
    double least = INFINITY;
    for (const struct pose *p = fit->poses; p < fit->poses + fit->pose_count; ++p)
        if (fits_better(&p->score, &fit->score))
            least = fmin(least, p->score.distance);
    for (const struct pose *p = fit->poses; p < fit->poses + fit->pose_count; ++p)
        if (fits_better(&p->score, &fit->score) && p->score.distance <= 1.3 * least + 0.001 &&
            (!best || changes(p) < changes(best)))
            best = p;
    return best;
}

/* ---- judgement ---- */

/* Adds "key=value" to the options --low. */
static void add_key(char out[160], const char *format, ...) __attribute__((format(printf, 2, 3)));
static void add_key(char out[160], const char *format, ...)
{
    size_t used = strlen(out);
    va_list arguments;
    used += (size_t)snprintf(out + used, 160 - used, "%s", used > 0 ? "," : "--low ");
    va_start(arguments, format);
    vsnprintf(out + used, 160 - used, format, arguments);
    va_end(arguments);
}

/* Writes what a pose changes, as options. They also have what the options change by now. */
static void name_pose(const struct fit *fit, const struct pose *pose, char out[160])
{
    const double least = 0.001 * fit->scan_size; /* of shifts, which bounds do not tell exactly */
    struct bake_placement now, all;
    char word[8];
    bake_placement_of(fit->options, &now);
    bake_placement_join(&now, &pose->place, &all);
    bake_turn_word((const double(*)[3])all.turn, word);
    out[0] = '\0';
    if (strcmp(word, "none") != 0)
        add_key(out, "turn=%s", word);
    if (all.scale != 1)
        add_key(out, "scale=%.4g", all.scale);
    for (int k = 0; k < 3; ++k)
        if (fabs(all.shift[k]) > least)
            add_key(out, "%c=%.4g", 'x' + k, all.shift[k]);
}

/* Reports a pose in which the mesh fits. A shift and a scale that is not of a unit are near what
 * bounds tell, so they are only a warning. */
static int report_pose(const struct fit *fit, const struct pose *pose)
{
    struct bsq_ctx *ctx = fit->surface->ctx;
    const char *low = fit->options->mesh_path, *scan = scan_name(fit);
    const double now = 100 * fit->score.near, then = 100 * pose->score.near;
    char options[160];
    if (pose->mirrored)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s does not fit %s: %.0f %% of its surface has the scan near it, and %.0f "
                        "%% if one of them is mirrored: mirror it, or --as-is",
                        low, scan, now, then);
    name_pose(fit, pose, options);
    if (is_mistake(pose))
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s does not fit %s: %.0f %% of its surface has the scan near it, and %.0f "
                        "%% with %s; to bake it all the same: --as-is",
                        low, scan, now, then, options);
    bsq_warn(ctx,
             "%s does not fit %s: %.0f %% of its surface has the scan near it, and %.0f %% with "
             "about %s",
             low, scan, now, then, options);
    return 0;
}

/* Fails if the mesh would fit inside out. */
static int judge_inverted(struct fit *fit)
{
    if (fit->options->two_sided)
        return 0;
    for (uint32_t i = 0; i < FEW; ++i)
        set_ray(fit, &fit->probes[i * (fit->count / FEW)], NULL, i);
    const double limit = FAR * fit->scan_size + fit->surface->detail;
    int status = trace(fit, FEW, -limit, limit, true);
    if (status < 0)
        return status;
    const struct score score = score_hits(fit, 0, FEW, fmin(fit->scan_size, fit->low_size));
    return fits_better(&score, &fit->score)
               ? bsq_fail(fit->surface->ctx, BSQ_EDATA,
                          "the faces of %s and %s look into opposite directions: %.0f %% of "
                          "the low-poly surface has the scan's back near it: --two-sided "
                          "takes it; to bake it all the same: --as-is",
                          fit->options->mesh_path, scan_name(fit), 100 * score.near)
               : 0;
}

/* Looks for what is wrong if the mesh is not near the scan. *fits: nothing was said of it. */
static int judge(struct fit *fit, bool *fits)
{
    const struct score *now = &fit->score;
    *fits = true;
    if (now->distance < DOUBT && now->near > 1 - FAR)
        return 0;
    int status = judge_inverted(fit);
    if (status < 0)
        return status;
    list_poses(fit);
    status = score_poses(fit);
    if (status < 0)
        return status;
    const struct pose *best = best_pose(fit);
    *fits = !best || !((fit->measured && now->near < 0.8) || is_mistake(best));
    if (!*fits)
        return report_pose(fit, best);
    *fits = !(fit->measured && now->far > MOST_FAR);
    if (!*fits)
        bsq_warn(fit->surface->ctx,
                 "%.0f %% of the surface of %s is farther from %s than %.0f %% of its size, or "
                 "finds nothing: is it the mesh of this scan, in the same place?",
                 100 * now->far, fit->options->mesh_path, scan_name(fit), 100 * FAR);
    return 0;
}

static int allocate(struct fit *fit)
{
    struct bsq_ctx *ctx = fit->surface->ctx;
    int status;
    BSQ_TRY(bsq_alloc(ctx, "distances", fit->count, sizeof *fit->probes, &fit->probes));
    BSQ_TRY(bsq_alloc(ctx, "distances", fit->count, sizeof *fit->rays, &fit->rays));
    BSQ_TRY(bsq_alloc(ctx, "distances", fit->count, sizeof *fit->hits, &fit->hits));
    BSQ_TRY(bsq_alloc(ctx, "distances", fit->count, sizeof *fit->distances, &fit->distances));
    BSQ_TRY(bsq_alloc(ctx, "distances", fit->count, sizeof *fit->reaches, &fit->reaches));
    BSQ_TRY(bsq_alloc(ctx, "poses", MOST_POSES, sizeof *fit->poses, &fit->poses));
    if (fit->surface->sees)
        BSQ_TRY(bsq_alloc(ctx, "distances", fit->count, sizeof *fit->objects, &fit->objects));
done:
    return status;
}

/* Traces all probes, for lengths and for the score of the mesh as it is. */
static int trace_probes(struct fit *fit)
{
    for (uint32_t i = 0; i < fit->count; ++i)
        set_ray(fit, &fit->probes[i], NULL, i);
    const double limit = USUAL_LIMIT * fit->scan_size + 2.0 * fit->surface->detail;
    int status = trace(fit, fit->count, -limit, limit, false);

    if (status == 0)
        fit->score = score_hits(fit, 0, fit->count, fmin(fit->scan_size, fit->low_size));
    for (uint32_t i = 0; i < fit->count && status == 0; ++i)
        fit->probes[i].t = fit->hits[i].triangle == BAKE_EXACT_NONE ? INFINITY : fit->hits[i].t;
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
    BSQ_TRY(allocate(&fit));
    place_probes(&fit);
    BSQ_TRY(trace_probes(&fit));
    if (measured) {
        BSQ_TRY(choose_lengths(&fit, front, back));
        /* The low-poly mesh may be in the middle between two layers. */
        reach = fmin(2 * fmax(*front, *back), USUAL_LIMIT * fit.scan_size);
        if (!options->as_is)
            BSQ_TRY(measure_layers(&fit, reach, &layers));
    }
    if (!options->as_is)
        BSQ_TRY(judge(&fit, &fits));
    if (fits && solid)
        BSQ_TRY(judge_openness(&fit));
    if (fits && layers > MOST_LAYERS)
        bsq_warn(surface->ctx,
                 "in front of %.0f %% of the nearest surface, %s has another layer within %g: the "
                 "nearest to the low-poly mesh is baked; a cage, or a shorter --front, chooses",
                 100 * layers, scan_name(&fit), reach);
done:
    bsq_free(surface->ctx, fit.objects);
    bsq_free(surface->ctx, fit.poses);
    bsq_free(surface->ctx, fit.reaches);
    bsq_free(surface->ctx, fit.distances);
    bsq_free(surface->ctx, fit.hits);
    bsq_free(surface->ctx, fit.rays);
    bsq_free(surface->ctx, fit.probes);
    return status;
}
