/* farm_plan.c - the plan file: JSON, which programs of a farm can read too. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <xxhash.h>

#include "base/job_files.h"
#include "base/text.h"
#include "base/output.h"
#include "formats/fingerprint.h"
#include "libbake/farm/farm.h"
#include "libbake/farm/farm_json.h"

static const char format[] = "Bisque bake plan";
enum { FORMAT_VERSION = 7 };

/* ---- the members ---- */

#define INPUT(kind, member) BSQ_MEMBER(kind, struct bake_farm_input, member)
#define TILE(member, least, most)                                                                  \
    BSQ_MEMBER(COUNT, struct bake_farm_tile, member), BSQ_RANGE(least, most, 1)
#define COST(kind, member) BSQ_MEMBER(kind, struct bake_task_cost, member)
#define PLAN(kind, member) BSQ_MEMBER(kind, struct bake_farm_plan, member)

static const struct bsq_option input_rows[] = {
    {INPUT(INPUT, path)}, {INPUT(TEXT, role)}, {INPUT(BYTES, bytes)}, {INPUT(TEXT, xxh3_128)}};
/* And "blocks". */
static const struct bsq_option tile_rows[] = {{TILE(tile, BAKE_FIRST_TILE, BAKE_LAST_TILE)},
                                              {TILE(width, 1, BAKE_MAX_SIDE)},
                                              {TILE(height, 1, BAKE_MAX_SIDE)}};
static const struct bsq_option cost_rows[] = {{COST(BYTES, texels)},
                                              {COST(BYTES, memory_bytes)},
                                              {COST(BYTES, scratch_bytes)},
                                              {COST(BYTES, part_bytes)},
                                              {COST(NUMBER, cpu_seconds)}};
static const struct bsq_option plan_rows[] = {
    {PLAN(COUNT, tasks), BSQ_RANGE(1, BAKE_MAX_TASKS, 1)},
    {PLAN(COUNT, block_side), BSQ_RANGE(1, 256, 1)},
    {PLAN(BYTES, degenerate_triangles)},
    {BSQ_LIST(struct bake_farm_plan, inputs, input_count, input_rows)},
    {BSQ_LIST(struct bake_farm_plan, tiles, tile_count, tile_rows)},
    {BSQ_LIST(struct bake_farm_plan, expected, expected_count, cost_rows)}};

static struct bake_farm_table option_table(void)
{
    struct bake_farm_table table;
    table.rows = bake_option_rows(&table.count);
    return table;
}

static int fail_memory(const struct bake_farm_plan *plan)
{
    return bsq_fail(plan->ctx, BSQ_ENOMEM, "%s: out of memory", plan->path);
}

static int fail_plan(const struct bake_farm_plan *plan, const char *what)
{
    return bsq_fail(plan->ctx, BSQ_EDATA, "%s: damaged plan: %s", plan->path, what);
}

/* ---- making a plan ---- */

/* Makes an empty plan. */
static int begin(struct bsq_ctx *ctx, const char *path, struct bake_farm_plan **out)
{
    int status = bsq_calloc(ctx, "plan", 1, sizeof **out, out);
    if (status < 0)
        return status;
    (*out)->ctx = ctx;
    (*out)->path = strdup(path);
    return (*out)->path ? 0 : bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", path);
}

/* Returns the plan, or frees it after a failure. */
static int hand_over(struct bake_farm_plan *plan, int status, struct bake_farm_plan **out)
{
    *out = status < 0 ? NULL : plan;
    if (status < 0)
        bake_close_plan(plan);
    return status;
}

int bake_farm_plan_create(struct bsq_ctx *ctx, const char *path, const struct bake_options *options,
                          uint32_t tasks, struct bake_farm_plan **out)
{
    struct bake_farm_plan *plan = NULL;
    int status = begin(ctx, path, &plan);
    if (status == 0)
        status = bsq_calloc(ctx, "plan", tasks, sizeof *plan->expected, &plan->expected);
    if (status == 0) {
        plan->options = *options;
        plan->tasks = plan->expected_count = tasks;
    }
    return hand_over(plan, status, out);
}

void bake_close_plan(struct bake_farm_plan *plan)
{
    if (!plan)
        return;
    struct bsq_ctx *ctx = plan->ctx;
    for (uint32_t i = 0; plan->tiles && i < plan->tile_count; i++)
        bsq_free(ctx, plan->tiles[i].task_of);
    for (uint32_t i = 0; plan->inputs && i < plan->input_count; i++)
        free(plan->inputs[i].identity);
    if (plan->owns_options)
        bake_farm_clear(ctx, option_table(), &plan->options);
    bake_farm_clear(ctx, BAKE_FARM_TABLE(plan_rows), plan);
    free(plan->path);
    bsq_free(ctx, plan);
}

/* Makes space for the tasks of a tile's blocks. */
static int count_blocks(const struct bake_farm_plan *plan, struct bake_farm_tile *tile)
{
    tile->columns = (tile->width - 1) / plan->block_side + 1;
    tile->rows = (tile->height - 1) / plan->block_side + 1;
    return bsq_calloc(plan->ctx, "blocks of a tile", (uint64_t)tile->columns * tile->rows,
                      sizeof *tile->task_of, &tile->task_of);
}

int bake_farm_add_tiles(struct bake_farm_plan *plan, const struct bake_baked_tile *tiles,
                        uint32_t count)
{
    int status = bsq_calloc(plan->ctx, "tiles", count, sizeof *plan->tiles, &plan->tiles);
    for (uint32_t i = 0; i < count && status == 0; i++) {
        struct bake_farm_tile *tile = &plan->tiles[plan->tile_count++];
        *tile = (struct bake_farm_tile){
            .tile = tiles[i].tile, .width = tiles[i].width, .height = tiles[i].height};
        status = count_blocks(plan, tile);
    }
    return status;
}

/* ---- inputs ---- */

/* Adds an input, whose path and role the plan takes over. */
static int add_input(struct bake_farm_plan *plan, uint64_t *capacity, struct bsq_noted_input *from)
{
    struct fmt_fingerprint print;
    int status = 0;
    BSQ_TRY(bsq_grow(plan->ctx, "inputs", plan->input_count + UINT64_C(1), sizeof *plan->inputs,
                     &plan->inputs, capacity));
    BSQ_TRY(fmt_fingerprint(plan->ctx, from->path, &print));
    struct bake_farm_input *input = &plan->inputs[plan->input_count++];
    *input = (struct bake_farm_input){.path = from->path,
                                      .role = from->role,
                                      .bytes = print.bytes,
                                      .xxh3_128 = strdup(print.hash),
                                      .identity = strdup(print.identity)};
    from->path = from->role = NULL;
    if (!input->xxh3_128 || !input->identity)
        status = fail_memory(plan);
done:
    return status;
}

int bake_farm_add_inputs(struct bake_farm_plan *plan)
{
    struct bsq_noted_input input;
    uint64_t next = 0, capacity = 0;
    int status;
    while ((status = bsq_next_input(plan->ctx, &next, &input)) > 0) {
        if (input.opened)
            status = add_input(plan, &capacity, &input);
        bsq_noted_input_free(&input);
        if (status < 0)
            break;
    }
    return status;
}

int bake_farm_check_inputs(const struct bake_farm_plan *plan)
{
    int status = 0;
    for (uint32_t i = 0; i < plan->input_count && status == 0; i++) {
        const struct bake_farm_input *input = &plan->inputs[i];
        bool same = false;
        status = fmt_is_same(plan->ctx, input->path, input->bytes, input->xxh3_128, input->identity,
                             &same);
        if (status == 0 && !same)
            status =
                bsq_fail(plan->ctx, BSQ_EDATA,
                         "%s: %s is not the file that the plan %s was made with: make a new plan",
                         input->path, input->role[0] ? input->role : "this input", plan->path);
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
        while (b + run < blocks && tile->task_of[b + run] == tile->task_of[b])
            run++;
        fprintf(stream, "%" PRIu64 "*%u ", run, tile->task_of[b]);
        b += run;
    }
    json_t *json = stream && fclose(stream) == 0 ? json_string(text) : NULL;
    free(text);
    return json;
}

static json_t *identities_to_json(const struct bake_farm_plan *plan)
{
    json_t *list = json_array();
    int failed = 0;
    for (uint32_t i = 0; i < plan->input_count; i++)
        failed |= json_array_append_new(list, json_string(plan->inputs[i].identity));
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

/* Computes the checksum of a plan's JSON, without its id and identities: of its compact form with
 * sorted names. Returns false if there is no memory. */
static bool compute_id(json_t *json, char id[33])
{
    char *text = json_dumps(json, JSON_COMPACT | JSON_SORT_KEYS | JSON_ENSURE_ASCII |
                                      JSON_REAL_PRECISION(17));
    if (!text)
        return false;
    const XXH128_hash_t hash = XXH3_128bits(text, strlen(text));
    snprintf(id, 33, "%016" PRIx64 "%016" PRIx64, hash.high64, hash.low64);
    free(text);
    return true;
}

/* Returns the plan as JSON, and sets its id; NULL as bake_farm_to_json() does. */
static json_t *plan_to_json(struct bake_farm_plan *plan, struct bake_farm_names *names)
{
    json_t *json = bake_farm_to_json(names, BAKE_FARM_TABLE(plan_rows), plan);
    json_t *tiles = json_object_get(json, "tiles");
    int failed = json == NULL;
    for (uint32_t i = 0; i < plan->tile_count && !failed; i++)
        failed |= json_object_set_new(json_array_get(tiles, i), "blocks",
                                      blocks_to_json(&plan->tiles[i]));
    failed = failed ||
             json_object_set_new(json, "options",
                                 bake_farm_to_json(names, option_table(), &plan->options)) != 0 ||
             json_object_set_new(json, "format", json_string(format)) != 0 ||
             json_object_set_new(json, "format_version", json_integer(FORMAT_VERSION)) != 0 ||
             json_object_set_new(json, "program_version", json_string(BSQ_VERSION)) != 0 ||
             !compute_id(json, plan->id) ||
             json_object_set_new(json, "id", json_string(plan->id)) != 0 ||
             json_object_set_new(json, "identities", identities_to_json(plan)) != 0;
    if (!failed)
        return json;
    json_decref(json);
    return NULL;
}

/* A plan file as JSON. */
struct text {
    json_t *json;
    uint64_t reserved; /* bytes of the budget */
};

static int load(const struct bake_farm_plan *plan, struct text *out)
{
    struct bsq_ctx *ctx = plan->ctx;
    struct bsq_file file;
    char *text = NULL;
    json_error_t error;
    *out = (struct text){0};
    int status = bsq_file_open_as(ctx, plan->path, BSQ_OPEN_OTHER, &file);
    if (status < 0)
        return status;
    BSQ_TRY(bsq_alloc(ctx, "plan", file.size, 1, &text));
    BSQ_TRY(bsq_file_read(ctx, &file, text, file.size, 0));
    const uint64_t bound = bsq_json_bound(text, file.size);
    BSQ_TRY(bsq_reserve(ctx, "plan", bound));
    out->reserved = bound;
    out->json = json_loadb(text, file.size, JSON_REJECT_DUPLICATES, &error);
    if (!out->json)
        status = bsq_fail(ctx, BSQ_EDATA, "%s:%d: not a plan of bisque-bake: %s", plan->path,
                          error.line, error.text);
done:
    bsq_free(ctx, text);
    bsq_file_close(ctx, &file);
    return status;
}

static void unload(const struct bake_farm_plan *plan, struct text *text)
{
    json_decref(text->json);
    bsq_release(plan->ctx, text->reserved);
}

/* Takes the id from a plan's JSON, and returns whether it fits the rest. The identities go, too. */
static bool take_id(json_t *json, char id[33])
{
    const char *text = json_string_value(json_object_get(json, "id"));
    char found[33];
    snprintf(id, 33, "%s", text ? text : "");
    json_object_del(json, "id");
    json_object_del(json, "identities");
    return compute_id(json, found) && strcmp(found, id) == 0;
}

/* Returns whether the file at the plan's path is this plan already. */
static bool is_there(const struct bake_farm_plan *plan)
{
    struct text text;
    char id[33];
    const bool same = load(plan, &text) == 0 && take_id(text.json, id) && strcmp(id, plan->id) == 0;
    unload(plan, &text);
    bsq_clear_error(plan->ctx);
    return same;
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

int bake_farm_plan_write(struct bake_farm_plan *plan, bool *kept)
{
    struct bake_farm_names names = {plan->ctx, plan->path, false};
    json_t *json = plan_to_json(plan, &names);
    char *text =
        json ? json_dumps(json, JSON_INDENT(1) | JSON_ENSURE_ASCII | JSON_REAL_PRECISION(17))
             : NULL;
    int status = names.failed ? BSQ_EUSAGE : text ? 0 : fail_memory(plan);
    *kept = status == 0 && is_there(plan);
    if (status == 0 && !*kept)
        status = write_text(plan, text);
    free(text);
    json_decref(json);
    return status;
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
        if (*end != ' ' || run == 0 || run > blocks - at || task >= plan->tasks)
            return false;
        for (uint64_t i = 0; i < run; i++)
            tile->task_of[at++] = (uint32_t)task;
        text = end + 1;
    }
    return at == blocks;
}

/* Reads the tasks of all blocks. */
static int read_tasks(const struct bake_farm_plan *plan, const json_t *tiles)
{
    int status = plan->tile_count > 0 ? 0 : fail_plan(plan, "tiles");
    for (uint32_t i = 0; i < plan->tile_count && status == 0; i++) {
        struct bake_farm_tile *tile = &plan->tiles[i];
        const json_t *blocks = json_object_get(json_array_get(tiles, i), "blocks");
        if (bsq_options_check(plan->ctx, tile_rows, BAKE_FARM_TABLE(tile_rows).count, tile) < 0)
            return BSQ_EDATA;
        status = count_blocks(plan, tile);
        if (status == 0 && !read_blocks(plan, json_string_value(blocks), tile))
            status = fail_plan(plan, "blocks");
    }
    return status;
}

static int read_identities(const struct bake_farm_plan *plan, const json_t *list)
{
    for (uint32_t i = 0; i < plan->input_count; i++) {
        const char *identity = json_string_value(json_array_get(list, i));
        plan->inputs[i].identity = strdup(identity ? identity : "");
        if (!plan->inputs[i].identity)
            return fail_memory(plan);
        if (!plan->inputs[i].path)
            return fail_plan(plan, "inputs");
    }
    return 0;
}

/* Checks that a file is a plan, and one of this program. */
static int check_format(const struct bake_farm_plan *plan, const json_t *json)
{
    const char *found = json_string_value(json_object_get(json, "format"));
    const char *program = json_string_value(json_object_get(json, "program_version"));
    if (!found || strcmp(found, format) != 0)
        return bsq_fail(plan->ctx, BSQ_EDATA, "%s: not a plan of bisque-bake", plan->path);
    if (!program || strcmp(program, BSQ_VERSION) != 0)
        return bsq_fail(plan->ctx, BSQ_EDATA,
                        "%s: this plan is of Bisque %s, this program is %s: all tasks need one "
                        "version",
                        plan->path, program ? program : "(unknown)", BSQ_VERSION);
    if (json_integer_value(json_object_get(json, "format_version")) != FORMAT_VERSION)
        return bsq_fail(plan->ctx, BSQ_EDATA, "%s: unknown version of the plan's format",
                        plan->path);
    return 0;
}

static int read_plan(struct bake_farm_plan *plan, json_t *json)
{
    const struct bake_farm_names names = {plan->ctx, plan->path, false};
    json_t *identities = json_incref(json_object_get(json, "identities"));
    const uint32_t *side = &plan->block_side;
    int status = 0;
    BSQ_TRY(check_format(plan, json));
    if (!take_id(json, plan->id))
        BSQ_TRY(fail_plan(plan, "its id does not fit the rest"));
    BSQ_TRY(bake_farm_from_json(&names, BAKE_FARM_TABLE(plan_rows), json, plan));
    if (bsq_options_check(plan->ctx, plan_rows, BAKE_FARM_TABLE(plan_rows).count, plan) < 0)
        status = BSQ_EDATA;
    else if (*side == 0 || (*side & (*side - 1)) != 0 || plan->expected_count != plan->tasks)
        status = fail_plan(plan, "block_side or expected");
    if (status < 0)
        goto done;
    plan->owns_options = true;
    bake_defaults(&plan->options);
    BSQ_TRY(bake_farm_from_json(&names, option_table(), json_object_get(json, "options"),
                                &plan->options));
    BSQ_TRY(read_tasks(plan, json_object_get(json, "tiles")));
    BSQ_TRY(read_identities(plan, identities));
done:
    json_decref(identities);
    return status;
}

int bake_farm_plan_read(struct bsq_ctx *ctx, const char *path, struct bake_farm_plan **out)
{
    struct bake_farm_plan *plan = NULL;
    struct text text = {0};
    int status = 0;
    BSQ_TRY(begin(ctx, path, &plan));
    BSQ_TRY(load(plan, &text));
    BSQ_TRY(read_plan(plan, text.json));
done:
    if (plan)
        unload(plan, &text);
    return hand_over(plan, status, out);
}
