/* cli.c - start and end of a program, checks of files, signals, exit codes. */
#include "tools/cli.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <strings.h>
#include <unistd.h>

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

/* If BSQ_PARENT has the process id of the parent, the program is interrupted when the parent dies.
 * A parent that is another process means that it has died already. */
static void die_with_parent(const char *program)
{
    const char *parent = getenv("BSQ_PARENT");
    if (!parent)
        return;
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (strtol(parent, NULL, 10) == getppid())
        return;
    fprintf(stderr, "%s: interrupted: the parent, process %.20s (BSQ_PARENT), has ended\n", program,
            parent);
    _exit(-BSQ_EINTR);
}

void cli_begin(struct cli *cli, const char *program, char **argv)
{
    reserve_standard_descriptors();
    die_with_parent(program);
    allow_open_files();
    *cli = (struct cli){.program = program};
    clock_gettime(CLOCK_MONOTONIC, &cli->started);
    cli->logged = cli->started;
    argv[0] = program_invocation_name = (char *)program;
    cli->command = json_array(); /* parsing changes the texts */
    for (; *argv; argv++)
        cli_json_append(&cli->command, cli_json_text(*argv));
    cli->warnings = json_array();
    /* A closed pipe or a file size limit becomes an error of write(2). As a signal it would end the
     * program without a message and leave temporary files. */
    signal(SIGPIPE, SIG_IGN);
    signal(SIGXFSZ, SIG_IGN);
}

/* ---- memory that lives until the program ends ---- */

static struct kept {
    struct kept *next;
    _Alignas(16) unsigned char bytes[];
} * all_kept;

void *cli_keep(size_t bytes)
{
    struct kept *block = calloc(1, sizeof *block + bytes);
    if (!block) {
        fprintf(stderr, "%s: out of memory\n", program_invocation_name);
        exit(-BSQ_ENOMEM);
    }
    block->next = all_kept; /* so that a search for leaks finds it */
    all_kept = block;
    return block->bytes;
}

char *cli_keep_text(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    const int length = vsnprintf(NULL, 0, format, arguments);
    va_end(arguments);
    char *text = cli_keep((size_t)length + 1);
    va_start(arguments, format);
    vsnprintf(text, (size_t)length + 1, format, arguments);
    va_end(arguments);
    return text;
}

void *cli_extend(const void *list, size_t count, size_t element_bytes)
{
    void *out = cli_keep((count + 1) * element_bytes);
    if (count > 0)
        memcpy(out, list, count * element_bytes);
    return out;
}

/* ---- the context ---- */

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
    return 0;
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
    for (unsigned i = 0; i < count; i++) {
        for (unsigned j = 0; j < i; j++)
            if (paths[i] && paths[j] && bsq_same_file(paths[i], paths[j]))
                return cli_usage(cli, "%s: two outputs have this name", paths[i]);
        if (paths[i])
            BSQ_PASS(bsq_output_check(cli->ctx, paths[i]));
    }
    return 0;
}

int cli_recognise_scans(struct cli *cli, const char *const *paths, uint32_t count,
                        const char *advice, struct cli_scans *out)
{
    out->meshes = cli_keep(count * sizeof *out->meshes);
    out->chunks = cli_keep(count * sizeof *out->chunks);
    for (uint32_t i = 0; i < count; i++) {
        enum fmt_kind kind = FMT_KIND_MESH;
        BSQ_PASS(fmt_recognise(cli->ctx, paths[i], &kind));
        if (kind != FMT_KIND_PIPE)
            BSQ_PASS(bsq_note_input(cli->ctx, paths[i], "the scan"));
        if (kind == FMT_KIND_NVDB || kind == FMT_KIND_VDB)
            return bsq_fail(cli->ctx, BSQ_EDATA, "%s: %s", paths[i], advice);
        if (kind == FMT_KIND_TRIS)
            out->chunks[out->chunk_count++] = paths[i];
        else
            out->meshes[out->mesh_count++] = paths[i];
    }
    return 0;
}

int cli_join(struct cli *cli, const char *const *paths, uint32_t count,
             const struct vox_join_options *how, struct vox_temp_tris **temp)
{
    struct vox_sort_report report = {.size = sizeof report};
    struct vox_join_options options = *how;
    if (count + (*temp != NULL) < 2)
        return 0;
    if (!*temp)
        BSQ_PASS(vox_temp_tris_create(cli->ctx, temp));
    options.size = sizeof options;
    options.tris_paths = paths;
    options.tris_count = count;
    options.temp_tris = *temp;
    options.temporary = true;
    return vox_join(cli->ctx, &options, &report);
}
