/* simplify.c - vox_simplify(): the order of its steps. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "base/context.h"
#include "base/job_files.h"
#include "formats/asset/low_mesh.h"
#include "libvoxel/simplify/limits.h"
#include "libvoxel/simplify/steps.h"
#include "libvoxel/temp_tris.h"

/* Triangles for the last collapse: enough that what comes before it does not show, see
 * docs/decisions; of large meshes fewer, for time. For an error, as many as its mesh may need. More
 * than WHOLE_TRIANGLES collapse in regions. */
enum {
    LAST_FACTOR = 6,
    LAST_FACTOR_LARGE = 4,
    LAST_TRIANGLES = 200000,
    LAST_TRIANGLES_LARGE = 4000000,
    WHOLE_TRIANGLES = 5000000,
    REGION_TRIANGLES = 1 << 20,
    MEASURED_TRIANGLES = 1 << 19, /* in a region; some 500 bytes each */
    ERROR_TRIANGLES = 1500000,
    ERROR_STEP = 4,
    ERROR_ROUNDS = 16
};
/* Shares of an error: how far a mesh may be before limits count, and the limits. */
static const double error_unlimited = 0.4, error_limit = 0.95;

struct simplifying {
    struct bsq_ctx *ctx;
    const struct vox_simplify_options *options;
    struct vox_simplify_report *report;
    struct fmt_tris_file *file;
    const struct fmt_tris_header *header;
    struct vox_level level; /* empty once the mesh is in memory */
    struct vox_mesh mesh;
    struct vox_removed removed; /* on the way to `mesh` */
    struct bsq_output_group outputs;
};

/* ---- small pieces ---- */

struct piece {
    float low[3], high[3];
    uint32_t triangles;
};

/* Counts pieces whose boxes are small or that are of few triangles, and gives them none. */
static void judge_pieces(struct simplifying *s, const uint32_t *parents, struct piece *pieces)
{
    const double least = s->options->min_component * s->report->diagonal;
    const double each = (double)s->report->triangles / s->mesh.triangle_count;
    for (uint32_t v = 0; v < s->mesh.vertex_count; v++) {
        struct piece *piece = &pieces[v];
        double square = 0;
        if (parents[v] != v)
            continue;
        for (int k = 0; k < 3; k++) {
            const double side = (double)piece->high[k] - (double)piece->low[k];
            square += side * side;
        }
        if (square >= least * least && each * piece->triangles >= (double)s->options->min_triangles)
            continue;
        s->report->dropped_pieces++;
        s->report->dropped_triangles += piece->triangles;
        piece->triangles = 0;
    }
}

static int drop_pieces(struct simplifying *s)
{
    struct vox_mesh *mesh = &s->mesh;
    uint32_t *parents = NULL, kept = 0;
    struct piece *pieces = NULL;
    int status = 0;
    if (!(s->options->min_component > 0) && s->options->min_triangles == 0)
        return 0;
    s->report->dropped_pieces = s->report->dropped_triangles = 0; /* regions have kept them */
    BSQ_TRY(BSQ_ALLOC(s->ctx, "pieces", mesh->vertex_count, &parents));
    BSQ_TRY(BSQ_ALLOC(s->ctx, "pieces", mesh->vertex_count, &pieces));
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        parents[v] = v;
        pieces[v] =
            (struct piece){{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}, 0};
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 1; k < 3; k++)
            parents[vox_find_root(parents, mesh->triangles[t][k])] =
                vox_find_root(parents, mesh->triangles[t][0]);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        struct piece *piece = &pieces[vox_find_root(parents, v)];
        for (int k = 0; k < 3; k++) {
            piece->low[k] = fminf(piece->low[k], mesh->positions[v][k]);
            piece->high[k] = fmaxf(piece->high[k], mesh->positions[v][k]);
        }
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        pieces[vox_find_root(parents, mesh->triangles[t][0])].triangles++;
    judge_pieces(s, parents, pieces);
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        if (pieces[vox_find_root(parents, mesh->triangles[t][0])].triangles > 0)
            vox_mesh_move_triangle(mesh, kept++, t);
    mesh->triangle_count = kept;
    if (kept == 0)
        status =
            bsq_fail(s->ctx, BSQ_EDATA,
                     "%s: no piece is as large as the least component, %g %% of the diagonal %g "
                     "and %" PRIu64 " triangles",
                     s->options->output_paths[0], 100 * s->options->min_component,
                     s->report->diagonal, s->options->min_triangles);
done:
    BSQ_FREE(s->ctx, pieces, parents);
    return status;
}

/* ---- steps ---- */

static int collapse_to(struct simplifying *s, struct vox_mesh *mesh, uint64_t target,
                       struct vox_limits *limits)
{
    const double start = bsq_seconds_now();
    const uint64_t more = mesh->triangle_count > target ? mesh->triangle_count - target : 0;
    bsq_progress_begin(s->ctx, "collapsing edges", "triangles", more);
    int status = vox_collapse(s->ctx, target < UINT32_MAX ? (uint32_t)target : UINT32_MAX, limits,
                              NULL, mesh, &s->removed);
    bsq_progress_end(s->ctx);
    s->report->seconds_collapse += bsq_seconds_now() - start;
    return status;
}

static int measure(struct simplifying *s, const struct vox_mesh *mesh, struct vox_simplified *out)
{
    const double start = bsq_seconds_now();
    out->triangles = mesh->triangle_count;
    out->vertices = mesh->vertex_count;
    if (s->options->unmeasured)
        return 0;
    int status = vox_measure(s->ctx, s->file, mesh, NULL, NULL, 0, MEASURED_TRIANGLES,
                             &out->from_scan, &out->from_mesh);
    s->report->seconds_measure += bsq_seconds_now() - start;
    return status;
}

/* Writes the mesh as the output of a level. */
static int write_level(struct simplifying *s, uint32_t level)
{
    const struct fmt_low_mesh mesh = {.positions = (const float(*)[3])s->mesh.positions,
                                      .triangles = (const uint32_t(*)[3])s->mesh.triangles,
                                      .vertex_count = s->mesh.vertex_count,
                                      .triangle_count = s->mesh.triangle_count};
    struct bsq_output *output;
    BSQ_PASS(fmt_low_mesh_write(s->ctx, s->options->output_paths[level], &mesh, s->header,
                                s->options->hard_angle, &output));
    return bsq_output_group_add(&s->outputs, output);
}

/* Takes the mesh into memory for collapses to a number of triangles. */
static int take_mesh(struct simplifying *s, uint64_t target)
{
    BSQ_PASS(vox_level_join(&s->level, &s->mesh));
    vox_level_free(&s->level, NULL);
    /* Where few edges collapse, the triangles that close slits would stay. */
    if (target < s->mesh.triangle_count / 2)
        BSQ_PASS(vox_mesh_close_slits(s->ctx, &s->mesh));
    return drop_pieces(s);
}

static double largest(const struct vox_simplified *level)
{
    return fmax(level->from_scan.max, level->from_mesh.max);
}

/* Marks triangles of the mesh where a distance may be above a limit. Sets *count to how many. The
 * caller frees marks->triangles. */
static int mark_triangles(struct simplifying *s, const struct vox_mesh *mesh,
                          struct vox_marks *marks, uint32_t *count)
{
    const double start = bsq_seconds_now();
    struct vox_distances ignored[2];
    BSQ_PASS(BSQ_CALLOC(s->ctx, "marks of triangles", mesh->triangle_count, &marks->triangles));
    BSQ_PASS(vox_measure(s->ctx, s->file, mesh, marks, NULL, 0, MEASURED_TRIANGLES, &ignored[0],
                         &ignored[1]));
    *count = 0;
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        *count += marks->triangles[t];
    s->report->seconds_measure += bsq_seconds_now() - start;
    return 0;
}

/* Collapses edges of a copy of the mesh, which takes its place if no distance is above `error`
 * then. Sets *marked to how many of its triangles are marked. Tightens limits there by `share`. */
static int try_collapse(struct simplifying *s, uint64_t target, struct vox_limits *limits,
                        float share, double error, uint32_t *marked)
{
    const struct vox_removed before = s->removed;
    struct vox_marks marks = {.limit = error / 1.0101}; /* bounds are true to 1 % */
    struct vox_mesh trial = {0};
    int status = 0;
    BSQ_TRY(vox_mesh_copy(s->ctx, &s->mesh, 0, &trial));
    BSQ_TRY(collapse_to(s, &trial, target, limits));
    BSQ_TRY(mark_triangles(s, &trial, &marks, marked));
    if (*marked > 0) {
        s->removed = before;
        if (limits)
            vox_limits_tighten(limits, &trial, marks.triangles, share);
    } else {
        vox_mesh_free(s->ctx, &s->mesh);
        s->mesh = trial;
        trial = (struct vox_mesh){0};
    }
done:
    bsq_free(s->ctx, (void *)marks.triangles);
    vox_mesh_free(s->ctx, &trial);
    return status;
}

/* Makes a mesh whose distances stay within the error. Limits take time, so edges collapse without
 * them as long as that leaves most of the error. Then each place has its own limit, which falls
 * where the result was too far away, at last to 0. */
static int simplify_to_error(struct simplifying *s)
{
    const double error = s->options->error;
    struct vox_simplified *kept = &s->report->levels[0];
    struct vox_limits limits = {0};
    uint64_t before;
    uint32_t marked = 1;
    int status = 0;
    *kept = (struct vox_simplified){.target = 0};
    s->report->level_count = 1;
    BSQ_TRY(take_mesh(s, 0));
    BSQ_TRY(measure(s, &s->mesh, kept));
    if (largest(kept) > error) {
        status = bsq_fail(s->ctx, BSQ_EDATA,
                          "--error: %g cannot be kept: a mesh of %" PRIu64
                          " triangles is off by %g already; allow a larger error",
                          error, kept->triangles, largest(kept));
        goto done;
    }
    do {
        before = s->mesh.triangle_count;
        BSQ_TRY(try_collapse(s, before / ERROR_STEP, NULL, 1, error_unlimited * error, &marked));
    } while (s->mesh.triangle_count < before / 2);
    BSQ_TRY(vox_limits_begin(s->ctx, &s->mesh, error_limit * error, &limits));
    marked = 1;
    for (int round = 0; round < ERROR_ROUNDS && marked > 0; round++)
        BSQ_TRY(try_collapse(s, 2, &limits, round < ERROR_ROUNDS / 2 ? 0.5F : 0, error, &marked));
    BSQ_TRY(measure(s, &s->mesh, kept));
    /* That none is above it is known from the marks; these bounds may be higher. */
    kept->from_scan.max = fmin(kept->from_scan.max, error);
    kept->from_mesh.max = fmin(kept->from_mesh.max, error);
    status = write_level(s, 0);
done:
    vox_limits_free(&limits);
    return status;
}

/* Collapses regions to a number of triangles. What small pieces keep of these is missing then. */
static int collapse_level(struct simplifying *s, uint64_t target)
{
    const double start = bsq_seconds_now();
    BSQ_PASS(vox_collapse_regions(&s->level, target, REGION_TRIANGLES, &s->removed));
    s->report->seconds_collapse += bsq_seconds_now() - start;
    BSQ_PASS(vox_level_join(&s->level, &s->mesh));
    return drop_pieces(s);
}

static int simplify_to_targets(struct simplifying *s)
{
    for (uint32_t i = 0; i < s->options->target_count; i++) {
        struct vox_simplified *level = &s->report->levels[i];
        *level = (struct vox_simplified){.target = s->options->targets[i]};
        s->report->level_count = i + 1;
        if (s->level.triangles > WHOLE_TRIANGLES) {
            BSQ_PASS(collapse_level(s, level->target));
        } else {
            if (s->level.parts)
                BSQ_PASS(take_mesh(s, level->target));
            BSQ_PASS(collapse_to(s, &s->mesh, level->target, NULL));
        }
        BSQ_PASS(measure(s, &s->mesh, level));
        BSQ_PASS(write_level(s, i));
        if (s->level.parts)
            vox_mesh_free(s->ctx, &s->mesh);
    }
    return 0;
}

/* ---- the whole ---- */

static int check_options(struct bsq_ctx *ctx, const struct vox_simplify_options *options)
{
    const uint32_t outputs = options->target_count > 0 ? options->target_count : 1;
    if (options->target_count > VOX_LEVELS_MAX)
        return bsq_fail(ctx, BSQ_EUSAGE, "%u meshes are more than %u", options->target_count,
                        VOX_LEVELS_MAX);
    if (options->target_count == 0 && !(options->error > 0))
        return bsq_fail(ctx, BSQ_EUSAGE, "neither a number of triangles nor an error is given");
    for (uint32_t i = 0; i < options->target_count; i++)
        if (options->targets[i] < 4 || (i > 0 && options->targets[i] >= options->targets[i - 1]))
            return bsq_fail(ctx, BSQ_EUSAGE,
                            "numbers of triangles must fall, and be at least 4: %" PRIu64,
                            options->targets[i]);
    if (options->unmeasured && options->target_count == 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "an error is kept by measuring");
    for (uint32_t i = 0; i < outputs; i++) {
        const char *path = options->output_paths[i];
        if (!fmt_low_mesh_path_is_known(path))
            return bsq_fail(ctx, BSQ_EUSAGE,
                            "%s: the name of a mesh must end in .obj, .ply or .glb", path);
        int status = bsq_output_check(ctx, path);
        if (status == 0)
            status = bsq_note_output(ctx, path);
        if (status < 0)
            return status;
    }
    return 0;
}

static double header_diagonal(const struct fmt_tris_header *header)
{
    double square = 0;
    for (int k = 0; k < 3; k++) {
        const double side = (double)header->bounds_max[k] - (double)header->bounds_min[k];
        square += side * side;
    }
    return sqrt(square);
}

int vox_scan_size(struct bsq_ctx *ctx, const char *tris_path, const struct vox_temp_tris *temp_tris,
                  uint64_t *triangles, double *diagonal)
{
    struct fmt_tris_file *file;
    BSQ_PASS(temp_tris ? fmt_tris_open_temp(ctx, &temp_tris->file, &file)
                       : fmt_tris_open(ctx, tris_path, &file));
    *triangles = fmt_tris_get_header(file)->triangle_count;
    *diagonal = header_diagonal(fmt_tris_get_header(file));
    fmt_tris_close(file);
    return 0;
}

static int open_scan(struct simplifying *s)
{
    const struct vox_temp_tris *temp = s->options->temp_tris;
    BSQ_PASS(temp ? fmt_tris_open_temp(s->ctx, &temp->file, &s->file)
                  : fmt_tris_open(s->ctx, s->options->tris_path, &s->file));
    s->header = fmt_tris_get_header(s->file);
    s->report->triangles = s->header->triangle_count;
    s->report->diagonal = header_diagonal(s->header);
    return 0;
}

static int reduce(struct simplifying *s)
{
    const struct vox_simplify_options *options = s->options;
    const double start = bsq_seconds_now();
    uint64_t last = ERROR_TRIANGLES;
    if (options->target_count > 0) {
        const uint64_t target = options->targets[0] < UINT32_MAX ? options->targets[0] : UINT32_MAX;
        last = LAST_FACTOR * target < LAST_TRIANGLES_LARGE ? LAST_FACTOR * target
                                                           : LAST_TRIANGLES_LARGE;
        last = last < LAST_TRIANGLES ? LAST_TRIANGLES : last;
        last = last < LAST_FACTOR_LARGE * target ? LAST_FACTOR_LARGE * target : last;
    }
    int status = vox_reduce_chunks(s->ctx, s->file, last, options->output_paths[0], &s->level);
    s->report->seconds_reduce = bsq_seconds_now() - start;
    return status;
}

void vox_simplify_defaults(struct vox_simplify_options *options)
{
    *options = (struct vox_simplify_options){.size = sizeof *options, .hard_angle = 180};
}

int vox_simplify(struct bsq_ctx *ctx, const struct vox_simplify_options *options,
                 struct vox_simplify_report *report)
{
    struct simplifying s = {
        .ctx = ctx, .options = options, .report = report, .level = {.ctx = ctx}};
    const uint64_t temp_before = bsq_temp_bytes(ctx);
    int status = 0;
    BSQ_TRY(bsq_clear_report(ctx, "vox_simplify_report", report, sizeof *report));
    BSQ_TRY(bsq_check_size(ctx, "vox_simplify_options", options->size, sizeof *options));
    BSQ_TRY(check_options(ctx, options));
    BSQ_TRY(open_scan(&s));
    BSQ_TRY(reduce(&s));
    BSQ_TRY(options->target_count > 0 ? simplify_to_targets(&s) : simplify_to_error(&s));
    status = bsq_output_group_commit(&s.outputs);
    report->dropped_pieces += s.removed.pieces;
    report->dropped_triangles += s.removed.triangles;
    report->cut_handles = s.removed.handles;
    report->temp_bytes = bsq_temp_bytes(ctx) - temp_before;
done:
    bsq_output_group_discard(&s.outputs);
    vox_mesh_free(ctx, &s.mesh);
    vox_level_free(&s.level, NULL);
    fmt_tris_close(s.file);
    return status;
}

/* Moves a mesh to the origin of the scan. */
static void move_mesh(struct vox_mesh *mesh, const double from[3], const double to[3])
{
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        for (int k = 0; k < 3; k++)
            mesh->positions[v][k] = (float)((double)mesh->positions[v][k] + (from[k] - to[k]));
}

int vox_measure_mesh(struct bsq_ctx *ctx, const char *scan_path, const struct vox_temp_tris *scan,
                     const struct vox_temp_tris *mesh, struct vox_measured_box *boxes,
                     uint32_t box_count, struct vox_distances *from_scan,
                     struct vox_distances *from_mesh)
{
    struct fmt_tris_file *file = NULL, *low = NULL;
    struct vox_level parts = {.ctx = ctx};
    struct vox_mesh whole = {0};
    int status = 0;
    BSQ_TRY(scan ? fmt_tris_open_temp(ctx, &scan->file, &file)
                 : fmt_tris_open(ctx, scan_path, &file));
    BSQ_TRY(fmt_tris_open_temp(ctx, &mesh->file, &low));
    BSQ_TRY(vox_reduce_chunks(ctx, low, UINT64_MAX, NULL, &parts));
    BSQ_TRY(vox_level_join(&parts, &whole));
    move_mesh(&whole, fmt_tris_get_header(low)->origin, fmt_tris_get_header(file)->origin);
    status = vox_measure(ctx, file, &whole, NULL, boxes, box_count, MEASURED_TRIANGLES, from_scan,
                         from_mesh);
done:
    vox_mesh_free(ctx, &whole);
    vox_level_free(&parts, NULL);
    fmt_tris_close(low);
    fmt_tris_close(file);
    return status;
}
