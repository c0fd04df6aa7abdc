/* farm_options.c - the options of a bake as JSON, by the rows of their table. */
#include "libbake/farm/farm_options.h"

#include <stdlib.h>
#include <string.h>

static uint32_t *count_of(const struct bsq_option *row, const void *options)
{
    return (void *)((char *)(uintptr_t)options + row->count_offset);
}

/* Returns element i of a list. */
static char *element_of(const struct bsq_option *row, const void *options, uint32_t i)
{
    return *(char **)bsq_option_at(row, options) + i * row->element_bytes;
}

/* ---- writing ---- */

static json_t *rows_to_json(const struct bsq_option *rows, size_t count, const void *options,
                            const char *plan_path);

static json_t *path_to_json(const char *path, const char *plan_path)
{
    char *name = path ? fmt_farm_path_in_plan(plan_path, path) : NULL;
    json_t *json = name ? json_string(name) : path ? NULL : json_null();
    free(name);
    return json;
}

static json_t *list_to_json(const struct bsq_option *row, const void *options,
                            const char *plan_path)
{
    json_t *list = json_array();
    bool failed = list == NULL;
    for (uint32_t i = 0; i < *count_of(row, options); i++)
        failed |=
            json_array_append_new(list, rows_to_json(row->rows, row->row_count,
                                                     element_of(row, options, i), plan_path)) != 0;
    if (!failed)
        return list;
    json_decref(list);
    return NULL;
}

static json_t *member_to_json(const struct bsq_option *row, const void *options,
                              const char *plan_path)
{
    const void *at = bsq_option_at(row, options);
    switch (row->kind) {
    case BSQ_OPTION_FLAG:
        return json_boolean(*(const bool *)at);
    case BSQ_OPTION_COUNT:
    case BSQ_OPTION_CHOICE:
        return json_integer(*(const uint32_t *)at);
    case BSQ_OPTION_BYTES:
        return json_integer((json_int_t) * (const uint64_t *)at);
    case BSQ_OPTION_NUMBER:
        return json_real(*(const double *)at);
    case BSQ_OPTION_TEXT:
        return json_string(*(const char *const *)at);
    case BSQ_OPTION_LIST:
        return list_to_json(row, options, plan_path);
    default:
        return path_to_json(*(const char *const *)at, plan_path);
    }
}

/* Returns an object with all members; of a single row without a name, its value. */
static json_t *rows_to_json(const struct bsq_option *rows, size_t count, const void *options,
                            const char *plan_path)
{
    if (!rows->member)
        return member_to_json(rows, options, plan_path);
    json_t *json = json_object();
    bool failed = json == NULL;
    for (size_t i = 0; i < count; i++)
        failed |= json_object_set_new(json, rows[i].member,
                                      member_to_json(&rows[i], options, plan_path)) != 0;
    if (!failed)
        return json;
    json_decref(json);
    return NULL;
}

json_t *bake_farm_options_to_json(const struct bake_options *options, const char *plan_path)
{
    size_t count;
    const struct bsq_option *rows = bake_option_rows(&count);
    return rows_to_json(rows, count, options, plan_path);
}

/* ---- reading ---- */

/* Where options are read from. */
struct source {
    struct bsq_ctx *ctx;
    const char *plan_path;
};

static int read_rows(const struct source *from, const struct bsq_option *rows, size_t count,
                     const json_t *json, void *options);

static int fail(const struct source *from, const struct bsq_option *row)
{
    return bsq_fail(from->ctx, BSQ_EDATA, "%s: the option %s is missing or has no such value",
                    from->plan_path, row->member ? row->member : "of several files");
}

/* Reads a text or a path. */
static int read_text(const struct source *from, const struct bsq_option *row, const json_t *json,
                     char **out)
{
    const char *text = json_string_value(json);
    const bool optional = row->kind != BSQ_OPTION_TEXT && row->member;
    if (!text)
        return optional && json_is_null(json) ? 0 : fail(from, row);
    *out = row->kind == BSQ_OPTION_TEXT ? strdup(text)
                                        : fmt_farm_path_from_plan(from->ctx, from->plan_path, text);
    return *out ? 0 : bsq_fail(from->ctx, BSQ_ENOMEM, "%s: out of memory", from->plan_path);
}

/* Counts the elements that are there to be freed, also after a failure. */
static int read_list(const struct source *from, const struct bsq_option *row, const json_t *json,
                     void *options)
{
    const size_t size = json_array_size(json);
    void *list = NULL;
    int status = 0;
    if (!json_is_array(json) || size > UINT32_MAX)
        return fail(from, row);
    list = calloc(size + 1, row->element_bytes);
    if (!list)
        return bsq_fail(from->ctx, BSQ_ENOMEM, "%s: out of memory", from->plan_path);
    *(void **)bsq_option_at(row, options) = list;
    *count_of(row, options) = (uint32_t)size;
    for (uint32_t i = 0; i < size; i++)
        BSQ_TRY(read_rows(from, row->rows, row->row_count, json_array_get(json, i),
                          element_of(row, options, i)));
done:
    return status;
}

static int read_member(const struct source *from, const struct bsq_option *row, const json_t *json,
                       void *options)
{
    void *at = bsq_option_at(row, options);
    uint64_t count = 0;
    switch (row->kind) {
    case BSQ_OPTION_FLAG:
        *(bool *)at = json_is_true(json);
        return json_is_boolean(json) ? 0 : fail(from, row);
    case BSQ_OPTION_COUNT:
    case BSQ_OPTION_CHOICE:
        if (!fmt_farm_is_count(json, UINT32_MAX, &count))
            return fail(from, row);
        *(uint32_t *)at = (uint32_t)count;
        return 0;
    case BSQ_OPTION_BYTES:
        return fmt_farm_is_count(json, INT64_MAX, at) ? 0 : fail(from, row);
    case BSQ_OPTION_NUMBER:
        *(double *)at = json_number_value(json);
        return json_is_number(json) ? 0 : fail(from, row);
    case BSQ_OPTION_LIST:
        return read_list(from, row, json, options);
    default:
        return read_text(from, row, json, at);
    }
}

static int read_rows(const struct source *from, const struct bsq_option *rows, size_t count,
                     const json_t *json, void *options)
{
    int status = 0;
    for (const struct bsq_option *row = rows; row < rows + count; row++)
        BSQ_TRY(read_member(from, row, row->member ? json_object_get(json, row->member) : json,
                            options));
done:
    return status;
}

int bake_farm_options_from_json(struct bsq_ctx *ctx, const char *plan_path, const json_t *json,
                                struct bake_options *out)
{
    size_t count;
    const struct bsq_option *rows = bake_option_rows(&count);
    *out = (struct bake_options){0};
    return read_rows(&(struct source){ctx, plan_path}, rows, count, json, out);
}

static void free_rows(const struct bsq_option *rows, size_t count, void *options)
{
    for (const struct bsq_option *row = rows; row < rows + count; row++) {
        void **at = bsq_option_at(row, options);
        if (row->kind == BSQ_OPTION_LIST)
            for (uint32_t i = 0; i < *count_of(row, options); i++)
                free_rows(row->rows, row->row_count, element_of(row, options, i));
        if (row->kind == BSQ_OPTION_LIST || row->kind == BSQ_OPTION_TEXT ||
            row->kind == BSQ_OPTION_INPUT || row->kind == BSQ_OPTION_OUTPUT)
            free(*at);
    }
}

void bake_farm_options_free(struct bake_options *options)
{
    size_t count;
    const struct bsq_option *rows = bake_option_rows(&count);
    free_rows(rows, count, options);
}
