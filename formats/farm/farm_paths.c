/* farm_paths.c - how a plan names files, so that a folder with a plan can move. */
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/path_map.h"
#include "formats/farm/farm.h"

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

char *fmt_farm_path_in_plan(const char *plan_path, const char *path)
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

char *fmt_farm_path_from_plan(struct bsq_ctx *ctx, const char *plan_path, const char *name)
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

int fmt_farm_check_name(struct bsq_ctx *ctx, const char *path)
{
    json_t *name = path ? json_string(path) : NULL;
    const bool good = !path || name;
    json_decref(name);
    return good ? 0 : bsq_fail(ctx, BSQ_EUSAGE, "%s: a plan cannot name it: it is not UTF-8", path);
}
