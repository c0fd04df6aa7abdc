/* module.c - finds and opens modules.
 *
 * A module gets the functions of base in a table (struct fmt_host). There are two other ways:
 *
 * - Link each module with its own copy of base. Two copies would then work on one context, and both
 *   rely on addresses: threads of the pool would run code of either copy, and one copy would free
 *   the messages of the other.
 * - Let a module use the program's own symbols. Then every program must be linked to export all
 *   functions of base, and a library inside another program's plug-in cannot do that.
 *
 * A table works wherever the library is linked. The headers that declare it are the whole contract,
 * and the stamp proves that both sides were compiled with the same ones.
 *
 * Modules are looked for in three places, in this order: beside the file that contains this code (a
 * program, or a shared library that was linked with Bisque); in ../lib/bisque relative to that
 * file's directory, for moved installations and the build tree; in the installation directory.
 * Modules are never closed, because the libraries that they load own threads and exit handlers. */
#include <dlfcn.h>
#include <limits.h>
#include <link.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include "formats/module/module.h"

const struct fmt_host fmt_host_functions = {
#define INITIAL(name) .name = bsq_##name,
    FMT_HOST_FUNCTIONS(INITIAL)
#undef INITIAL
};

enum { PLACES = 3 };

static void cut_last_name(char *path)
{
    char *slash = strrchr(path, '/');

    if (slash)
        *slash = '\0';
}

/* Finds the directories to look in. Returns their number, at least 1. */
static int find_places(char places[PLACES][PATH_MAX])
{
    struct link_map *object = NULL;
    char own[PATH_MAX];
    Dl_info info;
    int count = 0;

    /* The main program has an empty l_name, and info.dli_fname is argv[0], not always a path. */
    const bool shared = dladdr1(&fmt_host_functions, &info, (void **)&object, RTLD_DL_LINKMAP) &&
                        object && object->l_name[0];
    if (realpath(shared ? object->l_name : "/proc/self/exe", own)) {
        cut_last_name(own);
        strcpy(places[count++], own);
        cut_last_name(own);
        if (snprintf(places[count], PATH_MAX, "%s/lib/bisque", own) < PATH_MAX)
            count++;
    }
    if (count == 0 || strcmp(places[count - 1], fmt_module_directory) != 0)
        snprintf(places[count++], PATH_MAX, "%s", fmt_module_directory);
    return count;
}

/* The first place that has the file decides: one further down the list was not installed with this
 * program. */
int fmt_module_find(struct bsq_ctx *ctx, const char *file, const char *purpose, char out[PATH_MAX])
{
    char places[PLACES][PATH_MAX];
    const int count = find_places(places);

    for (int i = 0; i < count; i++)
        if (snprintf(out, PATH_MAX, "%s/%s", places[i], file) < PATH_MAX && access(out, F_OK) == 0)
            return 0;
    return bsq_fail(ctx, BSQ_ENOINPUT, "%s need the %s %s, which is not in %s%s%s%s%s", purpose,
                    strstr(file, ".so") ? "module" : "program", file, places[0],
                    count > 2 ? ", " : "", count > 2 ? places[1] : "", count > 1 ? " or " : "",
                    count > 1 ? places[count - 1] : "");
}

/* ---- threads and memory ---- */

/* The libraries of a module start threads when they are opened: log4cplus, which OpenVDB brings,
 * starts four. If the system refuses one, they end the process. */
enum { THREADS_NEEDED = 8 };

static void *wait_for_end(void *arg)
{
    pthread_mutex_lock(arg);
    pthread_mutex_unlock(arg);
    return NULL;
}

/* Checks that enough threads can be started: all of them wait until the last one has begun. */
static int check_threads(struct bsq_ctx *ctx, const char *purpose)
{
    pthread_t threads[THREADS_NEEDED];
    pthread_mutex_t gate = PTHREAD_MUTEX_INITIALIZER;
    int count = 0, error = 0;
    pthread_mutex_lock(&gate);
    while (count < THREADS_NEEDED && error == 0) {
        error = pthread_create(&threads[count], NULL, wait_for_end, &gate);
        count += error == 0;
    }
    pthread_mutex_unlock(&gate);
    for (int i = 0; i < count; i++)
        pthread_join(threads[i], NULL);
    if (error == 0)
        return 0;
    return bsq_fail(ctx, BSQ_ENOMEM, "%s need %d threads, of which the system starts only %d",
                    purpose, THREADS_NEEDED, count);
}

/* The libraries of a module take some 400 MiB of addresses. Some end the process if they cannot
 * start in what is left. */
static int check_addresses(struct bsq_ctx *ctx, const char *purpose, bool apart)
{
    const size_t needed = (size_t)512 << 20;
    struct rlimit limit;
    if (apart && getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur >= needed)
        return 0;
    void *addresses = mmap(NULL, needed, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (addresses == MAP_FAILED)
        return bsq_fail(ctx, BSQ_ENOMEM, "%s need %zu MiB of addresses for their libraries",
                        purpose, needed >> 20);
    munmap(addresses, needed);
    return 0;
}

int fmt_module_check(struct bsq_ctx *ctx, const char *purpose, bool apart)
{
    const int status = check_addresses(ctx, purpose, apart);
    return status < 0 ? status : check_threads(ctx, purpose);
}

/* Opens a library that may be open already. Sets *out to NULL if the dynamic linker fails. */
static int open_library(struct bsq_ctx *ctx, const char *path, const char *purpose, void **out)
{
    static pthread_mutex_t one_at_a_time = PTHREAD_MUTEX_INITIALIZER;
    const int flags = RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE;
    int status = 0;

    pthread_mutex_lock(&one_at_a_time);
    *out = dlopen(path, flags | RTLD_NOLOAD);
    if (!*out) {
        BSQ_TRY(fmt_module_check(ctx, purpose, false));
        *out = dlopen(path, flags);
    }
done:
    pthread_mutex_unlock(&one_at_a_time);
    return status;
}

int fmt_module_open(struct bsq_ctx *ctx, const char *name, const char *purpose,
                    const struct fmt_module **out)
{
    const struct fmt_module *module = NULL;
    char file[64], path[PATH_MAX];
    void *library;
    int status;

    *out = NULL;
    snprintf(file, sizeof file, "bisque-%s.so", name);
    BSQ_TRY(fmt_module_find(ctx, file, purpose, path));
    BSQ_TRY(open_library(ctx, path, purpose, &library));
    if (library)
        module = dlsym(library, "bisque_module");
    if (!module)
        status = bsq_fail(ctx, BSQ_ENOINPUT, "%s need the module %s, which cannot be opened: %s",
                          purpose, path, dlerror());
    else if (strcmp(module->stamp, fmt_module_stamp) != 0)
        status = bsq_fail(ctx, BSQ_ENOINPUT,
                          "%s need the module %s, which is of build %s; this program is of %s",
                          purpose, path, module->stamp, fmt_module_stamp);
    else
        *out = module;
done:
    return status;
}
