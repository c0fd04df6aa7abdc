/* bake_sizes.c - parses --size and --tiles. */
#include <stdlib.h>
#include <string.h>

#include "tools/bake_arguments.h"

/* Reads a number at *text and advances *text past it. Returns false unless the number is 1 to
 * `most`. */
static bool take_number(const char **text, unsigned long long most, uint32_t *out)
{
    char *end;
    bool digit = **text >= '0' && **text <= '9';
    unsigned long long value = strtoull(*text, &end, 10);
    *text = end;
    *out = (uint32_t)value;
    return digit && value >= 1 && value <= most;
}

/* Reads a character if it is there. */
static bool take(const char **text, char character)
{
    bool there = **text == character;
    *text += there;
    return there;
}

/* Reads a number of texels, such as 4096 or 4k. */
static bool take_side(const char **text, uint32_t *out)
{
    const bool good = take_number(text, BAKE_MAX_SIDE, out);
    const uint64_t texels = take(text, 'k') ? UINT64_C(1024) * *out : *out;
    *out = (uint32_t)texels;
    return good && texels <= BAKE_MAX_SIDE;
}

static bool take_size(const char **text, uint32_t *width, uint32_t *height)
{
    bool good = take_side(text, width);
    *height = *width;
    return good && (!take(text, 'x') || take_side(text, height));
}

/* Adds the size of a tile. */
static int add_tile_size(struct cli *cli, struct bake_options *options,
                         const struct bake_tile_size *size)
{
    for (uint32_t i = 0; i < options->tile_size_count; i++)
        if (options->tile_sizes[i].tile == size->tile)
            return cli_usage(cli, "--size: tile %u is given twice", size->tile);
    struct bake_tile_size *sizes = realloc((void *)(uintptr_t)options->tile_sizes,
                                           (options->tile_size_count + 1) * sizeof *sizes);
    if (!sizes)
        return cli_usage(cli, "--size: out of memory");
    sizes[options->tile_size_count++] = *size;
    options->tile_sizes = sizes;
    return 0;
}

/* Reads "1001=4096" or "*=2048". Sets *good, and *others after "*". */
static int take_tile_size(struct cli *cli, const char **text, struct bake_options *options,
                          bool *others, bool *good)
{
    struct bake_tile_size size = {0};
    const bool all = take(text, '*');
    *good = (all || take_number(text, BAKE_LAST_TILE, &size.tile)) && take(text, '=') &&
            take_size(text, &size.width, &size.height);
    if (!*good)
        return 0;
    if (!all)
        return add_tile_size(cli, options, &size);
    if (*others)
        return cli_usage(cli, "--size: * is given twice");
    *others = true;
    options->width = size.width;
    options->height = size.height;
    return 0;
}

int bake_parse_sizes(struct cli *cli, const char *text, struct bake_options *options)
{
    const char *at = text;
    const uint32_t width = options->width, height = options->height;
    bool good = take_size(&at, &options->width, &options->height) && *at == '\0';
    int status = 0;
    if (strchr(text, '=')) {
        options->width = width; /* of tiles that the text does not name */
        options->height = height;
        at = text;
        bool others = false;
        do
            status = take_tile_size(cli, &at, options, &others, &good);
        while (status == 0 && good && take(&at, ','));
        good = good && *at == '\0';
    }
    if (status == 0 && !good)
        status = cli_usage(cli,
                           "--size: \"%s\" is not N, WxH or TILE=SIZE,...,*=SIZE with numbers from "
                           "1 to %d",
                           text, BAKE_MAX_SIDE);
    return status;
}

int bake_parse_tiles(struct cli *cli, const char *text, struct bake_options *options)
{
    const char *at = text;
    do {
        struct bake_tile_range range;
        bool good = take_number(&at, BAKE_LAST_TILE, &range.first);
        range.last = range.first;
        if (good && take(&at, '-'))
            good = take_number(&at, BAKE_LAST_TILE, &range.last);
        if (!good || (*at != ',' && *at != '\0') || range.first < BAKE_FIRST_TILE ||
            range.last < range.first)
            return cli_usage(cli,
                             "--tiles: \"%s\" is not a list such as 1001-1003,1011 from %d to %d",
                             text, BAKE_FIRST_TILE, BAKE_LAST_TILE);
        struct bake_tile_range *ranges = realloc((void *)(uintptr_t)options->tile_ranges,
                                                 (options->tile_range_count + 1) * sizeof *ranges);
        if (!ranges)
            return cli_usage(cli, "--tiles: out of memory");
        ranges[options->tile_range_count++] = range;
        options->tile_ranges = ranges;
    } while (take(&at, ','));
    return 0;
}
