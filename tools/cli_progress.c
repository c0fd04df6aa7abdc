/* cli_progress.c - prints progress, as a bar, as lines of a log or of JSON, and warnings to
 * standard error.
 *
 * The bar is one line that is redrawn in place. Code that prints another line removes it first, and
 * the next progress report draws it again. */
#include <math.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "tools/cli.h"

enum { BAR_CELLS = 24, DEFAULT_COLUMNS = 80, LOG_SECONDS = 30 };

void cli_clear_bar(struct cli *cli)
{
    if (!cli->bar_drawn)
        return;
    fputs("\r\033[K", stderr);
    cli->bar_drawn = false;
}

static int terminal_columns(void)
{
    struct winsize size;
    if (ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 1)
        return size.ws_col;
    return DEFAULT_COLUMNS;
}

/* Returns "12.3 MiB" for bytes, "12.3 M" for other units. */
static struct cli_text format_amount(const char *unit, uint64_t amount)
{
    static const char *const prefixes[] = {"", " k", " M", " G", " T"};
    struct cli_text out;
    double value = (double)amount;
    if (strcmp(unit, "bytes") == 0)
        return cli_size(amount);
    unsigned i = 0;
    for (; value >= 999.5 && i < 4; i++)
        value /= 1000;
    snprintf(out.text, CLI_TEXT, i == 0 ? "%.0f%s" : "%.1f%s", value, prefixes[i]);
    return out;
}

/* Returns what follows an amount: " triangles", nothing for bytes. */
static struct cli_text format_unit(const char *unit)
{
    struct cli_text out = {""};
    if (strcmp(unit, "bytes") != 0)
        snprintf(out.text, CLI_TEXT, " %s", unit);
    return out;
}

/* Returns "  1:23 left", or nothing if that is not known. */
static struct cli_text format_remaining(const struct cli *cli, const struct bsq_progress *progress)
{
    struct cli_text out = {""};
    double elapsed = cli_seconds(&cli->stage_started);
    if (elapsed < 2 || progress->done == 0 || progress->done > progress->total)
        return out;
    double left = elapsed * (double)(progress->total - progress->done) / (double)progress->done;
    unsigned long seconds = left < 1e8 ? (unsigned long)left : 99999999;
    if (seconds >= 3600)
        snprintf(out.text, CLI_TEXT, "  %lu:%02lu:%02lu left", seconds / 3600, seconds / 60 % 60,
                 seconds % 60);
    else
        snprintf(out.text, CLI_TEXT, "  %lu:%02lu left", seconds / 60, seconds % 60);
    return out;
}

static void draw_bar(struct cli *cli, const struct bsq_progress *progress)
{
    char line[512], cells[BAR_CELLS + 1];
    const struct cli_text done = format_amount(progress->unit, progress->done);
    const struct cli_text unit = format_unit(progress->unit);
    if (progress->total > 0) {
        double fraction = (double)progress->done / (double)progress->total;
        fraction = fraction > 1 ? 1 : fraction;
        size_t filled = (size_t)(fraction * BAR_CELLS);
        memset(cells, '=', filled);
        memset(cells + filled, ' ', BAR_CELLS - filled);
        cells[BAR_CELLS] = '\0';
        snprintf(line, sizeof line, "%-11s [%s] %3.0f %%  %s of %s%s%s", progress->stage, cells,
                 fraction * 100, done.text, format_amount(progress->unit, progress->total).text,
                 unit.text, format_remaining(cli, progress).text);
    } else {
        snprintf(line, sizeof line, "%-11s %s%s", progress->stage, done.text, unit.text);
    }
    fprintf(stderr, "\r%.*s\033[K", terminal_columns() - 1, line);
    cli->bar_drawn = true;
}

/* Prints a line if none was printed for LOG_SECONDS. */
static void log_line(struct cli *cli, const struct bsq_progress *progress)
{
    if (cli_seconds(&cli->logged) < LOG_SECONDS)
        return;
    clock_gettime(CLOCK_MONOTONIC, &cli->logged);
    if (progress->total > 0)
        fprintf(stderr, "%s: %s: %.0f %%%s\n", cli->program, progress->stage,
                100 * fmin((double)progress->done / (double)progress->total, 1),
                format_remaining(cli, progress).text);
    else
        fprintf(stderr, "%s: %s: %s%s\n", cli->program, progress->stage,
                format_amount(progress->unit, progress->done).text,
                format_unit(progress->unit).text);
}

static void print_json_line(const struct bsq_progress *progress)
{
    /* Names of stages and units are plain words and need no escapes. */
    fprintf(stderr,
            "{\"stage\": \"%s\", \"unit\": \"%s\", \"done\": %llu, \"total\": %llu, "
            "\"finished\": %s}\n",
            progress->stage, progress->unit, (unsigned long long)progress->done,
            (unsigned long long)progress->total, progress->finished ? "true" : "false");
}

void cli_on_progress(void *user, const struct bsq_progress *progress)
{
    struct cli *cli = user;
    if (cli->progress == CLI_PROGRESS_JSON) {
        print_json_line(progress);
        return;
    }
    if (cli_prints_percent(cli)) {
        cli_percent_report(cli, progress);
        return;
    }
    if (cli->bar_stage != progress->stage) {
        cli->bar_stage = progress->stage;
        clock_gettime(CLOCK_MONOTONIC, &cli->stage_started);
        if (cli->on_stage)
            cli->on_stage(cli, progress->stage);
    }
    if (cli->progress == CLI_PROGRESS_LOG)
        log_line(cli, progress);
    if (progress->finished) {
        cli_clear_bar(cli);
        cli->bar_stage = NULL;
    } else if (cli->progress == CLI_PROGRESS_BAR) {
        draw_bar(cli, progress);
    }
}

void cli_on_warning(void *user, const char *line)
{
    struct cli *cli = user;
    cli_clear_bar(cli);
    cli_json_append(&cli->warnings, cli_json_text(line));
    if (cli->progress == CLI_PROGRESS_JSON) {
        json_t *object = json_pack("{s:o}", "warning", cli_json_text(line));
        if (object && json_dumpf(object, stderr, JSON_ENSURE_ASCII) == 0)
            fputc('\n', stderr);
        json_decref(object);
        return;
    }
    fprintf(stderr, "%s: warning: %s\n", cli->program, line);
}
