/* obj_path.c - finds the files that OBJ and MTL files name. */
#include "formats/mesh/obj_path.h"

#include <dirent.h>
#include <limits.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

#include "base/path_map.h"
#include "formats/mesh/mesh_text.h"

static bool is_file(const char *path)
{
    struct stat info;
    return stat(path, &info) == 0 && S_ISREG(info.st_mode);
}

static const char *last_component(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

/* Replaces the last component of `path` by the name of a file that differs in its capitals. Takes
 * the first one in the order of bytes. Returns whether there is one. */
static bool find_in_any_case(char *path)
{
    char *name = path + (last_component(path) - path), best[NAME_MAX + 1] = "";
    const char first = *name;
    *name = '\0';
    DIR *directory = opendir(name == path ? "." : path);
    *name = first;
    for (struct dirent *entry; directory && (entry = readdir(directory)) != NULL;)
        if (strcasecmp(entry->d_name, name) == 0 && (!*best || strcmp(entry->d_name, best) < 0))
            strcpy(best, entry->d_name);
    if (directory)
        closedir(directory);
    if (!*best)
        return false;
    memcpy(name, best, strlen(name));
    return is_file(path);
}

/* Tries the name, then the name with slashes instead of backslashes, then its last component.
 * `path` has space for the directory of `beside` and the name. */
static bool find_file(const char *beside, const char *name, bool any_case, char *path)
{
    const size_t beside_directory = (size_t)(last_component(beside) - beside);
    const size_t directory = name[0] == '/' ? 0 : beside_directory;
    memcpy(path, beside, directory);
    strcpy(path + directory, name);
    if (any_case ? find_in_any_case(path) : is_file(path))
        return true;
    strcpy(path + directory, name);
    for (char *c = path + directory; *c; c++)
        if (*c == '\\')
            *c = '/';
    if (any_case ? find_in_any_case(path) : is_file(path))
        return true;
    const char *component = last_component(name), *backslash = strrchr(component, '\\');
    component = backslash ? backslash + 1 : component;
    memcpy(path, beside, beside_directory);
    strcpy(path + beside_directory, component);
    return *component && (any_case ? find_in_any_case(path) : is_file(path));
}

int fmt_path_find(struct bsq_ctx *ctx, const char *beside, const char *name, char **out,
                  bool *exists)
{
    const size_t beside_directory = (size_t)(last_component(beside) - beside);
    const char *mapped = bsq_map_path(ctx, name), *plain = NULL;
    char *copy = NULL;
    *out = NULL;
    int status = mapped ? fmt_string_copy(ctx, name, &copy) : BSQ_ENOMEM;
    if (!status)
        status = bsq_check(ctx); /* directories may be long */
    const bool changed = !status && fmt_mesh_plain_name(copy);
    if (!status && !(plain = bsq_map_path(ctx, copy)))
        status = BSQ_ENOMEM;
    if (!status)
        status =
            bsq_alloc(ctx, "names", beside_directory + strlen(mapped) + strlen(plain) + 1, 1, out);
    if (status)
        goto done;
    const bool found = find_file(beside, mapped, false, *out) ||
                       (changed && find_file(beside, plain, false, *out)) ||
                       find_file(beside, plain, true, *out);
    if (exists)
        *exists = found;
    if (!found) {
        const size_t directory = plain[0] == '/' ? 0 : beside_directory;
        memcpy(*out, beside, directory);
        strcpy(*out + directory, plain);
    }
done:
    bsq_free(ctx, copy);
    if (status) {
        bsq_free(ctx, *out);
        *out = NULL;
    }
    return status;
}
