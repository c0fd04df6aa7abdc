/* cli.c - start and end of a program, checks of files, signals, exit codes. */
#include "tools/cli.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <strings.h>
#include <unistd.h>

#include "base/job_files.h"
#include "formats/file_kind.h"

/* ---- signals ---- */

/* The context to interrupt. Global, because a signal handler has no argument for it. */
static struct bsq_ctx *volatile signalled_ctx;

static void on_signal(int number)
{
    (void)number;
    if (signalled_ctx)
        bsq_interrupt(signalled_ctx);
}

static void catch_signal(int number)
{
    struct sigaction action = {.sa_handler = on_signal, .sa_flags = SA_RESTART}, before;
    sigemptyset(&action.sa_mask);
    /* A signal that the parent ignores (nohup, a background job) stays ignored. */
    if (sigaction(number, NULL, &before) == 0 && before.sa_handler != SIG_IGN)
        sigaction(number, &action, NULL);
}

/* ---- start and end of a program ---- */

/* Occupies the standard descriptors that are closed. Otherwise the next file that is opened would
 * get such a number, and messages would be written into it. Reading and writing still fail with
 * EBADF, so that a report that cannot be printed is an error. */
static void reserve_standard_descriptors(void)
{
    for (int fd = STDIN_FILENO; fd <= STDERR_FILENO; fd++) {
        if (fcntl(fd, F_GETFD) < 0 && open("/", O_PATH | O_DIRECTORY) != fd)
            _exit(-BSQ_EIO);
    }
}

/* Allows as many open files as the system does: maps of many UDIM tiles are open together. */
static void allow_open_files(void)
{
    struct rlimit limit;
    if (getrlimit(RLIMIT_NOFILE, &limit) == 0 && limit.rlim_cur < limit.rlim_max) {
        limit.rlim_cur = limit.rlim_max;
        setrlimit(RLIMIT_NOFILE, &limit);
    }
}

void cli_begin(struct cli *cli, const char *program, char **argv)
{
    reserve_standard_descriptors();
    allow_open_files();
    *cli = (struct cli){.program = program};
    clock_gettime(CLOCK_MONOTONIC, &cli->started);
    cli->logged = cli->started;
    argv[0] = (char *)program;
    cli->command = json_array(); /* parsing changes the texts */
    for (; *argv; argv++)
        cli_json_append(&cli->command, cli_json_text(*argv));
    cli->warnings = json_array();
    /* A closed pipe or a file size limit becomes an error of write(2). As a signal it would end the
     * program without a message and leave temporary files. */
    signal(SIGPIPE, SIG_IGN);
    signal(SIGXFSZ, SIG_IGN);
}

int cli_create_context(struct cli *cli)
{
    if (cli->progress == CLI_PROGRESS_AUTO) {
        const char *terminal = getenv("TERM");
        bool capable = isatty(STDERR_FILENO) && terminal && strcmp(terminal, "dumb") != 0;
        cli->progress = capable ? CLI_PROGRESS_BAR : CLI_PROGRESS_LOG;
    }
    struct bsq_ctx_options options = {
        .memory_bytes = cli->memory_bytes,
        .threads = cli->threads,
        .tmpdir = cli->tmpdir,
        .on_progress = cli->progress == CLI_PROGRESS_NONE ? NULL : cli_on_progress,
        .on_warning = cli_on_warning,
        .user = cli,
    };
    int status = bsq_ctx_create(&options, &cli->ctx);
    if (status < 0) {
        fprintf(stderr, "%s: out of memory\n", cli->program);
        cli->reported = true;
        return status;
    }
    bsq_set_strict(cli->ctx, cli->strict);
    signalled_ctx = cli->ctx;
    catch_signal(SIGINT);
    catch_signal(SIGTERM);
    catch_signal(SIGHUP);
    if (cli_prints_percent(cli))
        cli_percent_begin(cli);
    return cli_load_path_map(cli);
}

int cli_usage(struct cli *cli, const char *format, ...)
{
    va_list arguments;
    char *text = NULL, *line = NULL;
    cli_clear_bar(cli);
    va_start(arguments, format);
    if (vasprintf(&text, format, arguments) >= 0)
        line = bsq_escape(text, false);
    va_end(arguments);
    fprintf(stderr, "%s: %s\n", cli->program, line ? line : "out of memory");
    cli_percent_fail(cli, line ? line : "out of memory");
    free(line);
    free(text);
    cli->reported = true;
    return BSQ_EUSAGE;
}

int cli_end(struct cli *cli, int status)
{
    cli_clear_bar(cli);
    cli_percent_end(cli, status >= 0);
    if (status < 0 && !cli->reported) {
        const char *text = cli->ctx ? bsq_error(cli->ctx) : "";
        cli_percent_fail(cli, text);
        if (*text)
            fprintf(stderr, "%s: %s\n", cli->program, text);
        else
            fprintf(stderr, "%s: failed with status %d\n", cli->program, -status);
    }
    signalled_ctx = NULL;
    bsq_ctx_destroy(cli->ctx);
    json_decref(cli->command);
    json_decref(cli->warnings);
    if ((fflush(stdout) != 0 || ferror(stdout)) && status >= 0) {
        fprintf(stderr, "%s: standard output: %s\n", cli->program, strerror(errno));
        status = BSQ_EIO;
    }
    return status < 0 ? -status : 0;
}

/* ---- files ---- */

bool cli_ends_with(const char *text, const char *ending)
{
    size_t length = strlen(text), ending_length = strlen(ending);
    return length >= ending_length && strcasecmp(text + length - ending_length, ending) == 0;
}

int cli_check_outputs(struct cli *cli, const char *const *paths, unsigned count)
{
    int status = 0;
    for (unsigned i = 0; i < count; i++) {
        for (unsigned j = 0; j < i; j++)
            if (paths[i] && paths[j] && bsq_same_file(paths[i], paths[j]))
                return cli_usage(cli, "%s: two outputs have this name", paths[i]);
        if (paths[i])
            BSQ_TRY(bsq_output_check(cli->ctx, paths[i]));
    }
done:
    return status;
}

int cli_recognise_scans(struct cli *cli, const char *const *paths, uint32_t count,
                        const char *advice, struct cli_scans *out)
{
    int status = 0;
    out->meshes = calloc(count, sizeof *out->meshes);
    out->chunks = calloc(count, sizeof *out->chunks);
    if (!out->meshes || !out->chunks)
        return bsq_fail_errno(cli->ctx, BSQ_ENOMEM, ENOMEM, "%s", paths[0]);
    for (uint32_t i = 0; i < count; i++) {
        enum fmt_kind kind = FMT_KIND_MESH;
        BSQ_TRY(fmt_recognise(cli->ctx, paths[i], &kind));
        if (kind != FMT_KIND_PIPE)
            BSQ_TRY(bsq_note_input(cli->ctx, paths[i], "the scan"));
        if (kind == FMT_KIND_NVDB || kind == FMT_KIND_VDB)
            return bsq_fail(cli->ctx, BSQ_EDATA, "%s: %s", paths[i], advice);
        if (kind == FMT_KIND_TRIS)
            out->chunks[out->chunk_count++] = paths[i];
        else
            out->meshes[out->mesh_count++] = paths[i];
    }
done:
    return status;
}
