/* cli_options.c - reads command lines by tables of options, and prints --help from them. */
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "tools/cli.h"

enum { MOST_OPTIONS = 128, HELP_COLUMN = 28 };

/* ---- values; messages name `option` ---- */

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

/* Parses a size: a number with an optional unit. K, M, G, T and KiB ... are powers of 1024, kB ...
 * are powers of 1000. */
static int parse_bytes(struct cli *cli, const char *option, const char *text, uint64_t *out)
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

static int cli_parse_count(struct cli *cli, const char *option, const struct bsq_option *row,
                           const char *text, uint32_t *out)
{
    char *end;
    errno = 0;
    const unsigned long long value = strtoull(text, &end, 10);
    const bool digits = text[0] >= '0' && text[0] <= '9' && *end == '\0';
    if (!digits || errno == ERANGE || (double)value < row->least || (double)value > row->most)
        return cli_usage(cli, "%s: \"%s\" is not a whole number from %.0f to %.0f", option, text,
                         row->least, row->most);
    *out = (uint32_t)value;
    return 0;
}

static int cli_parse_number(struct cli *cli, const char *option, const struct bsq_option *row,
                            const char *text, double *out)
{
    char *end;
    const double value = strtod(text, &end);
    const bool below = row->least < 0; /* negative numbers are allowed */
    const bool number = is_decimal(text + (below && *text == '-')) &&
                        strspn(text, "0123456789.eE+-") == strlen(text) && *end == '\0';
    if (!number || !isfinite(value) || (row->positive && !(value > 0)))
        return cli_usage(cli, "%s: \"%s\" is not a %snumber", option, text,
                         row->positive ? "positive "
                         : below       ? ""
                                       : "non-negative ");
    if (value < row->least)
        return cli_usage(cli, "%s: %s is below %g", option, text, row->least);
    if (value > row->most)
        return cli_usage(cli, "%s: %s is above %g", option, text, row->most);
    *out = value;
    return 0;
}

/* Says that the text is not one of the words: "not up, down or auto". */
static int refuse_word(struct cli *cli, const char *option, const char *text, const char *words)
{
    char list[512], *to = list;
    for (const char *at = words; *at && to < list + sizeof list - 8; at++) {
        if (*at == ' ' || *at == '/')
            to += sprintf(to, strpbrk(at + 1, " /") ? ", " : " or ");
        else
            *to++ = *at;
    }
    *to = '\0';
    return cli_usage(cli, "%s: \"%s\" is not %s", option, text, list);
}

int cli_parse_word(struct cli *cli, const char *option, const char *text, const char *words,
                   unsigned *out)
{
    const int index = bsq_option_word(words, text);
    *out = index < 0 ? 0 : (unsigned)index;
    return index < 0 ? refuse_word(cli, option, text, words) : 0;
}

int cli_parse_value(struct cli *cli, const char *option, const struct bsq_option *row,
                    const char *text, void *options)
{
    void *at = bsq_option_at(row, options);
    const bool is_word = text && bsq_option_word(row->words, text) >= 0;
    unsigned word = 0;
    int status = 0;
    switch (row->kind) {
    case BSQ_OPTION_FLAG:
        status = row->words ? cli_parse_word(cli, option, text, row->words, &word) : 0;
        *(bool *)at = !row->words || word == 1;
        return status;
    case BSQ_OPTION_CHOICE:
        return cli_parse_word(cli, option, text, row->words, at);
    case BSQ_OPTION_COUNT:
        *(uint32_t *)at = UINT32_MAX;
        return is_word ? 0 : cli_parse_count(cli, option, row, text, at);
    case BSQ_OPTION_NUMBER:
        *(double *)at = -1;
        return is_word ? 0 : cli_parse_number(cli, option, row, text, at);
    case BSQ_OPTION_BYTES:
        return parse_bytes(cli, option, text, at);
    default:
        *(const char **)at = text;
        return 0;
    }
}

/* Returns whether two rows are keys of one option. */
static bool is_same_option(const struct bsq_option *a, const struct bsq_option *b)
{
    return a->name && b->name && a->key && b->key && strcmp(a->name, b->name) == 0;
}

/* ---- --help ---- */

/* Writes the default of a row to `buffer`; "" if the help names none. */
static const char *default_of(const struct bsq_option *row, char buffer[CLI_TEXT])
{
    struct bsq_option alone = *row;
    char text[BSQ_OPTION_TEXT_BYTES];
    double value;
    buffer[0] = '\0';
    if (!row->argument || row->own_syntax || strstr(row->help, "(default") ||
        row->kind == BSQ_OPTION_BYTES || row->kind > BSQ_OPTION_CHOICE)
        return buffer;
    alone.offset = 0;
    bsq_options_defaults(&alone, 1, &value);
    snprintf(buffer, CLI_TEXT, " (default: %s)", bsq_option_text(&alone, &value, text));
    return buffer;
}

/* Prints a row. follows: it has the same name as the row before it. */
static void print_row(const struct bsq_option *row, bool follows)
{
    char text[CLI_TEXT];
    const char *line = row->help;
    int width = row->letter ? printf("  -%c, ", row->letter) : printf("      ");
    width += follows ? printf("%*s", (int)strlen(row->name) + 3, "") : printf("--%s", row->name);
    if (row->key)
        width += printf("%s%s=%s", follows ? "" : " ", row->key, row->argument);
    else if (row->argument)
        width += printf(" %s", row->argument);
    if (width > HELP_COLUMN - 2)
        width = printf("\n") - 1;
    for (; line; line = strchr(line, '\n') ? strchr(line, '\n') + 1 : NULL) {
        const int length = (int)strcspn(line, "\n");
        printf("%*s%.*s%s\n", HELP_COLUMN - width, "", length, line,
               line[length] ? "" : default_of(row, text));
        width = 0;
    }
}

static void print_help(const struct cli_command *command, const struct cli_table *tables,
                       size_t count)
{
    const char *heading = "";
    fputs(command->usage, stdout);
    for (const struct cli_table *table = tables; table < tables + count; table++)
        for (const struct bsq_option *row = table->rows; row < table->rows + table->count; row++) {
            if (row->heading && strcmp(row->heading, heading) != 0)
                printf("\n%s:\n", heading = row->heading);
            if (row->name && row->help)
                print_row(row, row > table->rows && is_same_option(row, row - 1));
        }
    if (command->print_more)
        command->print_more();
}

/* Prints a line for each option of the help, with tabs between the columns: name, key, kind, least
 * and most value, words, argument. An option with a syntax of its own has the kind "own". */
static void print_options(const struct cli_table *tables, size_t count)
{
    static const char *const kinds[] = {"flag", "count", "bytes",  "number", "choice",
                                        "text", "input", "output", "list",   "none"};
    for (const struct cli_table *table = tables; table < tables + count; table++)
        for (const struct bsq_option *row = table->rows; row < table->rows + table->count; row++)
            if (row->name && row->help)
                printf("%s\t%s\t%s\t%.17g\t%.17g\t%s\t%s\n", row->name, row->key ? row->key : "",
                       row->own_syntax ? "own" : kinds[row->kind], row->least, row->most,
                       row->words ? row->words : "", row->argument ? row->argument : "");
}

/* ---- the command line ---- */

#define MEMBER(kind, member) BSQ_MEMBER(kind, struct cli, member)

static const struct bsq_option common_rows[] = {
    {BSQ_ROW("memory", "SIZE", "memory budget, e.g. 4G, 512MiB (default: half of the machine's)"),
     .heading = "All programs", MEMBER(BYTES, memory_bytes)},
    {BSQ_ROW("threads", "N", "worker threads (default: one per processor)"), MEMBER(COUNT, threads),
     BSQ_RANGE(1, 65536, 0)},
    {BSQ_ROW("progress", "WHEN",
             "auto, bar, none or json (default: auto, a bar on a terminal,\n"
             "else a line every 30 s);\n"
             "openjd, percent or alf: lines for schedulers"),
     MEMBER(CHOICE, progress), .words = "auto bar none json openjd percent alf"},
    {BSQ_ROW("json", NULL, "print the results as JSON"), MEMBER(FLAG, json)},
    {BSQ_ROW("help", NULL, "print this help"), MEMBER(FLAG, help)},
    {BSQ_ROW("version", NULL, "print the version"), MEMBER(FLAG, version)},
    {.name = "list-options", MEMBER(FLAG, list_options)}, /* for tests */
};

/* What getopt_long() knows, and the row of each option. */
struct parser {
    struct cli *cli;
    const struct cli_command *command;
    struct cli_table tables[CLI_MOST_TABLES + 1]; /* the command's, then the common one */
    size_t table_count;
    struct option options[MOST_OPTIONS + 1];
    struct {
        const struct cli_table *table;
        const struct bsq_option *row;
    } entries[MOST_OPTIONS];
    size_t count;
    char letters[8];
    const char *own_name; /* the last of the program's own options; NULL: none was given */
};

static void add_entry(struct parser *parser, const struct cli_table *table,
                      const struct bsq_option *row)
{
    const size_t i = parser->count++;
    parser->options[i] = (struct option){row->name, row->argument ? required_argument : no_argument,
                                         NULL, 256 + (int)i};
    parser->entries[i].table = table;
    parser->entries[i].row = row;
    if (row->letter) {
        parser->options[i].val = (unsigned char)row->letter;
        snprintf(parser->letters, sizeof parser->letters, ":%c:", row->letter);
    }
}

static void add_table(struct parser *parser, const struct cli_table *table)
{
    for (const struct bsq_option *row = table->rows; row < table->rows + table->count; row++) {
        const bool follows = row > table->rows && is_same_option(row, row - 1);
        if (row->name && !follows)
            add_entry(parser, table, row);
    }
}

/* Returns in how many letters two texts differ, counting changed, inserted and left out ones
 * (Wagner and Fischer 1974). `name` is shorter than CLI_TEXT. */
static unsigned count_typos(const char *word, size_t length, const char *name)
{
    const size_t letters = strlen(name);
    unsigned row[CLI_TEXT];
    for (unsigned j = 0; j <= letters; j++)
        row[j] = j;
    for (size_t i = 0; i < length; i++) {
        unsigned before = row[0]++;
        for (size_t j = 0; j < letters; j++) {
            const unsigned changed = before + (word[i] != name[j]);
            const unsigned other = 1 + (row[j] < row[j + 1] ? row[j] : row[j + 1]);
            before = row[j + 1];
            row[j + 1] = changed < other ? changed : other;
        }
    }
    return row[letters];
}

/* Writes the option that a wrong word is nearest to, such as "--rays ao=N". Options with keys are
 * found by both names in any order, and by the key alone, others also by what others call them.
 * Returns false if none is near. */
static bool find_nearest(const struct parser *parser, const char *word, char out[CLI_TEXT])
{
    const size_t length = strcspn(word, "=");
    size_t limit = length / 3 < 3 ? length / 3 : 3;
    bool found = false;
    for (const struct cli_table *table = parser->tables;
         table < parser->tables + parser->table_count; table++)
        for (const struct bsq_option *row = table->rows; row < table->rows + table->count; row++) {
            const char *key = row->key ? row->key : "", *gap = row->key ? "-" : "";
            char names[3][CLI_TEXT];
            if (!row->name || !row->help)
                continue;
            snprintf(names[0], CLI_TEXT, "%s%s%s", row->name, gap, key);
            snprintf(names[1], CLI_TEXT, "%s%s%s", key, gap, row->name);
            snprintf(names[2], CLI_TEXT, "%s", row->key ? key : row->also ? row->also : row->name);
            for (int i = 0; i < 3; i++) {
                const size_t typos = count_typos(word, length, names[i]);
                if (typos > limit || (found && typos == limit))
                    continue;
                found = true;
                limit = typos;
                snprintf(out, CLI_TEXT, "--%s%s%s%s%s", row->name, row->key ? " " : "", key,
                         row->key        ? "="
                         : row->argument ? " "
                                         : "",
                         row->argument ? row->argument : "");
            }
        }
    return found;
}

/* Says why getopt_long() returned '?' or ':'. Its own messages would print any bytes. */
static int refuse_option(const struct parser *parser, int option, char *const *argv)
{
    struct cli *cli = parser->cli;
    char nearest[CLI_TEXT];
    const char *word = argv[optind - 1];
    if (strncmp(word, "--", 2) != 0)
        return option == ':' ? cli_usage(cli, "option requires an argument -- '%c'", optopt)
                             : cli_usage(cli, "invalid option -- '%c'", optopt);
    if (option == ':')
        return cli_usage(cli, "option '%s' requires an argument", word);
    if (optopt != 0)
        return cli_usage(cli, "option '%s': no argument is allowed", word);
    if (find_nearest(parser, word + 2, nearest))
        return cli_usage(cli, "unrecognized option '%s'; the nearest is %s", word, nearest);
    return cli_usage(cli, "unrecognized option '%s' (see --help)", word);
}

/* Takes the value of a row; `name` is how it was given, without dashes. */
static int take_value(struct parser *parser, const struct cli_table *table,
                      const struct bsq_option *row, const char *name, const char *text)
{
    char option[CLI_TEXT + 2];
    snprintf(option, sizeof option, "--%s", name);
    if (table->given)
        table->given[row - table->rows] = true;
    if (row->own_syntax)
        return parser->command->take(parser->cli, parser->command->arguments, row, text);
    return cli_parse_value(parser->cli, option, row, text, table->options);
}

/* Takes KEY=VALUE,... for the rows of a name. The values live as long as the command line. */
static int take_keys(struct parser *parser, const struct cli_table *table,
                     const struct bsq_option *first, char *text)
{
    for (char *word = text; word;) {
        char *next = strchr(word, ','), *value = strchr(word, '='), name[CLI_TEXT];
        const struct bsq_option *row = first, *end = table->rows + table->count;
        if (next)
            *next++ = '\0';
        if (value)
            *value++ = '\0';
        while (row < end && is_same_option(row, first) && strcmp(row->key, word) != 0)
            row++;
        if (!value || row == end || !is_same_option(row, first))
            return cli_usage(parser->cli, "--%s: \"%s\" is not KEY=VALUE with a key of --help",
                             first->name, word);
        snprintf(name, sizeof name, "%s %s", row->name, row->key);
        BSQ_PASS(take_value(parser, table, row, name, value));
        word = next;
    }
    return 0;
}

static int cli_take_option(struct parser *parser, int option)
{
    struct cli *cli = parser->cli;
    size_t i = 0;
    while (parser->options[i].val != option)
        i++;
    const struct cli_table *table = parser->entries[i].table;
    const struct bsq_option *row = parser->entries[i].row;
    const char *name = parser->options[i].name;
    if (table->options != cli)
        parser->own_name = name;
    BSQ_PASS(row->key ? take_keys(parser, table, row, optarg)
                      : take_value(parser, table, row, name, optarg ? optarg : ""));
    if (cli->help)
        print_help(parser->command, parser->tables, parser->table_count);
    if (cli->list_options)
        print_options(parser->tables, parser->table_count);
    if (cli->version)
        cli_print("%s %s\n", cli->program, BSQ_VERSION);
    return cli->help || cli->list_options || cli->version ? 2 : 0;
}

int cli_parse(struct cli *cli, const struct cli_command *command, int argc, char **argv)
{
    struct parser parser = {.cli = cli, .command = command, .letters = ":"};
    int option;
    while (parser.table_count < CLI_MOST_TABLES && command->tables[parser.table_count].rows) {
        parser.tables[parser.table_count] = command->tables[parser.table_count];
        add_table(&parser, &parser.tables[parser.table_count++]);
    }
    parser.tables[parser.table_count] =
        (struct cli_table){common_rows, sizeof common_rows / sizeof *common_rows, cli, NULL};
    add_table(&parser, &parser.tables[parser.table_count++]);
    while ((option = getopt_long(argc, argv, parser.letters, parser.options, NULL)) != -1) {
        int status = option == '?' || option == ':' ? refuse_option(&parser, option, argv)
                                                    : cli_take_option(&parser, option);
        if (status != 0)
            return status;
    }
    if (cli->json && cli_prints_percent(cli))
        return cli_usage(cli, "--json and this --progress both write to standard output");
    if (cli->verify && parser.own_name)
        return cli_usage(cli, "--verify only checks files: leave out --%s", parser.own_name);
    if (cli->verify && optind == argc)
        return cli_usage(cli, "no input file given (see --help)");
    return 0;
}

bool cli_is_given(const struct cli_table *table, const char *name)
{
    bool given = false;
    for (size_t i = 0; i < table->count; i++)
        given |= table->given[i] && table->rows[i].name && strcmp(table->rows[i].name, name) == 0;
    return given;
}
