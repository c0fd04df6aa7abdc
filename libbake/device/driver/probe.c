/* probe.c - a child process asks the driver and replies through a pipe, in records of fixed size.
 */
#include "libbake/device/driver/driver.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/clock.h"

enum { TIMEOUT_SECONDS = 30 };

enum kind { DEVICE, WARNING, END };

struct record {
    enum kind kind;
    struct bake_device_info device;
    char warning[1024];
};

struct bake_probe_pipe {
    int pipe;
};

static void send(struct bake_probe_pipe *to, const struct record *record)
{
    const char *at = (const char *)record;
    size_t left = sizeof *record;

    while (left > 0) {
        ssize_t wrote = write(to->pipe, at, left);
        if (wrote < 0 && errno == EINTR)
            continue;
        if (wrote <= 0)
            _exit(1);
        at += wrote;
        left -= (size_t)wrote;
    }
}

void bake_probe_send_device(struct bake_probe_pipe *to, const struct bake_device_info *device)
{
    struct record record;

    memset(&record, 0, sizeof record);
    record.kind = DEVICE;
    record.device = *device;
    send(to, &record);
}

void bake_probe_send_warning(struct bake_probe_pipe *to, const char *line)
{
    struct record record;

    memset(&record, 0, sizeof record);
    record.kind = WARNING;
    snprintf(record.warning, sizeof record.warning, "%s", line);
    send(to, &record);
}

/* In the child: hides what a driver prints, dumps no core, and lets the child end with its parent.
 */
static void isolate(void)
{
    static const int signals[] = {SIGINT, SIGTERM, SIGHUP, SIGABRT, SIGSEGV, SIGBUS};
    const struct rlimit none = {0, 0};
    int null = open("/dev/null", O_RDWR);

    for (size_t i = 0; i < sizeof signals / sizeof *signals; i++)
        signal(signals[i], SIG_DFL);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    setrlimit(RLIMIT_CORE, &none);
    for (int fd = 0; null >= 0 && fd <= 2; fd++)
        dup2(null, fd);
}

static void run_child(int pipe, void (*ask)(struct bake_probe_pipe *to))
{
    struct bake_probe_pipe replies = {.pipe = pipe};
    struct record end;

    isolate();
    ask(&replies);
    memset(&end, 0, sizeof end);
    end.kind = END;
    send(&replies, &end);
    _exit(0); /* no driver's destructor */
}

/* Reads one whole record. Returns 0 at the end of the pipe or after the deadline. */
static int read_record(int pipe, double deadline, struct record *record)
{
    char *at = (char *)record;
    size_t left = sizeof *record;

    while (left > 0) {
        struct pollfd ready = {.fd = pipe, .events = POLLIN};
        double seconds = deadline - bsq_seconds_now();
        ssize_t got;
        int polled = seconds > 0 ? poll(&ready, 1, (int)(1000 * seconds) + 1) : 0;
        if (polled < 0 && errno == EINTR)
            continue;
        if (polled <= 0)
            return 0;
        got = read(pipe, at, left);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return 0;
        at += got;
        left -= (size_t)got;
    }
    return 1;
}

/* Waits for the child to end, and kills it first if it is late. Returns its wait status. */
static int reap(pid_t child, bool late)
{
    int status = 0;

    if (late)
        kill(child, SIGKILL);
    while (waitpid(child, &status, 0) < 0 && errno == EINTR)
        ;
    return status;
}

struct replies {
    struct record *records;
    uint64_t count, capacity;
    bool ended;
};

static int collect(struct bsq_ctx *ctx, int pipe, double deadline, struct replies *replies)
{
    struct record record;

    while (!replies->ended && read_record(pipe, deadline, &record)) {
        int status;
        if (record.kind == END) {
            replies->ended = true;
            continue;
        }
        status = bsq_grow(ctx, "devices", replies->count + 1, sizeof record, &replies->records,
                          &replies->capacity);
        if (status < 0)
            return status;
        replies->records[replies->count++] = record;
    }
    return 0;
}

static void pass_on(struct bsq_ctx *ctx, const struct replies *replies,
                    void (*fn)(void *arg, const struct bake_device_info *device), void *arg)
{
    for (uint64_t i = 0; i < replies->count; i++)
        if (replies->records[i].kind == WARNING)
            bsq_warn(ctx, "%s", replies->records[i].warning);
        else if (fn)
            fn(arg, &replies->records[i].device);
}

int bake_probe(struct bsq_ctx *ctx, const char *what, void (*ask)(struct bake_probe_pipe *to),
               void (*fn)(void *arg, const struct bake_device_info *device), void *arg)
{
    struct replies replies = {0};
    double deadline = bsq_seconds_now() + TIMEOUT_SECONDS;
    int ends[2], status, ended;
    bool late;
    pid_t child;

    if (pipe2(ends, O_CLOEXEC) < 0)
        return bsq_fail_errno(ctx, BSQ_ENODEVICE, errno, "asking for %s devices", what);
    child = fork();
    if (child == 0) {
        close(ends[0]);
        run_child(ends[1], ask);
    }
    close(ends[1]);
    if (child < 0) {
        close(ends[0]);
        return bsq_fail_errno(ctx, BSQ_ENODEVICE, errno, "asking for %s devices", what);
    }
    status = collect(ctx, ends[0], deadline, &replies);
    late = bsq_seconds_now() >= deadline;
    close(ends[0]);
    ended = reap(child, late || status < 0);
    if (replies.ended)
        pass_on(ctx, &replies, fn, arg);
    else if (status == 0 && late)
        bsq_warn(ctx, "%s is not used: its drivers have not named their devices for %d seconds",
                 what, TIMEOUT_SECONDS);
    else if (status == 0)
        bsq_warn(ctx, "%s is not used: a driver crashed when it was asked for its devices (%s)",
                 what, WIFSIGNALED(ended) ? strsignal(WTERMSIG(ended)) : "it ended the process");
    bsq_free(ctx, replies.records);
    return status;
}
