/* driver.c - opens drivers' libraries; starts bisque-devices and reads its answer from a file in
 * memory. */
#include "libbake/device/driver/driver.h"

#include <dlfcn.h>
#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/file.h"
#include "base/version.h"
#include "formats/program/program.h"

/* ---- libraries ---- */

const char *const bake_driver_directories[] = {"/usr/local/nvidia/lib64",
                                               "/usr/local/nvidia/lib",
                                               "/usr/lib/wsl/lib",
                                               "/run/opengl-driver/lib",
                                               "/opt/rocm/lib",
                                               "/usr/lib/x86_64-linux-gnu",
                                               "/usr/lib/aarch64-linux-gnu",
                                               "/usr/lib64",
                                               "/usr/lib/x86_64-linux-gnu/intel-opencl",
                                               "/usr/lib/aarch64-linux-gnu/intel-opencl",
                                               "/usr/lib64/intel-opencl",
                                               NULL};

void *bake_driver_library(const char *name, int flags, const char *const directories[],
                          const char **found)
{
    void *library = dlopen(name, flags);
    *found = NULL;
    for (; !library && *directories; directories++) {
        char path[PATH_MAX];
        const int length = snprintf(path, sizeof path, "%s/%s", *directories, name);
        if (length < 0 || (size_t)length >= sizeof path || access(path, R_OK) != 0)
            continue;
        library = dlopen(path, flags);
        *found = library ? *directories : NULL;
    }
    return library;
}

/* ---- bisque-devices ---- */

enum { TIMEOUT_SECONDS = 30 };

struct answer {
    char version[32]; /* of the program; first in all versions */
    uint32_t bytes;   /* of the structure */
    struct bake_device_list list;
};

bool bake_probe_answer(int to, const struct bake_device_list *list)
{
    struct answer answer;
    memset(&answer, 0, sizeof answer); /* padding too */
    strcpy(answer.version, BSQ_VERSION);
    answer.bytes = sizeof answer;
    answer.list = *list;
    return write(to, &answer, sizeof answer) == sizeof answer;
}

/* ---- its caller ---- */

/* Runs the program, and reads its answer as far as there is one. Also without memory for a process,
 * the job can go on without GPUs. Returns the bytes read or a status. */
static int ask(struct bsq_ctx *ctx, const char *name, const char *title, char *path,
               struct answer *out, struct fmt_program_end *end)
{
    char *const arguments[] = {path, (char *)(uintptr_t)name, NULL};
    const int file = bsq_fd_above_standard(memfd_create("devices", MFD_CLOEXEC));
    int status = 0;
    memset(out, 0, sizeof *out);
    *end = (struct fmt_program_end){.error = file < 0 ? errno : 0};
    if (file >= 0)
        status = fmt_program_run(ctx, arguments, -1, file, TIMEOUT_SECONDS, end);
    if (!status && end->error)
        status = bsq_fail(ctx, BSQ_ENODEVICE, "%s cannot be used: %s does not start: %s", title,
                          path, strerror(end->error));
    if (!status)
        status = (int)pread(file, out, sizeof *out, 0);
    if (status == -1)
        status = bsq_fail(ctx, BSQ_ENODEVICE, "%s cannot be used: the answer of %s: %s", title,
                          path, strerror(errno));
    if (file >= 0)
        close(file);
    out->version[sizeof out->version - 1] = '\0';
    return status;
}

/* Reports an answer that did not come or is of another version. */
static int fail_answer(struct bsq_ctx *ctx, const char *title, const char *path,
                       const struct answer *answer, const struct fmt_program_end *end)
{
    if (answer->version[0] && strcmp(answer->version, BSQ_VERSION) != 0)
        return bsq_fail(ctx, BSQ_ENODEVICE,
                        "%s cannot be used: %s is of version %s, this program is of " BSQ_VERSION,
                        title, path, answer->version);
    if (end->late)
        return bsq_fail(ctx, BSQ_ENODEVICE,
                        "%s cannot be used: its drivers have not named their devices for %d "
                        "seconds",
                        title, TIMEOUT_SECONDS);
    return bsq_fail(ctx, BSQ_ENODEVICE,
                    "%s cannot be used: a driver crashed when it was asked for its devices (%s)",
                    title,
                    end->state >= 0 && WIFSIGNALED(end->state) ? strsignal(WTERMSIG(end->state))
                                                               : "it ended the process");
}

/* Takes over a whole answer, and ends its texts. Returns false if it is damaged. */
static bool take_over(const struct answer *answer, struct bake_device_list *out)
{
    *out = answer->list;
    out->why[sizeof out->why - 1] = '\0';
    for (uint32_t i = 0; i < BAKE_DEVICES_MAX; i++) {
        out->devices[i].id[sizeof out->devices[i].id - 1] = '\0';
        out->devices[i].name[sizeof out->devices[i].name - 1] = '\0';
    }
    return out->count <= BAKE_DEVICES_MAX;
}

/* Finds bisque-devices. Without it there are no devices, rather than no input. */
static int driver_find_program(struct bsq_ctx *ctx, const char *title, char path[PATH_MAX])
{
    char purpose[32];
    int status;
    snprintf(purpose, sizeof purpose, "%s devices", title);
    status = fmt_program_find(ctx, "bisque-devices", purpose, path);
    if (status != BSQ_ENOINPUT)
        return status;
    char *why = strdup(bsq_error(ctx));
    bsq_clear_error(ctx);
    status = bsq_fail(ctx, BSQ_ENODEVICE, "%s", why ? why : "bisque-devices is missing");
    free(why);
    return status;
}

int bake_probe(struct bsq_ctx *ctx, const char *name, const char *title,
               struct bake_device_list *out)
{
    struct fmt_program_end end;
    struct answer answer;
    char path[PATH_MAX];
    int status;
    BSQ_TRY(driver_find_program(ctx, title, path));
    BSQ_TRY(ask(ctx, name, title, path, &answer, &end));
    const bool answered = status == (int)sizeof answer && answer.bytes == sizeof answer &&
                          strcmp(answer.version, BSQ_VERSION) == 0 && take_over(&answer, out);
    status = answered ? 0 : fail_answer(ctx, title, path, &answer, &end);
done:
    return status;
}
