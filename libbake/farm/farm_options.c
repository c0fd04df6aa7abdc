/* farm_options.c - see farm_options.h.
 *
 * A table lists the members of struct bake_options, so each is written and read in the same way. A
 * member that is missing in the table would be lost in tasks; the assertion on the size reminds of
 * it. */
#include "libbake/farm/farm_options.h"

#include <limits.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/path_map.h"

/* Only an OPTIONAL path may be null. */
enum kind { PATH, OPTIONAL, TEXT, U32, U64, NUMBER, BOOL, CHOICE };

struct member {
    const char *name;
    size_t offset;
    enum kind kind;
    uint32_t most; /* the largest value of a CHOICE */
};

#define MEMBER(kind, name)                                                                         \
    {                                                                                              \
#name, offsetof(struct bake_options, name), kind, 0                                        \
    }
#define CHOICE_MEMBER(name, last)                                                                  \
    {                                                                                              \
#name, offsetof(struct bake_options, name), CHOICE, last                                   \
    }

static const struct member members[] = {
    MEMBER(PATH, scan_path),
    MEMBER(PATH, mesh_path),
    MEMBER(U32, maps),
    MEMBER(PATH, output_path),
    CHOICE_MEMBER(sample_type, BAKE_FLOAT),
    MEMBER(U32, width),
    MEMBER(U32, height),
    MEMBER(U32, samples),
    CHOICE_MEMBER(rays, BAKE_RAYS_FACE),
    MEMBER(OPTIONAL, cage_path),
    MEMBER(NUMBER, front),
    MEMBER(NUMBER, back),
    MEMBER(U32, padding),
    MEMBER(BOOL, green_down),
    CHOICE_MEMBER(normal_space, BAKE_OBJECT_SPACE),
    CHOICE_MEMBER(sampling, BAKE_NEAREST),
    CHOICE_MEMBER(scan_normals, BSQ_SCAN_NORMALS_FLAT),
    MEMBER(NUMBER, height_range),
    CHOICE_MEMBER(position_in, BAKE_IN_BOX),
    MEMBER(NUMBER, curvature_range),
    MEMBER(NUMBER, curvature_radius),
    MEMBER(U32, ao_rays),
    MEMBER(NUMBER, ao_distance),
    MEMBER(NUMBER, ao_spread),
    MEMBER(BOOL, ao_falloff),
    MEMBER(U32, thickness_rays),
    MEMBER(NUMBER, thickness_distance),
    MEMBER(BOOL, two_sided),
    MEMBER(TEXT, device),
    MEMBER(U64, gpu_memory_bytes),
    MEMBER(U32, exr_tile_side),
    MEMBER(OPTIONAL, preview_path),
    MEMBER(U32, preview_views),
    CHOICE_MEMBER(preview_up, BAKE_UP_Z),
};
enum { MEMBERS = sizeof members / sizeof *members };

/* tile_sizes and tile_ranges are written by themselves. Plans have no more scans and meshes,
 * so names need no matching. */
_Static_assert(sizeof(struct bake_options) == 296, "a new option needs a row in `members`");
_Static_assert(sizeof(enum bake_rays) == sizeof(unsigned), "a CHOICE is an unsigned number");

static void *member_of(const void *options, const struct member *member)
{
    return (char *)(uintptr_t)options + member->offset;
}

/* ---- paths ---- */

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

char *bake_farm_path_in_plan(const char *plan_path, const char *path)
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

char *bake_farm_path_from_plan(struct bsq_ctx *ctx, const char *plan_path, const char *name)
{
    const char *slash = strrchr(plan_path, '/');
    name = bsq_map_path(ctx, name);
    if (!name || name[0] == '/' || !slash)
        return name ? strdup(name) : NULL;
    char *directory = strndup(plan_path, (size_t)(slash - plan_path)), *out = NULL;
    if (!directory)
        return NULL;
    while (strncmp(name, "../", 3) == 0 && remove_last(directory))
        name += 3;
    const char *between = directory[0] == '\0' && plan_path[0] != '/' ? "" : "/";
    if (asprintf(&out, "%s%s%s", directory, strcmp(directory, "/") == 0 ? "" : between, name) < 0)
        out = NULL;
    free(directory);
    return out;
}

/* ---- writing ---- */

static json_t *path_to_json(const char *plan_path, const char *path)
{
    char *name = path ? bake_farm_path_in_plan(plan_path, path) : NULL;
    json_t *json = name ? json_string(name) : path ? NULL : json_null();
    free(name);
    return json;
}

static json_t *member_to_json(const struct bake_options *options, const struct member *member,
                              const char *plan_path)
{
    const void *at = member_of(options, member);
    switch (member->kind) {
    case PATH:
    case OPTIONAL:
        return path_to_json(plan_path, *(const char *const *)at);
    case TEXT:
        return *(const char *const *)at ? json_string(*(const char *const *)at) : json_null();
    case U32:
    case CHOICE:
        return json_integer(*(const uint32_t *)at);
    case U64:
        return json_integer((json_int_t) * (const uint64_t *)at);
    case NUMBER:
        return json_real(*(const double *)at);
    default:
        return json_boolean(*(const bool *)at);
    }
}

static json_t *tile_sizes_to_json(const struct bake_options *options)
{
    json_t *list = json_array();
    for (uint32_t i = 0; i < options->tile_size_count; i++) {
        const struct bake_tile_size *size = &options->tile_sizes[i];
        json_array_append_new(list, json_pack("[I, I, I]", (json_int_t)size->tile,
                                              (json_int_t)size->width, (json_int_t)size->height));
    }
    return list;
}

static json_t *tile_ranges_to_json(const struct bake_options *options)
{
    json_t *list = json_array();
    for (uint32_t i = 0; i < options->tile_range_count; i++)
        json_array_append_new(list, json_pack("[I, I]", (json_int_t)options->tile_ranges[i].first,
                                              (json_int_t)options->tile_ranges[i].last));
    return list;
}

json_t *bake_farm_options_to_json(const struct bake_options *options, const char *plan_path)
{
    json_t *json = json_object();
    int failed = json == NULL;
    for (size_t i = 0; i < MEMBERS; i++)
        failed |= json_object_set_new(json, members[i].name,
                                      member_to_json(options, &members[i], plan_path));
    failed |= json_object_set_new(json, "tile_sizes", tile_sizes_to_json(options));
    failed |= json_object_set_new(json, "tile_ranges", tile_ranges_to_json(options));
    if (failed) {
        json_decref(json);
        return NULL;
    }
    return json;
}

/* ---- reading ---- */

static int fail_member(struct bsq_ctx *ctx, const char *plan_path, const char *name)
{
    return bsq_fail(ctx, BSQ_EDATA, "%s: the option %s is missing or has no value that it can have",
                    plan_path, name);
}

/* Reads a whole number up to `most`. Returns false if the value is none. */
static bool read_count(const json_t *value, uint64_t most, uint64_t *out)
{
    const json_int_t number = json_integer_value(value);
    if (!json_is_integer(value) || number < 0 || (uint64_t)number > most)
        return false;
    *out = (uint64_t)number;
    return true;
}

static bool read_string(struct bsq_ctx *ctx, const char *plan_path, const struct member *member,
                        const json_t *value, char **out)
{
    const char *text = json_string_value(value);
    *out = NULL;
    if (text)
        *out = member->kind == TEXT ? strdup(text) : bake_farm_path_from_plan(ctx, plan_path, text);
    return text ? *out != NULL : member->kind == OPTIONAL && json_is_null(value);
}

static bool read_member(struct bsq_ctx *ctx, struct bake_options *options, const char *plan_path,
                        const struct member *member, const json_t *value)
{
    void *at = member_of(options, member);
    uint64_t count = 0;
    bool good;
    switch (member->kind) {
    case PATH:
    case OPTIONAL:
    case TEXT:
        return read_string(ctx, plan_path, member, value, at);
    case U32:
    case CHOICE:
        good = read_count(value, member->kind == CHOICE ? member->most : UINT32_MAX, &count);
        *(uint32_t *)at = (uint32_t)count;
        return good;
    case U64:
        return read_count(value, INT64_MAX, at);
    case NUMBER:
        *(double *)at = json_number_value(value);
        return json_is_number(value);
    default:
        *(bool *)at = json_is_true(value);
        return json_is_boolean(value);
    }
}

/* Reads a list of lists of `width` numbers. The caller frees *out. */
static bool read_lists(const json_t *json, size_t width, uint32_t **out, uint32_t *count)
{
    *count = 0;
    *out = calloc(json_array_size(json) * width + 1, sizeof **out);
    if (!json_is_array(json) || !*out || json_array_size(json) > UINT32_MAX)
        return false;
    for (size_t i = 0; i < json_array_size(json); i++)
        for (size_t k = 0; k < width; k++) {
            uint64_t number;
            if (!read_count(json_array_get(json_array_get(json, i), k), UINT32_MAX, &number))
                return false;
            (*out)[i * width + k] = (uint32_t)number;
        }
    *count = (uint32_t)json_array_size(json);
    return true;
}

static bool read_tiles(const json_t *json, struct bake_options *options)
{
    _Static_assert(sizeof(struct bake_tile_size) == 3 * sizeof(uint32_t), "three numbers");
    _Static_assert(sizeof(struct bake_tile_range) == 2 * sizeof(uint32_t), "two numbers");
    uint32_t *sizes = NULL, *ranges = NULL;
    bool good =
        read_lists(json_object_get(json, "tile_sizes"), 3, &sizes, &options->tile_size_count);
    options->tile_sizes = (const struct bake_tile_size *)sizes;
    good = good &&
           read_lists(json_object_get(json, "tile_ranges"), 2, &ranges, &options->tile_range_count);
    options->tile_ranges = (const struct bake_tile_range *)ranges;
    return good;
}

int bake_farm_options_from_json(struct bsq_ctx *ctx, const char *plan_path, const json_t *json,
                                struct bake_options *out)
{
    *out = (struct bake_options){0};
    for (size_t i = 0; i < MEMBERS; i++)
        if (!read_member(ctx, out, plan_path, &members[i], json_object_get(json, members[i].name)))
            return fail_member(ctx, plan_path, members[i].name);
    return read_tiles(json, out) ? 0 : fail_member(ctx, plan_path, "tile_sizes or tile_ranges");
}

void bake_farm_options_free(struct bake_options *options)
{
    for (size_t i = 0; i < MEMBERS; i++)
        if (members[i].kind == PATH || members[i].kind == OPTIONAL || members[i].kind == TEXT)
            free(*(char **)member_of(options, &members[i]));
    free((void *)(uintptr_t)options->tile_sizes);
    free((void *)(uintptr_t)options->tile_ranges);
}
