/* farm_options.c - the options of a job as JSON, by a table of their members. */
#include <stdlib.h>
#include <string.h>

#include "formats/farm/farm.h"

static void *member_of(const void *options, const struct fmt_farm_member *member)
{
    return (char *)(uintptr_t)options + member->offset;
}

/* Returns the count of a list of paths. */
static uint32_t *count_of(const void *options, const struct fmt_farm_member *member)
{
    return (void *)((char *)(uintptr_t)options + member->most);
}

static bool is_string(const struct fmt_farm_member *member)
{
    return member->kind == FMT_FARM_PATH || member->kind == FMT_FARM_OPTIONAL ||
           member->kind == FMT_FARM_TEXT;
}

/* ---- writing ---- */

static json_t *path_to_json(const char *plan_path, const char *path)
{
    char *name = path ? fmt_farm_path_in_plan(plan_path, path) : NULL;
    json_t *json = name ? json_string(name) : path ? NULL : json_null();
    free(name);
    return json;
}

static json_t *paths_to_json(const char *plan_path, char *const *paths, uint32_t count)
{
    json_t *list = json_array();
    int failed = list == NULL;
    for (uint32_t i = 0; i < count; i++)
        failed |= json_array_append_new(list, path_to_json(plan_path, paths[i]));
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

static json_t *member_to_json(const void *options, const struct fmt_farm_member *member,
                              const char *plan_path)
{
    const void *at = member_of(options, member);
    switch (member->kind) {
    case FMT_FARM_PATH:
    case FMT_FARM_OPTIONAL:
        return path_to_json(plan_path, *(const char *const *)at);
    case FMT_FARM_PATHS:
        return paths_to_json(plan_path, *(char *const *const *)at, *count_of(options, member));
    case FMT_FARM_TEXT:
        return *(const char *const *)at ? json_string(*(const char *const *)at) : json_null();
    case FMT_FARM_U32:
    case FMT_FARM_CHOICE:
        return json_integer(*(const uint32_t *)at);
    case FMT_FARM_U64:
        return json_integer((json_int_t) * (const uint64_t *)at);
    case FMT_FARM_NUMBER:
        return json_real(*(const double *)at);
    default:
        return json_boolean(*(const bool *)at);
    }
}

json_t *fmt_farm_options_to_json(const struct fmt_farm_member *members, size_t count,
                                 const void *options, const char *plan_path)
{
    json_t *json = json_object();
    int failed = json == NULL;
    for (size_t i = 0; i < count; i++)
        failed |= json_object_set_new(json, members[i].name,
                                      member_to_json(options, &members[i], plan_path));
    if (!failed)
        return json;
    json_decref(json);
    return NULL;
}

/* ---- reading ---- */

int fmt_farm_fail_option(struct bsq_ctx *ctx, const char *plan_path, const char *name)
{
    return bsq_fail(ctx, BSQ_EDATA, "%s: the option %s is missing or has no value that it can have",
                    plan_path, name);
}

bool fmt_farm_is_count(const json_t *value, uint64_t most, uint64_t *out)
{
    const json_int_t number = json_integer_value(value);
    if (!json_is_integer(value) || number < 0 || (uint64_t)number > most)
        return false;
    *out = (uint64_t)number;
    return true;
}

static bool read_string(struct bsq_ctx *ctx, const char *plan_path,
                        const struct fmt_farm_member *member, const json_t *value, char **out)
{
    const char *text = json_string_value(value);
    *out = NULL;
    if (text)
        *out = member->kind == FMT_FARM_TEXT ? strdup(text)
                                             : fmt_farm_path_from_plan(ctx, plan_path, text);
    const bool optional = member->kind == FMT_FARM_OPTIONAL ||
                          (member->kind == FMT_FARM_TEXT && member->most == FMT_FARM_OR_NULL);
    return text ? *out != NULL : optional && json_is_null(value);
}

/* Reads a list of paths. *count: those that are there to be freed, also after a failure. */
static bool read_paths(struct bsq_ctx *ctx, const char *plan_path, const json_t *list, char ***out,
                       uint32_t *count)
{
    static const struct fmt_farm_member path = {.kind = FMT_FARM_PATH};
    const size_t size = json_array_size(list);
    bool good = json_is_array(list) && size <= UINT32_MAX;
    *count = 0;
    *out = good ? calloc(size + 1, sizeof **out) : NULL;
    for (size_t i = 0; *out && i < size && good; i++) {
        good = read_string(ctx, plan_path, &path, json_array_get(list, i), &(*out)[i]);
        *count += good;
    }
    return good && *out;
}

static bool read_member(struct bsq_ctx *ctx, void *options, const char *plan_path,
                        const struct fmt_farm_member *member, const json_t *value)
{
    void *at = member_of(options, member);
    uint64_t count = 0;
    bool good;
    switch (member->kind) {
    case FMT_FARM_PATH:
    case FMT_FARM_OPTIONAL:
    case FMT_FARM_TEXT:
        return read_string(ctx, plan_path, member, value, at);
    case FMT_FARM_PATHS:
        return read_paths(ctx, plan_path, value, at, count_of(options, member));
    case FMT_FARM_U32:
    case FMT_FARM_CHOICE:
        good = fmt_farm_is_count(value, member->kind == FMT_FARM_CHOICE ? member->most : UINT32_MAX,
                                 &count);
        *(uint32_t *)at = (uint32_t)count;
        return good;
    case FMT_FARM_U64:
        return fmt_farm_is_count(value, INT64_MAX, at);
    case FMT_FARM_NUMBER:
        *(double *)at = json_number_value(value);
        return json_is_number(value);
    default:
        *(bool *)at = json_is_true(value);
        return json_is_boolean(value);
    }
}

int fmt_farm_options_from_json(struct bsq_ctx *ctx, const struct fmt_farm_member *members,
                               size_t count, const char *plan_path, const json_t *json,
                               void *options)
{
    for (size_t i = 0; i < count; i++)
        if (!read_member(ctx, options, plan_path, &members[i],
                         json_object_get(json, members[i].name)))
            return fmt_farm_fail_option(ctx, plan_path, members[i].name);
    return 0;
}

void fmt_farm_options_free(const struct fmt_farm_member *members, size_t count, void *options)
{
    for (size_t i = 0; i < count; i++) {
        void *at = member_of(options, &members[i]);
        if (members[i].kind == FMT_FARM_PATHS) {
            char **paths = *(char ***)at;
            for (uint32_t k = 0; k < *count_of(options, &members[i]); k++)
                free(paths[k]);
        }
        if (members[i].kind == FMT_FARM_PATHS || is_string(&members[i]))
            free(*(void **)at);
    }
}
