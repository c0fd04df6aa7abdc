/* farm_json.c - structures as JSON, by the rows of their tables; and how a plan names files, so
 * that a folder with a plan can move. */
#include "libbake/farm/farm_json.h"

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/path_map.h"

/* ---- names of files ---- */

/* Returns the directory of a plan as an absolute path without links; NULL if it does not exist or
 * there is no memory. */
static char *plan_directory(const char *plan_path)
{
    const char *slash = strrchr(plan_path, '/');
    char *directory = slash ? strndup(plan_path, (size_t)(slash - plan_path) + 1) : strdup(".");
    char *real = directory ? realpath(directory, NULL) : NULL;
    free(directory);
    return real;
}

/* Returns an absolute path of a file that need not exist. */
static char *absolute(const char *path)
{
    char here[PATH_MAX], *out = NULL;
    if (path[0] == '/' || !getcwd(here, sizeof here))
        return strdup(path);
    return asprintf(&out, "%s/%s", strcmp(here, "/") == 0 ? "" : here, path) < 0 ? NULL : out;
}

/* Returns whether no component of an absolute path but the last is "." or "..". */
static bool is_plain(const char *path)
{
    return !strstr(path, "/../") && !strstr(path, "/./");
}

/* Replaces the directory of an absolute path that is not plain by its real one, if it exists. The
 * path is on the heap, and so is what is returned; NULL if there is no memory. */
static char *made_plain(char *path)
{
    char *slash = path ? strrchr(path, '/') : NULL, *out = NULL;
    if (!slash || is_plain(path))
        return path;
    *slash = '\0';
    char *real = realpath(path, NULL);
    *slash = '/';
    if (!real)
        return path;
    if (asprintf(&out, "%s%s", strcmp(real, "/") == 0 ? "" : real, slash) < 0)
        out = NULL;
    free(real);
    free(path);
    return out;
}

/* Returns the path of `to` as seen from `directory`; both are absolute and share `common` bytes of
 * whole components. */
static char *path_from(const char *directory, const char *to, size_t common)
{
    const char *rest = to + common + (to[common] == '/');
    size_t ups = 0;
    for (const char *c = directory + common; *c; c++)
        ups += *c == '/' && c[1] != '\0';
    char *out = malloc(3 * ups + strlen(rest) + 1), *end = out;
    for (size_t i = 0; out && i < ups; i++)
        end = mempcpy(end, "../", 3);
    if (out)
        memcpy(end, rest, strlen(rest) + 1);
    return out;
}

/* Returns the bytes that both paths share, up to the end of a component. */
static size_t shared_bytes(const char *directory, const char *path)
{
    size_t common = 0;
    for (size_t i = 0;; i++) {
        const bool end = directory[i] == '\0' || directory[i] == '/';
        if (end && (path[i] == '/' || path[i] == '\0'))
            common = i;
        if (directory[i] == '\0' || directory[i] != path[i])
            return common;
    }
}

/* Returns how a plan names a file: a path below the plan's directory, and one that was given
 * relative to the current directory, becomes relative to the plan's directory; others stay as they
 * are. The caller frees it. NULL if there is no memory. */
static char *name_in_plan(const char *plan_path, const char *path)
{
    char *directory = plan_directory(plan_path), *full = made_plain(absolute(path)), *out = NULL;
    if (directory && full) {
        const size_t common = shared_bytes(directory, full);
        const bool below = common == strlen(directory) && full[common] == '/';
        if (is_plain(full) && (below || path[0] != '/'))
            out = path_from(directory, full, common);
    }
    if (!out && full)
        out = strdup(full);
    free(directory);
    free(full);
    return out;
}

/* Removes the last component of a directory if that leads to its parent: if the component is a
 * directory, no link. Returns false if it is not. */
static bool remove_last(char *directory)
{
    struct stat info;
    char *slash = strrchr(directory, '/'), *last = slash ? slash + 1 : directory;
    if (*last == '\0' || strcmp(last, ".") == 0 || strcmp(last, "..") == 0 ||
        lstat(directory, &info) != 0 || !S_ISDIR(info.st_mode))
        return false;
    if (slash == directory)
        last[0] = '\0';
    else
        *(slash ? slash : directory) = '\0';
    return true;
}

/* Returns the path that a name in a plan stands for. Rules for paths (base/path_map.h) apply to
 * absolute ones. The caller frees it. NULL if there is no memory. */
static char *path_of_name(const struct bake_farm_names *names, const char *name)
{
    const char *slash = strrchr(names->plan_path, '/');
    name = bsq_map_path(names->ctx, name);
    if (!name || name[0] == '/' || !slash)
        return name ? strdup(name) : NULL;
    char *directory = strndup(names->plan_path, (size_t)(slash - names->plan_path)), *out = NULL;
    if (!directory)
        return NULL;
    while (strncmp(name, "../", 3) == 0 && remove_last(directory))
        name += 3;
    const char *between = directory[0] == '\0' && names->plan_path[0] != '/' ? "" : "/";
    if (asprintf(&out, "%s%s%s", directory, strcmp(directory, "/") == 0 ? "" : between, name) < 0)
        out = NULL;
    free(directory);
    return out;
}

/* ---- rows ---- */

static struct bake_farm_table table_of(const struct bsq_option *row)
{
    return (struct bake_farm_table){row->rows, row->row_count};
}

static uint32_t *count_of(const struct bsq_option *row, const void *of)
{
    return (void *)((char *)(uintptr_t)of + row->count_offset);
}

/* Returns element i of a list. */
static char *element_of(const struct bsq_option *row, const void *of, uint32_t i)
{
    return *(char **)bsq_option_at(row, of) + i * row->element_bytes;
}

/* ---- writing ---- */

static json_t *text_to_json(struct bake_farm_names *names, const char *text)
{
    json_t *json = json_string(text), *other = json ? NULL : json_string_nocheck(text);
    if (other) {
        bsq_fail(names->ctx, BSQ_EUSAGE, "%s: a plan cannot name it: it is not UTF-8", text);
        names->failed = true;
        json_decref(other);
    }
    return json;
}

static json_t *path_to_json(struct bake_farm_names *names, const char *path)
{
    char *name = path ? name_in_plan(names->plan_path, path) : NULL;
    json_t *json = name ? text_to_json(names, name) : path ? NULL : json_null();
    free(name);
    return json;
}

static json_t *list_to_json(struct bake_farm_names *names, const struct bsq_option *row,
                            const void *from)
{
    json_t *list = json_array();
    for (uint32_t i = 0; list && i < *count_of(row, from); i++)
        if (json_array_append_new(
                list, bake_farm_to_json(names, table_of(row), element_of(row, from, i))) != 0) {
            json_decref(list);
            list = NULL;
        }
    return list;
}

static json_t *member_to_json(struct bake_farm_names *names, const struct bsq_option *row,
                              const void *from)
{
    const void *at = bsq_option_at(row, from);
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
        return text_to_json(names, *(const char *const *)at);
    case BSQ_OPTION_LIST:
        return list_to_json(names, row, from);
    default:
        return path_to_json(names, *(const char *const *)at);
    }
}

/* A single row without a name stands for its value. */
json_t *bake_farm_to_json(struct bake_farm_names *names, struct bake_farm_table table,
                          const void *from)
{
    if (!table.rows->member)
        return member_to_json(names, table.rows, from);
    json_t *json = json_object();
    for (size_t i = 0; json && i < table.count; i++)
        if (json_object_set_new(json, table.rows[i].member,
                                member_to_json(names, &table.rows[i], from)) != 0) {
            json_decref(json);
            json = NULL;
        }
    return json;
}

/* ---- reading ---- */

static int fail_value(const struct bake_farm_names *names, const struct bsq_option *row)
{
    return bsq_fail(names->ctx, BSQ_EDATA, "%s: damaged plan: %s is missing or has no such value",
                    names->plan_path, row->member ? row->member : "one of several files");
}

static int fail_memory(const struct bake_farm_names *names)
{
    return bsq_fail(names->ctx, BSQ_ENOMEM, "%s: out of memory", names->plan_path);
}

/* Reads a whole number from 0 to `most`. Returns false if the value is none. */
static bool read_count(const json_t *json, uint64_t most, uint64_t *out)
{
    const json_int_t number = json_integer_value(json);
    *out = (uint64_t)number;
    return json_is_integer(json) && number >= 0 && (uint64_t)number <= most;
}

/* Reads a text or a path. */
static int read_text(const struct bake_farm_names *names, const struct bsq_option *row,
                     const json_t *json, char **out)
{
    const char *text = json_string_value(json);
    const bool is_path = row->kind != BSQ_OPTION_TEXT;
    if (!text)
        return is_path && row->member && json_is_null(json) ? 0 : fail_value(names, row);
    *out = is_path ? path_of_name(names, text) : strdup(text);
    return *out ? 0 : fail_memory(names);
}

/* Counts the elements that are there to be freed, also after a failure. */
static int read_list(const struct bake_farm_names *names, const struct bsq_option *row,
                     const json_t *json, void *to)
{
    const size_t size = json_array_size(json);
    char *list;
    if (!json_is_array(json) || size > UINT32_MAX)
        return fail_value(names, row);
    int status = bsq_calloc(names->ctx, "plan", size, row->element_bytes, &list);
    if (status < 0)
        return status;
    *(void **)bsq_option_at(row, to) = list;
    *count_of(row, to) = (uint32_t)size;
    for (uint32_t i = 0; i < size && status == 0; i++)
        status = bake_farm_from_json(names, table_of(row), json_array_get(json, i),
                                     element_of(row, to, i));
    return status;
}

static int read_member(const struct bake_farm_names *names, const struct bsq_option *row,
                       const json_t *json, void *to)
{
    void *at = bsq_option_at(row, to);
    uint64_t count = 0;
    bool good = true;
    switch (row->kind) {
    case BSQ_OPTION_FLAG:
        *(bool *)at = json_is_true(json);
        good = json_is_boolean(json);
        break;
    case BSQ_OPTION_COUNT:
    case BSQ_OPTION_CHOICE:
        good = read_count(json, UINT32_MAX, &count);
        *(uint32_t *)at = (uint32_t)count;
        break;
    case BSQ_OPTION_BYTES:
        good = read_count(json, INT64_MAX, at);
        break;
    case BSQ_OPTION_NUMBER:
        *(double *)at = json_number_value(json);
        good = json_is_number(json);
        break;
    case BSQ_OPTION_LIST:
        return read_list(names, row, json, to);
    default:
        return read_text(names, row, json, at);
    }
    return good ? 0 : fail_value(names, row);
}

int bake_farm_from_json(const struct bake_farm_names *names, struct bake_farm_table table,
                        const json_t *json, void *to)
{
    int status = 0;
    for (const struct bsq_option *row = table.rows; row < table.rows + table.count; row++)
        BSQ_TRY(
            read_member(names, row, row->member ? json_object_get(json, row->member) : json, to));
done:
    return status;
}

void bake_farm_clear(struct bsq_ctx *ctx, struct bake_farm_table table, void *of)
{
    for (const struct bsq_option *row = table.rows; row < table.rows + table.count; row++) {
        void **at = bsq_option_at(row, of);
        if (row->kind == BSQ_OPTION_LIST) {
            for (uint32_t i = 0; *at && i < *count_of(row, of); i++)
                bake_farm_clear(ctx, table_of(row), element_of(row, of, i));
            bsq_free(ctx, *at);
        } else if (row->kind == BSQ_OPTION_TEXT || row->kind == BSQ_OPTION_INPUT ||
                   row->kind == BSQ_OPTION_OUTPUT) {
            free(*at);
        }
    }
}
