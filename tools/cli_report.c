/* cli_report.c - numbers as text for people, and results as JSON for programs. */
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>

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

const char *cli_size_text(uint64_t bytes, char *buffer)
{
    static const char *const units[] = {"B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB"};
    double value = (double)bytes;
    unsigned i = 0;
    for (; value >= 1023.95 && i < 6; i++)
        value /= 1024;
    snprintf(buffer, CLI_TEXT, i == 0 ? "%.0f %s" : "%.1f %s", value, units[i]);
    return buffer;
}

const char *cli_count_text(uint64_t count, char *buffer)
{
    char digits[24];
    int length = snprintf(digits, sizeof digits, "%llu", (unsigned long long)count);
    char *to = buffer;
    for (int i = 0; i < length; i++) {
        if (i > 0 && (length - i) % 3 == 0)
            *to++ = ',';
        *to++ = digits[i];
    }
    *to = '\0';
    return buffer;
}

const char *cli_counted_text(uint64_t count, const char *singular, const char *plural, char *buffer)
{
    char digits[CLI_TEXT];
    snprintf(buffer, CLI_TEXT, "%s %s", cli_count_text(count, digits),
             count == 1 ? singular : plural);
    return buffer;
}

const char *cli_print_count(const char *separator, uint64_t count, const char *singular,
                            const char *plural)
{
    char text[CLI_TEXT];
    if (count == 0)
        return separator;
    cli_print("%s%s %s", separator, cli_count_text(count, text), count == 1 ? singular : plural);
    return ", ";
}

void cli_print_cost(const struct cli *cli)
{
    char high[CLI_TEXT], limit[CLI_TEXT], resident[CLI_TEXT];
    cli_print("memory: %s of a budget of %s (resident at most %s)\n",
              cli_size_text(bsq_memory_high(cli->ctx), high),
              cli_size_text(bsq_memory_limit(cli->ctx), limit),
              cli_size_text(max_rss_bytes(), resident));
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

/* Returns the bytes that this process read by system calls, 0 if the system does not tell. */
static uint64_t bytes_by_calls(void)
{
    unsigned long long bytes = 0;
    FILE *file = fopen("/proc/self/io", "re");
    if (!file)
        return 0;
    if (fscanf(file, "rchar: %llu", &bytes) != 1)
        bytes = 0;
    fclose(file);
    return bytes;
}

static void add_share(void *json, const char *name, uint64_t bytes)
{
    cli_json_set(json, name, json_integer((json_int_t)bytes));
}

/* Returns an object with the memory that was set aside for each purpose. */
static json_t *shares_json(const struct cli *cli)
{
    json_t *shares = json_object();
    bsq_memory_shares(cli->ctx, add_share, &shares);
    return shares;
}

static json_t *cost_json(const struct cli *cli)
{
    struct rusage usage = {0};
    getrusage(RUSAGE_SELF, &usage);
    return json_pack("{s:i, s:I, s:I, s:o, s:I, s:I, s:f, s:f, s:f}", "threads",
                     (int)bsq_threads(cli->ctx), "memory_budget_bytes",
                     (json_int_t)bsq_memory_limit(cli->ctx), "memory_high_bytes",
                     (json_int_t)bsq_memory_high(cli->ctx), "memory_shares_bytes", shares_json(cli),
                     "max_rss_bytes", (json_int_t)max_rss_bytes(), "bytes_read",
                     (json_int_t)(bytes_by_calls() + bsq_mapped_bytes(cli->ctx)), "seconds",
                     cli_seconds(&cli->started), "seconds_user", seconds_of(usage.ru_utime),
                     "seconds_system", seconds_of(usage.ru_stime));
}

json_t *cli_complete_json(const struct cli *cli, json_t *root)
{
    json_t *head = json_pack("{s:s, s:s}", "program", cli->program, "version", BSQ_VERSION);
    keep_if(root && json_object_update(head, root) == 0, &head);
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
