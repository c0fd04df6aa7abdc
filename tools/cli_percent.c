/* cli_percent.c - prints progress as lines that schedulers read: one percentage over all stages.
 *
 * A program lists its stages with the share of its time that each usually takes. A job that has
 * fewer stages jumps ahead; the percentage never falls. Lines go to standard output, which render
 * farms read. A thread repeats the last line if a stage says nothing for HEARTBEAT_SECONDS, so that
 * a scheduler sees that the program lives. */
#include "tools/cli.h"

#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>

enum { HEARTBEAT_SECONDS = 30 };

static const struct stage {
    const char *program, *name;
    unsigned share; /* percent of the program's time */
    enum cli_stage_count count;
} stages[] = {
    {"bisque-voxelize", "reading", 45, CLI_ONCE},
    {"bisque-voxelize", "writing", 15, CLI_ONCE},
    {"bisque-voxelize", "voxelizing", 30, CLI_ONCE},
    {"bisque-voxelize", "reading parts", 9, CLI_ONCE},
    {"bisque-bake", "tracing", 66, CLI_EACH_TRACED_TILE},
    {"bisque-bake", "measuring curvature", 14, CLI_EACH_TRACED_TILE},
    {"bisque-bake", "reading parts", 4, CLI_EACH_TILE},
    {"bisque-bake", "filtering", 1, CLI_EACH_TILE},
    {"bisque-bake", "writing", 12, CLI_EACH_TILE},
    {"bisque-bake", "preview", 3, CLI_ONCE},
};
enum { STAGES = sizeof stages / sizeof *stages };

/* The state is global because the thread outlives any call; a program has one job. */
static struct {
    pthread_mutex_t lock;
    pthread_cond_t stop;
    pthread_t thread;
    bool running, stopping;
    const struct cli *cli;
    const char *name;        /* of the stage that runs; NULL: none */
    const char *last;        /* the stage that was begun last; NULL: none */
    const struct stage *row; /* of that stage in the table; NULL: none */
    uint32_t times;          /* how often it was begun before */
    double percent;          /* of all stages */
    double printed;          /* in the last line; < 0: none yet */
    struct timespec at;      /* when the last line was printed */
} state = {.lock = PTHREAD_MUTEX_INITIALIZER, .printed = -1};

bool cli_prints_percent(const struct cli *cli)
{
    return cli->progress == CLI_PROGRESS_OPENJD || cli->progress == CLI_PROGRESS_PERCENT ||
           cli->progress == CLI_PROGRESS_ALF;
}

/* ---- lines; the caller holds the lock ---- */

static void print_line(const struct cli *cli, double percent)
{
    if (cli->progress == CLI_PROGRESS_OPENJD)
        printf("openjd_progress: %.1f\n", percent);
    else if (cli->progress == CLI_PROGRESS_PERCENT)
        printf("Progress: %.0f%%\n", floor(percent));
    else
        printf("ALF_PROGRESS %.0f%%\n", floor(percent));
    fflush(stdout);
    state.printed = percent;
    clock_gettime(CLOCK_MONOTONIC, &state.at);
}

/* Prints a line if the number in it is another one. */
static void print_if_new(const struct cli *cli)
{
    const double step = cli->progress == CLI_PROGRESS_OPENJD ? 10 : 1;
    if (floor(state.percent * step) > floor(state.printed * step) || state.printed < 0)
        print_line(cli, state.percent);
}

/* ---- the percentage ---- */

/* Returns the row of a stage. NULL: it is not in the table. */
static const struct stage *row_of(const struct cli *cli, const char *name)
{
    for (const struct stage *row = stages; row < stages + STAGES; row++)
        if (strcmp(row->program, cli->program) == 0 && strcmp(row->name, name) == 0)
            return row;
    return NULL;
}

/* Returns the percentage when `part` of the current stage is done. Stages that are not in the table
 * have no share. */
static double percent_at(const struct cli *cli, double fraction)
{
    double before = 0;
    const uint32_t *times = state.row ? cli->stage_counts[state.row->count] : NULL;
    const double count = times && *times > 1 ? *times : 1;
    if (!state.row)
        return 0;
    for (const struct stage *row = stages; row < state.row; row++)
        if (strcmp(row->program, cli->program) == 0)
            before += row->share;
    return before + state.row->share * fmin((state.times + fraction) / count, 1);
}

/* Notes that a stage runs; counts how often it was begun. */
static void enter_stage(const struct cli *cli, const struct bsq_progress *progress)
{
    const bool same = state.last && strcmp(state.last, progress->stage) == 0;
    if (state.name)
        return;
    state.times = same ? state.times + 1 : 0;
    state.row = row_of(cli, progress->stage);
    state.name = state.last = progress->stage;
    if (cli->progress == CLI_PROGRESS_OPENJD && !same) {
        printf("openjd_status: %s\n", progress->stage);
        fflush(stdout);
    }
}

void cli_percent_report(struct cli *cli, const struct bsq_progress *progress)
{
    double fraction = progress->total > 0 ? (double)progress->done / (double)progress->total : 0;
    pthread_mutex_lock(&state.lock);
    enter_stage(cli, progress);
    fraction = progress->finished ? 1 : fmin(fraction, 1);
    fraction = percent_at(cli, fraction);
    state.percent = fmax(state.percent, fraction);
    print_if_new(cli);
    if (progress->finished)
        state.name = NULL;
    pthread_mutex_unlock(&state.lock);
}

/* ---- the heartbeat ---- */

/* Prints the last line again if none was printed for so long that the next one would come too late.
 */
static void repeat_line(const struct timespec *now)
{
    if (now->tv_sec - state.at.tv_sec >= HEARTBEAT_SECONDS - 1)
        print_line(state.cli, state.percent);
}

static void *beat(void *unused)
{
    (void)unused;
    pthread_mutex_lock(&state.lock);
    while (!state.stopping) {
        struct timespec now, next;
        clock_gettime(CLOCK_MONOTONIC, &now);
        repeat_line(&now);
        next = state.at;
        next.tv_sec += HEARTBEAT_SECONDS - 1;
        pthread_cond_timedwait(&state.stop, &state.lock, &next);
    }
    pthread_mutex_unlock(&state.lock);
    return NULL;
}

/* A system that allows no more threads only loses the heartbeat. The thread leaves signals to
 * others. */
void cli_percent_begin(const struct cli *cli)
{
    pthread_condattr_t attributes;
    sigset_t all, before;
    state.cli = cli;
    pthread_condattr_init(&attributes);
    pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
    pthread_cond_init(&state.stop, &attributes);
    pthread_condattr_destroy(&attributes);
    print_line(cli, 0);
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    state.running = pthread_create(&state.thread, NULL, beat, NULL) == 0;
    pthread_sigmask(SIG_SETMASK, &before, NULL);
}

void cli_percent_end(const struct cli *cli, bool success)
{
    if (!state.cli)
        return;
    pthread_mutex_lock(&state.lock);
    state.stopping = true;
    if (success && state.printed < 100)
        print_line(cli, 100);
    pthread_cond_signal(&state.stop);
    pthread_mutex_unlock(&state.lock);
    if (state.running)
        pthread_join(state.thread, NULL);
    state.cli = NULL;
}

void cli_percent_fail(const struct cli *cli, const char *text)
{
    if (cli->progress != CLI_PROGRESS_OPENJD)
        return;
    printf("openjd_fail: %s\n", text);
    fflush(stdout);
}
