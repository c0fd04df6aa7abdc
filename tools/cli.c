/* cli.c - common options, parsing of values, checks of files, signals, exit codes. */
#include "tools/cli.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/escape.h"
#include "base/loss.h"
#include "base/output.h"
#include "tools/cli_percent.h"

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
    argv[0] = (char *)program;
    /* A closed pipe or a file size limit becomes an error of write(2). As a signal it would end the
     * program without a message and leave temporary files. */
    signal(SIGPIPE, SIG_IGN);
    signal(SIGXFSZ, SIG_IGN);
}

static int parse_progress(struct cli *cli)
{
    static const char *const words[] = {"auto",   "bar",     "none", "json",
                                        "openjd", "percent", "alf",  NULL};
    unsigned mode = 0;
    int status = cli_parse_word(cli, "--progress", optarg, words, &mode);
    if (status == 0)
        cli->progress = (enum cli_progress)mode;
    return status;
}

static int parse_threads(struct cli *cli)
{
    uint64_t threads = 0;
    int status = cli_parse_count(cli, "--threads", optarg, 1, 65536, &threads);
    if (status == 0)
        cli->threads = (unsigned)threads;
    return status;
}

int cli_common_option(struct cli *cli, int option, const char *help)
{
    switch (option) {
    case CLI_MEMORY:
        cli->memory_text = optarg;
        return cli_parse_size(cli, "--memory", optarg, &cli->memory_bytes);
    case CLI_THREADS:
        return parse_threads(cli);
    case CLI_TMPDIR:
        cli->tmpdir = optarg;
        return 0;
    case CLI_PATH_MAP:
        cli->path_map = optarg;
        return 0;
    case CLI_STRICT:
        cli->strict = true;
        return 0;
    case CLI_VERIFY:
        cli->verify = true;
        return 0;
    case CLI_PROGRESS:
        return parse_progress(cli);
    case CLI_JSON:
        cli->json = true;
        return 0;
    case CLI_HELP:
        fputs(help, stdout);
        return 2;
    case CLI_VERSION:
        cli_print("%s %s\n", cli->program, BSQ_VERSION);
        return 2;
    default:
        return 1;
    }
}

static const struct option *find_option(const struct option *options, int option)
{
    while (options->name && options->val != option)
        options++;
    return options->name ? options : NULL;
}

/* Says why getopt_long() returned '?' or ':'. Its own messages would print any bytes. */
static int refuse_option(struct cli *cli, int option, char *const *argv)
{
    const char *word = argv[optind - 1];
    if (strncmp(word, "--", 2) != 0)
        return option == ':' ? cli_usage(cli, "option requires an argument -- '%c'", optopt)
                             : cli_usage(cli, "invalid option -- '%c'", optopt);
    if (option == ':')
        return cli_usage(cli, "option '%s' requires an argument", word);
    if (optopt != 0)
        return cli_usage(cli, "option '%s': no argument is allowed", word);
    return cli_usage(cli, "unrecognized option '%s'", word);
}

int cli_parse_options(struct cli *cli, int argc, char **argv, const struct option *options,
                      int (*take)(struct cli *cli, void *arguments, int option), void *arguments)
{
    const char *letters = find_option(options, 'o') ? ":o:" : ":";
    const char *own_name = NULL;
    int option;
    while ((option = getopt_long(argc, argv, letters, options, NULL)) != -1) {
        int status = option == '?' || option == ':' ? refuse_option(cli, option, argv)
                                                    : take(cli, arguments, option);
        if (status != 0)
            return status;
        const struct option *own =
            option >= CLI_OWN || option == 'o' ? find_option(options, option) : NULL;
        if (own)
            own_name = own->name;
    }
    if (cli->json && cli_prints_percent(cli))
        return cli_usage(cli, "--json and this --progress both write to standard output");
    if (cli->verify && own_name)
        return cli_usage(cli, "--verify only checks files: leave out --%s", own_name);
    if (cli->verify && optind == argc)
        return cli_usage(cli, "no input file given (see --help)");
    return 0;
}

int cli_create_context(struct cli *cli)
{
    if (cli->progress == CLI_PROGRESS_AUTO) {
        const char *terminal = getenv("TERM");
        bool capable = isatty(STDERR_FILENO) && terminal && strcmp(terminal, "dumb") != 0;
        cli->progress = capable ? CLI_PROGRESS_BAR : CLI_PROGRESS_NONE;
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
    if ((fflush(stdout) != 0 || ferror(stdout)) && status >= 0) {
        fprintf(stderr, "%s: standard output: %s\n", cli->program, strerror(errno));
        status = BSQ_EIO;
    }
    return status < 0 ? -status : 0;
}

/* ---- values ---- */

/* Refuses what strtod() also takes but an option does not: "inf", "0x1p3" and leading space. */
static bool is_decimal(const char *text)
{
    return (text[0] >= '0' && text[0] <= '9') ||
           (text[0] == '.' && text[1] >= '0' && text[1] <= '9');
}

/* Returns the factor of a unit such as "", "k", "MiB", "gb", or 0 if it is unknown. */
static uint64_t unit_factor(const char *unit)
{
    static const char prefixes[] = "kmgt";
    if (*unit == '\0' || strcasecmp(unit, "b") == 0)
        return 1;
    const char *prefix = strchr(prefixes, *unit | 0x20);
    if (!prefix)
        return 0;
    bool decimal = strcasecmp(unit + 1, "b") == 0;
    if (!decimal && unit[1] != '\0' && strcasecmp(unit + 1, "ib") != 0)
        return 0;
    uint64_t factor = 1;
    for (const char *p = prefixes; p <= prefix; p++)
        factor *= decimal ? 1000 : 1024;
    return factor;
}

int cli_parse_size(struct cli *cli, const char *option, const char *text, uint64_t *out)
{
    char *end = (char *)text;
    long double number = 0;
    if (is_decimal(text) && !(text[0] == '0' && (text[1] | 0x20) == 'x'))
        number = strtold(text, &end);
    long double bytes = number * (long double)unit_factor(end);
    if (end == text || !(bytes >= 1.0L))
        return cli_usage(cli, "%s: \"%s\" is not a size such as 512MiB or 4G", option, text);
    if (!(bytes < 0x1p63L))
        return cli_usage(cli, "%s: \"%s\" is too large a size: less than 8388608T is possible",
                         option, text);
    *out = (uint64_t)bytes;
    return 0;
}

int cli_parse_count(struct cli *cli, const char *option, const char *text, uint64_t min,
                    uint64_t max, uint64_t *out)
{
    char *end;
    errno = 0;
    unsigned long long value = strtoull(text, &end, 10);
    bool digits = text[0] >= '0' && text[0] <= '9' && *end == '\0';
    if (!digits || errno == ERANGE || value < min || value > max)
        return cli_usage(cli, "%s: \"%s\" is not a whole number from %llu to %llu", option, text,
                         (unsigned long long)min, (unsigned long long)max);
    *out = value;
    return 0;
}

int cli_parse_length(struct cli *cli, const char *option, const char *text, bool positive,
                     double *out)
{
    char *end;
    double value = strtod(text, &end);
    bool number =
        is_decimal(text) && strspn(text, "0123456789.eE+-") == strlen(text) && *end == '\0';
    if (!number || !isfinite(value) || (positive && !(value > 0)))
        return cli_usage(cli, "%s: \"%s\" is not a %s number", option, text,
                         positive ? "positive" : "non-negative");
    *out = value;
    return 0;
}

int cli_parse_word(struct cli *cli, const char *option, const char *text, const char *const *words,
                   unsigned *out)
{
    for (unsigned i = 0; words[i]; i++) {
        if (strcmp(words[i], text) == 0) {
            *out = i;
            return 0;
        }
    }
    char *list = NULL;
    size_t size;
    FILE *stream = open_memstream(&list, &size);
    for (unsigned i = 0; stream && words[i]; i++)
        fprintf(stream, "%s%s", i == 0 ? "" : words[i + 1] ? ", " : " or ", words[i]);
    if (stream)
        fclose(stream);
    int status = cli_usage(cli, "%s: \"%s\" is not %s", option, text, list ? list : "known");
    free(list);
    return status;
}

int cli_parse_scan_normals(struct cli *cli, const char *text, enum bsq_scan_normals *out)
{
    static const char *const words[] = {"smooth", "area", "angle", "max", "flat", NULL};
    static const enum bsq_scan_normals normals[] = {BSQ_SCAN_NORMALS_SMOOTH, BSQ_SCAN_NORMALS_AREA,
                                                    BSQ_SCAN_NORMALS_ANGLE, BSQ_SCAN_NORMALS_MAX,
                                                    BSQ_SCAN_NORMALS_FLAT};
    unsigned word = 0;
    int status = cli_parse_word(cli, "--scan-normals", text, words, &word);
    if (status == 0)
        *out = normals[word];
    return status;
}

/* ---- files ---- */

bool cli_ends_with(const char *text, const char *ending)
{
    size_t length = strlen(text), ending_length = strlen(ending);
    return length >= ending_length && strcasecmp(text + length - ending_length, ending) == 0;
}

/* Returns the absolute path of a file that need not exist; NULL if its directory does not exist. */
static char *absolute_name(const char *path)
{
    char *target = bsq_follow_links(path), *name = NULL;
    const char *slash = target ? strrchr(target, '/') : NULL;
    char *directory = slash ? strndup(target, (size_t)(slash - target + 1)) : strdup(".");
    char *resolved = target && directory ? realpath(directory, NULL) : NULL;
    if (resolved && asprintf(&name, "%s/%s", resolved, slash ? slash + 1 : target) < 0)
        name = NULL;
    free(resolved);
    free(directory);
    free(target);
    return name;
}

bool cli_same_file(const char *a, const char *b)
{
    struct stat info_a, info_b;
    bool exists_a = stat(a, &info_a) == 0, exists_b = stat(b, &info_b) == 0;
    if (exists_a && exists_b)
        return info_a.st_dev == info_b.st_dev && info_a.st_ino == info_b.st_ino;
    if (exists_a != exists_b)
        return false;
    char *name_a = absolute_name(a), *name_b = absolute_name(b);
    bool same = name_a && name_b && strcmp(name_a, name_b) == 0;
    free(name_a);
    free(name_b);
    return same;
}

int cli_check_picture(struct cli *cli, const char *path)
{
    int status = bsq_output_check(cli->ctx, path);
    if (status == 0 && !cli_ends_with(path, ".png"))
        status = cli_usage(cli, "%s: the picture is a PNG file: its name must end in .png", path);
    return status;
}
