/* cli_report.c - numbers as text for people, and results as JSON for programs. */
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>

#include "base/job_files.h"
#include "formats/file_kind.h"
#include "tools/cli.h"

void cli_print(const char *format, ...)
{
    va_list arguments;
    const size_t length = strlen(format);
    const bool ends = length > 0 && format[length - 1] == '\n';
    char *text = NULL, *escaped = NULL;
    va_start(arguments, format);
    if (vasprintf(&text, format, arguments) >= 0) {
        if (ends)
            text[strlen(text) - 1] = '\0';
        escaped = bsq_escape(text, false);
    }
    va_end(arguments);
    fputs(escaped ? escaped : "out of memory", stdout);
    if (ends)
        putchar('\n');
    free(escaped);
    free(text);
}

double cli_seconds(const struct timespec *since)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)(now.tv_sec - since->tv_sec) + (double)(now.tv_nsec - since->tv_nsec) * 1e-9;
}

static uint64_t max_rss_bytes(void)
{
    struct rusage usage;
    return getrusage(RUSAGE_SELF, &usage) == 0 ? (uint64_t)usage.ru_maxrss * 1024 : 0;
}

struct cli_text cli_size(uint64_t bytes)
{
    struct cli_text out;
    static const char *const units[] = {"B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB"};
    double value = (double)bytes;
    unsigned i = 0;
    for (; value >= 1023.95 && i < 6; i++)
        value /= 1024;
    snprintf(out.text, CLI_TEXT, i == 0 ? "%.0f %s" : "%.1f %s", value, units[i]);
    return out;
}

struct cli_text cli_count(uint64_t count)
{
    struct cli_text out = {0};
    char digits[24], *to = out.text;
    int length = snprintf(digits, sizeof digits, "%llu", (unsigned long long)count);
    for (int i = 0; i < length; i++) {
        if (i > 0 && (length - i) % 3 == 0)
            *to++ = ',';
        *to++ = digits[i];
    }
    return out;
}

struct cli_text cli_counted(uint64_t count, const char *singular, const char *plural)
{
    struct cli_text out = cli_count(count);
    const size_t length = strlen(out.text);
    snprintf(out.text + length, CLI_TEXT - length, " %s", count == 1 ? singular : plural);
    return out;
}

const char *cli_print_count(const char *separator, uint64_t count, const char *singular,
                            const char *plural)
{
    if (count == 0)
        return separator;
    cli_print("%s%s", separator, cli_counted(count, singular, plural).text);
    return ", ";
}

void cli_print_cost(const struct cli *cli)
{
    cli_print("memory: %s of a budget of %s (resident at most %s)\n",
              cli_size(bsq_memory_high(cli->ctx)).text, cli_size(bsq_memory_limit(cli->ctx)).text,
              cli_size(max_rss_bytes()).text);
    cli_print("time: %.2f s\n", cli_seconds(&cli->started));
}

json_t *cli_json_text(const char *text)
{
    if (!text)
        return json_null();
    json_t *string = json_string(text);
    if (string)
        return string;
    char *copy = bsq_escape(text, true);
    string = copy ? json_string(copy) : NULL;
    free(copy);
    return string;
}

/* Frees the JSON value if adding to it failed. */
static void keep_if(bool good, json_t **json)
{
    if (good)
        return;
    json_decref(*json);
    *json = NULL;
}

void cli_json_append(json_t **json, json_t *value)
{
    keep_if(json_array_append_new(*json, value) == 0, json);
}

void cli_json_set(json_t **json, const char *name, json_t *value)
{
    keep_if(json_object_set_new(*json, name, value) == 0, json);
}

static double seconds_of(struct timeval time)
{
    return (double)time.tv_sec + (double)time.tv_usec * 1e-6;
}

static json_t *cost_json(const struct cli *cli)
{
    struct rusage usage = {0};
    getrusage(RUSAGE_SELF, &usage);
    return json_pack("{s:i, s:I, s:I, s:I, s:f, s:f, s:f}", "threads", (int)bsq_threads(cli->ctx),
                     "memory_budget_bytes", (json_int_t)bsq_memory_limit(cli->ctx),
                     "memory_high_bytes", (json_int_t)bsq_memory_high(cli->ctx), "max_rss_bytes",
                     (json_int_t)max_rss_bytes(), "seconds", cli_seconds(&cli->started),
                     "seconds_user", seconds_of(usage.ru_utime), "seconds_system",
                     seconds_of(usage.ru_stime));
}

/* Returns an array of the files that the job has read, by other programs too, and of those that
 * were missing. Files that it wrote itself are not listed. */
static json_t *inputs_json(const struct cli *cli)
{
    json_t *list = json_array();
    struct bsq_noted_input input;
    char identity[BSQ_IDENTITY_BYTES];
    int status = 0;
    for (uint64_t next = 0; (status = bsq_next_input(cli->ctx, &next, &input)) > 0;) {
        bsq_identity_text(&input.found, identity);
        if (!input.own)
            cli_json_append(&list, json_pack("{s:o, s:s}", "path", cli_json_text(input.path),
                                             "identity", input.opened ? identity : ""));
        bsq_noted_input_free(&input);
    }
    keep_if(status == 0, &list);
    return list;
}

json_t *cli_complete_json(const struct cli *cli, json_t *root)
{
    json_t *head = json_pack("{s:s, s:s}", "program", cli->program, "version", BSQ_VERSION);
    keep_if(root && json_object_update(head, root) == 0, &head);
    cli_json_set(&head, "files_read", inputs_json(cli));
    cli_json_set(&head, "cost", cost_json(cli));
    json_decref(root);
    return head;
}

int cli_print_json(struct cli *cli, json_t *root)
{
    json_t *head = cli_complete_json(cli, root);
    int status = 0;
    if (!head)
        status = bsq_fail(cli->ctx, BSQ_ENOMEM, "out of memory for the JSON report");
    else if (json_dumpf(head, stdout,
                        JSON_INDENT(2) | JSON_ENSURE_ASCII | JSON_REAL_PRECISION(15)) != 0 ||
             fputc('\n', stdout) == EOF)
        status = bsq_fail(cli->ctx, BSQ_EIO, "standard output: the JSON report cannot be written");
    json_decref(head);
    return status;
}

int cli_say_kept(struct cli *cli, const char *path, const char *what)
{
    if (!cli->json) {
        cli_print("%s: %s is complete already, kept\n", path, what);
        return 0;
    }
    return cli_print_json(cli, json_pack("{s:o, s:b}", "path", cli_json_text(path), "kept", 1));
}

/* ---- distances between a mesh and its scan ---- */

void cli_print_distances(const char *what, const struct vox_distances *d)
{
    cli_print("  %s: mean %.4g, rms %.4g, p99 %.4g, max %.4g at %.6g,%.6g,%.6g\n", what, d->mean,
              d->rms, d->p99, d->max, d->where[0], d->where[1], d->where[2]);
}

json_t *cli_distances_json(const struct vox_distances *d)
{
    return json_pack("{s:f, s:f, s:f, s:f, s:[f, f, f]}", "mean", d->mean, "rms", d->rms, "p99",
                     d->p99, "max", d->max, "where", d->where[0], d->where[1], d->where[2]);
}

/* ---- the option --verify ---- */

static void print_content(const char *path, const struct fmt_verify_report *r)
{
    const struct cli_text triangles = cli_counted(r->triangles, "triangle", "triangles");
    const struct cli_text size = cli_size(r->file_bytes);
    if (r->kind == FMT_KIND_TRIS)
        cli_print("%s: ok (chunk file of version %u: %s and %s in %s, %s)\n", path, r->version,
                  triangles.text, cli_counted(r->vertices, "vertex", "vertices").text,
                  cli_counted(r->chunks, "chunk", "chunks").text, size.text);
    else
        cli_print("%s: ok (surface grid of version %u: %s and %s of %s%s, %s)\n", path, r->version,
                  cli_counted(r->voxels, "voxel", "voxels").text,
                  cli_counted(r->second_records, "second record", "second records").text,
                  triangles.text, r->has_color ? ", with colour" : "", size.text);
}

static json_t *content_json(const char *path, const struct fmt_verify_report *r)
{
    if (r->kind == FMT_KIND_TRIS)
        return json_pack("{s:o, s:b, s:s, s:i, s:I, s:I, s:I, s:I}", "path", cli_json_text(path),
                         "ok", 1, "kind", "tris", "version", (int)r->version,
                         CLI_COUNT(r, file_bytes), CLI_COUNT(r, triangles), CLI_COUNT(r, vertices),
                         CLI_COUNT(r, chunks));
    return json_pack("{s:o, s:b, s:s, s:i, s:I, s:I, s:I, s:I, s:f, s:b}", "path",
                     cli_json_text(path), "ok", 1, "kind", "nvdb", "version", (int)r->version,
                     CLI_COUNT(r, file_bytes), CLI_COUNT(r, triangles), CLI_COUNT(r, voxels),
                     CLI_COUNT(r, second_records), CLI_VALUE(r, voxel_size), "has_color",
                     (int)r->has_color);
}

/* Checks one file. *entry is its JSON object; NULL without --json or without memory. */
static int verify_file(struct cli *cli, const char *path, json_t **entry)
{
    struct fmt_verify_report report = {.size = sizeof report};
    int status = fmt_verify(cli->ctx, path, &report);
    *entry = NULL;
    cli_clear_bar(cli);
    if (status < 0)
        fprintf(stderr, "%s: %s\n", cli->program, bsq_error(cli->ctx));
    else if (!cli->json)
        print_content(path, &report);
    if (cli->json && status == 0)
        *entry = content_json(path, &report);
    else if (cli->json)
        *entry = json_pack("{s:o, s:b, s:i, s:o}", "path", cli_json_text(path), "ok", 0, "status",
                           -status, "error", cli_json_text(bsq_error(cli->ctx)));
    return status;
}

int cli_verify(struct cli *cli, char *const *paths, int count)
{
    json_t *list = cli->json ? json_array() : NULL;
    int result = 0;
    for (int i = 0; i < count; i++) {
        json_t *entry;
        int status = verify_file(cli, paths[i], &entry);
        if (cli->json)
            cli_json_append(&list, entry);
        result = result < 0 ? result : status;
        if (status == BSQ_EINTR)
            break;
        if (status < 0)
            bsq_clear_error(cli->ctx);
    }
    cli->reported = result < 0;
    if (cli->json) {
        int status = cli_print_json(cli, json_pack("{s:o}", "files", list));
        if (status < 0)
            cli->reported = false;
        result = result < 0 ? result : status;
    }
    return result;
}
