/* judge.c - whether the low-poly mesh fits the scan.
 *
 * A pair that fits costs no more than the measurement: other poses are traced only if the distances
 * are doubtful. A pose is scored by the share of points that have a surface near them, facing the
 * same way, and by the mean distance. Both must be much better than those of the mesh as it is, so
 * that symmetric shapes, rough meshes and meshes of a part of the scan pass. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "base/text.h"
#include "libbake/fit/probes.h"

enum { MOST_POSES = 160, TURNS = 24 };

/* Mean distance, as a share of the size, below which nothing is doubtful. */
#define DOUBT 0.004

/* Share of the points that may be far without a warning. */
#define MOST_FAR 0.2

/* ---- poses ---- */

/* Finds the bounds of the mesh in a pose. */
static void judge_bounds_of(const struct fit *fit, const struct pose *pose, double low[3],
                            double high[3])
{
    for (int corner = 0; corner < 8; ++corner) {
        double p[3];
        for (int k = 0; k < 3; ++k)
            p[k] = corner >> k & 1 ? fit->mesh->bounds_max[k] : fit->mesh->bounds_min[k];
        bake_transform_point(&pose->transform, p, p);
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
    judge_bounds_of(fit, pose, low, high);
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
    judge_bounds_of(fit, pose, low, high);
    for (int k = 0; k < 3; ++k) {
        const double way = 0.5 * (scan->scan_min[k] + scan->scan_max[k]) - 0.5 * (low[k] + high[k]);
        pose->transform.shift[k] += way;
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
            struct pose pose = {.transform.scale = scale,
                                .turn = turn,
                                .mirrored = mirrored,
                                .unit = unit,
                                .other_scale = other_scale};
            bake_turn_matrix(turn, pose.transform.turn);
            for (int r = 0; r < 3 && mirrored; ++r)
                pose.transform.turn[r][0] = -pose.transform.turn[r][0];
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
                bake_fit_set_ray(fit, &fit->probes[i * (fit->count / FEW)], &fit->poses[done + p],
                                 (uint64_t)p * FEW + i);
        const double limit = FAR * fit->scan_size + fit->surface->detail;
        status = bake_fit_trace(fit, (uint64_t)poses * FEW, -limit, limit, false);
        for (uint32_t p = 0; p < poses && status == 0; ++p) {
            struct pose *pose = &fit->poses[done + p];
            pose->score =
                bake_fit_score(fit, (uint64_t)p * FEW, FEW,
                               fmin(fit->scan_size, pose->transform.scale * fit->low_size));
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
    const locale_t host = bsq_plain_numbers();
    va_start(arguments, format);
    vsnprintf(out + used, 160 - used, format, arguments);
    va_end(arguments);
    uselocale(host);
}

/* Writes what a pose changes, as options. They also have what the options change by now. */
static void name_pose(const struct fit *fit, const struct pose *pose, char out[160])
{
    const double least = 0.001 * fit->scan_size; /* of shifts, which bounds do not tell exactly */
    struct bake_transform now, all;
    char word[8];
    bake_transform_of(fit->options, &now);
    bake_transform_join(&now, &pose->transform, &all);
    bake_turn_word((const double(*)[3])all.turn, word);
    out[0] = '\0';
    if (strcmp(word, "none") != 0)
        add_key(out, "turn=%s", word);
    if (all.scale != 1)
        add_key(out, "scale=%.4g", all.scale);
    for (int k = 0; k < 3; ++k)
        if (fabs(all.shift[k]) > least)
            add_key(out, "%c=%.4g", 'x' + k, all.shift[k]);
    if (out[0] == '\0')
        strcpy(out, "no --low");
}

/* Reports a pose in which the mesh fits. A shift and a scale that is not of a unit are near what
 * bounds tell, so they are only a warning. */
static int report_pose(const struct fit *fit, const struct pose *pose)
{
    struct bsq_ctx *ctx = fit->surface->ctx;
    const char *low = fit->options->mesh_path, *scan = bake_fit_scan(fit);
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
        bake_fit_set_ray(fit, &fit->probes[i * (fit->count / FEW)], NULL, i);
    const double limit = FAR * fit->scan_size + fit->surface->detail;
    BSQ_PASS(bake_fit_trace(fit, FEW, -limit, limit, true));
    const struct score score = bake_fit_score(fit, 0, FEW, fmin(fit->scan_size, fit->low_size));
    return fits_better(&score, &fit->score)
               ? bsq_fail(fit->surface->ctx, BSQ_EDATA,
                          "the faces of %s and %s look into opposite directions: %.0f %% of "
                          "the low-poly surface has the scan's back near it: --two-sided "
                          "takes it; to bake it all the same: --as-is",
                          fit->options->mesh_path, bake_fit_scan(fit), 100 * score.near)
               : 0;
}

int bake_fit_judge(struct fit *fit, bool *fits)
{
    struct bsq_ctx *ctx = fit->surface->ctx;
    const struct score *now = &fit->score;
    int status;
    *fits = true;
    if (now->distance < DOUBT && now->near > 1 - FAR)
        return 0;
    BSQ_TRY(judge_inverted(fit));
    BSQ_TRY(BSQ_ALLOC(ctx, "poses", MOST_POSES, &fit->poses));
    list_poses(fit);
    BSQ_TRY(score_poses(fit));
    const struct pose *best = best_pose(fit);
    const bool wrong = best && ((fit->measured && now->near < 0.8) || is_mistake(best));
    *fits = !wrong && !(fit->measured && now->far > MOST_FAR);
    if (wrong)
        status = report_pose(fit, best);
    else if (!*fits)
        bsq_warn(ctx,
                 "%.0f %% of the surface of %s is farther from %s than %.0f %% of its size, or "
                 "finds nothing: is it the mesh of this scan, in the same place?",
                 100 * now->far, fit->options->mesh_path, bake_fit_scan(fit), 100 * FAR);
done:
    bsq_free(ctx, fit->poses);
    fit->poses = NULL;
    return status;
}
