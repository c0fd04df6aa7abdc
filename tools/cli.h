/* cli.h - what Bisque's programs share: common options, parsing of values, progress, reports and
 * the way out.
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

enum cli_progress { CLI_PROGRESS_AUTO, CLI_PROGRESS_BAR, CLI_PROGRESS_NONE, CLI_PROGRESS_JSON };

struct cli {
    const char *program;
    struct bsq_ctx *ctx; /* NULL before cli_create_context() */

    uint64_t memory_bytes;   /* 0: not given */
    const char *memory_text; /* as given, NULL: not given */
    unsigned threads;        /* 0: not given */
    const char *tmpdir;
    const char *job_option; /* name of an own option but --verify, which has no use for it; NULL:
                               none given */
    enum cli_progress progress;
    bool json; /* results as JSON */

    bool reported;  /* the failure has been printed */
    bool bar_drawn; /* the cursor stands behind a progress bar */
    const char *bar_stage;
    struct timespec started, stage_started;
};

/* Values of the common options for getopt_long; a program's own long options start at CLI_OWN. */
enum {
    CLI_MEMORY = 256,
    CLI_THREADS,
    CLI_TMPDIR,
    CLI_PROGRESS,
    CLI_JSON,
    CLI_HELP,
    CLI_VERSION,
    CLI_OWN
};

#define CLI_COMMON_OPTIONS                                                                         \
    {"memory", required_argument, NULL, CLI_MEMORY},                                               \
        {"threads", required_argument, NULL, CLI_THREADS},                                         \
        {"progress", required_argument, NULL, CLI_PROGRESS},                                       \
        {"json", no_argument, NULL, CLI_JSON}, {"help", no_argument, NULL, CLI_HELP},              \
    {                                                                                              \
        "version", no_argument, NULL, CLI_VERSION                                                  \
    }
#define CLI_TMPDIR_OPTION                                                                          \
    {                                                                                              \
        "tmpdir", required_argument, NULL, CLI_TMPDIR                                              \
    }

/* Text on the common options for --help. */
#define CLI_COMMON_HELP                                                                            \
    "      --memory SIZE       memory budget, e.g. 4G, 512MiB (default: half of the machine's)\n"  \
    "      --threads N         worker threads (default: one per processor)\n"                      \
    "      --progress WHEN     auto, bar, none or json (default: auto, a bar on a terminal)\n"     \
    "      --json              print the results as JSON\n"                                        \
    "      --help              print this help\n"                                                  \
    "      --version           print the version\n"

/* ---- the way in and out ---- */

/* Starts the clock and makes getopt's messages begin with the program's name. `argv` is main's. */
void cli_begin(struct cli *cli, const char *program, char **argv);

/* Handles a common option with its value in optarg: 0 done, 1 not a common option, 2 done and the
 * program is to end (--help, --version), < 0 failure. */
int cli_common_option(struct cli *cli, int option, const char *help);

/* Goes through all options; `take` gets each with its value in optarg and returns as
 * cli_common_option(), to which it hands what it does not know, does. 0 at the end, else what
 * `take` returned first. optind is that of the first file then. */
int cli_parse_options(struct cli *cli, int argc, char **argv, const struct option *options,
                      int (*take)(struct cli *cli, void *arguments, int option), void *arguments);

/* Creates the context and lets SIGINT, SIGTERM and SIGHUP interrupt it. */
int cli_create_context(struct cli *cli);

/* Prints a usage error, returns BSQ_EUSAGE. */
int cli_usage(struct cli *cli, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Prints the failure if `status` is one, frees the context, checks that standard output could be
 * written; returns the exit code. */
int cli_end(struct cli *cli, int status);

/* ---- values; `option` names the option in messages ---- */

/* SIZE: a number with an optional unit; K, M, G, T and KiB ... are powers of 1024, kB ... of 1000.
 */
int cli_parse_size(struct cli *cli, const char *option, const char *text, uint64_t *out);
int cli_parse_count(struct cli *cli, const char *option, const char *text, uint64_t min,
                    uint64_t max, uint64_t *out);
/* A finite decimal number >= 0, or > 0 where `positive`. */
int cli_parse_length(struct cli *cli, const char *option, const char *text, bool positive,
                     double *out);
/* One of `words` (NULL-terminated); *out is its number. */
int cli_parse_word(struct cli *cli, const char *option, const char *text, const char *const *words,
                   unsigned *out);

/* ---- files ---- */

/* Case does not matter. */
bool cli_ends_with(const char *text, const char *ending);

/* Do both names mean one file, existing or not? */
bool cli_same_file(const char *a, const char *b);

/* Finds out now whether an output can be created, and refuses one that is an input. */
int cli_check_output(struct cli *cli, const char *path, const char *const *inputs,
                     uint32_t input_count);

/* The same for a picture, which also has to be called .png. */
int cli_check_picture(struct cli *cli, const char *path, const char *const *inputs,
                      uint32_t input_count);

/* Checks whole files, .tris or .nvdb, each alone, and prints a line on each: what a sound one is on
 * standard output, what is wrong with another on standard error. All are checked; returns the
 * status of the first that is not sound. */
int cli_verify(struct cli *cli, char *const *paths, int count);

/* ---- reports ---- */

/* Callbacks of the context; `user` is the struct cli. */
void cli_on_progress(void *user, const struct bsq_progress *progress);
void cli_on_warning(void *user, const char *line);
/* Takes a progress bar off the terminal, so that a line can be printed. */
void cli_clear_bar(struct cli *cli);

double cli_seconds(const struct timespec *since);
uint64_t cli_max_rss_bytes(void);

/* Texts such as "12.3 MiB", "1,234,567" and "1 vertex" or "12 vertices"; `buffer` has CLI_TEXT
 * bytes and is returned. */
enum { CLI_TEXT = 64 };
const char *cli_size_text(uint64_t bytes, char *buffer);
const char *cli_count_text(uint64_t count, char *buffer);
const char *cli_things_text(uint64_t count, const char *singular, const char *plural, char *buffer);

/* Prints "12 unused vertices" after `separator` where count > 0; returns the next separator. */
const char *cli_print_count(const char *separator, uint64_t count, const char *singular,
                            const char *plural);
/* The last line of a report: memory and time. */
void cli_print_cost(const struct cli *cli);

/* A JSON string, with bytes that are not UTF-8 replaced. NULL gives null. */
json_t *cli_json_text(const char *text);
/* Adds program, version and cost to `root` (a reference is taken over; NULL: no memory) and prints
 * it. */
int cli_print_json(struct cli *cli, json_t *root);

#endif
