/* cli_path_map.c - reads the rules of --path-map: JSON, Open Job Description's pathmapping-1.0. */
#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/path_map.h"
#include "tools/cli.h"

static int fail_rules(struct cli *cli, const char *what)
{
    return bsq_fail(cli->ctx, BSQ_EDATA, "%s: no rules of pathmapping-1.0: %s", cli->path_map,
                    what);
}

/* Adds one rule. */
static int add_rule(struct cli *cli, const json_t *rule)
{
    static const char *const formats[] = {"POSIX", "WINDOWS", "URI"};
    const char *format = json_string_value(json_object_get(rule, "source_path_format"));
    const char *source = json_string_value(json_object_get(rule, "source_path"));
    const char *destination = json_string_value(json_object_get(rule, "destination_path"));
    unsigned i = 0;
    if (!format || !source || !destination || !*source)
        return fail_rules(cli, "a rule has no format, source or destination");
    while (i < 3 && strcmp(formats[i], format) != 0)
        i++;
    if (i == 3)
        return fail_rules(cli, "a format is not POSIX, WINDOWS or URI");
    return bsq_add_path_rule(cli->ctx, (enum bsq_path_format)i, source, destination);
}

static int add_rules(struct cli *cli, const json_t *root)
{
    const char *version = json_string_value(json_object_get(root, "version"));
    const json_t *rules = json_object_get(root, "path_mapping_rules");
    int status = 0;
    /* Open Job Description gives an empty object if there are no rules. */
    if (json_is_object(root) && json_object_size(root) == 0)
        return 0;
    if (!version || strcmp(version, "pathmapping-1.0") != 0)
        return fail_rules(cli, "another version");
    if (rules && !json_is_array(rules))
        return fail_rules(cli, "path_mapping_rules is no list");
    for (size_t i = 0; i < json_array_size(rules) && status == 0; i++)
        status = add_rule(cli, json_array_get(rules, i));
    return status;
}

/* Loads a file as JSON. *reserved: bytes of the budget that the caller releases. */
static int load(struct cli *cli, json_t **out, uint64_t *reserved)
{
    enum { BYTES_A_CHARACTER = 256, MOST_OTHERS = 1 << 16 }; /* of Jansson's memory */
    const int fd = open(cli->path_map, O_RDONLY | O_NONBLOCK | O_CLOEXEC);
    struct stat info = {0};
    json_error_t error;
    int status = fd < 0 || fstat(fd, &info) != 0
                     ? bsq_fail_errno(cli->ctx, BSQ_ENOINPUT, errno, "%s", cli->path_map)
                 : S_ISREG(info.st_mode)
                     ? 0
                     : bsq_fail(cli->ctx, BSQ_ENOINPUT, "%s: not a regular file", cli->path_map);
    if (status < 0)
        goto done;
    const uint64_t bound = BYTES_A_CHARACTER * (uint64_t)info.st_size + MOST_OTHERS;
    BSQ_TRY(bsq_reserve(cli->ctx, "rules for paths", bound));
    *reserved = bound;
    *out = json_loadfd(fd, JSON_REJECT_DUPLICATES, &error);
    status = *out ? 0 : fail_rules(cli, error.text);
done:
    if (fd >= 0)
        close(fd);
    return status;
}

int cli_load_path_map(struct cli *cli)
{
    json_t *root = NULL;
    uint64_t reserved = 0;
    if (!cli->path_map)
        return 0;
    int status = load(cli, &root, &reserved);
    if (status == 0)
        status = add_rules(cli, root);
    json_decref(root);
    bsq_release(cli->ctx, reserved);
    return status;
}

int cli_map_input(struct cli *cli, const char **path)
{
    const char *mapped = *path ? bsq_map_path(cli->ctx, *path) : NULL;
    if (*path && !mapped)
        return BSQ_ENOMEM;
    *path = mapped;
    return 0;
}
