/* driver.c - opens drivers' libraries; starts bisque-devices and reads its answer from a pipe. */
#include "libbake/device/driver/driver.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/file.h"
#include "base/version.h"
#include "formats/module/module.h"

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

enum {
    TIMEOUT_SECONDS = 30,
    POLL_MILLISECONDS = 100, /* an interruption is noticed after so long */
    END_SECONDS = 1          /* for a killed process; one that a driver blocks may never end */
};

struct answer {
    char version[32]; /* of the program; first in all versions */
    uint32_t bytes;   /* of the structure */
    struct bake_device_list list;
};

bool bake_probe_answer(int to, const struct bake_device_list *list)
{
    struct answer answer;
    const char *at = (const char *)&answer;

    memset(&answer, 0, sizeof answer); /* padding too */
    strcpy(answer.version, BSQ_VERSION);
    answer.bytes = sizeof answer;
    answer.list = *list;
    for (size_t left = sizeof answer; left > 0;) {
        ssize_t wrote = write(to, at, left);
        if (wrote < 0 && errno == EINTR)
            continue;
        if (wrote <= 0)
            return false;
        at += wrote;
        left -= (size_t)wrote;
    }
    return true;
}

/* ---- its caller ---- */

/* The process that was started. */
struct child {
    pid_t process;
    int pipe;
    double deadline;
    bool late;
};

/* Starts a program whose standard output is `to`. It has no other descriptor, and hides what
 * drivers print. Returns 0 or an errno. */
static int spawn(const char *path, const char *argument, int to, pid_t *out)
{
    char *const arguments[] = {(char *)path, (char *)argument, NULL};
    posix_spawn_file_actions_t actions;
    int code = posix_spawn_file_actions_init(&actions);

    if (code != 0)
        return code;
    if ((code = posix_spawn_file_actions_adddup2(&actions, to, STDOUT_FILENO)) == 0 &&
        (code = posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDWR, 0)) ==
            0 &&
        (code = posix_spawn_file_actions_adddup2(&actions, STDIN_FILENO, STDERR_FILENO)) == 0 &&
        (code = posix_spawn_file_actions_addclosefrom_np(&actions, STDERR_FILENO + 1)) == 0)
        code = posix_spawn(out, path, &actions, NULL, arguments, environ);
    posix_spawn_file_actions_destroy(&actions);
    return code;
}

/* Also without memory for a process, the job can go on without GPUs. */
static int start(struct bsq_ctx *ctx, const struct bake_device_kind *kind, const char *path,
                 struct child *out)
{
    int ends[2] = {-1, -1}, code = 0;

    if (pipe2(ends, O_CLOEXEC) < 0) {
        code = errno;
    } else {
        ends[0] = bsq_fd_above_standard(ends[0]);
        ends[1] = bsq_fd_above_standard(ends[1]);
        code =
            ends[0] < 0 || ends[1] < 0 ? EMFILE : spawn(path, kind->name, ends[1], &out->process);
    }
    if (ends[1] >= 0)
        close(ends[1]);
    out->pipe = ends[0];
    out->deadline = bsq_seconds_now() + TIMEOUT_SECONDS;
    if (code == 0)
        return 0;
    if (ends[0] >= 0)
        close(ends[0]);
    return bsq_fail(ctx, BSQ_ENODEVICE, "%s cannot be used: %s does not start: %s", kind->drivers,
                    path, strerror(code));
}

/* Reads an answer until it is whole, the pipe ends or the deadline has passed. Returns the bytes
 * read, or BSQ_EINTR. */
static int read_answer(struct bsq_ctx *ctx, struct child *child, struct answer *out)
{
    size_t bytes = 0;

    memset(out, 0, sizeof *out);
    while (bytes < sizeof *out && !child->late) {
        struct pollfd ready = {.fd = child->pipe, .events = POLLIN};
        int polled = poll(&ready, 1, POLL_MILLISECONDS);
        ssize_t got = polled > 0 ? read(child->pipe, (char *)out + bytes, sizeof *out - bytes) : -1;
        int status = bsq_check(ctx);
        if (status < 0)
            return status;
        if (got == 0)
            break;
        bytes += got > 0 ? (size_t)got : 0;
        child->late = got < 0 && bsq_seconds_now() > child->deadline;
    }
    out->version[sizeof out->version - 1] = '\0';
    return (int)bytes;
}

/* Waits until the process has ended, and kills it first unless it has answered. A process that a
 * driver blocks in the kernel is left behind. Returns its wait status, or -1. */
static int end(struct child *child, bool answered)
{
    const struct timespec pause = {.tv_nsec = 1000000};
    int ended = -1;
    pid_t got;

    close(child->pipe);
    if (!answered)
        kill(child->process, SIGKILL);
    child->deadline = bsq_seconds_now() + END_SECONDS;
    while ((got = waitpid(child->process, &ended, WNOHANG)) == 0 &&
           bsq_seconds_now() < child->deadline)
        nanosleep(&pause, NULL);
    if (got == 0 && answered)
        kill(child->process, SIGKILL);
    return got == child->process ? ended : -1;
}

/* Reports an answer that did not come or is of another version. */
static int fail_answer(struct bsq_ctx *ctx, const struct bake_device_kind *kind, const char *path,
                       const struct answer *answer, const struct child *child, int ended)
{
    if (answer->version[0] && strcmp(answer->version, BSQ_VERSION) != 0)
        return bsq_fail(ctx, BSQ_ENODEVICE,
                        "%s cannot be used: %s is of version %s, this program is of " BSQ_VERSION,
                        kind->drivers, path, answer->version);
    if (child->late)
        return bsq_fail(ctx, BSQ_ENODEVICE,
                        "%s cannot be used: its drivers have not named their devices for %d "
                        "seconds",
                        kind->drivers, TIMEOUT_SECONDS);
    return bsq_fail(
        ctx, BSQ_ENODEVICE,
        "%s cannot be used: a driver crashed when it was asked for its devices (%s)", kind->drivers,
        ended >= 0 && WIFSIGNALED(ended) ? strsignal(WTERMSIG(ended)) : "it ended the process");
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
static int find_program(struct bsq_ctx *ctx, const struct bake_device_kind *kind, char **path)
{
    char purpose[32];
    int status;

    snprintf(purpose, sizeof purpose, "%s devices", kind->drivers);
    status = fmt_module_find(ctx, "the program bisque-devices", "bisque-devices", purpose, path);
    if (status != BSQ_ENOINPUT)
        return status;
    char *why = strdup(bsq_error(ctx));
    bsq_clear_error(ctx);
    status = bsq_fail(ctx, BSQ_ENODEVICE, "%s", why ? why : "bisque-devices is missing");
    free(why);
    return status;
}

int bake_probe(struct bsq_ctx *ctx, const struct bake_device_kind *kind,
               struct bake_device_list *out)
{
    struct child child = {0};
    struct answer answer;
    char *path = NULL;
    int status;

    BSQ_TRY(find_program(ctx, kind, &path));
    BSQ_TRY(start(ctx, kind, path, &child));
    const int bytes = read_answer(ctx, &child, &answer);
    const bool answered = bytes == (int)sizeof answer && answer.bytes == sizeof answer &&
                          strcmp(answer.version, BSQ_VERSION) == 0 && take_over(&answer, out);
    const int ended = end(&child, answered);
    BSQ_TRY(bytes);
    if (!answered) {
        BSQ_TRY(bsq_check(ctx)); /* a signal may have ended the process first */
        status = fail_answer(ctx, kind, path, &answer, &child, ended);
    }
done:
    free(path);
    return status < 0 ? status : 0;
}
