/* voxelize_info.c - the option --info: prints what is in files. */
#include <string.h>

#include "formats/file_info.h"
#include "tools/voxelize_report.h"

/* Names of a list that are printed; --json has all. */
enum { MOST_NAMES = 20 };

static void print_value(const json_t *value);

static void print_list(const json_t *list)
{
    const size_t count = json_array_size(list);
    for (size_t i = 0; i < count && i < MOST_NAMES; i++) {
        cli_print("%s", i > 0 ? ", " : "");
        print_value(json_array_get(list, i));
    }
    if (count > MOST_NAMES)
        cli_print(" and %zu more", count - MOST_NAMES);
}

/* Prints the members of an object. */
static void print_members(const json_t *object)
{
    const char *key, *comma = "";
    json_t *member;
    json_object_foreach((json_t *)(uintptr_t)object, key, member)
    {
        cli_print("%s%s ", comma, key);
        print_value(member);
        comma = ", ";
    }
}

static void print_value(const json_t *value)
{
    char text[CLI_TEXT];
    if (json_is_array(value)) {
        print_list(value);
    } else if (json_is_string(value)) {
        cli_print("%s", json_string_value(value));
    } else if (json_is_integer(value)) {
        cli_print("%s", cli_count_text((uint64_t)json_integer_value(value), text));
    } else if (json_is_real(value)) {
        cli_print("%.7g", json_real_value(value));
    } else if (json_is_boolean(value)) {
        cli_print("%s", json_is_true(value) ? "yes" : "no");
    } else if (json_is_object(value)) {
        cli_print("(");
        print_members(value);
        cli_print(")");
    }
}

/* Prints a member as a line; a list of objects has a line for each. */
static void print_member(const char *key, const json_t *value)
{
    const size_t count = json_array_size(value);
    if (json_is_null(value) || (json_is_array(value) && count == 0))
        return;
    cli_print("  ");
    for (const char *c = key; *c; c++)
        cli_print("%c", *c == '_' ? ' ' : *c);
    if (json_is_object(json_array_get(value, 0))) {
        cli_print(":\n");
        for (size_t i = 0; i < count && i < MOST_NAMES; i++) {
            cli_print("    ");
            print_members(json_array_get(value, i));
            cli_print("\n");
        }
        if (count > MOST_NAMES)
            cli_print("    and %zu more\n", count - MOST_NAMES);
        return;
    }
    cli_print(": ");
    if (json_is_object(value))
        print_members(value);
    else
        print_value(value);
    cli_print("\n");
}

int voxelize_info_print(struct cli *cli, const char *const *paths, uint32_t count)
{
    json_t *list = json_array();
    int status = 0;
    for (uint32_t i = 0; i < count; i++) {
        const char *key;
        json_t *info, *member;
        BSQ_TRY(fmt_describe(cli->ctx, paths[i], &info));
        cli_clear_bar(cli);
        if (!cli->json) {
            cli_print("%s\n", paths[i]);
            json_object_foreach(info, key, member) if (strcmp(key, "path") != 0)
                print_member(key, member);
        }
        cli_json_append(&list, info);
    }
    if (cli->json)
        return cli_print_json(cli, json_pack("{s:o}", "files", list));
done:
    json_decref(list);
    return status;
}
