/* fault.c - see fault.h. It makes system calls directly, since faults.c replaces the functions. */
#include "tests/faults/fault.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

static atomic_ulong calls;
static atomic_ulong sent; /* how many there had been when a signal had been handled */

static const struct {
    const char *name;
    int number;
} errors[] = {{"ENOSPC", ENOSPC}, {"EIO", EIO},     {"EINTR", EINTR},   {"EDQUOT", EDQUOT},
              {"EMFILE", EMFILE}, {"EPERM", EPERM}, {"ENOMEM", ENOMEM}, {"EOPNOTSUPP", EOPNOTSUPP}};

const char *fault_setting(const char *name)
{
    const char *value = getenv(name);
    return value ? value : "";
}

static void append(const char *path, const char *line, int size)
{
    int fd = (int)syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_APPEND, 0600);
    syscall(SYS_write, fd, line, (size_t)size);
    syscall(SYS_close, fd);
}

static void log_call(unsigned long number, const char *call, const char *path)
{
    char line[5000];
    const char *log = fault_setting("FAULT_LOG");
    if (*log)
        append(log, line, snprintf(line, sizeof line, "%lu %s %s\n", number, call, path));
}

__attribute__((destructor)) static void write_count(void)
{
    char line[64];
    const unsigned long all = atomic_load(&calls), before = atomic_load(&sent);
    const char *count = fault_setting("FAULT_COUNT");
    if (*count)
        append(count, line,
               snprintf(line, sizeof line, "%lu %lu\n", all, before ? all - before : 0));
}

static void pause_here(void)
{
    const char *flag = fault_setting("FAULT_FLAG");
    syscall(SYS_close, syscall(SYS_openat, AT_FDCWD, flag, O_WRONLY | O_CREAT, 0600));
    while (syscall(SYS_faccessat, AT_FDCWD, flag, F_OK) == 0)
        usleep(1000);
}

/* Returns the number of a signal such as TERM, or 0. */
static int signal_of(const char *name)
{
    for (int number = 1; number < SIGRTMIN; number++)
        if (sigabbrev_np(number) && strcmp(name, sigabbrev_np(number)) == 0)
            return number;
    return 0;
}

/* Handles the signal at once, in this thread, even if it blocks signals, as worker threads do. */
static void send_signal(int signal)
{
    sigset_t only, before;
    sigemptyset(&only);
    sigaddset(&only, signal);
    pthread_sigmask(SIG_UNBLOCK, &only, &before);
    raise(signal);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
}

int fault_at(const char *kind, const char *call, const char *path)
{
    if (!strstr(fault_setting("FAULT_CALLS"), kind) || !strstr(path, fault_setting("FAULT_PATH")))
        return FAULT_GO_ON;
    unsigned long number = atomic_fetch_add(&calls, 1) + 1;
    unsigned long at = strtoul(fault_setting("FAULT_AT"), NULL, 10);
    log_call(number, call, path);
    if (at == 0 || number < at || (number > at && !*fault_setting("FAULT_STICKY")))
        return FAULT_GO_ON;
    const char *what = fault_setting("FAULT_DO");
    if (signal_of(what) > 0) {
        send_signal(signal_of(what));
        atomic_store(&sent, atomic_load(&calls));
    }
    if (strcmp(what, "pause") == 0)
        pause_here();
    if (strcmp(what, "short") == 0)
        return FAULT_SHORT;
    for (size_t i = 0; i < sizeof errors / sizeof *errors; i++) {
        if (strcmp(what, errors[i].name) == 0) {
            errno = errors[i].number;
            return FAULT_FAIL;
        }
    }
    return FAULT_GO_ON;
}
