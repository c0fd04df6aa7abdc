/* run.c - runs programs that are installed with Bisque. */
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/context.h"
#include "formats/program/program.h"

/* Of a process that was killed; one that a driver blocks in the kernel may never end. */
enum { END_SECONDS = 1 };

int fmt_program_misfit(struct bsq_ctx *ctx, const struct fmt_converter *how)
{
    char program[PATH_MAX];
    BSQ_PASS(fmt_program_find(ctx, how->program, how->purpose, program));
    return bsq_fail(ctx, BSQ_ENOINPUT, "%s: %s is not of this program's build, or does not work",
                    how->path, program);
}

/* Reports that a program did not do its work. text: its output. left: the memory that it had. */
static int program_fail(struct bsq_ctx *ctx, const struct fmt_converter *how,
                        const struct fmt_program_end *end, char *text, uint64_t left)
{
    const char *path = how->path, *library = how->library;
    const int code = end->state >= 0 && WIFEXITED(end->state) ? WEXITSTATUS(end->state) : -1;
    const int signal = end->state >= 0 && WIFSIGNALED(end->state) ? WTERMSIG(end->state) : 0;
    enum { NOT_LINKED = 127 }; /* of the dynamic linker */
    for (char *c = text; *c; c++)
        *c = (unsigned char)*c < ' ' || *c == 127 ? ' ' : *c;
    if (end->error || code == NOT_LINKED)
        return bsq_fail_errno(ctx, BSQ_ENOINPUT, end->error ? end->error : ELIBACC,
                              "%s: the program of %s does not start", path, library);
    if (code == -BSQ_EUSAGE)
        return fmt_program_misfit(ctx, how);
    if (code == -BSQ_EDATA || code == -BSQ_ENOINPUT)
        return bsq_fail(ctx, -code, "%s: %s", path, text);
    if (code == -BSQ_ENOMEM)
        return bsq_fail(ctx, BSQ_ENOMEM,
                        "%s: %s needs more memory than its %" PRIu64
                        " bytes of --memory: raise it, "
                        "unless the file is damaged",
                        path, library, left);
    if (code == -BSQ_EIO && how->exports)
        return bsq_fail(ctx, BSQ_EIO, "%s: %s cannot write it: %s", path, library, text);
    if (code == -BSQ_EIO)
        return bsq_fail(ctx, BSQ_EIO, "%s: its content cannot be written to a temporary file",
                        path);
    if (signal == SIGXCPU)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s: cannot be read: %s has not read it in %" PRIu64 " seconds", path,
                        library, how->seconds);
    return bsq_fail(ctx, BSQ_EDATA, "%s: cannot be read: %s crashed (%s): the file is damaged",
                    path, library, signal ? strsignal(signal) : "it ended the program");
}

void fmt_program_isolate(void)
{
    static const int crashes[] = {SIGABRT, SIGSEGV, SIGBUS, SIGFPE, SIGILL};
    const struct rlimit none = {0, 0};
    for (size_t i = 0; i < sizeof crashes / sizeof *crashes; i++)
        signal(crashes[i], SIG_DFL);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    setrlimit(RLIMIT_CORE, &none);
}

/* Limits memory to `memory` bytes more than the process has now, time to `seconds` of a processor,
 * and the descriptors of files. */
static void program_limit(uint64_t memory, uint64_t seconds, uint64_t files)
{
    unsigned long pages = 0;
    FILE *statm = fopen("/proc/self/statm", "r");
    const bool known = statm && fscanf(statm, "%lu", &pages) == 1;
    if (statm)
        fclose(statm);
    const uint64_t all = pages * (uint64_t)sysconf(_SC_PAGESIZE) + memory;
    struct rlimit space = {RLIM_INFINITY, RLIM_INFINITY};
    const struct rlimit time = {seconds, seconds + 1}, open = {files, files};
#ifdef __SANITIZE_ADDRESS__
    const bool limited = false; /* it takes addresses for each allocation */
#else
    const bool limited = true;
#endif
    getrlimit(RLIMIT_AS, &space);
    if (limited && known && all > memory && all < space.rlim_cur)
        setrlimit(RLIMIT_AS, &(struct rlimit){all, all});
    setrlimit(RLIMIT_CPU, &time);
    setrlimit(RLIMIT_NOFILE, &open);
}

const char *fmt_program_begin(int argument_count, char **arguments, uint64_t own, uint64_t files,
                              struct fmt_program_input *input)
{
    struct stat info;
    if (argument_count != 5 || strcmp(arguments[1], fmt_program_stamp) != 0 ||
        fstat(STDIN_FILENO, &info) != 0 || !S_ISREG(info.st_mode)) {
        fprintf(stderr, "%s: is run by Bisque for files of some formats\n", arguments[0]);
        _exit(-BSQ_EUSAGE);
    }
    fmt_program_isolate();
    input->size = (uint64_t)info.st_size;
    input->bytes = input->size == 0
                       ? (const void *)""
                       : mmap(NULL, input->size, PROT_READ, MAP_PRIVATE, STDIN_FILENO, 0);
    if (input->bytes == MAP_FAILED)
        _exit(-BSQ_ENOMEM);
    if (own < UINT64_MAX)
        program_limit(strtoull(arguments[3], NULL, 10) + own, strtoull(arguments[4], NULL, 10),
                      files);
    return arguments[2];
}

void fmt_program_refuse(int status, const char *text)
{
    const bool empty = ftruncate(STDOUT_FILENO, 0) == 0 && lseek(STDOUT_FILENO, 0, SEEK_SET) == 0;
    const bool told = empty && dprintf(STDOUT_FILENO, "%s", text) >= 0;
    _exit(told ? -status : -BSQ_EIO);
}

/* Starts a program. Returns 0 or an errno. */
static int program_start(char *const arguments[], int from, int to, pid_t *out)
{
    posix_spawn_file_actions_t actions;
    int error = posix_spawn_file_actions_init(&actions);
    if (error != 0)
        return error;
    error = posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", O_RDWR, 0);
    if (error == 0)
        error = posix_spawn_file_actions_adddup2(&actions, from < 0 ? STDERR_FILENO : from,
                                                 STDIN_FILENO);
    if (error == 0)
        error = posix_spawn_file_actions_adddup2(&actions, to, STDOUT_FILENO);
    if (error == 0)
        error = posix_spawn_file_actions_addclosefrom_np(&actions, STDERR_FILENO + 1);
    if (error == 0)
        error = posix_spawn(out, arguments[0], &actions, NULL, arguments, environ);
    posix_spawn_file_actions_destroy(&actions);
    return error;
}

/* Waits until the process ends, the deadline has passed, or the context, unless it is NULL, is
 * interrupted. Returns whether it has ended. */
static bool await(struct bsq_ctx *ctx, pid_t process, double deadline, int *state)
{
    struct timespec pause = {.tv_nsec = 100000};
    pid_t got;
    while ((got = waitpid(process, state, WNOHANG)) == 0 && bsq_seconds_now() < deadline &&
           !(ctx && bsq_check(ctx) < 0)) {
        nanosleep(&pause, NULL);
        pause.tv_nsec += pause.tv_nsec < 10000000 ? pause.tv_nsec : 0;
    }
    if (got != process)
        *state = -1;
    return got != 0;
}

int fmt_program_run(struct bsq_ctx *ctx, char *const arguments[], int from, int to, double seconds,
                    struct fmt_program_end *out)
{
    pid_t process;
    *out = (struct fmt_program_end){.state = -1};
    out->error = program_start(arguments, from, to, &process);
    if (out->error != 0)
        return 0;
    if (!await(ctx, process, bsq_seconds_now() + seconds, &out->state)) {
        out->late = true;
        kill(process, SIGKILL);
        await(NULL, process, bsq_seconds_now() + END_SECONDS, &out->state);
    }
    return bsq_check(ctx); /* a signal may have ended the process first */
}

int fmt_program_convert(struct bsq_ctx *ctx, const struct fmt_converter *how, int from,
                        struct bsq_file *to)
{
    const uint64_t left = how->memory > 0 ? how->memory : bsq_memory_left(ctx);
    struct fmt_program_end end;
    struct stat info;
    char program[PATH_MAX], memory[24], seconds[24], text[201] = "", none[] = "";
    char *arguments[] = {program,
                         (char *)(uintptr_t)fmt_program_stamp,
                         how->option ? how->option : none,
                         memory,
                         seconds,
                         NULL};
    uint64_t got = 0;
    snprintf(memory, sizeof memory, "%" PRIu64, left);
    snprintf(seconds, sizeof seconds, "%" PRIu64, how->seconds);
    BSQ_PASS(fmt_program_find(ctx, how->program, how->purpose, program));
    BSQ_PASS(fmt_program_run(ctx, arguments, from, to->fd, INFINITY, &end));
    if (fstat(to->fd, &info) == 0)
        to->size = (uint64_t)info.st_size;
    if (end.error == 0 && end.state == 0)
        return 0;
    BSQ_PASS(bsq_file_read_some(ctx, to, text, sizeof text - 1, 0, &got));
    return program_fail(ctx, how, &end, text, left);
}
