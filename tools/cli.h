/* cli.h - what Bisque's programs share: common options, parsing of values, checks of files,
 * progress and reports.
 *
 * A program calls cli_begin(), cli_parse_options() and cli_create_context(), does its work through
 * the libraries and returns cli_end() from main. Every failure becomes one line "PROGRAM: MESSAGE"
 * on standard error; the exit code is the negated status. */
#ifndef CLI_H
#define CLI_H

#include <getopt.h>
#include <jansson.h>
#include <stdio.h>
#include <time.h>

#include "base/context.h"

enum cli_progress {
    CLI_PROGRESS_AUTO,
    CLI_PROGRESS_BAR,
    CLI_PROGRESS_NONE,
    CLI_PROGRESS_JSON,
    CLI_PROGRESS_OPENJD,
    CLI_PROGRESS_PERCENT,
    CLI_PROGRESS_ALF
};

/* How often a stage of progress comes. */
enum cli_stage_count {
    CLI_ONCE,
    CLI_EACH_TILE,
    CLI_EACH_TRACED_TILE,
    CLI_EACH_TRACE,
    CLI_STAGE_COUNTS
};

struct cli {
    const char *program;
    struct bsq_ctx *ctx; /* NULL before cli_create_context() */

    uint64_t memory_bytes;   /* 0: not given */
    const char *memory_text; /* as given; NULL: not given */
    unsigned threads;        /* 0: not given */
    const char *tmpdir;
    const char *path_map; /* file with rules for paths; NULL: none */
    enum cli_progress progress;
    bool json;   /* print results as JSON */
    bool verify; /* only check files */
    bool strict; /* warnings of lost data are errors */

    bool reported;  /* the failure has been printed */
    bool bar_drawn; /* the terminal's last line is a progress bar */
    const char *bar_stage;
    const uint32_t *stage_counts[CLI_STAGE_COUNTS]; /* how often stages come; NULL: once */
    struct timespec started, stage_started;
};

/* Values of the common options for getopt_long; a program's own long options start at CLI_OWN. */
enum {
    CLI_MEMORY = 256,
    CLI_THREADS,
    CLI_TMPDIR,
    CLI_VERIFY,
    CLI_STRICT,
    CLI_PROGRESS,
    CLI_PATH_MAP,
    CLI_JSON,
    CLI_HELP,
    CLI_VERSION,
    CLI_OWN
};

#define CLI_COMMON_OPTIONS                                                                         \
    {"memory", required_argument, NULL, CLI_MEMORY},                                               \
        {"threads", required_argument, NULL, CLI_THREADS},                                         \
        {"progress", required_argument, NULL, CLI_PROGRESS},                                       \
        {"path-map", required_argument, NULL, CLI_PATH_MAP},                                       \
        {"json", no_argument, NULL, CLI_JSON}, {"help", no_argument, NULL, CLI_HELP},              \
    {                                                                                              \
        "version", no_argument, NULL, CLI_VERSION                                                  \
    }
#define CLI_TMPDIR_OPTION                                                                          \
    {                                                                                              \
        "tmpdir", required_argument, NULL, CLI_TMPDIR                                              \
    }

#define CLI_STRICT_OPTION                                                                          \
    {                                                                                              \
        "strict", no_argument, NULL, CLI_STRICT                                                    \
    }
#define CLI_VERIFY_OPTION                                                                          \
    {                                                                                              \
        "verify", no_argument, NULL, CLI_VERIFY                                                    \
    }

/* Texts of --help. */
#define CLI_STRICT_HELP                                                                            \
    "      --strict            end with an error if data of an input is lost, not with a warning\n"
#define CLI_VERIFY_HELP                                                                            \
    "      --verify            check FILES (.tris, .nvdb), print a line on each, do nothing "      \
    "else\n"
#define CLI_COMMON_HELP                                                                            \
    "      --memory SIZE       memory budget, e.g. 4G, 512MiB (default: half of the machine's)\n"  \
    "      --threads N         worker threads (default: one per processor)\n"                      \
    "      --progress WHEN     auto, bar, none or json (default: auto, a bar on a terminal);\n"    \
    "                          openjd, percent or alf: lines for schedulers\n"                     \
    "      --path-map FILE     rules for paths on this machine (pathmapping-1.0)\n"                \
    "      --json              print the results as JSON\n"                                        \
    "      --help              print this help\n"                                                  \
    "      --version           print the version\n"

/* ---- start and end of a program ---- */

/* Reserves closed standard descriptors, starts the clock, ignores SIGPIPE and SIGXFSZ, and makes
 * getopt's messages begin with the program's name. `argv` is main's. */
void cli_begin(struct cli *cli, const char *program, char **argv);

/* Handles a common option, whose value is in optarg. Returns 0; 1 if it is not a common option; 2
 * if the program is to end (--help, --version); a negative status on failure. */
int cli_common_option(struct cli *cli, int option, const char *help);

/* Parses all options. Calls `take` for each, with its value in optarg; options that `take` does not
 * know go to cli_common_option(), and `take` returns what that returns. --verify excludes options
 * of the program's own. Returns 0, or the first result of `take` that is not 0. After success
 * optind is the index of the first file in argv. */
int cli_parse_options(struct cli *cli, int argc, char **argv, const struct option *options,
                      int (*take)(struct cli *cli, void *arguments, int option), void *arguments);

/* Creates the context and lets SIGINT, SIGTERM and SIGHUP interrupt it. */
int cli_create_context(struct cli *cli);

/* Prints a usage error; returns BSQ_EUSAGE. */
int cli_usage(struct cli *cli, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Prints the failure if `status` is negative, frees the context, and checks that standard output
 * was written. Returns the exit code. */
int cli_end(struct cli *cli, int status);

/* ---- values of options; messages name `option` ---- */

/* Parses a size in bytes: a number with an optional unit. K, M, G, T and KiB ... are powers of
 * 1024, kB ... are powers of 1000. */
int cli_parse_size(struct cli *cli, const char *option, const char *text, uint64_t *out);
/* Parses a whole number from min to max. */
int cli_parse_count(struct cli *cli, const char *option, const char *text, uint64_t min,
                    uint64_t max, uint64_t *out);
/* Parses a finite decimal number >= 0, or > 0 if `positive`. */
int cli_parse_length(struct cli *cli, const char *option, const char *text, bool positive,
                     double *out);
/* Parses one of `words` (NULL-terminated); sets *out to its index. */
int cli_parse_word(struct cli *cli, const char *option, const char *text, const char *const *words,
                   unsigned *out);
/* Parses the value of --scan-normals, such as smooth. */
int cli_parse_scan_normals(struct cli *cli, const char *text, enum bsq_scan_normals *out);

/* ---- files ---- */

/* Returns whether `text` ends with `ending`, ignoring case. */
bool cli_ends_with(const char *text, const char *ending);

/* Returns whether both paths name one file, which need not exist. */
bool cli_same_file(const char *a, const char *b);

/* Checks the output of a picture with bsq_output_check(); its name must also end in .png. */
int cli_check_picture(struct cli *cli, const char *path);

/* Checks whole files (.tris, .nvdb) and prints a line on each: its content on standard output, or
 * what is wrong on standard error. Checks all of them; returns the status of the first that failed.
 */
int cli_verify(struct cli *cli, char *const *paths, int count);

/* Reads the rules of --path-map, which apply to names in files from then on. */
int cli_load_path_map(struct cli *cli);

/* Applies these rules to an input of the command line; *path may be NULL. */
int cli_map_input(struct cli *cli, const char **path);

/* ---- reports ---- */

/* Callbacks of the context; `user` is the struct cli. */
void cli_on_progress(void *user, const struct bsq_progress *progress);
void cli_on_warning(void *user, const char *line);
/* Removes the progress bar from the terminal, so that a line can be printed. */
void cli_clear_bar(struct cli *cli);

/* Prints to standard output as printf() does, escaped as bsq_escape() does; newlines stay. Tools
 * print all reports with this, because names in them come from files and command lines. */
void cli_print(const char *format, ...) __attribute__((format(printf, 1, 2)));

double cli_seconds(const struct timespec *since);
uint64_t cli_max_rss_bytes(void);

/* Write "12.3 MiB", "1,234,567", and "1 vertex" or "12 vertices" to `buffer` of CLI_TEXT bytes, and
 * return it. */
enum { CLI_TEXT = 64 };
const char *cli_size_text(uint64_t bytes, char *buffer);
const char *cli_count_text(uint64_t count, char *buffer);
const char *cli_counted_text(uint64_t count, const char *singular, const char *plural,
                             char *buffer);

/* Prints `separator` and, for example, "12 unused vertices" if count > 0. Returns the separator for
 * the next count. */
const char *cli_print_count(const char *separator, uint64_t count, const char *singular,
                            const char *plural);
/* Prints the last lines of a report: memory and time. */
void cli_print_cost(const struct cli *cli);

/* Returns a JSON string of the text; if it is not UTF-8, of the escaped text. NULL gives null. */
json_t *cli_json_text(const char *text);
/* Prints `root` with program, version and cost added. Takes over the caller's reference; NULL means
 * that there was no memory for it. */
int cli_print_json(struct cli *cli, json_t *root);

#endif
