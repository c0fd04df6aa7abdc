/* farm_plan.c - the members of a grid's plan. */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "base/channels.h"
#include "libvoxel/farm/farm.h"
#include "libvoxel/voxelize/plan/plan.h"

/* Tasks of other sources may make other voxels, whatever their version is called. */
static const char program_version[] = BSQ_VERSION " of sources "
#include "chunk_sources.inc"
    ;

static const struct fmt_farm_kind grid_kind = {.format = "Bisque grid plan",
                                               .format_version = 1,
                                               .program = "bisque-voxelize",
                                               .program_version = program_version,
                                               .work = "a grid",
                                               .magic = "BSQGPRT\n",
                                               .part_version = 1,
                                               .most_tasks = VOX_MAX_TASKS};

/* A place on the curve has three times as many bits, which JSON can hold. */
enum { CURVE_BITS_MAX = 20 };

#define MEMBER(kind, name, most)                                                                   \
    {                                                                                              \
#name, offsetof(struct vox_voxelize_options, name), FMT_FARM_##kind, most                  \
    }

/* The input files are written by themselves. */
static const struct fmt_farm_member members[] = {
    MEMBER(PATH, grid_path, 0),
    MEMBER(U32, resolution, 0),
    MEMBER(NUMBER, voxel_size, 0),
    MEMBER(CHOICE, grid_type, VOX_GRID_ONINDEX),
    MEMBER(CHOICE, scan_normals, BSQ_SCAN_NORMALS_FLAT),
    MEMBER(OPTIONAL, vdb_path, 0),
    MEMBER(BOOL, ids, 0),
    MEMBER(TEXT, channels, FMT_FARM_OR_NULL),
    MEMBER(OPTIONAL, scan_normal_map, 0),
};
enum { MEMBERS = sizeof members / sizeof *members };
_Static_assert(sizeof(struct vox_voxelize_options) == 96, "a new option needs a row in `members`");
_Static_assert(sizeof(enum vox_grid_type) == sizeof(unsigned), "a choice is an unsigned number");

uint32_t vox_channel_values(const struct vox_voxelize_options *options)
{
    const char *list = options->channels;
    return list ? bsq_channel_list_values(list, strlen(list)) : 0;
}

/* ---- making ---- */

/* Allocates what each task has. */
static int make_tasks(struct vox_farm_plan *plan)
{
    struct bsq_ctx *ctx = plan->base.ctx;
    const uint64_t tasks = plan->base.task_count;
    int status = bsq_calloc(ctx, "plan", tasks, sizeof *plan->costs, &plan->costs);
    return status < 0 ? status
                      : bsq_calloc(ctx, "plan", tasks + 1, sizeof *plan->cuts, &plan->cuts);
}

/* Copies the options and paths, so that the plan owns them as one that was read does. */
static int copy_options(struct vox_farm_plan *plan, const struct vox_voxelize_options *from)
{
    struct vox_voxelize_options *to = &plan->options;
    const char *const *paths = from->part_paths ? from->part_paths : &from->tris_path;
    const uint32_t count = from->part_paths ? from->part_count : 1;
    char **copies = calloc((size_t)count + 1, sizeof *copies);
    bool failed = copies == NULL;
    *to = *from;
    to->temp_tris = NULL;
    to->part_paths = (const char *const *)copies;
    to->part_count = count;
    for (uint32_t i = 0; i < count && !failed; i++)
        failed = !(copies[i] = strdup(paths[i]));
    to->tris_path = failed ? NULL : copies[0];
    to->grid_path = strdup(from->grid_path);
    to->vdb_path = from->vdb_path ? strdup(from->vdb_path) : NULL;
    to->channels = from->channels ? strdup(from->channels) : NULL;
    to->scan_normal_map = from->scan_normal_map ? strdup(from->scan_normal_map) : NULL;
    failed |= (from->channels && !to->channels) || (from->scan_normal_map && !to->scan_normal_map);
    failed |= !to->grid_path || (from->vdb_path && !to->vdb_path);
    return failed ? fmt_farm_fail_memory(&plan->base) : 0;
}

static void place_curve(struct vox_farm_plan *plan, const int32_t lo[3], const int32_t hi[3])
{
    uint32_t most = 0;
    for (int a = 0; a < 3; a++) {
        plan->first_region[a] = lo[a] >> VOX_REGION_LOG2;
        const uint32_t last = (uint32_t)((hi[a] >> VOX_REGION_LOG2) - plan->first_region[a]);
        most = last > most ? last : most;
    }
    while (most >> plan->curve_shift >> CURVE_BITS_MAX)
        plan->curve_shift++;
    plan->curve_bits = 1;
    while (most >> plan->curve_shift >> plan->curve_bits)
        plan->curve_bits++;
}

int vox_farm_plan_create(struct bsq_ctx *ctx, const char *path,
                         const struct vox_voxelize_options *options, uint32_t task_count,
                         const int32_t lo[3], const int32_t hi[3], struct vox_farm_plan **out)
{
    struct vox_farm_plan *plan;
    *out = NULL;
    if (task_count < 1 || task_count > VOX_MAX_TASKS)
        return bsq_fail(ctx, BSQ_EUSAGE, "%u tasks: must be 1 to %d", task_count, VOX_MAX_TASKS);
    int status = bsq_calloc(ctx, "plan", 1, sizeof *plan, &plan);
    if (status < 0)
        return status;
    status = fmt_farm_plan_init(ctx, &grid_kind, path, task_count, &plan->base);
    if (status == 0)
        status = copy_options(plan, options);
    if (status == 0)
        status = make_tasks(plan);
    place_curve(plan, lo, hi);
    if (status < 0)
        vox_farm_plan_free(plan);
    else
        *out = plan;
    return status;
}

void vox_farm_plan_free(struct vox_farm_plan *plan)
{
    if (!plan)
        return;
    struct bsq_ctx *ctx = plan->base.ctx;
    char **paths = (char **)(uintptr_t)plan->options.part_paths;
    for (uint32_t i = 0; paths && i < plan->options.part_count; i++)
        free(paths[i]);
    free(paths);
    fmt_farm_options_free(members, MEMBERS, &plan->options);
    bsq_free(ctx, plan->costs);
    bsq_free(ctx, plan->cuts);
    fmt_farm_plan_clear(&plan->base);
    bsq_free(ctx, plan);
}

/* ---- writing ---- */

static json_t *scans_to_json(const struct vox_farm_plan *plan)
{
    json_t *list = json_array();
    int failed = list == NULL;
    for (uint32_t i = 0; i < plan->options.part_count; i++) {
        char *name = fmt_farm_path_in_plan(plan->base.path, plan->options.part_paths[i]);
        failed |= json_array_append_new(list, name ? json_string(name) : NULL);
        free(name);
    }
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

static json_t *costs_to_json(const struct vox_farm_plan *plan)
{
    json_t *list = json_array();
    int failed = list == NULL;
    for (uint32_t i = 0; i < plan->base.task_count; i++) {
        const struct vox_task_cost *cost = &plan->costs[i];
        failed |= json_array_append_new(
            list, json_pack("{s:I, s:f, s:I, s:I, s:I, s:f}", "regions", (json_int_t)cost->regions,
                            "work", cost->work, "memory_bytes", (json_int_t)cost->memory_bytes,
                            "scratch_bytes", (json_int_t)cost->scratch_bytes, "part_bytes",
                            (json_int_t)cost->part_bytes, "cpu_seconds", cost->cpu_seconds));
    }
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

static json_t *cuts_to_json(const struct vox_farm_plan *plan)
{
    json_t *list = json_array();
    int failed = list == NULL;
    for (uint32_t i = 1; i < plan->base.task_count; i++) {
        const bool end = plan->cuts[i] == UINT64_MAX;
        failed |= json_array_append_new(list, end ? json_null()
                                                  : json_integer((json_int_t)plan->cuts[i]));
    }
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

int vox_farm_plan_write(struct vox_farm_plan *plan, bool *kept)
{
    const int32_t *first = plan->first_region;
    *kept = false;
    int status = fmt_farm_check_name(plan->base.ctx, plan->options.grid_path);
    if (status == 0)
        status = fmt_farm_check_name(plan->base.ctx, plan->options.vdb_path);
    if (status < 0)
        return status;
    return fmt_farm_plan_write(
        &plan->base,
        json_pack("{s:f, s:[f, f, f], s:[i, i, i], s:i, s:i, s:o, s:o, s:o, s:o}", "voxel_size",
                  plan->voxel_size, "start", plan->start[0], plan->start[1], plan->start[2],
                  "first_region", first[0], first[1], first[2], "curve_bits", (int)plan->curve_bits,
                  "curve_shift", (int)plan->curve_shift, "cuts", cuts_to_json(plan), "expected",
                  costs_to_json(plan), "scans", scans_to_json(plan), "options",
                  fmt_farm_options_to_json(members, MEMBERS, &plan->options, plan->base.path)),
        kept);
}

/* ---- reading ---- */

static int read_scans(struct vox_farm_plan *plan, const json_t *list)
{
    const size_t count = json_array_size(list);
    char **paths = calloc(count + 1, sizeof *paths);
    bool good = paths && count > 0 && count <= UINT32_MAX;
    plan->options.part_paths = (const char *const *)paths;
    for (size_t i = 0; i < count && good; i++) {
        const char *name = json_string_value(json_array_get(list, i));
        plan->options.part_count++;
        good = name != NULL &&
               (paths[i] = fmt_farm_path_from_plan(plan->base.ctx, plan->base.path, name)) != NULL;
    }
    plan->options.tris_path = good ? paths[0] : NULL;
    return good ? 0 : fmt_farm_fail_plan(&plan->base, "scans");
}

static int read_cuts(struct vox_farm_plan *plan, const json_t *list)
{
    const uint32_t tasks = plan->base.task_count;
    bool good = json_array_size(list) == tasks - 1;
    for (uint32_t i = 1; i < tasks && good; i++) {
        const json_t *cut = json_array_get(list, i - 1);
        plan->cuts[i] = UINT64_MAX;
        good = json_is_null(cut) || fmt_farm_is_count(cut, INT64_MAX, &plan->cuts[i]);
        good = good && plan->cuts[i] >= plan->cuts[i - 1];
    }
    plan->cuts[tasks] = UINT64_MAX;
    return good ? 0 : fmt_farm_fail_plan(&plan->base, "cuts");
}

static int read_costs(struct vox_farm_plan *plan, const json_t *list)
{
    const struct fmt_farm_plan *base = &plan->base;
    int status =
        json_array_size(list) == base->task_count ? 0 : fmt_farm_fail_plan(base, "expected");
    for (uint32_t i = 0; i < base->task_count && status == 0; i++) {
        const json_t *json = json_array_get(list, i);
        struct vox_task_cost *cost = &plan->costs[i];
        cost->work = json_number_value(json_object_get(json, "work"));
        cost->cpu_seconds = json_number_value(json_object_get(json, "cpu_seconds"));
        status = fmt_farm_read_count(base, json, "regions", 0, INT64_MAX, &cost->regions);
        if (status == 0)
            status =
                fmt_farm_read_count(base, json, "memory_bytes", 0, INT64_MAX, &cost->memory_bytes);
        if (status == 0)
            status = fmt_farm_read_count(base, json, "scratch_bytes", 0, INT64_MAX,
                                         &cost->scratch_bytes);
        if (status == 0)
            status = fmt_farm_read_count(base, json, "part_bytes", 0, INT64_MAX, &cost->part_bytes);
    }
    return status;
}

/* Reads three numbers. */
static bool read_three(const json_t *list, double out[3])
{
    bool good = json_array_size(list) == 3;
    for (size_t a = 0; a < 3 && good; a++) {
        const json_t *value = json_array_get(list, a);
        good = json_is_number(value);
        out[a] = json_number_value(value);
    }
    return good;
}

static int read_place(struct vox_farm_plan *plan, const json_t *json)
{
    const struct fmt_farm_plan *base = &plan->base;
    double first[3];
    uint64_t bits = 0, shift = 0;
    int status = fmt_farm_read_count(base, json, "curve_bits", 1, CURVE_BITS_MAX, &bits);
    if (status == 0)
        status = fmt_farm_read_count(base, json, "curve_shift", 0, 31 - VOX_REGION_LOG2, &shift);
    plan->curve_bits = (uint32_t)bits;
    plan->curve_shift = (uint32_t)shift;
    plan->voxel_size = json_number_value(json_object_get(json, "voxel_size"));
    if (status == 0 && !read_three(json_object_get(json, "start"), plan->start))
        status = fmt_farm_fail_plan(base, "start");
    bool good = read_three(json_object_get(json, "first_region"), first);
    for (int a = 0; a < 3 && good; a++) {
        good = fabs(first[a]) < 0x1p30 && first[a] == floor(first[a]);
        plan->first_region[a] = good ? (int32_t)first[a] : 0;
    }
    return status == 0 && !good ? fmt_farm_fail_plan(base, "first_region") : status;
}

static int read_members(struct vox_farm_plan *plan, const json_t *json)
{
    int status = read_place(plan, json);
    if (status == 0)
        status = fmt_farm_options_from_json(plan->base.ctx, members, MEMBERS, plan->base.path,
                                            json_object_get(json, "options"), &plan->options);
    if (status == 0)
        status = read_scans(plan, json_object_get(json, "scans"));
    if (status == 0)
        status = make_tasks(plan);
    if (status == 0)
        status = read_cuts(plan, json_object_get(json, "cuts"));
    return status < 0 ? status : read_costs(plan, json_object_get(json, "expected"));
}

int vox_farm_plan_read(struct bsq_ctx *ctx, const char *path, struct vox_farm_plan **out)
{
    struct fmt_farm_text text;
    struct vox_farm_plan *plan;
    *out = NULL;
    int status = bsq_calloc(ctx, "plan", 1, sizeof *plan, &plan);
    if (status < 0)
        return status;
    status = fmt_farm_plan_read(ctx, &grid_kind, path, &plan->base, &text);
    if (status == 0)
        status = read_members(plan, text.json);
    fmt_farm_text_clear(&text);
    if (status == 0)
        *out = plan;
    else
        vox_farm_plan_free(plan);
    return status;
}
