/* farm_plan.c - the plan file: JSON, which programs of a farm can read too. */
#include <assert.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <xxhash.h>

#include "base/json_bound.h"
#include "base/output.h"
#include "libbake/farm/farm_options.h"

#define FORMAT "Bisque bake plan"
enum { FORMAT_VERSION = 1 };

/* Tasks of other sources may bake other texels, whatever their version is called. */
static const char program_version[] = BSQ_VERSION " of sources "
#include "bake_sources.inc"
    ;

static int fail_memory(const struct bake_farm_plan *plan)
{
    return bsq_fail(plan->ctx, BSQ_ENOMEM, "%s: out of memory", plan->path);
}

int bake_farm_plan_create(struct bsq_ctx *ctx, const char *path, const struct bake_options *options,
                          uint32_t task_count, struct bake_farm_plan **out)
{
    struct bake_farm_plan *plan;
    *out = NULL;
    int status = bsq_calloc(ctx, "plan", 1, sizeof *plan, &plan);
    if (status < 0)
        return status;
    plan->ctx = ctx;
    plan->task_count = task_count;
    if (options)
        plan->options = *options;
    plan->path = strdup(path);
    status = plan->path ? bsq_calloc(ctx, "plan", task_count, sizeof *plan->costs, &plan->costs)
                        : bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", path);
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
    struct bsq_ctx *ctx = plan->ctx;
    for (uint32_t i = 0; i < plan->input_count; i++) {
        free(plan->inputs[i].path);
        free(plan->inputs[i].role);
    }
    for (uint32_t i = 0; i < plan->tile_count; i++)
        bsq_free(ctx, plan->tiles[i].tasks);
    if (plan->owns_options)
        bake_farm_options_free(&plan->options);
    bsq_free(ctx, plan->tiles);
    bsq_free(ctx, plan->costs);
    free(plan->inputs);
    free(plan->path);
    bsq_free(ctx, plan);
}

int bake_farm_add_tiles(struct bake_farm_plan *plan, const struct bake_baked_tile *tiles,
                        uint32_t count)
{
    int status = bsq_calloc(plan->ctx, "tiles", count, sizeof *plan->tiles, &plan->tiles);
    for (uint32_t i = 0; i < count && status == 0; i++) {
        struct bake_farm_tile *tile = &plan->tiles[plan->tile_count++];
        *tile = (struct bake_farm_tile){.number = tiles[i].tile,
                                        .width = tiles[i].width,
                                        .height = tiles[i].height,
                                        .columns = (tiles[i].width - 1) / plan->block_side + 1,
                                        .rows = (tiles[i].height - 1) / plan->block_side + 1};
        status = bsq_calloc(plan->ctx, "blocks of a tile", (uint64_t)tile->columns * tile->rows,
                            sizeof *tile->tasks, &tile->tasks);
    }
    return status;
}

char *bake_farm_part_path(const struct bake_farm_plan *plan, uint32_t task)
{
    const size_t length = strlen(plan->path);
    const bool json = length > 5 && strcmp(plan->path + length - 5, ".json") == 0;
    char *path;
    return asprintf(&path, "%.*s.%04u.part", (int)(json ? length - 5 : length), plan->path, task) <
                   0
               ? NULL
               : path;
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
            list, json_pack("{s:I, s:I, s:I, s:o}", "tile", (json_int_t)tile->number, "width",
                            (json_int_t)tile->width, "height", (json_int_t)tile->height, "blocks",
                            blocks_to_json(tile)));
    }
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

/* Writes 128 bits as 32 hexadecimal digits. */
static void hash_text(const uint64_t hash[2], char text[33])
{
    snprintf(text, 33, "%016" PRIx64 "%016" PRIx64, hash[0], hash[1]);
}

static json_t *inputs_to_json(const struct bake_farm_plan *plan)
{
    json_t *list = json_array();
    int failed = list == NULL;
    for (uint32_t i = 0; i < plan->input_count; i++) {
        const struct bake_farm_input *input = &plan->inputs[i];
        char text[33], *path = bake_farm_path_in_plan(plan->path, input->path);
        hash_text(input->hash, text);
        failed |=
            !path || json_array_append_new(
                         list, json_pack("{s:s, s:s, s:I, s:s}", "path", path, "role", input->role,
                                         "bytes", (json_int_t)input->bytes, "xxh3_128", text));
        free(path);
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
    for (uint32_t i = 0; i < plan->task_count; i++) {
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

/* Returns the plan as JSON without its id; NULL if there is no memory. */
static json_t *plan_to_json(const struct bake_farm_plan *plan)
{
    return json_pack("{s:s, s:i, s:s, s:I, s:I, s:I, s:o, s:o, s:o, s:o}", "format", FORMAT,
                     "format_version", FORMAT_VERSION, "program_version", program_version, "tasks",
                     (json_int_t)plan->task_count, "block_side", (json_int_t)plan->block_side,
                     "degenerate_triangles", (json_int_t)plan->degenerate_triangles, "options",
                     bake_farm_options_to_json(&plan->options, plan->path), "inputs",
                     inputs_to_json(plan), "tiles", tiles_to_json(plan), "expected",
                     costs_to_json(plan));
}

/* Computes the checksum of a plan's JSON, without its id: of its compact form with sorted names.
 * Returns false if there is no memory. */
static bool compute_id(json_t *json, uint64_t id[2])
{
    char *text = json_dumps(json, JSON_COMPACT | JSON_SORT_KEYS | JSON_ENSURE_ASCII |
                                      JSON_REAL_PRECISION(17));
    if (!text)
        return false;
    const XXH128_hash_t hash = XXH3_128bits(text, strlen(text));
    id[0] = hash.high64;
    id[1] = hash.low64;
    free(text);
    return true;
}

static int write_text(const struct bake_farm_plan *plan, const char *text)
{
    struct bsq_output *output;
    int status = bsq_output_open(plan->ctx, plan->path, &output);
    if (status < 0)
        return status;
    status = bsq_output_write(output, text, strlen(text));
    if (status == 0)
        return bsq_output_commit(output);
    bsq_output_discard(output);
    return status;
}

/* Returns whether the file at the plan's path is this text already. */
static bool is_there(const struct bake_farm_plan *plan, const char *text)
{
    const size_t length = strlen(text);
    char *found = malloc(length + 1);
    FILE *file = fopen(plan->path, "re");
    const bool same = found && file && fread(found, 1, length + 1, file) == length &&
                      memcmp(found, text, length) == 0;
    if (file)
        fclose(file);
    free(found);
    return same;
}

/* Checks that a plan can name a file: JSON holds UTF-8 only. NULL is allowed. */
static int check_name(const struct bake_farm_plan *plan, const char *path)
{
    json_t *name = path ? json_string(path) : NULL;
    const bool good = !path || name;
    json_decref(name);
    return good ? 0
                : bsq_fail(plan->ctx, BSQ_EUSAGE, "%s: a plan cannot name it: it is not UTF-8",
                           path);
}

static int check_names(const struct bake_farm_plan *plan)
{
    int status = check_name(plan, plan->options.output_path);
    if (status == 0)
        status = check_name(plan, plan->options.preview_path);
    for (uint32_t i = 0; i < plan->input_count && status == 0; i++)
        status = check_name(plan, plan->inputs[i].path);
    return status;
}

int bake_farm_plan_write(struct bake_farm_plan *plan, bool *kept)
{
    if (check_names(plan) < 0)
        return BSQ_EUSAGE;
    char id[33];
    char *text = NULL;
    json_t *json = plan_to_json(plan);
    if (json && compute_id(json, plan->id)) {
        hash_text(plan->id, id);
        if (json_object_set_new(json, "id", json_string(id)) == 0)
            text = json_dumps(json, JSON_INDENT(1) | JSON_ENSURE_ASCII | JSON_REAL_PRECISION(17));
    }
    json_decref(json);
    if (!text)
        return fail_memory(plan);
    *kept = is_there(plan, text);
    int status = *kept ? 0 : write_text(plan, text);
    free(text);
    return status;
}

/* ---- reading ---- */

static int fail_plan(const struct bake_farm_plan *plan, const char *what)
{
    return bsq_fail(plan->ctx, BSQ_EDATA, "%s: damaged plan: %s", plan->path, what);
}

/* Reads a whole number from `least` to `most`; fails with `name`. */
static int read_count(const struct bake_farm_plan *plan, const json_t *json, const char *name,
                      uint64_t least, uint64_t most, uint64_t *out)
{
    const json_t *value = json_object_get(json, name);
    const json_int_t number = json_integer_value(value);
    if (!json_is_integer(value) || number < 0 || (uint64_t)number < least ||
        (uint64_t)number > most)
        return fail_plan(plan, name);
    *out = (uint64_t)number;
    return 0;
}

static bool read_hash(const char *text, uint64_t hash[2])
{
    if (!text || strlen(text) != 32 || strspn(text, "0123456789abcdef") != 32)
        return false;
    char half[17] = "";
    memcpy(half, text, 16);
    hash[0] = strtoull(half, NULL, 16);
    hash[1] = strtoull(text + 16, NULL, 16);
    return true;
}

static int read_inputs(struct bake_farm_plan *plan, const json_t *list)
{
    const size_t count = json_array_size(list);
    if (!json_is_array(list) || count > UINT32_MAX)
        return fail_plan(plan, "inputs");
    plan->inputs = calloc(count + 1, sizeof *plan->inputs);
    if (!plan->inputs)
        return fail_memory(plan);
    for (size_t i = 0; i < count; i++) {
        const json_t *json = json_array_get(list, i);
        struct bake_farm_input *input = &plan->inputs[plan->input_count++];
        const char *path = json_string_value(json_object_get(json, "path"));
        const char *role = json_string_value(json_object_get(json, "role"));
        int status = read_count(plan, json, "bytes", 0, INT64_MAX, &input->bytes);
        if (status < 0)
            return status;
        if (!path || !role ||
            !read_hash(json_string_value(json_object_get(json, "xxh3_128")), input->hash))
            return fail_plan(plan, "an input");
        input->path = bake_farm_path_from_plan(plan->ctx, plan->path, path);
        input->role = strdup(role);
        if (!input->path || !input->role)
            return fail_memory(plan);
    }
    return 0;
}

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
        if (*end != ' ' || run == 0 || run > blocks - at || task >= plan->task_count)
            return false;
        for (uint64_t i = 0; i < run; i++)
            tile->tasks[at++] = (uint32_t)task;
        text = end + 1;
    }
    return at == blocks;
}

static int read_sizes(const struct bake_farm_plan *plan, const json_t *list,
                      struct bake_baked_tile *sizes)
{
    int status = 0;
    for (size_t i = 0; i < json_array_size(list) && status == 0; i++) {
        const json_t *json = json_array_get(list, i);
        uint64_t tile = 0, width = 0, height = 0;
        status = read_count(plan, json, "tile", BAKE_FIRST_TILE, BAKE_LAST_TILE, &tile);
        if (status == 0)
            status = read_count(plan, json, "width", 1, BAKE_MAX_SIDE, &width);
        if (status == 0)
            status = read_count(plan, json, "height", 1, BAKE_MAX_SIDE, &height);
        sizes[i] = (struct bake_baked_tile){
            .tile = (uint32_t)tile, .width = (uint32_t)width, .height = (uint32_t)height};
    }
    return status;
}

static int read_tiles(struct bake_farm_plan *plan, const json_t *list)
{
    const size_t count = json_array_size(list);
    struct bake_baked_tile *sizes;
    if (count == 0 || count > BAKE_LAST_TILE)
        return fail_plan(plan, "tiles");
    int status = bsq_alloc(plan->ctx, "tiles", count, sizeof *sizes, &sizes);
    if (status == 0)
        status = read_sizes(plan, list, sizes);
    if (status == 0)
        status = bake_farm_add_tiles(plan, sizes, (uint32_t)count);
    for (size_t i = 0; i < count && status == 0; i++) {
        const json_t *blocks = json_object_get(json_array_get(list, i), "blocks");
        if (!read_blocks(plan, json_string_value(blocks), &plan->tiles[i]))
            status = fail_plan(plan, "blocks");
    }
    bsq_free(plan->ctx, sizes);
    return status;
}

static int read_costs(struct bake_farm_plan *plan, const json_t *list)
{
    int status = json_array_size(list) == plan->task_count ? 0 : fail_plan(plan, "expected");
    for (uint32_t i = 0; i < plan->task_count && status == 0; i++) {
        const json_t *json = json_array_get(list, i);
        struct bake_task_cost *cost = &plan->costs[i];
        cost->cpu_seconds = json_number_value(json_object_get(json, "cpu_seconds"));
        status = read_count(plan, json, "texels", 0, INT64_MAX, &cost->texels);
        if (status == 0)
            status = read_count(plan, json, "memory_bytes", 0, INT64_MAX, &cost->memory_bytes);
        if (status == 0)
            status = read_count(plan, json, "scratch_bytes", 0, INT64_MAX, &cost->scratch_bytes);
        if (status == 0)
            status = read_count(plan, json, "part_bytes", 0, INT64_MAX, &cost->part_bytes);
    }
    return status;
}

static int check_format(struct bsq_ctx *ctx, const char *path, const json_t *json)
{
    const char *format = json_string_value(json_object_get(json, "format"));
    const char *program = json_string_value(json_object_get(json, "program_version"));
    if (!format || strcmp(format, FORMAT) != 0)
        return bsq_fail(ctx, BSQ_EDATA, "%s: not a plan of bisque-bake", path);
    if (!program || strcmp(program, program_version) != 0)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s: this plan is of Bisque %s, this program is %s: all tasks need one "
                        "version",
                        path, program ? program : "(unknown)", program_version);
    if (json_integer_value(json_object_get(json, "format_version")) != FORMAT_VERSION)
        return bsq_fail(ctx, BSQ_EDATA, "%s: unknown version of the plan's format", path);
    return 0;
}

static int read_members(struct bake_farm_plan *plan, json_t *json)
{
    uint64_t side = 0, found[2] = {0};
    int status = read_count(plan, json, "block_side", 1, 256, &side);
    plan->block_side = (uint32_t)side;
    if (status == 0 && (side & (side - 1)) != 0)
        status = fail_plan(plan, "block_side");
    if (status == 0)
        status = read_count(plan, json, "degenerate_triangles", 0, INT64_MAX,
                            &plan->degenerate_triangles);
    if (status == 0) {
        plan->owns_options = true;
        status = bake_farm_options_from_json(plan->ctx, plan->path,
                                             json_object_get(json, "options"), &plan->options);
    }
    if (status == 0)
        status = read_inputs(plan, json_object_get(json, "inputs"));
    if (status == 0)
        status = read_tiles(plan, json_object_get(json, "tiles"));
    if (status == 0)
        status = read_costs(plan, json_object_get(json, "expected"));
    if (status == 0 && !read_hash(json_string_value(json_object_get(json, "id")), plan->id))
        status = fail_plan(plan, "id");
    if (status < 0)
        return status;
    json_object_del(json, "id");
    if (!compute_id(json, found))
        return fail_memory(plan);
    return found[0] == plan->id[0] && found[1] == plan->id[1]
               ? 0
               : fail_plan(plan, "its id does not fit the rest");
}

static int read_json(struct bsq_ctx *ctx, const char *path, json_t *json,
                     struct bake_farm_plan **out)
{
    int status = check_format(ctx, path, json);
    const json_int_t tasks = json_integer_value(json_object_get(json, "tasks"));
    if (status == 0 && (tasks < 1 || tasks > BAKE_MAX_TASKS))
        status = bsq_fail(ctx, BSQ_EDATA, "%s: damaged plan: tasks", path);
    if (status == 0)
        status = bake_farm_plan_create(ctx, path, NULL, (uint32_t)tasks, out);
    if (status < 0)
        return status;
    assert(*out);
    status = read_members(*out, json);
    if (status < 0) {
        bake_farm_plan_free(*out);
        *out = NULL;
    }
    return status;
}

/* Reads the file as JSON. *reserved: bytes of the budget that the caller releases. */
static int load(struct bsq_ctx *ctx, const char *path, json_t **json, uint64_t *reserved)
{
    struct bsq_file file;
    char *text = NULL;
    json_error_t error;
    *json = NULL;
    *reserved = 0;
    int status = bsq_file_open_as(ctx, path, BSQ_OPEN_OTHER, &file);
    if (status < 0)
        return status;
    status = bsq_alloc(ctx, "plan", file.size, 1, &text);
    if (status == 0)
        status = bsq_file_read(ctx, &file, text, file.size, 0);
    const uint64_t bound = status == 0 ? bsq_json_bound(text, file.size) : 0;
    if (status == 0 && (status = bsq_reserve(ctx, "plan", bound)) == 0)
        *reserved = bound;
    if (status == 0 && !(*json = json_loadb(text, file.size, JSON_REJECT_DUPLICATES, &error)))
        status = bsq_fail(ctx, BSQ_EDATA, "%s:%d: not a plan of bisque-bake: %s", path, error.line,
                          error.text);
    bsq_free(ctx, text);
    bsq_file_close(ctx, &file);
    return status;
}

int bake_farm_plan_read(struct bsq_ctx *ctx, const char *path, struct bake_farm_plan **out)
{
    json_t *json;
    uint64_t reserved;
    *out = NULL;
    int status = load(ctx, path, &json, &reserved);
    if (status == 0)
        status = read_json(ctx, path, json, out);
    json_decref(json);
    bsq_release(ctx, reserved);
    return status;
}
