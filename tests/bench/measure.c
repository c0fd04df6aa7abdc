/* measure.c - runs a command and writes its cost to a file, as one line of key=value pairs.
 *
 * With --at-hand BYTES, it first prefaults this much memory and frees it. The host of a virtual
 * machine may reclaim free memory, and getting it back can take thirty times as long as touching
 * it. Without this, the cost of a command would depend on what ran before.
 *
 * The figures are the resource usage of the child that wait4(2) returns. "written" counts the bytes
 * that the command wrote to files, temporary ones included, whether or not they have reached the
 * disk; it is 0 on file systems in memory. If memory runs out, the system kills the child before
 * any other process. */
#include <errno.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { BLOCK_BYTES = 512, SMALLEST_PAGE = 4096 };
enum { EXIT_USAGE = 64, EXIT_CREATE = 73, EXIT_SYSTEM = 71, EXIT_NOT_RUN = 127 };

static double seconds(struct timeval t)
{
    return (double)t.tv_sec + (double)t.tv_usec * 1e-6;
}

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + (double)t.tv_nsec * 1e-9;
}

static void be_killed_first(void)
{
    FILE *file = fopen("/proc/self/oom_score_adj", "w");
    if (!file)
        return;
    fputs("1000", file);
    fclose(file);
}

/* Prefaults memory in a child process, which the system kills first if there is too little. */
static void have_at_hand(size_t bytes)
{
    pid_t child = bytes ? fork() : -1;
    if (child < 0)
        return;
    if (child > 0) {
        while (waitpid(child, NULL, 0) < 0 && errno == EINTR)
            ;
        return;
    }
    be_killed_first();
    char *memory = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (memory != MAP_FAILED) {
        madvise(memory, bytes, MADV_HUGEPAGE);
        for (size_t at = 0; at < bytes; at += SMALLEST_PAGE)
            ((volatile char *)memory)[at] = 1;
    }
    _exit(0);
}

static pid_t start(char **command)
{
    pid_t child = fork();
    if (child != 0)
        return child;
    be_killed_first();
    execvp(command[0], command);
    fprintf(stderr, "measure: %s: %s\n", command[0], strerror(errno));
    _exit(EXIT_NOT_RUN);
}

/* Returns the exit status as a shell reports it. */
static int shell_status(int status)
{
    return WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
}

static int report(const char *path, double wall, int status, const struct rusage *usage)
{
    FILE *file = fopen(path, "w");
    if (!file) {
        fprintf(stderr, "measure: %s: %s\n", path, strerror(errno));
        return EXIT_CREATE;
    }
    fprintf(file, "wall=%.4f user=%.4f system=%.4f rss_kib=%ld read=%llu written=%llu status=%d\n",
            wall, seconds(usage->ru_utime), seconds(usage->ru_stime), usage->ru_maxrss,
            (unsigned long long)usage->ru_inblock * BLOCK_BYTES,
            (unsigned long long)usage->ru_oublock * BLOCK_BYTES, status);
    if (fclose(file) != 0) {
        fprintf(stderr, "measure: %s: %s\n", path, strerror(errno));
        return EXIT_CREATE;
    }
    return status;
}

int main(int argc, char **argv)
{
    struct rusage usage;
    int status = 0;
    bool at_hand = argc > 2 && strcmp(argv[1], "--at-hand") == 0;
    size_t bytes = at_hand ? strtoull(argv[2], NULL, 10) : 0;
    argv += at_hand ? 2 : 0, argc -= at_hand ? 2 : 0;
    if (argc < 3) {
        fputs("usage: measure [--at-hand BYTES] REPORT COMMAND [ARGUMENT...]\n", stderr);
        return EXIT_USAGE;
    }
    have_at_hand(bytes);
    double begin = now();
    pid_t child = start(argv + 2);
    while (child >= 0 && wait4(child, &status, 0, &usage) < 0) {
        if (errno != EINTR)
            child = -1;
    }
    double wall = now() - begin;
    if (child < 0) {
        fprintf(stderr, "measure: %s: %s\n", argv[2], strerror(errno));
        return EXIT_SYSTEM;
    }
    return report(argv[1], wall, shell_status(status), &usage);
}
