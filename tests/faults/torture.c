/* torture.c - runs a program many times, kills it or makes system calls in it fail, and checks the
 * files that it leaves.
 *
 *   torture [-ep] [-c CALLS] [-m MOST] [-n RUNS] [-s SEED] [-x CODE]...
 *           MODE OUTPUT... -- PROGRAM ARGUMENT...
 *
 * Runs in the current directory, which holds the inputs. OUTPUTs are the files that the program
 * writes there. The first run is undisturbed, and its outputs are the expected bytes. MODE:
 *
 *   kill        SIGKILL at RUNS random moments
 *   kill-at     SIGKILL before each call of the kinds CALLS (see faults.c)
 *   interrupt   SIGTERM before each call of these kinds
 *   full        the disk is full from each call of these kinds on
 *   ERRNO       each call of these kinds fails once
 *   short       each transfer of these kinds does half, once
 *
 * In every second run the outputs exist before, with other content. What must hold after a run:
 *
 * - Each output is as it was before, or as expected; after success all are as expected. Unless the
 *   program was killed, the disk stays full, or with -e, either all are new or none is.
 * - There are no other files. Only a killed program may leave a temporary file, which the next run
 *   removes.
 * - A failure prints one line on standard error, which begins with the program's name, names a file
 *   and ends with the reason. The exit code is one of CODE, by default 74.
 * - Half transfers, EINTR and EOPNOTSUPP change nothing. Use EOPNOTSUPP only with calls that a file
 *   system may lack.
 * - An interrupted program says so. (test_interrupt.sh checks that it ends soon.)
 *
 * -p takes away files without a name (O_TMPFILE). -m limits the runs to about MOST calls, evenly
 * spread, with the first and the last. -e: each output appears on its own, as a chunk file does
 * before its grid. */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { MOST_OUTPUTS = 8, MOST_CODES = 8, MOST_NAMES = 256 };

struct content {
    char *bytes;
    size_t size;
};

static struct {
    bool plain, each_alone;
    const char *calls, *mode;
    unsigned runs;
    unsigned long most;
    uint64_t random;
    int codes[MOST_CODES + 1];
    char **outputs;
    int output_count;
    char **command;
    char directory[4096], log[64];
    struct content whole[MOST_OUTPUTS];
    char *inputs[MOST_NAMES]; /* names of files in the directory before the first run */
    int input_count;
    double seconds; /* of the undisturbed run */
} job;

static struct {
    unsigned runs, finished, failed, killed,
        left; /* left: runs after which there were temporary files */
} seen;

static const char old_text[] = "what was here before\n";

static void give_up(const char *what)
{
    printf("not ok 1 - torture: %s: %s\n", what, strerror(errno));
    exit(1);
}

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* splitmix64 (Steele, Lea & Flood 2014). */
static double random_share(void)
{
    uint64_t z = job.random += 0x9e3779b97f4a7c15u;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return (double)((z ^ z >> 31) >> 11) * 0x1p-53;
}

/* ---- files ---- */

/* The content of a file; `bytes` is NULL if there is no file. */
static struct content read_file(const char *path)
{
    struct content content = {NULL, 0};
    FILE *file = fopen(path, "rb");
    if (!file)
        return content;
    fseek(file, 0, SEEK_END);
    content.size = (size_t)ftell(file);
    rewind(file);
    content.bytes = malloc(content.size + 1);
    if (!content.bytes || fread(content.bytes, 1, content.size, file) != content.size)
        give_up(path);
    content.bytes[content.size] = '\0';
    fclose(file);
    return content;
}

static void write_old(const char *path)
{
    FILE *file = fopen(path, "wb");
    if (!file || fputs(old_text, file) < 0 || fclose(file) != 0)
        give_up(path);
}

static int list_directory(char *names[MOST_NAMES])
{
    int count = 0;
    DIR *list = opendir(".");
    for (struct dirent *entry; list && (entry = readdir(list));) {
        if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0 &&
            count < MOST_NAMES)
            names[count++] = strdup(entry->d_name);
    }
    closedir(list);
    return count;
}

static bool is_among(const char *name, char *const *names, int count)
{
    for (int i = 0; i < count; i++)
        if (strcmp(name, names[i]) == 0)
            return true;
    return false;
}

/* Returns whether a name has the form ".NAME.XXXXXXXXXXXX.tmp". */
static bool is_temporary(const char *name)
{
    size_t length = strlen(name);
    return name[0] == '.' && length > 18 && strcmp(name + length - 4, ".tmp") == 0 &&
           name[length - 17] == '.';
}

/* ---- one run ---- */

struct run {
    bool had_old;
    int wait_status;
    char *message;     /* standard error */
    const char *wrong; /* what must not be; NULL: nothing */
};

static void set_environment(const char *what, unsigned long at, bool sticky)
{
    char number[24];
    snprintf(number, sizeof number, "%lu", at);
    setenv("FAULT_UNDER", job.directory, 1);
    setenv("FAULT_CALLS", job.calls, 1);
    setenv("FAULT_AT", number, 1);
    setenv("FAULT_DO", what, 1);
    if (sticky)
        setenv("FAULT_STICKY", "1", 1);
    if (at == 0)
        setenv("FAULT_LOG", job.log, 1);
    else
        unsetenv("FAULT_LOG");
    if (job.plain)
        setenv("FAULT_PLAIN", "1", 1);
    setenv("LD_PRELOAD", getenv("FAULTS"), 1);
}

/* Runs the program; kills it after `kill_after` seconds unless that is negative. */
static void run_program(struct run *run, const char *what, unsigned long at, bool sticky,
                        double kill_after)
{
    FILE *message = tmpfile();
    if (!message)
        give_up("tmpfile");
    double start = now();
    pid_t child = fork();
    if (child == 0) {
        int nowhere = open("/dev/null", O_WRONLY);
        dup2(nowhere, STDOUT_FILENO);
        dup2(fileno(message), STDERR_FILENO);
        set_environment(what, at, sticky);
        execv(job.command[0], job.command);
        _exit(127);
    }
    if (child < 0)
        give_up("fork");
    if (kill_after >= 0) {
        double wait = start + kill_after - now();
        struct timespec pause = {(time_t)wait, (long)(1e9 * (wait - (double)(time_t)wait))};
        if (wait > 0)
            nanosleep(&pause, NULL);
        kill(child, SIGKILL);
    }
    while (waitpid(child, &run->wait_status, 0) < 0)
        if (errno != EINTR)
            give_up("waitpid");
    if (at == 0 && kill_after < 0)
        job.seconds = now() - start;
    long size = (fseek(message, 0, SEEK_END), ftell(message));
    rewind(message);
    run->message = calloc((size_t)size + 1, 1);
    if (!run->message || fread(run->message, 1, (size_t)size, message) != (size_t)size)
        give_up("standard error");
    fclose(message);
}

/* ---- files that are left ---- */

/* Returns whether the output is new and whole. */
static bool check_output(struct run *run, int i, bool success)
{
    struct content now_there = read_file(job.outputs[i]);
    bool is_whole = now_there.bytes && now_there.size == job.whole[i].size &&
                    memcmp(now_there.bytes, job.whole[i].bytes, now_there.size) == 0;
    bool is_before =
        run->had_old ? now_there.bytes && strcmp(now_there.bytes, old_text) == 0 : !now_there.bytes;
    if (success && !is_whole)
        run->wrong = "success, but an output is not whole";
    else if (!is_whole && !is_before)
        run->wrong = "an output is neither whole nor as before";
    free(now_there.bytes);
    return is_whole;
}

/* A disk that stays full does not let a program take back what it has renamed. */
static void check_outputs(struct run *run, bool success, bool killed)
{
    int whole = 0;
    for (int i = 0; i < job.output_count; i++)
        whole += check_output(run, i, success);
    if (whole > 0 && whole < job.output_count && !killed && !job.each_alone &&
        strcmp(job.mode, "full") != 0)
        run->wrong = "only some outputs are new";
}

static void check_directory(struct run *run, bool may_leave)
{
    char *names[MOST_NAMES];
    int count = list_directory(names), temporary = 0;
    for (int i = 0; i < count; i++) {
        if (is_temporary(names[i]))
            temporary++;
        else if (!is_among(names[i], job.inputs, job.input_count) &&
                 !is_among(names[i], job.outputs, job.output_count))
            run->wrong = "a file that does not belong here";
        free(names[i]);
    }
    seen.left += temporary > 0;
    if (temporary > 0 && !may_leave)
        run->wrong = "a temporary file was left";
}

/* Checks for one line: the program, a file or the directory of temporary files, the reason. */
static void check_message(struct run *run, const char *reason)
{
    const char *slash = strrchr(job.command[0], '/'), *program = slash ? slash + 1 : job.command[0];
    char *end = strchr(run->message, '\n');
    if (strcmp(job.mode, "interrupt") == 0) {
        if (!end || end[1] != '\0' || !strstr(run->message, ": interrupted"))
            run->wrong = "the interruption is not described by one line";
        return;
    }
    bool names_file = strstr(run->message, "temporary file") != NULL;
    for (int i = 0; i < job.output_count; i++)
        names_file |= strstr(run->message, job.outputs[i]) != NULL;
    for (int i = 0; i < job.input_count; i++)
        names_file |= strstr(run->message, job.inputs[i]) != NULL;
    if (!end || end[1] != '\0' || strncmp(run->message, program, strlen(program)) != 0)
        run->wrong = "the failure is not described by one line";
    else if (!names_file)
        run->wrong = "the message names no file";
    else if (reason && !strstr(run->message, reason))
        run->wrong = "the message does not say why";
}

static bool is_expected_code(int code)
{
    for (int i = 0; job.codes[i]; i++)
        if (job.codes[i] == code)
            return true;
    return false;
}

static void check_run(struct run *run, const char *reason, bool may_fail)
{
    bool success = WIFEXITED(run->wait_status) && WEXITSTATUS(run->wait_status) == 0;
    bool killed = WIFSIGNALED(run->wait_status) && WTERMSIG(run->wait_status) == SIGKILL;
    seen.runs++;
    seen.finished += success;
    seen.killed += killed;
    check_directory(run, killed);
    check_outputs(run, success, killed);
    if (success || killed)
        return;
    seen.failed++;
    if (!WIFEXITED(run->wait_status))
        run->wrong = "it crashed";
    else if (!may_fail)
        run->wrong = "it failed where it could go on";
    else if (!is_expected_code(WEXITSTATUS(run->wait_status)))
        run->wrong = "another exit code than expected";
    else
        check_message(run, reason);
}

static void prepare(struct run *run)
{
    for (int i = 0; i < job.output_count; i++) {
        unlink(job.outputs[i]);
        if (run->had_old)
            write_old(job.outputs[i]);
    }
}

static void report_wrong(const struct run *run, unsigned long number)
{
    printf("# run %lu of %s: %s (wait status %#x)\n# stderr: %s\n", number, job.mode, run->wrong,
           (unsigned)run->wait_status, run->message);
}

/* ---- modes ---- */

/* Runs the program undisturbed; returns the number of calls. */
static unsigned long run_whole(void)
{
    struct run run = {0};
    unsigned long calls = 0;
    prepare(&run);
    run_program(&run, "", 0, false, -1);
    if (!WIFEXITED(run.wait_status) || WEXITSTATUS(run.wait_status) != 0) {
        printf("not ok 1 - torture: undisturbed it fails: %s\n", run.message);
        exit(1);
    }
    free(run.message);
    FILE *log = fopen(job.log, "r");
    for (int c; log && (c = getc(log)) != EOF;)
        calls += c == '\n';
    if (log)
        fclose(log);
    unlink(job.log);
    return calls;
}

static const char *reason_of(const char *mode)
{
    static const struct {
        const char *mode;
        int number;
    } reasons[] = {{"full", ENOSPC},   {"ENOSPC", ENOSPC}, {"EIO", EIO},      {"EDQUOT", EDQUOT},
                   {"EMFILE", EMFILE}, {"EPERM", EPERM},   {"ENOMEM", ENOMEM}};
    for (size_t i = 0; i < sizeof reasons / sizeof *reasons; i++)
        if (strcmp(mode, reasons[i].mode) == 0)
            return strerror(reasons[i].number);
    return NULL;
}

static bool torture_once(unsigned long number)
{
    struct run run = {.had_old = number % 2 != 0};
    bool full = strcmp(job.mode, "full") == 0, by_time = strcmp(job.mode, "kill") == 0;
    bool harmless = strcmp(job.mode, "short") == 0 || strcmp(job.mode, "EINTR") == 0 ||
                    strcmp(job.mode, "EOPNOTSUPP") == 0;
    prepare(&run);
    if (by_time)
        run_program(&run, "", 0, false, 1.05 * job.seconds * random_share());
    else
        run_program(&run,
                    full                                 ? "ENOSPC"
                    : strcmp(job.mode, "kill-at") == 0   ? "KILL"
                    : strcmp(job.mode, "interrupt") == 0 ? "TERM"
                                                         : job.mode,
                    number, full, -1);
    check_run(&run, reason_of(job.mode), !harmless);
    if (run.wrong)
        report_wrong(&run, number);
    free(run.message);
    return !run.wrong;
}

/* Checks that a run after a killed one gives the expected files and removes temporary ones. */
static bool run_again(void)
{
    struct run run = {.had_old = true};
    unsigned left = seen.left;
    run_program(&run, "", 0, false, -1);
    unlink(job.log);
    check_run(&run, NULL, false);
    seen.left = left;
    if (run.wrong)
        report_wrong(&run, 0);
    free(run.message);
    return !run.wrong;
}

static void parse(int argc, char **argv)
{
    int option, codes = 0;
    job.calls = "write sync size name";
    job.runs = 200;
    job.random = 1;
    job.most = (unsigned long)-1;
    while ((option = getopt(argc, argv, "+epc:m:n:s:x:")) != -1) {
        switch (option) {
        case 'e':
            job.each_alone = true;
            break;
        case 'p':
            job.plain = true;
            break;
        case 'c':
            job.calls = optarg;
            break;
        case 'm':
            job.most = strtoul(optarg, NULL, 10);
            break;
        case 'n':
            job.runs = (unsigned)strtoul(optarg, NULL, 10);
            break;
        case 's':
            job.random = strtoull(optarg, NULL, 10);
            break;
        case 'x':
            if (codes < MOST_CODES)
                job.codes[codes++] = atoi(optarg);
            break;
        default:
            exit(64);
        }
    }
    if (codes == 0)
        job.codes[0] = 74;
    job.mode = argv[optind++];
    job.outputs = argv + optind;
    while (argv[optind] && strcmp(argv[optind], "--") != 0)
        job.output_count++, optind++;
    job.command = argv + optind + 1;
    if (!argv[optind] || !job.command[0] || job.output_count > MOST_OUTPUTS || !getenv("FAULTS"))
        exit(64);
}

int main(int argc, char **argv)
{
    parse(argc, argv);
    if (!getcwd(job.directory, sizeof job.directory))
        give_up("getcwd");
    snprintf(job.log, sizeof job.log, "/tmp/bisque-faults.%d", (int)getpid());
    uint64_t seed = job.random;
    job.input_count = list_directory(job.inputs);
    unsigned long calls = run_whole(), good = 0;
    for (int i = 0; i < job.output_count; i++) {
        job.whole[i] = read_file(job.outputs[i]);
        if (!job.whole[i].bytes)
            give_up(job.outputs[i]);
    }
    bool by_time = strcmp(job.mode, "kill") == 0, kills = strncmp(job.mode, "kill", 4) == 0;
    unsigned long last = by_time ? job.runs : calls, runs = 0;
    unsigned long step = by_time || last <= job.most ? 1 : last / job.most;
    for (unsigned long i = 1; i <= last; runs++) {
        good += torture_once(i);
        i += i < last && last - i < step ? last - i : step;
    }
    unlink(job.log);
    bool again = !kills || run_again();
    for (int i = 0; i < job.output_count; i++)
        unlink(job.outputs[i]);
    bool passed = runs > 0 && good == runs && again;
    const char *slash = strrchr(job.command[0], '/');
    printf("%s - %s%s at %lu %s%s%s of %s: %u finished, %u failed, %u killed, %u left a temporary "
           "file; seed %llu\n",
           passed ? "ok" : "not ok", job.mode, job.plain ? " (no O_TMPFILE)" : "", runs,
           by_time ? "moments" : "calls (", by_time ? "" : job.calls, by_time ? "" : ")",
           slash ? slash + 1 : job.command[0], seen.finished, seen.failed, seen.killed, seen.left,
           (unsigned long long)seed);
    return passed ? 0 : 1;
}
