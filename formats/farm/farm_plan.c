/* farm_plan.c - the plan file: JSON, which programs of a farm can read too. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <xxhash.h>

#include "base/json_bound.h"
#include "formats/farm/farm.h"

/* The last member of a plan. */
#define IDENTITIES "identities"

int fmt_farm_fail_memory(const struct fmt_farm_plan *plan)
{
    return bsq_fail(plan->ctx, BSQ_ENOMEM, "%s: out of memory", plan->path);
}

int fmt_farm_fail_plan(const struct fmt_farm_plan *plan, const char *what)
{
    return bsq_fail(plan->ctx, BSQ_EDATA, "%s: damaged plan: %s", plan->path, what);
}

int fmt_farm_plan_init(struct bsq_ctx *ctx, const struct fmt_farm_kind *kind, const char *path,
                       uint32_t task_count, struct fmt_farm_plan *plan)
{
    *plan = (struct fmt_farm_plan){
        .ctx = ctx, .kind = kind, .path = strdup(path), .task_count = task_count};
    return plan->path ? 0 : bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", path);
}

void fmt_farm_plan_clear(struct fmt_farm_plan *plan)
{
    for (uint32_t i = 0; i < plan->input_count; i++) {
        free(plan->inputs[i].path);
        free(plan->inputs[i].role);
        free(plan->inputs[i].identity);
    }
    free(plan->inputs);
    free(plan->path);
    *plan = (struct fmt_farm_plan){0};
}

/* ---- writing ---- */

/* Writes 128 bits as 32 hexadecimal digits. */
static void hash_text(const uint64_t hash[2], char text[33])
{
    snprintf(text, 33, "%016" PRIx64 "%016" PRIx64, hash[0], hash[1]);
}

static json_t *inputs_to_json(const struct fmt_farm_plan *plan)
{
    json_t *list = json_array();
    int failed = list == NULL;
    for (uint32_t i = 0; i < plan->input_count; i++) {
        const struct fmt_farm_input *input = &plan->inputs[i];
        char text[33], *path = fmt_farm_path_in_plan(plan->path, input->path);
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

static json_t *identities_to_json(const struct fmt_farm_plan *plan)
{
    json_t *list = json_array();
    int failed = list == NULL;
    for (uint32_t i = 0; i < plan->input_count; i++) {
        const char *identity = plan->inputs[i].identity;
        failed |= json_array_append_new(list, identity ? json_string(identity) : json_null());
    }
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

/* Adds what plans of all kinds have, except for the id and the identities. Returns whether that
 * worked. */
static bool complete(const struct fmt_farm_plan *plan, json_t *json)
{
    const struct fmt_farm_kind *kind = plan->kind;
    return json_object_set_new(json, "format", json_string(kind->format)) == 0 &&
           json_object_set_new(json, "format_version", json_integer(kind->format_version)) == 0 &&
           json_object_set_new(json, "program_version", json_string(kind->program_version)) == 0 &&
           json_object_set_new(json, "tasks", json_integer(plan->task_count)) == 0 &&
           json_object_set_new(json, "inputs", inputs_to_json(plan)) == 0;
}

/* Computes the checksum of a plan's JSON, without its id and identities: of its compact form with
 * sorted names. Returns false if there is no memory. */
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

int fmt_farm_write_text(struct bsq_ctx *ctx, const char *path, const char *text)
{
    struct bsq_output *output;
    int status = bsq_output_open(ctx, path, &output);
    if (status < 0)
        return status;
    status = bsq_output_write(output, text, strlen(text));
    if (status == 0)
        return bsq_output_commit(output);
    bsq_output_discard(output);
    return status;
}

/* Returns whether the file at the plan's path is this text already, but for the identities, which
 * are its last member. */
static bool is_there(const struct fmt_farm_plan *plan, const char *text)
{
    const char *last = strstr(text, ",\n \"" IDENTITIES "\": ");
    const size_t length = last ? (size_t)(last - text) + 1 : 0;
    char *found = malloc(length + 1);
    FILE *file = fopen(plan->path, "re");
    const bool same = last && found && file && fread(found, 1, length, file) == length &&
                      memcmp(found, text, length) == 0;
    if (file)
        fclose(file);
    free(found);
    return same;
}

/* Returns the whole text of a plan, whose id it sets; NULL if there is no memory. The caller frees
 * it. */
static char *plan_text(struct fmt_farm_plan *plan, json_t *json)
{
    char id[33];
    if (!json || !complete(plan, json) || !compute_id(json, plan->id))
        return NULL;
    hash_text(plan->id, id);
    if (json_object_set_new(json, "id", json_string(id)) != 0 ||
        json_object_set_new(json, IDENTITIES, identities_to_json(plan)) != 0)
        return NULL;
    return json_dumps(json, JSON_INDENT(1) | JSON_ENSURE_ASCII | JSON_REAL_PRECISION(17));
}

int fmt_farm_plan_write(struct fmt_farm_plan *plan, json_t *members, bool *kept)
{
    char *text = NULL;
    int status = 0;
    for (uint32_t i = 0; i < plan->input_count && status == 0; i++)
        status = fmt_farm_check_name(plan->ctx, plan->inputs[i].path);
    if (status == 0) {
        text = plan_text(plan, members);
        status = text ? 0 : fmt_farm_fail_memory(plan);
    }
    *kept = status == 0 && text && is_there(plan, text);
    if (status == 0 && text && !*kept)
        status = fmt_farm_write_text(plan->ctx, plan->path, text);
    free(text);
    json_decref(members);
    return status;
}

/* ---- reading ---- */

bool fmt_farm_is_count(const json_t *value, uint64_t most, uint64_t *out)
{
    const json_int_t number = json_integer_value(value);
    if (!json_is_integer(value) || number < 0 || (uint64_t)number > most)
        return false;
    *out = (uint64_t)number;
    return true;
}

int fmt_farm_read_count(const struct fmt_farm_plan *plan, const json_t *json, const char *name,
                        uint64_t least, uint64_t most, uint64_t *out)
{
    return fmt_farm_is_count(json_object_get(json, name), most, out) && *out >= least
               ? 0
               : fmt_farm_fail_plan(plan, name);
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

static int read_inputs(struct fmt_farm_plan *plan, const json_t *list)
{
    const size_t count = json_array_size(list);
    if (!json_is_array(list) || count > UINT32_MAX)
        return fmt_farm_fail_plan(plan, "inputs");
    plan->inputs = calloc(count + 1, sizeof *plan->inputs);
    if (!plan->inputs)
        return fmt_farm_fail_memory(plan);
    for (size_t i = 0; i < count; i++) {
        const json_t *json = json_array_get(list, i);
        struct fmt_farm_input *input = &plan->inputs[plan->input_count++];
        const char *path = json_string_value(json_object_get(json, "path"));
        const char *role = json_string_value(json_object_get(json, "role"));
        int status = fmt_farm_read_count(plan, json, "bytes", 0, INT64_MAX, &input->bytes);
        if (status < 0)
            return status;
        if (!path || !role ||
            !read_hash(json_string_value(json_object_get(json, "xxh3_128")), input->hash))
            return fmt_farm_fail_plan(plan, "an input");
        input->path = fmt_farm_path_from_plan(plan->ctx, plan->path, path);
        input->role = strdup(role);
        if (!input->path || !input->role)
            return fmt_farm_fail_memory(plan);
    }
    return 0;
}

/* Reads the identities of the inputs; list: NULL if there are none. */
static int read_identities(struct fmt_farm_plan *plan, const json_t *list)
{
    for (uint32_t i = 0; i < plan->input_count; i++) {
        const char *identity = json_string_value(json_array_get(list, i));
        plan->inputs[i].identity = identity ? strdup(identity) : NULL;
        if (identity && !plan->inputs[i].identity)
            return fmt_farm_fail_memory(plan);
    }
    return 0;
}

/* Checks that a file is a plan of this kind, of this program. */
static int check_format(const struct fmt_farm_plan *plan, const json_t *json)
{
    const struct fmt_farm_kind *kind = plan->kind;
    const char *format = json_string_value(json_object_get(json, "format"));
    const char *program = json_string_value(json_object_get(json, "program_version"));
    if (!format || strcmp(format, kind->format) != 0)
        return bsq_fail(plan->ctx, BSQ_EDATA, "%s: not a plan of %s", plan->path, kind->program);
    if (!program || strcmp(program, kind->program_version) != 0)
        return bsq_fail(plan->ctx, BSQ_EDATA,
                        "%s: this plan is of Bisque %s, this program is %s: all tasks need one "
                        "version",
                        plan->path, program ? program : "(unknown)", kind->program_version);
    if (json_integer_value(json_object_get(json, "format_version")) != kind->format_version)
        return bsq_fail(plan->ctx, BSQ_EDATA, "%s: unknown version of the plan's format",
                        plan->path);
    return 0;
}

/* Checks the id, and removes it from the JSON. */
static int read_id(struct fmt_farm_plan *plan, json_t *json)
{
    uint64_t found[2];
    if (!read_hash(json_string_value(json_object_get(json, "id")), plan->id))
        return fmt_farm_fail_plan(plan, "id");
    json_object_del(json, "id");
    if (!compute_id(json, found))
        return fmt_farm_fail_memory(plan);
    return found[0] == plan->id[0] && found[1] == plan->id[1]
               ? 0
               : fmt_farm_fail_plan(plan, "its id does not fit the rest");
}

static int read_members(struct fmt_farm_plan *plan, json_t *json)
{
    uint64_t tasks = 0;
    json_t *identities = json_incref(json_object_get(json, IDENTITIES));
    json_object_del(json, IDENTITIES);
    int status = check_format(plan, json);
    if (status == 0)
        status = read_id(plan, json);
    if (status == 0)
        status = fmt_farm_read_count(plan, json, "tasks", 1, plan->kind->most_tasks, &tasks);
    plan->task_count = (uint32_t)tasks;
    if (status == 0)
        status = read_inputs(plan, json_object_get(json, "inputs"));
    if (status == 0)
        status = read_identities(plan, identities);
    json_decref(identities);
    return status;
}

/* Reads the file as JSON. */
static int load(const struct fmt_farm_plan *plan, struct fmt_farm_text *out)
{
    struct bsq_ctx *ctx = plan->ctx;
    struct bsq_file file;
    char *text = NULL;
    json_error_t error;
    int status = bsq_file_open_as(ctx, plan->path, BSQ_OPEN_OTHER, &file);
    if (status < 0)
        return status;
    status = bsq_alloc(ctx, "plan", file.size, 1, &text);
    if (status == 0)
        status = bsq_file_read(ctx, &file, text, file.size, 0);
    const uint64_t bound = status == 0 ? bsq_json_bound(text, file.size) : 0;
    if (status == 0 && (status = bsq_reserve(ctx, "plan", bound)) == 0)
        out->reserved = bound;
    if (status == 0 && !(out->json = json_loadb(text, file.size, JSON_REJECT_DUPLICATES, &error)))
        status = bsq_fail(ctx, BSQ_EDATA, "%s:%d: not a plan of %s: %s", plan->path, error.line,
                          plan->kind->program, error.text);
    bsq_free(ctx, text);
    bsq_file_close(ctx, &file);
    return status;
}

int fmt_farm_plan_read(struct bsq_ctx *ctx, const struct fmt_farm_kind *kind, const char *path,
                       struct fmt_farm_plan *plan, struct fmt_farm_text *text)
{
    *text = (struct fmt_farm_text){.ctx = ctx};
    int status = fmt_farm_plan_init(ctx, kind, path, 0, plan);
    if (status == 0)
        status = load(plan, text);
    return status < 0 ? status : read_members(plan, text->json);
}

void fmt_farm_text_clear(struct fmt_farm_text *text)
{
    json_decref(text->json);
    if (text->ctx)
        bsq_release(text->ctx, text->reserved);
    *text = (struct fmt_farm_text){0};
}
