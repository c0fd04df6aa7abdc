/* find.c - finds programs and files that are installed with Bisque.
 *
 * They are looked for in three places, in this order: beside the file that contains this code (a
 * program, or a shared library that was linked with Bisque); in ../lib/bisque relative to that
 * file's directory, for moved installations and the build tree; in the installation directory. */
#include <dlfcn.h>
#include <limits.h>
#include <link.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

#include "formats/program/program.h"

enum { PLACES = 3 };

static void cut_last_name(char *path)
{
    char *slash = strrchr(path, '/');

    if (slash)
        *slash = '\0';
}

/* Sets the path of a shared library, or of the program if that is NULL. Of a program that was
 * replaced since it began, as by an upgrade, only the last name is another one then. */
static bool find_own_path(const char *library, char out[PATH_MAX])
{
    if (library)
        return realpath(library, out) != NULL;
    const ssize_t length = readlink("/proc/self/exe", out, PATH_MAX - 1);
    out[length > 0 ? length : 0] = '\0';
    return length > 0;
}

/* Finds the directories to look in. Returns their number, at least 1. */
static int find_places(char places[PLACES][PATH_MAX])
{
    struct link_map *object = NULL;
    char own[PATH_MAX];
    Dl_info info;
    int count = 0;

    /* The main program has an empty l_name, and info.dli_fname is argv[0], not always a path. */
    const bool shared = dladdr1(fmt_program_directory, &info, (void **)&object, RTLD_DL_LINKMAP) &&
                        object && object->l_name[0];
    if (find_own_path(shared ? object->l_name : NULL, own)) {
        cut_last_name(own);
        strcpy(places[count++], own);
        cut_last_name(own);
        if (snprintf(places[count], PATH_MAX, "%s/lib/bisque", own) < PATH_MAX)
            count++;
    }
    if (count == 0 || strcmp(places[count - 1], fmt_program_directory) != 0)
        snprintf(places[count++], PATH_MAX, "%s", fmt_program_directory);
    return count;
}

/* The first place that has the file decides: one further down the list was not installed with this
 * program. */
int fmt_program_find(struct bsq_ctx *ctx, const char *file, const char *purpose, char out[PATH_MAX])
{
    char places[PLACES][PATH_MAX];
    const int count = find_places(places);

    for (int i = 0; i < count; i++)
        if (snprintf(out, PATH_MAX, "%s/%s", places[i], file) < PATH_MAX && access(out, F_OK) == 0)
            return 0;
    return bsq_fail(ctx, BSQ_ENOINPUT, "%s need the program %s, which is not in %s%s%s%s%s",
                    purpose, file, places[0], count > 2 ? ", " : "", count > 2 ? places[1] : "",
                    count > 1 ? " or " : "", count > 1 ? places[count - 1] : "");
}

/* ---- threads and memory ---- */

/* Libraries start threads when they are loaded: log4cplus, which OpenVDB brings,
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

/* The libraries take some 400 MiB of addresses. Some end the process if they cannot start in what
 * is left. */
static int check_addresses(struct bsq_ctx *ctx, const char *purpose)
{
    const size_t needed = (size_t)512 << 20;
    struct rlimit limit;
    if (getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur >= needed)
        return 0;
    return bsq_fail(ctx, BSQ_ENOMEM, "%s need %zu MiB of addresses for their libraries", purpose,
                    needed >> 20);
}

int fmt_program_check(struct bsq_ctx *ctx, const char *purpose)
{
    BSQ_PASS(check_addresses(ctx, purpose));
    return check_threads(ctx, purpose);
}
