/* bake_transfers.c - see bake_transfers.h. */
#include "tools/bake_transfers.h"

#include <stdlib.h>
#include <string.h>

const char *bake_transfer_name(const char *word)
{
    static const char prefix[] = "transfer:";
    return strncmp(word, prefix, strlen(prefix)) == 0 ? word + strlen(prefix) : NULL;
}

/* Adds an entry with a copy of the name's first `length` bytes. */
static int add(struct cli *cli, struct bake_transfer **list, uint32_t *count, const char *name,
               size_t length, const char *path)
{
    struct bake_transfer *grown = realloc(*list, (*count + UINT64_C(1)) * sizeof *grown);
    char *copy = strndup(name, length);
    if (grown)
        *list = grown;
    if (!grown || !copy) {
        free(copy);
        return cli_usage(cli, "out of memory");
    }
    grown[(*count)++] = (struct bake_transfer){.name = copy, .texture_path = path};
    return 0;
}

static struct bake_transfer *find(const struct bake_transfers *transfers, const char *name)
{
    for (uint32_t i = 0; i < transfers->map_count; i++)
        if (strcmp(transfers->maps[i].name, name) == 0)
            return &transfers->maps[i];
    return NULL;
}

int bake_add_transfer(struct cli *cli, struct bake_transfers *transfers, const char *name)
{
    if (find(transfers, name))
        return cli_usage(cli, "--maps: transfer:%s is named twice", name);
    return add(cli, &transfers->maps, &transfers->map_count, name, strlen(name), NULL);
}

/* Where names of channels are added. */
struct additions {
    struct cli *cli;
    struct bake_transfers *transfers;
};

static int add_channel(void *arg, const char *name)
{
    const struct additions *to = (const struct additions *)arg;
    struct bake_transfer *map = find(to->transfers, name);
    if (map)
        map->no_file = false;
    return map ? 0
               : add(to->cli, &to->transfers->maps, &to->transfers->map_count, name, strlen(name),
                     NULL);
}

int bake_add_channels(struct cli *cli, struct bake_transfers *transfers,
                      struct bake_options *options)
{
    struct additions to = {cli, transfers};
    const int status = bake_find_channels(cli->ctx, options, add_channel, &to);
    options->transfers = transfers->maps;
    options->transfer_count = transfers->map_count;
    return status;
}

int bake_parse_texture(struct cli *cli, struct bake_transfers *transfers, const char *text)
{
    const char *equals = strchr(text, '=');
    if (!equals || equals == text || equals[1] == '\0')
        return cli_usage(cli, "--texture: \"%s\" is not NAME=FILE", text);
    return add(cli, &transfers->textures, &transfers->texture_count, text, (size_t)(equals - text),
               equals + 1);
}

/* Makes opacity a part of the mask. */
static int use_opacity(struct cli *cli, struct bake_transfers *transfers)
{
    static const char name[] = "opacity";
    struct bake_transfer *map = find(transfers, name);
    const bool has_file = map != NULL;
    if (!map && add(cli, &transfers->maps, &transfers->map_count, name, strlen(name), NULL) < 0)
        return BSQ_EUSAGE;
    map = find(transfers, name);
    map->in_mask = true;
    map->no_file = !has_file;
    return 0;
}

int bake_use_transfers(struct cli *cli, struct bake_transfers *transfers,
                       struct bake_options *options)
{
    if (transfers->mask_opacity && use_opacity(cli, transfers) < 0)
        return BSQ_EUSAGE;
    for (uint32_t i = 0; i < transfers->texture_count; i++) {
        const struct bake_transfer *texture = &transfers->textures[i];
        struct bake_transfer *map = find(transfers, texture->name);
        if (!map)
            return cli_usage(cli, "--texture %s=%s: --maps does not have transfer:%s",
                             texture->name, texture->texture_path, texture->name);
        if (map->texture_path)
            return cli_usage(cli, "--texture: \"%s\" is given twice", texture->name);
        map->texture_path = texture->texture_path;
    }
    options->transfers = transfers->maps;
    options->transfer_count = transfers->map_count;
    return 0;
}

static void free_list(struct bake_transfer *list, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++)
        free((void *)(uintptr_t)list[i].name);
    free(list);
}

void bake_transfers_free(struct bake_transfers *transfers)
{
    free_list(transfers->maps, transfers->map_count);
    free_list(transfers->textures, transfers->texture_count);
}
