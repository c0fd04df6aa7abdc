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
#include <link.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "formats/module/module.h"

const struct fmt_host fmt_host_functions = {
#define INITIAL(name) .name = bsq_##name,
    FMT_HOST_FUNCTIONS(INITIAL)
#undef INITIAL
};

enum { PLACES = 3 };

/* Directories to look in; an entry may be NULL. */
struct places {
    char *directories[PLACES];
};

static void places_free(struct places *places)
{
    for (int i = 0; i < PLACES; i++)
        free(places->directories[i]);
}

static void cut_last_name(char *path)
{
    char *slash = strrchr(path, '/');

    if (slash)
        *slash = '\0';
}

/* Returns the path of the file that this code was loaded from; the caller frees it. Returns NULL if
 * that file no longer exists. */
static char *own_path(void)
{
    struct link_map *object = NULL;
    Dl_info info;

    /* The main program has an empty l_name, and info.dli_fname is argv[0], not always a path. */
    if (!dladdr1(&fmt_host_functions, &info, (void **)&object, RTLD_DL_LINKMAP) || !object ||
        !object->l_name[0])
        return realpath("/proc/self/exe", NULL);
    return realpath(object->l_name, NULL);
}

static int find_places(struct bsq_ctx *ctx, struct places *places)
{
    char *own = own_path(), *near = NULL;
    int status = 0;

    *places = (struct places){{NULL}};
    if (own) {
        cut_last_name(own);
        places->directories[0] = strdup(own);
        cut_last_name(own);
        if (!places->directories[0] || asprintf(&near, "%s/lib/bisque", own) < 0)
            status = BSQ_ENOMEM;
        else
            places->directories[1] = near;
    }
    if (status == 0 && !(near && strcmp(near, fmt_module_directory) == 0)) {
        places->directories[2] = strdup(fmt_module_directory);
        if (!places->directories[2])
            status = BSQ_ENOMEM;
    }
    free(own);
    if (status < 0) {
        places_free(places);
        bsq_fail(ctx, status, "no memory to look for modules");
    }
    return status;
}

/* Reports a file that is in none of the places. */
static int fail_missing(struct bsq_ctx *ctx, const char *what, const char *purpose,
                        const struct places *places)
{
    const char *listed[PLACES] = {"", "", ""};
    int count = 0;

    for (int i = 0; i < PLACES; i++)
        if (places->directories[i])
            listed[count++] = places->directories[i];
    return bsq_fail(ctx, BSQ_ENOINPUT, "%s need %s, which is not in %s%s%s%s%s", purpose, what,
                    listed[0], count > 2 ? ", " : "", count > 2 ? listed[1] : "",
                    count > 1 ? " or " : "", count > 1 ? listed[count - 1] : "");
}

/* The first place that has the file decides: one further down the list was not installed with this
 * program. */
int fmt_module_find(struct bsq_ctx *ctx, const char *what, const char *file, const char *purpose,
                    char **out)
{
    struct places places;
    int status = find_places(ctx, &places);

    *out = NULL;
    if (status != 0)
        return status;
    for (int i = 0; i < PLACES && !*out && status == 0; i++) {
        if (!places.directories[i])
            continue;
        if (asprintf(out, "%s/%s", places.directories[i], file) < 0) {
            *out = NULL;
            status = bsq_fail(ctx, BSQ_ENOMEM, "no memory to look for modules");
        } else if (access(*out, F_OK) != 0) {
            free(*out);
            *out = NULL;
        }
    }
    if (status == 0 && !*out)
        status = fail_missing(ctx, what, purpose, &places);
    places_free(&places);
    return status;
}

static int find_module(struct bsq_ctx *ctx, const char *name, const char *purpose, char **out)
{
    char *what = NULL;
    int status;

    *out = NULL;
    if (asprintf(&what, "the module bisque-%s.so", name) < 0)
        return bsq_fail(ctx, BSQ_ENOMEM, "no memory to look for modules");
    status = fmt_module_find(ctx, what, strrchr(what, ' ') + 1, purpose, out);
    free(what);
    return status;
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
static int check_addresses(struct bsq_ctx *ctx, const char *purpose)
{
    const size_t needed = (size_t)512 << 20;
    void *addresses = mmap(NULL, needed, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (addresses == MAP_FAILED)
        return bsq_fail(ctx, BSQ_ENOMEM, "%s need %zu MiB of addresses for their libraries",
                        purpose, needed >> 20);
    munmap(addresses, needed);
    return 0;
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
        BSQ_TRY(check_addresses(ctx, purpose));
        BSQ_TRY(check_threads(ctx, purpose));
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
    void *library;
    char *path;
    int status;

    *out = NULL;
    BSQ_TRY(find_module(ctx, name, purpose, &path));
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
    free(path);
    return status;
}
