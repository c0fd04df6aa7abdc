/* probe.c - starts bisque-devices and reads its answer from a pipe: a head, then the devices. */
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
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
#include "libbake/device/driver/driver.h"

enum {
    TIMEOUT_SECONDS = 30,
    POLL_MILLISECONDS = 100, /* an interruption is noticed after so long */
    END_SECONDS = 1,         /* for a killed process; one that a driver blocks may never end */
    DEVICES_MAX = 4096       /* an answer with more is damaged */
};

struct head {
    char version[32]; /* of the program; first in all versions */
    uint32_t device_bytes, device_count;
    char warning[BAKE_WARNING_BYTES];
};

/* ---- bisque-devices ---- */

static bool write_all(int to, const void *data, size_t bytes)
{
    const char *at = data;

    while (bytes > 0) {
        ssize_t wrote = write(to, at, bytes);
        if (wrote < 0 && errno == EINTR)
            continue;
        if (wrote <= 0)
            return false;
        at += wrote;
        bytes -= (size_t)wrote;
    }
    return true;
}

bool bake_probe_answer(int to, const struct bake_device_list *list)
{
    struct head head;

    memset(&head, 0, sizeof head);
    strcpy(head.version, BSQ_VERSION);
    head.device_bytes = sizeof *list->devices;
    head.device_count = (uint32_t)list->count;
    memcpy(head.warning, list->warning, sizeof head.warning);
    return write_all(to, &head, sizeof head) &&
           write_all(to, list->devices, list->count * sizeof *list->devices);
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

/* Reports an errno. Also without memory for a process, the job can go on without GPUs. */
static int fail_start(struct bsq_ctx *ctx, const struct bake_device_kind *kind, const char *path,
                      int code)
{
    return bsq_fail(ctx, BSQ_ENODEVICE, "%s cannot be used: %s does not start: %s", kind->drivers,
                    path, strerror(code));
}

static int start(struct bsq_ctx *ctx, const struct bake_device_kind *kind, const char *path,
                 struct child *out)
{
    int ends[2], code = 0;

    if (pipe2(ends, O_CLOEXEC) < 0)
        return fail_start(ctx, kind, path, errno);
    out->pipe = bsq_fd_above_standard(ends[0]);
    ends[1] = bsq_fd_above_standard(ends[1]);
    if (out->pipe < 0 || ends[1] < 0)
        code = EMFILE;
    else
        code = spawn(path, kind->name, ends[1], &out->process);
    if (ends[1] >= 0)
        close(ends[1]);
    if (code == 0) {
        out->deadline = bsq_seconds_now() + TIMEOUT_SECONDS;
        return 0;
    }
    if (out->pipe >= 0)
        close(out->pipe);
    return fail_start(ctx, kind, path, code);
}

/* Reads bytes. *whole: whether all came before the pipe's end and the deadline. */
static int read_all(struct bsq_ctx *ctx, struct child *child, void *to, size_t bytes, bool *whole)
{
    char *at = to;
    int status = 0;

    *whole = false;
    while (bytes > 0 && status == 0) {
        struct pollfd ready = {.fd = child->pipe, .events = POLLIN};
        int polled = poll(&ready, 1, POLL_MILLISECONDS);
        ssize_t got = polled > 0 ? read(child->pipe, at, bytes) : -1;
        status = bsq_check(ctx);
        if (got == 0)
            return status;
        if (got > 0) {
            at += got;
            bytes -= (size_t)got;
        } else if (bsq_seconds_now() > child->deadline) {
            child->late = true;
            return status;
        }
    }
    *whole = bytes == 0;
    return status;
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

/* Reads the answer. *answered: whether it was whole and of this version. */
static int read_answer(struct bsq_ctx *ctx, struct child *child, struct bake_device_list *out,
                       struct head *head, bool *answered)
{
    int status = read_all(ctx, child, head, sizeof *head, answered);

    head->version[sizeof head->version - 1] = head->warning[sizeof head->warning - 1] = '\0';
    *answered = *answered && strcmp(head->version, BSQ_VERSION) == 0 &&
                head->device_bytes == sizeof *out->devices && head->device_count <= DEVICES_MAX;
    if (status < 0 || !*answered || head->device_count == 0)
        return status;
    status = bsq_alloc(ctx, "devices", head->device_count, sizeof *out->devices, &out->devices);
    if (status == 0)
        status =
            read_all(ctx, child, out->devices, head->device_count * sizeof *out->devices, answered);
    return status;
}

/* Reports an answer that did not come or is of another version. */
static int fail_answer(struct bsq_ctx *ctx, const struct bake_device_kind *kind, const char *path,
                       const struct head *head, const struct child *child, int ended)
{
    if (head->version[0] && strcmp(head->version, BSQ_VERSION) != 0)
        return bsq_fail(ctx, BSQ_ENODEVICE,
                        "%s cannot be used: %s is of version %s, this program is of " BSQ_VERSION,
                        kind->drivers, path, head->version);
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

/* Takes over an answer that is whole, and ends its texts. */
static void take_over(const struct head *head, struct bake_device_list *out)
{
    memcpy(out->warning, head->warning, sizeof out->warning);
    out->count = head->device_count;
    for (uint64_t i = 0; i < out->count; i++) {
        out->devices[i].id[sizeof out->devices[i].id - 1] = '\0';
        out->devices[i].name[sizeof out->devices[i].name - 1] = '\0';
    }
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
    struct head head = {.version = ""};
    bool answered = false;
    char *path;
    int ended, status = find_program(ctx, kind, &path);

    *out = (struct bake_device_list){0};
    if (status == 0)
        status = start(ctx, kind, path, &child);
    if (status < 0) {
        free(path);
        return status;
    }
    status = read_answer(ctx, &child, out, &head, &answered);
    ended = end(&child, answered);
    if (status == 0 && !answered)
        status = bsq_check(ctx); /* a signal may have ended the process first */
    if (status == 0 && !answered)
        status = fail_answer(ctx, kind, path, &head, &child, ended);
    if (status == 0)
        take_over(&head, out);
    else
        bake_device_list_free(ctx, out);
    free(path);
    return status;
}
