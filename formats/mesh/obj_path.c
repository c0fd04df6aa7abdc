/* obj_path.c - finds the files that OBJ and MTL files name. */
#include "formats/mesh/obj_path.h"

#include <string.h>
#include <sys/stat.h>

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

int fmt_path_find(struct bsq_ctx *ctx, const char *beside, const char *name, char **out,
                  bool *exists)
{
    size_t directory = name[0] == '/' ? 0 : (size_t)(last_component(beside) - beside);
    size_t beside_directory = (size_t)(last_component(beside) - beside);
    size_t name_size = strlen(name) + 1;
    char *path = NULL;
    int status = bsq_alloc(ctx, "names", beside_directory + name_size, 1, &path);
    *out = path;
    if (status)
        return status;
    memcpy(path, beside, directory);
    memcpy(path + directory, name, name_size);
    bool found = is_file(path);
    if (!found) {
        for (char *c = path + directory; *c; c++)
            if (*c == '\\')
                *c = '/';
        found = is_file(path);
    }
    if (!found) {
        const char *component = last_component(name);
        const char *backslash = strrchr(component, '\\');
        if (backslash)
            component = backslash + 1;
        memcpy(path, beside, beside_directory);
        strcpy(path + beside_directory, component);
        found = *component && is_file(path);
    }
    if (!found) {
        memcpy(path, beside, directory);
        memcpy(path + directory, name, name_size);
    }
    if (exists)
        *exists = found;
    return 0;
}
