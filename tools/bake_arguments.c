/* bake_arguments.c - see bake_arguments.h. */
#include "tools/bake_arguments.h"

#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "formats/file_kind.h"

static const char usage[] =
    "Usage: bisque-bake [OPTION]... SCAN.nvdb LOW.obj... -o OUT_<MAP>.exr\n"
    "       bisque-bake [OPTION]... SCAN.tris LOW.obj... -o OUT_<MAP>.exr\n"
    "       bisque-bake [OPTION]... SCAN.nvdb LOW.obj -o OUT_<MAP>.exr --tasks N --plan PLAN\n"
    "       bisque-bake --plan PLAN --task I\n"
    "       bisque-bake --plan PLAN --merge [--task I]\n"
    "       bisque-bake --plan PLAN\n"
    "       bisque-bake --list devices\n"
    "       bisque-bake --list tiles LOW.obj...\n"
    "Bakes the normals and colours of a scan into texture maps of a low-poly mesh: fast from a\n"
    "voxel grid (SCAN.nvdb), or exactly from the scan's own triangles (SCAN.tris).\n"
    "<MAP> in the output's name is replaced by the name of the map, <UDIM> by the number of the tile,\n"
    "<UVTILE> by u1_v1 and so on, <OBJECT> and <MATERIAL> by names in the low-poly meshes, which then\n"
    "have maps of their own. A name that ends in .exr gives OpenEXR files, one that ends in .png PNG\n"
    "files; -o FOLDER/ gives FOLDER/LOW_<MAP>.exr, or .png with a preset. Options with KEY=VALUE take several, with commas between them: --rays ao=32,thickness=16\n";

/* ---- maps ---- */

static const char transfer_prefix[] = "transfer:", opacity_word[] = "mask:opacity";

static int add_transfer(struct cli *cli, struct bake_transfers *list, const char *name,
                        size_t length, const char *path)
{
    struct bake_transfer *grown =
        realloc(list->maps, (list->count + UINT64_C(1)) * sizeof *list->maps);
    char *copy = strndup(name, length);
    if (grown)
        list->maps = grown;
    if (!grown || !copy) {
        free(copy);
        return cli_usage(cli, "out of memory");
    }
    grown[list->count++] = (struct bake_transfer){.name = copy, .texture_path = path};
    return 0;
}

static struct bake_transfer *find_transfer(const struct bake_transfers *list, const char *name)
{
    for (uint32_t i = 0; i < list->count; i++)
        if (strcmp(list->maps[i].name, name) == 0)
            return &list->maps[i];
    return NULL;
}

/* Returns the bits of a map, of another name of a map, or of "all"; 0 for other words. */
static uint32_t maps_of_word(const char *word)
{
    for (unsigned i = 0; bake_map_name(i); i++)
        if (strcmp(word, bake_map_name(i)) == 0 ||
            (bake_map_alias(i) && strcmp(word, bake_map_alias(i)) == 0))
            return 1u << i;
    return strcmp(word, "all") == 0 ? BAKE_MAPS_ALL : 0;
}

static int refuse_map(struct cli *cli, const char *word)
{
    char names[512] = "";
    size_t length = 0;
    for (unsigned i = 0; i < 2 * BAKE_MAX_MAPS; i++) { /* names, then other names */
        const char *name = i < BAKE_MAX_MAPS ? bake_map_name(i) : bake_map_alias(i - BAKE_MAX_MAPS);
        if (name)
            length += (size_t)snprintf(names + length, sizeof names - length, "%s, ", name);
    }
    return cli_usage(cli, "--maps: \"%s\" is not %s%s, all or %sNAME", word, names, opacity_word,
                     transfer_prefix);
}

static int parse_map(struct cli *cli, struct bake_arguments *arguments, const char *word)
{
    const size_t prefix = strlen(transfer_prefix);
    const bool opacity = strcmp(word, opacity_word) == 0;
    const uint32_t maps = opacity ? BAKE_MAP_MASK : maps_of_word(word);
    arguments->mask_opacity |= opacity;
    arguments->bake.maps |= maps;
    if (maps)
        return 0;
    if (strncmp(word, transfer_prefix, prefix) != 0)
        return refuse_map(cli, word);
    if (find_transfer(&arguments->transfers, word + prefix))
        return cli_usage(cli, "--maps: %s is named twice", word);
    return add_transfer(cli, &arguments->transfers, word + prefix, strlen(word + prefix), NULL);
}

static int parse_maps(struct cli *cli, struct bake_arguments *arguments, const char *text)
{
    char *list = strdup(text), *rest = list, *word;
    int status = list ? 0 : cli_usage(cli, "--maps: out of memory");
    arguments->bake.maps = 0;
    while (status == 0 && (word = strsep(&rest, ",")))
        status = parse_map(cli, arguments, word);
    free(list);
    return status;
}

static void print_maps(void)
{
    printf("\nMaps:\n");
    for (unsigned i = 0; bake_map_name(i); i++)
        printf("      %-18s  %s\n", bake_map_name(i), bake_map_summary(i));
    for (unsigned i = 0; bake_map_name(i); i++)
        if (bake_map_alias(i))
            printf("      %-18s  another name of %s\n", bake_map_alias(i), bake_map_name(i));
    printf("      %-18s  the mask, multiplied by the scan's opacity\n", opacity_word);
    printf("      %-18s  all of these that the scan can give\n", "all");
    printf("      %sNAME       another texture of the scan, such as roughness\n", transfer_prefix);
}

static int parse_texture(struct cli *cli, struct bake_arguments *arguments, const char *text)
{
    const char *equals = strchr(text, '=');
    if (!equals || equals == text || equals[1] == '\0')
        return cli_usage(cli, "--texture: \"%s\" is not NAME=FILE", text);
    return add_transfer(cli, &arguments->textures, text, (size_t)(equals - text), equals + 1);
}

static void use_transfers(struct bake_arguments *arguments)
{
    arguments->bake.transfers = arguments->transfers.maps;
    arguments->bake.transfer_count = arguments->transfers.count;
}

/* Makes opacity a part of the mask. */
static int use_opacity(struct cli *cli, struct bake_transfers *list)
{
    static const char name[] = "opacity";
    const bool has_file = find_transfer(list, name) != NULL;
    if (!has_file && add_transfer(cli, list, name, strlen(name), NULL) < 0)
        return BSQ_EUSAGE;
    struct bake_transfer *map = find_transfer(list, name);
    map->in_mask = true;
    map->no_file = !has_file;
    return 0;
}

/* Gives the transfer maps their textures, and the options the maps. */
static int finish_transfers(struct cli *cli, struct bake_arguments *arguments)
{
    if (arguments->mask_opacity && use_opacity(cli, &arguments->transfers) < 0)
        return BSQ_EUSAGE;
    for (uint32_t i = 0; i < arguments->textures.count; i++) {
        const struct bake_transfer *texture = &arguments->textures.maps[i];
        struct bake_transfer *map = find_transfer(&arguments->transfers, texture->name);
        if (!map)
            return cli_usage(cli, "--texture %s=%s: --maps does not have transfer:%s",
                             texture->name, texture->texture_path, texture->name);
        if (map->texture_path)
            return cli_usage(cli, "--texture: \"%s\" is given twice", texture->name);
        map->texture_path = texture->texture_path;
    }
    use_transfers(arguments);
    return 0;
}

static int name_in_folder(struct cli *cli, struct bake_arguments *arguments);

/* Where names of channels are added. */
struct additions {
    struct cli *cli;
    struct bake_arguments *to;
};

/* Notes that the scans have a channel. */
static int note_channel(struct cli *cli, struct bake_arguments *arguments, const char *name)
{
    char *old = arguments->channels;
    if (asprintf(&arguments->channels, "%s%s,", old ? old : ",", name) < 0)
        arguments->channels = NULL;
    free(old);
    return arguments->channels ? 0 : cli_usage(cli, "out of memory");
}

static int add_channel(void *arg, const char *name)
{
    const struct additions *added = (const struct additions *)arg;
    struct bake_transfers *list = &added->to->transfers;
    struct bake_transfer *map = find_transfer(list, name);
    int status = note_channel(added->cli, added->to, name);
    if (status < 0 || !(added->to->bake.maps & BAKE_MAPS_ALL))
        return status;
    if (map)
        map->no_file = false;
    else
        status = add_transfer(added->cli, list, name, strlen(name), NULL);
    use_transfers(added->to);
    return status;
}

/* Replaces, in the packs of a preset, a channel that the scans do not have: as glTF has it, what
 * has no roughness is rough, and what has no value of another kind has 0. */
static int fill_pack(struct cli *cli, struct bake_arguments *arguments, const char *name)
{
    const bool rough = strcmp(name, "roughness") == 0;
    int status = bsq_warn_loss(
        cli->ctx, "--preset: the scan has no %s: the packed map has %d there", name, rough);
    for (uint32_t i = 0; i < arguments->bake.pack_count && status == 0; i++) {
        char *list = (char *)(uintptr_t)arguments->packs[i].maps, *word = strstr(list, name);
        if (!word)
            continue;
        const bool inverted = word - list >= 2 && strncmp(word - 2, "1-", 2) == 0;
        char *to = inverted ? word - 2 : word;
        *to = rough != inverted ? '1' : '0';
        memmove(to + 1, word + strlen(name), strlen(word + strlen(name)) + 1);
    }
    return status;
}

static bool is_in_pack(const struct bake_arguments *arguments, const char *name)
{
    bool any = false;
    for (uint32_t i = 0; i < arguments->bake.pack_count; i++)
        any |= strstr(arguments->packs[i].maps, name) != NULL;
    return any;
}

/* Drops the transfer maps of a preset that the scans cannot give. */
static int fill_packs(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_transfers *list = &arguments->transfers;
    int status = 0;
    uint32_t kept = 0;
    for (uint32_t i = 0; i < list->count; i++) {
        const struct bake_transfer map = list->maps[i];
        char word[CLI_TEXT];
        snprintf(word, sizeof word, ",%s,", map.name);
        if (map.texture_path || map.in_mask || !is_in_pack(arguments, map.name) ||
            (arguments->channels && strstr(arguments->channels, word))) {
            list->maps[kept++] = map;
            continue;
        }
        if (status == 0)
            status = fill_pack(cli, arguments, map.name);
        free((void *)(uintptr_t)map.name);
    }
    list->count = kept;
    use_transfers(arguments);
    return status;
}

int bake_arguments_look(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    const bool fills =
        bake->preset > 0 && bake->pack_count > 0 && !bake_arguments_has(arguments, "packs");
    struct additions to = {cli, arguments};
    int status;
    BSQ_TRY(name_in_folder(cli, arguments));
    BSQ_TRY(bake_check_options(cli->ctx, bake));
    BSQ_TRY(bake_look(cli->ctx, bake, arguments->given,
                      fills || bake->maps & BAKE_MAPS_ALL ? add_channel : NULL, &to));
    if (fills)
        BSQ_TRY(fill_packs(cli, arguments));
    status = bake_check_options(cli->ctx, bake);
done:
    return status;
}

/* ---- packs, presets and quality ---- */

/* Adds a word of a pack to the maps that are baked. */
static int add_packed(struct cli *cli, struct bake_arguments *arguments, const char *word)
{
    const char *name = strncmp(word, "1-", 2) == 0 ? word + 2 : word;
    const uint32_t map = maps_of_word(name);
    if (strcmp(name, "0") == 0 || strcmp(name, "1") == 0 || *name == '\0')
        return 0; /* bake_check_options() refuses what is no name */
    arguments->bake.maps |= map;
    return map || find_transfer(&arguments->transfers, name)
               ? 0
               : add_transfer(cli, &arguments->transfers, name, strlen(name), NULL);
}

static int parse_pack(struct cli *cli, struct bake_arguments *arguments, const char *text)
{
    struct bake_options *bake = &arguments->bake;
    struct bake_pack *grown =
        realloc(arguments->packs, (bake->pack_count + UINT64_C(1)) * sizeof *grown);
    char *name = strdup(text), *equals = name ? strchr(name, '=') : NULL;
    if (grown)
        bake->packs = arguments->packs = grown;
    if (!grown || !equals) {
        free(name);
        return cli_usage(
            cli, grown && name ? "--pack: \"%s\" is not NAME=MAP,..." : "--pack %s: out of memory",
            text);
    }
    *equals = '\0';
    grown[bake->pack_count++] = (struct bake_pack){name, equals + 1};
    /* cppcheck-suppress memleak; the pack owns the name */
    return 0;
}

/* Bakes what packs show, beside the maps that are named or, without any, the default ones. */
static int finish_packs(struct cli *cli, struct bake_arguments *arguments)
{
    int status = 0;
    if (arguments->bake.pack_count > 0 && !bake_arguments_has(arguments, "maps"))
        arguments->bake.maps = BAKE_MAPS_USUAL;
    for (uint32_t i = 0; i < arguments->bake.pack_count && status == 0; i++) {
        char *list = strdup(arguments->packs[i].maps), *rest = list, *word;
        status = list ? 0 : cli_usage(cli, "--pack: out of memory");
        while (status == 0 && (word = strsep(&rest, ",")))
            status = add_packed(cli, arguments, word);
        free(list);
    }
    return status;
}

/* What words of --quality and --preset stand for: values of other options that are not given. */
static const struct setting {
    const char *option, *word, *name, *key, *text;
} settings[] = {
    {"quality", "draft", "samples", NULL, "1"},
    {"quality", "draft", "rays", "ao", "8"},
    {"quality", "draft", "rays", "thickness", "4"},
    {"quality", "final", "samples", NULL, "4"},
    {"quality", "final", "rays", "ao", "256"},
    {"quality", "final", "rays", "thickness", "128"},
    {"preset", "unreal", "normal", "green", "down"},
    {"preset", "unreal", "pack", NULL, "orm=ao,roughness,metallic"},
    {"preset", "unity", "normal", "green", "up"},
    {"preset", "unity", "pack", NULL, "mask_map=metallic,ao,0,1-roughness"},
    {"preset", "blender", "normal", "green", "up"},
    {"preset", "gltf", "normal", "green", "up"},
    {"preset", "gltf", "pack", NULL, "orm=ao,roughness,metallic"},
    {"preset", "unreal", "type", NULL, "8"},
    {"preset", "unity", "type", NULL, "8"},
    {"preset", "gltf", "type", NULL, "8"},
};

/* Returns whether a row's value is one of its words: that of a setting. */
static bool is_chosen(const struct bake_options *bake, const struct setting *setting)
{
    const uint32_t value =
        strcmp(setting->option, "preset") == 0 ? bake->preset : (uint32_t)bake->quality;
    size_t count;
    for (const struct bsq_option *row = bake_option_rows(&count); count-- > 0; row++)
        if (row->name && strcmp(row->name, setting->option) == 0)
            return bsq_option_word(row->words, setting->word) == (int)value;
    return false;
}

static int take_option(struct cli *cli, void *arg, const struct bsq_option *row, const char *text);

static int apply_setting(struct cli *cli, struct bake_arguments *arguments,
                         const struct setting *setting)
{
    struct bake_options *bake = &arguments->bake;
    size_t count;
    const struct bsq_option *rows = bake_option_rows(&count);
    for (size_t i = 0; i < count; i++) {
        const struct bsq_option *row = &rows[i];
        if (!row->name || strcmp(row->name, setting->name) != 0 || arguments->given[i] ||
            (setting->key && strcmp(row->key, setting->key) != 0))
            continue;
        return row->own_syntax ? take_option(cli, arguments, row, setting->text)
                               : cli_parse_value(cli, setting->option, row, setting->text, bake);
    }
    return 0;
}

/* OpenEXR files have no samples of 8 bits, which presets ask for in PNG files. */
static int apply_settings(struct cli *cli, struct bake_arguments *arguments)
{
    const bool is_exr = cli_ends_with(arguments->bake.output_path, ".exr");
    int status = 0;
    for (size_t i = 0; i < sizeof settings / sizeof *settings && status == 0; i++)
        if (is_chosen(&arguments->bake, &settings[i]) &&
            !(is_exr && strcmp(settings[i].name, "type") == 0))
            status = apply_setting(cli, arguments, &settings[i]);
    return status;
}

static void count_tile(void *arg, const struct bake_tile_info *tile)
{
    (void)tile;
    ++*(unsigned *)arg;
}

/* If the output is a folder, makes the names of maps in it: by the low-poly mesh, or by object if
 * there are several meshes. */
static int name_in_folder(struct cli *cli, struct bake_arguments *arguments)
{
    static const char *const suffixes[] = {"exr", "png", "png", "exr", "png"}; /* by preset */
    struct bake_options *bake = &arguments->bake;
    const char *path = bake->output_path, *slash = strrchr(bake->mesh_path, '/');
    const char *name = slash ? slash + 1 : bake->mesh_path;
    const size_t length = strlen(path);
    const bool slashed = length > 0 && path[length - 1] == '/';
    struct stat info;
    unsigned tiles = 0;
    const bool there = stat(path, &info) == 0 && S_ISDIR(info.st_mode);
    if (!there && slashed)
        return bsq_fail(cli->ctx, BSQ_ECANTCREAT, "%s: there is no such folder", path);
    if (!there)
        return 0;
    bsq_mute_warnings(cli->ctx, true); /* the bake reads the meshes again, and then gives them */
    const int status = bake_list_tiles(cli->ctx, bake, count_tile, &tiles);
    bsq_mute_warnings(cli->ctx, false);
    if (status < 0)
        return status;
    const bool by_object = bake->more_mesh_count > 0 || bake->match_names;
    const char *dot = strrchr(name, '.');
    const int stem =
        by_object ? 0 : (int)(dot && dot > name ? dot - name : (ptrdiff_t)strlen(name));
    if (asprintf(&arguments->output, "%s%s%s%.*s_<MAP>%s.%s", path, slashed ? "" : "/",
                 by_object ? BAKE_OBJECT_TOKEN : "", stem, name,
                 tiles > 1 ? "." BAKE_UDIM_TOKEN : "", suffixes[bake->preset]) < 0)
        arguments->output = NULL;
    bake->output_path = arguments->output;
    return arguments->output ? 0 : bsq_fail(cli->ctx, BSQ_ENOMEM, "%s: out of memory", path);
}

/* ---- sizes and tiles ---- */

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

/* Parses N, WxH, or a list of sizes by tile. */
static int parse_sizes(struct cli *cli, const char *text, struct bake_options *options)
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

/* Parses a list such as "1001-1003,1011". */
static int parse_tiles(struct cli *cli, const char *text, struct bake_options *options)
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

/* ---- other options with a syntax of their own ---- */

/* Parses "_low,_high". The texts live as long as the arguments. */
static int parse_suffixes(struct cli *cli, struct bake_arguments *arguments, const char *option,
                          const char *text)
{
    char *copy = strdup(text), *comma = copy ? strchr(copy, ',') : NULL;
    free(arguments->suffixes);
    arguments->suffixes = copy;
    if (!copy)
        return cli_usage(cli, "%s: out of memory", option);
    if (!comma || strchr(comma + 1, ','))
        return cli_usage(cli, "%s: \"%s\" is not %sLOW,HIGH", option, text,
                         strcmp(option, "--match") == 0 ? "name or " : "");
    *comma = '\0';
    arguments->bake.low_suffix = copy;
    arguments->bake.high_suffix = comma + 1;
    return 0;
}

static int parse_list(struct cli *cli, struct bake_arguments *arguments, const char *text)
{
    unsigned kind = 0;
    const int status = cli_parse_word(cli, "--list", text, "devices tiles", &kind);
    arguments->list_devices = kind == 0;
    arguments->list_tiles = kind == 1;
    return status;
}

static int parse_png_bits(struct cli *cli, struct bake_options *bake, const char *text)
{
    unsigned word = 0;
    const int status = cli_parse_word(cli, "--png-bits", text, "8 16", &word);
    bake->sample_type = word == 0 ? BAKE_UINT8 : BAKE_UINT16;
    return status;
}

static int take_option(struct cli *cli, void *arg, const struct bsq_option *row, const char *text)
{
    struct bake_arguments *arguments = arg;
    struct bake_options *bake = &arguments->bake;
    const char *name = row->name;
    if (strcmp(name, "maps") == 0)
        return parse_maps(cli, arguments, text);
    if (strcmp(name, "texture") == 0)
        return parse_texture(cli, arguments, text);
    if (strcmp(name, "pack") == 0)
        return parse_pack(cli, arguments, text);
    if (strcmp(name, "size") == 0)
        return parse_sizes(cli, text, bake);
    if (strcmp(name, "tiles") == 0)
        return parse_tiles(cli, text, bake);
    if (strcmp(name, "match") == 0) {
        bake->match_names = true;
        return strcmp(text, "name") == 0 ? 0 : parse_suffixes(cli, arguments, "--match", text);
    }
    if (strcmp(name, "match-suffixes") == 0)
        return parse_suffixes(cli, arguments, "--match-suffixes", text);
    if (strcmp(name, "device") == 0) {
        bake->device = text;
        return bake_is_device_name(text)
                   ? 0
                   : cli_usage(cli, "--device: \"%s\" is not " BAKE_DEVICE_NAMES, text);
    }
    if (strcmp(name, "task") == 0)
        return bake_farm_parse(cli, name, text, &arguments->farm.task);
    if (strcmp(name, "merge-tile") == 0) {
        arguments->farm.merge = true;
        return bake_farm_parse(cli, name, text, &arguments->farm.task);
    }
    if (strcmp(name, "list") == 0)
        return parse_list(cli, arguments, text);
    if (strcmp(name, "png-bits") == 0)
        return parse_png_bits(cli, bake, text);
    bake->sample_type = strcmp(name, "half") == 0 ? BAKE_HALF : BAKE_FLOAT;
    return 0;
}

/* ---- all of them ---- */

static const struct bsq_option list_rows[] = {
    {.name = "list",
     .argument = "WHAT",
     .own_syntax = true,
     .kind = BSQ_OPTION_NONE,
     .heading = "Instead of a bake",
     .help = "print the devices, or the UDIM tiles of a low-poly mesh, and exit"},
    /* Old names; those of other options are in their rows. */
    {.name = "list-devices",
     .kind = BSQ_OPTION_FLAG,
     .offset = offsetof(struct bake_arguments, list_devices)},
    {.name = "list-tiles",
     .kind = BSQ_OPTION_FLAG,
     .offset = offsetof(struct bake_arguments, list_tiles)},
    {.name = "mask-opacity",
     .kind = BSQ_OPTION_FLAG,
     .offset = offsetof(struct bake_arguments, mask_opacity)},
    {.name = "match-suffixes", .argument = "LOW,HIGH", .own_syntax = true, .kind = BSQ_OPTION_NONE},
    {.name = "half", .own_syntax = true, .kind = BSQ_OPTION_NONE},
    {.name = "float", .own_syntax = true, .kind = BSQ_OPTION_NONE},
    {.name = "png-bits", .argument = "N", .own_syntax = true, .kind = BSQ_OPTION_NONE},
};
enum { LIST_ROWS = sizeof list_rows / sizeof *list_rows };

static const struct bsq_option cli_rows[] = {
    CLI_STRICT_ROW, {.name = "verify", BSQ_MEMBER(FLAG, struct cli, verify)}, /* an old name */
};

struct cli_table bake_arguments_table(const struct bake_arguments *arguments)
{
    struct cli_table table = {.options = (void *)(uintptr_t)&arguments->bake,
                              .given = (bool *)(uintptr_t)arguments->given};
    table.rows = bake_option_rows(&table.count);
    return table;
}

bool bake_arguments_has(const struct bake_arguments *arguments, const char *member)
{
    size_t count, i = 0;
    const struct bsq_option *rows = bake_option_rows(&count);
    while (i < count && strcmp(rows[i].member, member) != 0)
        i++;
    return i < count && arguments->given[i];
}

/* Checks the options of tasks against each other. */
static int check_tasks(struct cli *cli, struct bake_arguments *arguments, int inputs)
{
    struct bake_tasks *farm = &arguments->farm;
    const struct cli_table table = bake_arguments_table(arguments);
    const struct bsq_option *row = cli_given(&table, false);
    if (farm->tasks) {
        farm->write_plan = farm->plan;
        farm->plan = NULL;
    }
    if (farm->plan && (!farm->task.given || farm->merge) && bake_arguments_has(arguments, "device"))
        return cli_usage(cli, "--plan has the device of the tasks: give --device to --task only");
    if (farm->plan && (!farm->merge || farm->task.given) &&
        bake_arguments_has(arguments, "max_missed"))
        return cli_usage(cli, "--max-missed is for the bake of all texels: give it to --merge");
    if (farm->tasks && arguments->bake.page_path)
        return cli_usage(cli, "--report shows a bake in one piece, without --tasks");
    return bake_farm_check(cli, farm, row ? row->name : NULL, inputs);
}

static int check_arguments(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    const int count = arguments->file_count;
    if (cli->verify)
        return 0;
    if (arguments->list_devices)
        return count == 0 ? 0 : cli_usage(cli, "--list devices takes no files");
    if (arguments->list_tiles)
        return count > 0 ? 0 : cli_usage(cli, "--list tiles takes files: LOW.obj...");
    if (check_tasks(cli, arguments, count) < 0)
        return BSQ_EUSAGE;
    if (arguments->farm.plan)
        return 0;
    if (count < 2)
        return cli_usage(cli, "%d input file%s given, not two: SCAN.nvdb and LOW.obj (see --help)",
                         count, count == 1 ? "" : "s");
    if (bake->ao_falloff && bake->ao_distance <= 0)
        return cli_usage(cli, "--ao falloff=linear needs --distance ao=D");
    if (!bake->output_path)
        return cli_usage(cli, "no output given: add -o 'OUT_<MAP>.exr'");
    arguments->bake.strict = cli->strict;
    if (apply_settings(cli, arguments) < 0 || finish_packs(cli, arguments) < 0)
        return BSQ_EUSAGE;
    return finish_transfers(cli, arguments);
}

int bake_arguments_parse(struct cli *cli, struct bake_arguments *arguments, int argc, char **argv)
{
    const struct cli_command command = {
        .usage = usage,
        .print_more = print_maps,
        .tables = {bake_arguments_table(arguments),
                   {bake_task_rows, BAKE_TASK_ROWS, &arguments->farm, NULL},
                   {list_rows, LIST_ROWS, arguments, NULL},
                   {cli_rows, sizeof cli_rows / sizeof *cli_rows, cli, NULL}},
        .take = take_option,
        .arguments = arguments,
    };
    bake_defaults(&arguments->bake);
    int status = cli_parse(cli, &command, argc, argv);
    arguments->files = argv + optind;
    arguments->file_count = argc - optind;
    return status != 0 ? status : check_arguments(cli, arguments);
}

static void free_transfers(struct bake_transfers *list)
{
    for (uint32_t i = 0; i < list->count; i++)
        free((void *)(uintptr_t)list->maps[i].name);
    free(list->maps);
}

void bake_arguments_free(struct bake_arguments *arguments)
{
    for (uint32_t i = 0; i < arguments->bake.pack_count && arguments->packs; i++)
        free((void *)(uintptr_t)arguments->packs[i].name);
    free(arguments->packs);
    free(arguments->output);
    free(arguments->channels);
    free(arguments->paths);
    free(arguments->suffixes);
    free_transfers(&arguments->transfers);
    free_transfers(&arguments->textures);
    free((void *)(uintptr_t)arguments->bake.tile_sizes);
    free((void *)(uintptr_t)arguments->bake.tile_ranges);
}

/* ---- inputs ---- */

int bake_arguments_map_inputs(struct cli *cli, struct bake_arguments *arguments)
{
    const struct cli_table table = bake_arguments_table(arguments);
    int status = 0;
    for (int i = 0; i < arguments->file_count && !cli->verify; i++) {
        const char *path = arguments->files[i];
        BSQ_TRY(cli_map_input(cli, &path));
        arguments->files[i] = (char *)(uintptr_t)path;
    }
    BSQ_TRY(cli_map_inputs(cli, &table));
    for (uint32_t i = 0; i < arguments->transfers.count; i++)
        BSQ_TRY(cli_map_input(cli, &arguments->transfers.maps[i].texture_path));
    status = cli_map_input(cli, &arguments->farm.plan);
done:
    return status;
}

/* Writes the inputs that are scans, or those that are not, to `out`. Returns their number, or a
 * negative status. */
static int take_inputs(struct cli *cli, const struct bake_arguments *arguments, bool scans,
                       const char **out)
{
    int count = 0;
    for (int i = 0; i < arguments->file_count; i++) {
        enum fmt_kind kind;
        int status = fmt_recognise(cli->ctx, arguments->files[i], &kind);
        if (status < 0)
            return status;
        if ((kind == FMT_KIND_TRIS || kind == FMT_KIND_NVDB) == scans)
            out[count++] = arguments->files[i];
    }
    return count;
}

/* Points the options at sorted inputs. */
static int use_inputs(struct cli *cli, struct bake_arguments *arguments, int scans, int meshes)
{
    struct bake_options *bake = &arguments->bake;
    if (scans == 0 || meshes == 0)
        return cli_usage(cli, "%d scan%s (.nvdb, .tris) and %d low-poly mesh%s given (see --help)",
                         scans, scans == 1 ? "" : "s", meshes, meshes == 1 ? "" : "es");
    bake->scan_path = arguments->paths[0];
    bake->more_scan_paths = arguments->paths + 1;
    bake->more_scan_count = (uint32_t)scans - 1;
    bake->mesh_path = arguments->paths[scans];
    bake->more_mesh_paths = arguments->paths + scans + 1;
    bake->more_mesh_count = (uint32_t)meshes - 1;
    return 0;
}

/* Points the options at the meshes, without scans, so that the command of a bake lists its tiles.
 */
static int use_meshes_alone(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    const int meshes = take_inputs(cli, arguments, false, arguments->paths);
    if (meshes <= 0)
        return meshes < 0 ? meshes : cli_usage(cli, "--list tiles takes files: LOW.obj...");
    bake->mesh_path = arguments->paths[0];
    bake->more_mesh_paths = arguments->paths + 1;
    bake->more_mesh_count = (uint32_t)meshes - 1;
    return 0;
}

int bake_arguments_sort_inputs(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    const int count = arguments->file_count;
    arguments->paths = calloc((size_t)count + 1, sizeof *arguments->paths);
    if (!arguments->paths)
        return bsq_fail(cli->ctx, BSQ_ENOMEM, "out of memory");
    for (int i = 0; i < count; i++)
        if (strcmp(arguments->files[i], "-") == 0)
            return cli_usage(cli, "-: standard input is not read: scans and low-poly meshes must "
                                  "be files");
    if (arguments->list_tiles)
        return use_meshes_alone(cli, arguments);
    if (count == 2) {
        bake->scan_path = arguments->paths[0] = arguments->files[0];
        bake->mesh_path = arguments->paths[1] = arguments->files[1];
        return 0;
    }
    const int scans = take_inputs(cli, arguments, true, arguments->paths);
    const int meshes =
        scans < 0 ? scans : take_inputs(cli, arguments, false, arguments->paths + scans);
    return meshes < 0 ? meshes : use_inputs(cli, arguments, scans, meshes);
}
