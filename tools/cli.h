/* cli.h - what Bisque's programs share: common options, parsing of values, checks of files,
 * progress and reports.
 *
 * A program calls cli_begin(), cli_parse() and cli_create_context(), does its work through
 * the libraries and returns cli_end() from main. Every failure becomes one line "PROGRAM: MESSAGE"
 * on standard error; the exit code is the negated status. */
#ifndef CLI_H
#define CLI_H

#include <getopt.h>
#include <jansson.h>
#include <stdio.h>
#include <time.h>

#include "base/options.h"
#include "libvoxel/voxel.h"

enum cli_progress {
    CLI_PROGRESS_AUTO,
    CLI_PROGRESS_BAR,
    CLI_PROGRESS_NONE,
    CLI_PROGRESS_JSON,
    CLI_PROGRESS_OPENJD,
    CLI_PROGRESS_PERCENT,
    CLI_PROGRESS_ALF,
    CLI_PROGRESS_LOG /* a line now and then: what `auto` is without a terminal */
};

/* How often a stage of progress comes. */
enum cli_stage_count { CLI_ONCE, CLI_EACH_TILE, CLI_EACH_TRACED_TILE, CLI_STAGE_COUNTS };

struct cli {
    const char *program;
    struct bsq_ctx *ctx; /* NULL before cli_create_context() */

    uint64_t memory_bytes; /* 0: not given */
    unsigned threads;      /* 0: not given */
    const char *tmpdir;
    enum cli_progress progress;
    bool json;   /* print results as JSON */
    bool verify; /* only check files */
    bool strict; /* warnings of lost data are errors */
    bool help, list_options, version;

    bool reported;  /* the failure has been printed */
    bool bar_drawn; /* the terminal's last line is a progress bar */
    const char *bar_stage;
    const uint32_t *stage_counts[CLI_STAGE_COUNTS]; /* how often stages come; NULL: once */
    /* Prints what is known when a stage begins; NULL: nothing. */
    void (*on_stage)(struct cli *cli, const char *stage);
    const void *watched; /* for on_stage() */
    json_t *command;     /* the arguments as given, a list */
    json_t *warnings;    /* that were printed, a list */
    struct timespec started, stage_started, logged;
};

#define CLI_HEADING "All programs"

/* Rows of options that not every program has; they set members of struct cli. */
#define CLI_TMPDIR_ROW                                                                             \
    {                                                                                              \
        BSQ_ROW("tmpdir", "DIR",                                                                   \
                "directory for temporary files (default: $TMPDIR, else the output's)"),            \
            .heading = CLI_HEADING, BSQ_MEMBER(TEXT, struct cli, tmpdir)                           \
    }
#define CLI_STRICT_ROW                                                                             \
    {                                                                                              \
        BSQ_ROW("strict", NULL,                                                                    \
                "end with an error if data of an input is lost, not with a warning"),              \
            .heading = CLI_HEADING, BSQ_MEMBER(FLAG, struct cli, strict)                           \
    }
#define CLI_VERIFY_ROW                                                                             \
    {                                                                                              \
        BSQ_ROW("verify", NULL,                                                                    \
                "check FILES (.tris, .nvdb), print a line on each, do nothing else"),              \
            .heading = CLI_HEADING, BSQ_MEMBER(FLAG, struct cli, verify)                           \
    }

/* ---- start and end of a program ---- */

/* Reserves closed standard descriptors, starts the clock, ignores SIGPIPE and SIGXFSZ, and makes
 * getopt's messages begin with the program's name. `argv` is main's. */
void cli_begin(struct cli *cli, const char *program, char **argv);

/* A table of options, and what they set. */
struct cli_table {
    const struct bsq_option *rows;
    size_t count;
    void *options; /* the structure with the members; the program's struct cli for common ones */
    bool *given;   /* for each row: whether it was given; NULL: not asked for */
};

enum { CLI_MOST_TABLES = 4 };

/* The command line of a program. */
struct cli_command {
    const char *usage;                        /* the first lines of --help */
    void (*print_more)(void);                 /* prints the last lines, or NULL */
    struct cli_table tables[CLI_MOST_TABLES]; /* fewer tables end with one without rows */
    /* Takes the value of a row with its own syntax. Returns 0, or what cli_usage() returns. */
    int (*take)(struct cli *cli, void *arguments, const struct bsq_option *row, const char *text);
    void *arguments;
};

/* Reads the command line by the tables and the common options. --verify excludes options that are
 * not members of struct cli. Returns 0; 2 if the program is to end (--help, --version); a negative
 * status on failure. After success optind is the index of the first file in argv. */
int cli_parse(struct cli *cli, const struct cli_command *command, int argc, char **argv);

/* Returns whether an option was given. */
bool cli_is_given(const struct cli_table *table, const char *name);

/* Creates the context and lets SIGINT, SIGTERM and SIGHUP interrupt it. */
int cli_create_context(struct cli *cli);

/* Prints a usage error; returns BSQ_EUSAGE. */
int cli_usage(struct cli *cli, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Prints the failure if `status` is negative, frees the context, and checks that standard output
 * was written. Returns the exit code. */
int cli_end(struct cli *cli, int status);

/* ---- memory that lives until the program ends; without memory they end it ---- */

/* Returns `bytes` of zeros. */
void *cli_keep(size_t bytes);
/* Returns a text as printf() prints it. */
char *cli_keep_text(const char *format, ...) __attribute__((format(printf, 1, 2)));
/* Returns a copy of a list with space for one more element, of zeros. */
void *cli_extend(const void *list, size_t count, size_t element_bytes);

/* ---- values of options; messages name `option` ---- */

/* Sets the member of a row to the value of a text. */
int cli_parse_value(struct cli *cli, const char *option, const struct bsq_option *row,
                    const char *text, void *options);
/* Parses one of `words`, as rows have them; sets *out to its index. */
int cli_parse_word(struct cli *cli, const char *option, const char *text, const char *words,
                   unsigned *out);

/* ---- files ---- */

/* Returns whether `text` ends with `ending`, ignoring case. */
bool cli_ends_with(const char *text, const char *ending);

/* Checks that outputs can be created and are different files. Some may be NULL. */
int cli_check_outputs(struct cli *cli, const char *const *paths, unsigned count);

/* The inputs of a program that takes scans. */
struct cli_scans {
    const char **meshes, **chunks; /* mesh files, and chunk files */
    uint32_t mesh_count, chunk_count;
};
/* Notes the files of a scan as inputs, and finds out what they are. A grid is BSQ_EDATA; the
 * message ends with `advice`. */
int cli_recognise_scans(struct cli *cli, const char *const *paths, uint32_t count,
                        const char *advice, struct cli_scans *out);

/* Makes one chunk file of several, whose meshes, if any, were sorted to *temp: a temporary file,
 * which *temp then has. A file alone stays as it is. Of *how, reads output_path, scan_normals and
 * ids. The caller closes *temp, also on failure. Errors: those of vox_join(). */
int cli_join(struct cli *cli, const char *const *paths, uint32_t count,
             const struct vox_join_options *how, struct vox_temp_tris **temp);

/* Checks whole files (.tris, .nvdb) and prints a line on each: its content on standard output, or
 * what is wrong on standard error. Checks all of them; returns the status of the first that failed.
 */
int cli_verify(struct cli *cli, char *const *paths, int count);

/* ---- progress as lines for schedulers: openjd, percent and alf ---- */

/* Returns whether --progress asks for these lines. */
bool cli_prints_percent(const struct cli *cli);

/* Prints the first line, and starts the heartbeat. */
void cli_percent_begin(const struct cli *cli);

/* Takes a report of the context. */
void cli_percent_report(struct cli *cli, const struct bsq_progress *progress);

/* Stops the heartbeat; prints 100 % after a success. Does nothing if nothing was begun. */
void cli_percent_end(const struct cli *cli, bool success);

/* Prints a failure for Open Job Description. */
void cli_percent_fail(const struct cli *cli, const char *text);

/* ---- reports ---- */

/* Callbacks of the context; `user` is the struct cli. */
void cli_on_progress(void *user, const struct bsq_progress *progress);
void cli_on_warning(void *user, const char *line);
/* Removes the progress bar from the terminal, so that a line can be printed. */
void cli_clear_bar(struct cli *cli);

/* Prints to standard output as printf() does, escaped as bsq_escape() does. Only a newline at the
 * end of the format is one. Tools print all reports with this, because names in them come from
 * files and command lines. */
void cli_print(const char *format, ...) __attribute__((format(printf, 1, 2)));

double cli_seconds(const struct timespec *since);

/* Return "12.3 MiB", "1,234,567", and "1 vertex" or "12 vertices". */
enum { CLI_TEXT = 64 };
struct cli_text {
    char text[CLI_TEXT];
};
struct cli_text cli_size(uint64_t bytes);
struct cli_text cli_count(uint64_t count);
struct cli_text cli_counted(uint64_t count, const char *singular, const char *plural);

/* Prints `separator` and, for example, "12 skipped lines" if count > 0. Returns the separator for
 * the next count. */
const char *cli_print_count(const char *separator, uint64_t count, const char *singular,
                            const char *plural);
/* Prints the last lines of a report: memory and time. */
void cli_print_cost(const struct cli *cli);

/* A member of a structure for json_pack(), with its name: a count for "s:I", other values. */
#define CLI_COUNT(of, member) #member, (json_int_t)(of)->member
#define CLI_VALUE(of, member) #member, (of)->member

/* Returns a JSON string of the text; if it is not UTF-8, of the escaped text. NULL gives null. */
json_t *cli_json_text(const char *text);
/* Adds a value, which it takes over, to an array or an object. Without memory, frees *json and sets
 * it to NULL; NULL stays. */
void cli_json_append(json_t **json, json_t *value);
void cli_json_set(json_t **json, const char *name, json_t *value);
/* Returns `root` with program, version, cost and the files that were read ("files_read") added;
 * NULL without memory. Takes over `root`. */
json_t *cli_complete_json(const struct cli *cli, json_t *root);
/* Prints what cli_complete_json() returns. Takes over the caller's reference; NULL means that there
 * was no memory for it. */
int cli_print_json(struct cli *cli, json_t *root);
/* Prints a line on distances between surfaces; returns them as an object. */
void cli_print_distances(const char *what, const struct vox_distances *distances);
json_t *cli_distances_json(const struct vox_distances *distances);
/* Prints that a file is there already. */
int cli_say_kept(struct cli *cli, const char *path, const char *what);

#endif
