/* farm_plan.c - the members of a bake's plan. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/farm/farm_options.h"

static const struct fmt_farm_kind bake_kind = {.format = "Bisque bake plan",
                                               .format_version = 4,
                                               .program = "bisque-bake",
                                               .program_version = BSQ_VERSION,
                                               .work = "a bake",
                                               .magic = "BSQPART\n",
                                               .part_version = 3,
                                               .most_tasks = BAKE_MAX_TASKS};

int bake_farm_plan_create(struct bsq_ctx *ctx, const char *path, const struct bake_options *options,
                          uint32_t task_count, struct bake_farm_plan **out)
{
    struct bake_farm_plan *plan;
    *out = NULL;
    int status = bsq_calloc(ctx, "plan", 1, sizeof *plan, &plan);
    if (status < 0)
        return status;
    plan->options = *options;
    status = fmt_farm_plan_init(ctx, &bake_kind, path, task_count, &plan->base);
    if (status == 0)
        status = bsq_calloc(ctx, "plan", task_count, sizeof *plan->costs, &plan->costs);
    if (status < 0)
        bake_farm_plan_free(plan);
    else
        *out = plan;
    return status;
}

void bake_farm_plan_free(struct bake_farm_plan *plan)
{
    if (!plan)
        return;
    struct bsq_ctx *ctx = plan->base.ctx;
    for (uint32_t i = 0; i < plan->tile_count; i++) {
        bsq_free(ctx, plan->tiles[i].tasks);
        free(plan->tiles[i].object);
        free(plan->tiles[i].material);
    }
    if (plan->owns_options)
        bake_farm_options_free(&plan->options);
    bsq_free(ctx, plan->tiles);
    bsq_free(ctx, plan->costs);
    fmt_farm_plan_clear(&plan->base);
    bsq_free(ctx, plan);
}

/* Copies a name, which may be NULL. */
static int copy_name(const struct bake_farm_plan *plan, const char *name, char **out)
{
    *out = name ? strdup(name) : NULL;
    return name && !*out ? fmt_farm_fail_memory(&plan->base) : 0;
}

int bake_farm_add_tiles(struct bake_farm_plan *plan, const struct bake_baked_tile *tiles,
                        uint32_t count)
{
    int status = bsq_calloc(plan->base.ctx, "tiles", count, sizeof *plan->tiles, &plan->tiles);
    for (uint32_t i = 0; i < count && status == 0; i++) {
        struct bake_farm_tile *tile = &plan->tiles[plan->tile_count++];
        *tile = (struct bake_farm_tile){.number = tiles[i].tile,
                                        .width = tiles[i].width,
                                        .height = tiles[i].height,
                                        .columns = (tiles[i].width - 1) / plan->block_side + 1,
                                        .rows = (tiles[i].height - 1) / plan->block_side + 1};
        status =
            bsq_calloc(plan->base.ctx, "blocks of a tile", (uint64_t)tile->columns * tile->rows,
                       sizeof *tile->tasks, &tile->tasks);
        if (status == 0)
            status = copy_name(plan, tiles[i].object, &tile->object);
        if (status == 0)
            status = copy_name(plan, tiles[i].material, &tile->material);
    }
    return status;
}

/* ---- writing ---- */

/* Writes the tasks of a tile's blocks in row order as runs: "12*0 3*1 " is twelve blocks of task 0,
 * then three of task 1. Returns NULL if there is no memory. */
static json_t *blocks_to_json(const struct bake_farm_tile *tile)
{
    const uint64_t blocks = (uint64_t)tile->columns * tile->rows;
    char *text = NULL;
    size_t size;
    FILE *stream = open_memstream(&text, &size);
    for (uint64_t b = 0; stream && b < blocks;) {
        uint64_t run = 1;
        while (b + run < blocks && tile->tasks[b + run] == tile->tasks[b])
            run++;
        fprintf(stream, "%" PRIu64 "*%u ", run, tile->tasks[b]);
        b += run;
    }
    const bool failed = !stream || fclose(stream) != 0;
    json_t *json = failed ? NULL : json_string(text);
    free(text);
    return json;
}

static json_t *tiles_to_json(const struct bake_farm_plan *plan)
{
    json_t *list = json_array();
    int failed = list == NULL;
    for (uint32_t i = 0; i < plan->tile_count; i++) {
        const struct bake_farm_tile *tile = &plan->tiles[i];
        failed |= json_array_append_new(
            list, json_pack("{s:I, s:s?, s:s?, s:I, s:I, s:o}", "tile", (json_int_t)tile->number,
                            "object", tile->object, "material", tile->material, "width",
                            (json_int_t)tile->width, "height", (json_int_t)tile->height, "blocks",
                            blocks_to_json(tile)));
    }
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

static json_t *costs_to_json(const struct bake_farm_plan *plan)
{
    json_t *list = json_array();
    int failed = list == NULL;
    for (uint32_t i = 0; i < plan->base.task_count; i++) {
        const struct bake_task_cost *cost = &plan->costs[i];
        failed |= json_array_append_new(
            list, json_pack("{s:I, s:I, s:I, s:I, s:f}", "texels", (json_int_t)cost->texels,
                            "memory_bytes", (json_int_t)cost->memory_bytes, "scratch_bytes",
                            (json_int_t)cost->scratch_bytes, "part_bytes",
                            (json_int_t)cost->part_bytes, "cpu_seconds", cost->cpu_seconds));
    }
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

/* Returns the members of a bake's plan; NULL if there is no memory. */
static json_t *members_to_json(const struct bake_farm_plan *plan)
{
    return json_pack("{s:I, s:I, s:o, s:o, s:o}", "block_side", (json_int_t)plan->block_side,
                     "degenerate_triangles", (json_int_t)plan->degenerate_triangles, "options",
                     bake_farm_options_to_json(&plan->options, plan->base.path), "tiles",
                     tiles_to_json(plan), "expected", costs_to_json(plan));
}

int bake_farm_plan_write(struct bake_farm_plan *plan, bool *kept)
{
    *kept = false;
    int status = fmt_farm_check_name(plan->base.ctx, plan->options.output_path);
    if (status == 0)
        status = fmt_farm_check_name(plan->base.ctx, plan->options.preview_path);
    if (status == 0)
        status = fmt_farm_check_name(plan->base.ctx, plan->options.low_suffix);
    if (status == 0)
        status = fmt_farm_check_name(plan->base.ctx, plan->options.high_suffix);
    for (uint32_t i = 0; i < plan->tile_count && status == 0; i++) {
        status = fmt_farm_check_name(plan->base.ctx, plan->tiles[i].object);
        if (status == 0)
            status = fmt_farm_check_name(plan->base.ctx, plan->tiles[i].material);
    }
    return status < 0 ? status : fmt_farm_plan_write(&plan->base, members_to_json(plan), kept);
}

/* ---- reading ---- */

/* Reads the runs of blocks_to_json(). */
static bool read_blocks(const struct bake_farm_plan *plan, const char *text,
                        struct bake_farm_tile *tile)
{
    const uint64_t blocks = (uint64_t)tile->columns * tile->rows;
    uint64_t at = 0;
    while (text && *text) {
        char *end;
        const unsigned long long run = strtoull(text, &end, 10);
        if (*text < '0' || *text > '9' || *end != '*' || end[1] < '0' || end[1] > '9')
            return false;
        const unsigned long long task = strtoull(end + 1, &end, 10);
        if (*end != ' ' || run == 0 || run > blocks - at || task >= plan->base.task_count)
            return false;
        for (uint64_t i = 0; i < run; i++)
            tile->tasks[at++] = (uint32_t)task;
        text = end + 1;
    }
    return at == blocks;
}

/* Sets *out to the name in an object, NULL if it is null there. */
static int read_name(const struct bake_farm_plan *plan, const json_t *json, const char *name,
                     const char **out)
{
    const json_t *value = json_object_get(json, name);
    *out = json_string_value(value);
    return *out || json_is_null(value) ? 0 : fmt_farm_fail_plan(&plan->base, name);
}

/* The names in *sizes are those of the JSON. */
static int read_sizes(const struct bake_farm_plan *plan, const json_t *list,
                      struct bake_baked_tile *sizes)
{
    int status = 0;
    for (size_t i = 0; i < json_array_size(list) && status == 0; i++) {
        const json_t *json = json_array_get(list, i);
        uint64_t tile = 0, width = 0, height = 0;
        status =
            fmt_farm_read_count(&plan->base, json, "tile", BAKE_FIRST_TILE, BAKE_LAST_TILE, &tile);
        if (status == 0)
            status = fmt_farm_read_count(&plan->base, json, "width", 1, BAKE_MAX_SIDE, &width);
        if (status == 0)
            status = fmt_farm_read_count(&plan->base, json, "height", 1, BAKE_MAX_SIDE, &height);
        const char *object = NULL, *material = NULL;
        if (status == 0)
            status = read_name(plan, json, "object", &object);
        if (status == 0)
            status = read_name(plan, json, "material", &material);
        sizes[i] = (struct bake_baked_tile){.tile = (uint32_t)tile,
                                            .width = (uint32_t)width,
                                            .height = (uint32_t)height,
                                            .object = (char *)(uintptr_t)object,
                                            .material = (char *)(uintptr_t)material};
    }
    return status;
}

static int read_tiles(struct bake_farm_plan *plan, const json_t *list)
{
    const size_t count = json_array_size(list);
    struct bake_baked_tile *sizes;
    if (count == 0 || count > UINT32_MAX)
        return fmt_farm_fail_plan(&plan->base, "tiles");
    int status = bsq_alloc(plan->base.ctx, "tiles", count, sizeof *sizes, &sizes);
    if (status == 0)
        status = read_sizes(plan, list, sizes);
    if (status == 0)
        status = bake_farm_add_tiles(plan, sizes, (uint32_t)count);
    for (size_t i = 0; i < count && status == 0; i++) {
        const json_t *blocks = json_object_get(json_array_get(list, i), "blocks");
        if (!read_blocks(plan, json_string_value(blocks), &plan->tiles[i]))
            status = fmt_farm_fail_plan(&plan->base, "blocks");
    }
    bsq_free(plan->base.ctx, sizes);
    return status;
}

static int read_costs(struct bake_farm_plan *plan, const json_t *list)
{
    int status = json_array_size(list) == plan->base.task_count
                     ? 0
                     : fmt_farm_fail_plan(&plan->base, "expected");
    for (uint32_t i = 0; i < plan->base.task_count && status == 0; i++) {
        const json_t *json = json_array_get(list, i);
        struct bake_task_cost *cost = &plan->costs[i];
        cost->cpu_seconds = json_number_value(json_object_get(json, "cpu_seconds"));
        status = fmt_farm_read_count(&plan->base, json, "texels", 0, INT64_MAX, &cost->texels);
        if (status == 0)
            status = fmt_farm_read_count(&plan->base, json, "memory_bytes", 0, INT64_MAX,
                                         &cost->memory_bytes);
        if (status == 0)
            status = fmt_farm_read_count(&plan->base, json, "scratch_bytes", 0, INT64_MAX,
                                         &cost->scratch_bytes);
        if (status == 0)
            status = fmt_farm_read_count(&plan->base, json, "part_bytes", 0, INT64_MAX,
                                         &cost->part_bytes);
    }
    return status;
}

static int read_members(struct bake_farm_plan *plan, const json_t *json)
{
    struct bsq_ctx *ctx = plan->base.ctx;
    uint64_t side = 0;
    int status = fmt_farm_read_count(&plan->base, json, "block_side", 1, 256, &side);
    plan->block_side = (uint32_t)side;
    if (status == 0 && (side & (side - 1)) != 0)
        status = fmt_farm_fail_plan(&plan->base, "block_side");
    if (status == 0)
        status = fmt_farm_read_count(&plan->base, json, "degenerate_triangles", 0, INT64_MAX,
                                     &plan->degenerate_triangles);
    if (status == 0) {
        plan->owns_options = true;
        status = bake_farm_options_from_json(ctx, plan->base.path, json_object_get(json, "options"),
                                             &plan->options);
    }
    if (status == 0)
        status = read_tiles(plan, json_object_get(json, "tiles"));
    if (status == 0)
        status = bsq_calloc(ctx, "plan", plan->base.task_count, sizeof *plan->costs, &plan->costs);
    return status < 0 ? status : read_costs(plan, json_object_get(json, "expected"));
}

int bake_farm_plan_read(struct bsq_ctx *ctx, const char *path, struct bake_farm_plan **out)
{
    struct fmt_farm_text text;
    struct bake_farm_plan *plan;
    *out = NULL;
    int status = bsq_calloc(ctx, "plan", 1, sizeof *plan, &plan);
    if (status < 0)
        return status;
    status = fmt_farm_plan_read(ctx, &bake_kind, path, &plan->base, &text);
    if (status == 0)
        status = read_members(plan, text.json);
    fmt_farm_text_clear(&text);
    if (status == 0)
        *out = plan;
    else
        bake_farm_plan_free(plan);
    return status;
}
