/* path_map.c - see path_map.h. Mapped paths are kept, so that callers need not free them. */
#include "base/path_map.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/context_internal.h"
#include "base/text.h"

struct rule {
    enum bsq_path_format format;
    size_t length; /* of the source, without separators at its end */
    char *source, *destination;
};

struct bsq_path_map {
    struct rule *rules; /* longest source first */
    size_t rule_count;
    struct bsq_texts mapped; /* paths that were handed out */
    struct bsq_tally tally;  /* of these */
};

static void free_map(struct bsq_ctx *ctx, void *object)
{
    struct bsq_path_map *map = object;
    for (size_t i = 0; i < map->rule_count; i++) {
        free(map->rules[i].source);
        free(map->rules[i].destination);
    }
    bsq_texts_free(&map->mapped);
    bsq_tally_release(ctx, &map->tally);
    free(map->rules);
    free(map);
}

static bool rules_is_separator(enum bsq_path_format format, char c)
{
    return c == '/' || (format == BSQ_PATH_WINDOWS && c == '\\');
}

static char rules_lower(char c)
{
    return c >= 'A' && c <= 'Z' ? (char)(c - 'A' + 'a') : c;
}

static bool same_character(enum bsq_path_format format, char a, char b)
{
    if (rules_is_separator(format, a) && rules_is_separator(format, b))
        return true;
    return format == BSQ_PATH_WINDOWS ? rules_lower(a) == rules_lower(b) : a == b;
}

/* Returns whether a path is the rule's source or lies below it. */
static bool fits(const struct rule *rule, const char *path)
{
    for (size_t i = 0; i < rule->length; i++)
        if (path[i] == '\0' || !same_character(rule->format, rule->source[i], path[i]))
            return false;
    const char next = path[rule->length];
    return next == '\0' || rules_is_separator(rule->format, next);
}

static int rules_add_rule(struct bsq_path_map *map, const struct rule *rule)
{
    struct rule *rules = reallocarray(map->rules, map->rule_count + 1, sizeof *rules);
    size_t at = 0;
    if (!rules)
        return ENOMEM;
    map->rules = rules;
    while (at < map->rule_count && rules[at].length >= rule->length)
        at++;
    memmove(rules + at + 1, rules + at, (map->rule_count - at) * sizeof *rules);
    rules[at] = *rule;
    map->rule_count++;
    return 0;
}

int bsq_add_path_rule(struct bsq_ctx *ctx, enum bsq_path_format format, const char *source,
                      const char *destination)
{
    struct rule rule = {.format = format, .length = strlen(source)};
    if (rule.length == 0)
        return bsq_fail(ctx, BSQ_EDATA, "a rule for paths has an empty source");
    while (rule.length > 0 && rules_is_separator(format, source[rule.length - 1]))
        rule.length--;
    rule.source = strdup(source);
    rule.destination = strdup(destination);
    pthread_mutex_lock(&ctx->members_lock);
    struct bsq_path_map *map = bsq_member_of(ctx, BSQ_PATH_MAP, sizeof *map, free_map);
    const int error = rule.source && rule.destination && map ? rules_add_rule(map, &rule) : ENOMEM;
    pthread_mutex_unlock(&ctx->members_lock);
    if (error == 0)
        return 0;
    free(rule.source);
    free(rule.destination);
    return bsq_fail_errno(ctx, BSQ_ENOMEM, error, "%s", source);
}

/* Returns the destination and what follows the source in the path, with "/" between components.
 * NULL if there is no memory. */
static char *rules_replace(const struct rule *rule, const char *path)
{
    const char *rest = path + rule->length;
    const size_t length = strlen(rule->destination);
    size_t kept = length;
    while (rules_is_separator(rule->format, *rest))
        rest++;
    while (kept > 0 && rule->destination[kept - 1] == '/')
        kept--;
    char *out = malloc(length + strlen(rest) + 2);
    if (!out)
        return NULL;
    if (*rest == '\0') {
        memcpy(out, rule->destination, length + 1);
        return out;
    }
    char *end = mempcpy(out, rule->destination, kept);
    *end++ = '/';
    for (; *rest; rest++)
        *end++ = rules_is_separator(rule->format, *rest) ? '/' : *rest;
    *end = '\0';
    return out;
}

/* Sets *out to a kept copy of the mapped path. Errors: BSQ_ENOMEM. */
static int rules_keep(struct bsq_ctx *ctx, const struct rule *rule, const char *path,
                      const char **out)
{
    struct bsq_path_map *map = ctx->members[BSQ_PATH_MAP].object;
    char *mapped = rules_replace(rule, path);
    uint64_t number = 0;
    int status = mapped ? bsq_texts_add(ctx, &map->tally, &map->mapped, mapped, &number)
                        : bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", path);
    free(mapped);
    *out = status == 0 ? map->mapped.list[number] : NULL;
    return status;
}

const char *bsq_map_path(struct bsq_ctx *ctx, const char *name)
{
    const char *out = name;
    pthread_mutex_lock(&ctx->members_lock);
    const struct bsq_path_map *map = ctx->members[BSQ_PATH_MAP].object;
    size_t i = 0;
    while (map && i < map->rule_count && !fits(&map->rules[i], name))
        i++;
    if (map && i < map->rule_count)
        (void)rules_keep(ctx, &map->rules[i], name, &out); /* NULL tells of the failure */
    pthread_mutex_unlock(&ctx->members_lock);
    return out;
}
