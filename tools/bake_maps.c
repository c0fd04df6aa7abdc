/* bake_maps.c - the options --maps, --texture, --pack, --preset and --quality, and a folder as the
 * output. */
#include <errno.h>
#include <string.h>
#include <sys/stat.h>

#include "tools/bake_arguments.h"

static const char transfer_prefix[] = "transfer:", opacity_word[] = "mask:opacity";

static void add_transfer(struct bake_transfers *list, const char *name, const char *path)
{
    list->maps = cli_extend(list->maps, list->count, sizeof *list->maps);
    list->maps[list->count++] = (struct bake_transfer){.name = name, .texture_path = path};
}

static struct bake_transfer *bake_maps_find_transfer(const struct bake_transfers *list,
                                                     const char *name)
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
    if (bake_maps_find_transfer(&arguments->transfers, word + prefix))
        return cli_usage(cli, "--maps: %s is named twice", word);
    add_transfer(&arguments->transfers, word + prefix, NULL);
    return 0;
}

static int parse_maps(struct cli *cli, struct bake_arguments *arguments, const char *text)
{
    char *rest = cli_keep_text("%s", text), *word;
    arguments->bake.maps = 0;
    while ((word = strsep(&rest, ",")))
        BSQ_PASS(parse_map(cli, arguments, word));
    return 0;
}

void bake_maps_print(void)
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
    add_transfer(&arguments->textures, cli_keep_text("%.*s", (int)(equals - text), text),
                 equals + 1);
    return 0;
}

static void use_transfers(struct bake_arguments *arguments)
{
    arguments->bake.transfers = arguments->transfers.maps;
    arguments->bake.transfer_count = arguments->transfers.count;
}

/* Makes opacity a part of the mask. */
static void use_opacity(struct bake_transfers *list)
{
    static const char name[] = "opacity";
    const bool has_file = bake_maps_find_transfer(list, name) != NULL;
    if (!has_file)
        add_transfer(list, name, NULL);
    struct bake_transfer *map = bake_maps_find_transfer(list, name);
    map->in_mask = true;
    map->no_file = !has_file;
}

/* Gives the transfer maps their textures, and the options the maps. */
static int finish_transfers(struct cli *cli, struct bake_arguments *arguments)
{
    if (arguments->mask_opacity)
        use_opacity(&arguments->transfers);
    for (uint32_t i = 0; i < arguments->textures.count; i++) {
        const struct bake_transfer *texture = &arguments->textures.maps[i];
        struct bake_transfer *map = bake_maps_find_transfer(&arguments->transfers, texture->name);
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

/* Notes that the scans have a channel. */
static int bake_maps_add_channel(void *arg, const char *name)
{
    struct bake_arguments *to = arg;
    struct bake_transfer *map = bake_maps_find_transfer(&to->transfers, name);
    to->channels = cli_keep_text("%s%s,", to->channels ? to->channels : ",", name);
    if (!(to->bake.maps & BAKE_MAPS_ALL))
        return 0;
    if (map)
        map->no_file = false;
    else
        add_transfer(&to->transfers, cli_keep_text("%s", name), NULL);
    use_transfers(to);
    return 0;
}

/* Replaces, in the packs of a preset, a channel that the scans do not have: as glTF has it, what
 * has no roughness is rough, and what has no value of another kind has 0. */
static int fill_pack(struct cli *cli, struct bake_arguments *arguments, const char *name)
{
    const bool rough = strcmp(name, "roughness") == 0;
    BSQ_PASS(bsq_warn_loss(cli->ctx, "--preset: the scan has no %s: the packed map has %d there",
                           name, rough));
    for (uint32_t i = 0; i < arguments->bake.pack_count; i++) {
        char *list = (char *)(uintptr_t)arguments->packs[i].maps, *word = strstr(list, name);
        if (!word)
            continue;
        const bool inverted = word - list >= 2 && strncmp(word - 2, "1-", 2) == 0;
        char *to = inverted ? word - 2 : word;
        *to = rough != inverted ? '1' : '0';
        memmove(to + 1, word + strlen(name), strlen(word + strlen(name)) + 1);
    }
    return 0;
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
        BSQ_PASS(fill_pack(cli, arguments, map.name));
    }
    list->count = kept;
    use_transfers(arguments);
    return 0;
}

static void bake_maps_count_tile(void *arg, const struct bake_tile_info *tile)
{
    (void)tile;
    ++*(unsigned *)arg;
}

/* Replaces what could be a token, such as <MAP>, in a part of a path that is the name of a file. */
static void take_literally(char *part, int length)
{
    for (int i = 0; i < length; i++)
        if (part[i] == '<' || part[i] == '>')
            part[i] = '_';
}

/* If the output is a folder, makes the names of maps in it: by the low-poly mesh, or by object if
 * there are several meshes. */
static int name_in_folder(struct cli *cli, struct bake_arguments *arguments)
{
    static const char *const suffixes[] = {"exr", "png", "png", "exr", "png"}; /* by preset */
    static const char *const prefixes[] = {"", "T_", "", "", ""};              /* likewise */
    struct bake_options *bake = &arguments->bake;
    const char *path = bake->output_path, *slash = strrchr(bake->mesh_path, '/');
    const char *name = slash ? slash + 1 : bake->mesh_path;
    const size_t length = strlen(path);
    const bool slashed = length > 0 && path[length - 1] == '/';
    struct stat info;
    unsigned tiles = 0;
    const bool there = stat(path, &info) == 0 && S_ISDIR(info.st_mode);
    if (!there && !slashed)
        return 0;
    if (!there && mkdir(path, 0777) != 0 && errno != EEXIST)
        return bsq_fail_errno(cli->ctx, BSQ_ECANTCREAT, errno, "%s", path);
    arguments->new_folder = there ? NULL : path;
    bsq_mute_warnings(cli->ctx, true); /* the bake reads the meshes again, and then gives them */
    const int status = bake_list_tiles(cli->ctx, bake, bake_maps_count_tile, &tiles);
    bsq_mute_warnings(cli->ctx, false);
    BSQ_PASS(status);
    const bool by_object = bake->more_mesh_count > 0 || bake->match_names;
    const char *dot = strrchr(name, '.');
    const int stem =
        by_object ? 0 : (int)(dot && dot > name ? dot - name : (ptrdiff_t)strlen(name));
    char *output =
        cli_keep_text("%s%s%s%s%.*s_<MAP>%s.%s", path, slashed ? "" : "/", prefixes[bake->preset],
                      by_object ? BAKE_OBJECT_TOKEN : "", stem, name,
                      tiles > 1 ? "." BAKE_UDIM_TOKEN : "", suffixes[bake->preset]);
    take_literally(output + length + !slashed, stem + (int)strlen(prefixes[bake->preset]));
    bake->output_path = output;
    bake->engine_names = true;
    return 0;
}

int bake_arguments_complete(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    const struct cli_table table = bake_arguments_table(arguments);
    const bool fills = bake->preset > 0 && bake->pack_count > 0 && !cli_is_given(&table, "pack");
    BSQ_PASS(name_in_folder(cli, arguments));
    BSQ_PASS(bake_check_options(cli->ctx, bake));
    BSQ_PASS(bake_inspect(cli->ctx, bake, arguments->given,
                          fills || bake->maps & BAKE_MAPS_ALL ? bake_maps_add_channel : NULL,
                          arguments));
    if (fills)
        BSQ_PASS(fill_packs(cli, arguments));
    return bake_check_options(cli->ctx, bake);
}

/* ---- packs, presets and quality ---- */

/* Adds a word of a pack to the maps that are baked. */
static void bake_maps_add_packed(struct bake_arguments *arguments, const char *word)
{
    const char *name = strncmp(word, "1-", 2) == 0 ? word + 2 : word;
    const uint32_t map = maps_of_word(name);
    if (strcmp(name, "0") == 0 || strcmp(name, "1") == 0 || *name == '\0')
        return; /* bake_check_options() refuses what is no name */
    arguments->bake.maps |= map;
    if (!map && !bake_maps_find_transfer(&arguments->transfers, name))
        add_transfer(&arguments->transfers, name, NULL);
}

static int parse_pack(struct cli *cli, struct bake_arguments *arguments, const char *text)
{
    struct bake_options *bake = &arguments->bake;
    char *name = cli_keep_text("%s", text), *equals = strchr(name, '=');
    if (!equals)
        return cli_usage(cli, "--pack: \"%s\" is not NAME=MAP,...", text);
    *equals = '\0';
    arguments->packs = cli_extend(arguments->packs, bake->pack_count, sizeof *arguments->packs);
    arguments->packs[bake->pack_count++] = (struct bake_pack){name, equals + 1};
    bake->packs = arguments->packs;
    return 0;
}

/* Bakes what packs show, beside the maps that are named or, without any, the default ones. */
static void finish_packs(struct bake_arguments *arguments)
{
    const struct cli_table table = bake_arguments_table(arguments);
    if (arguments->bake.pack_count > 0 && !cli_is_given(&table, "maps"))
        arguments->bake.maps = BAKE_MAPS_USUAL;
    for (uint32_t i = 0; i < arguments->bake.pack_count; i++) {
        char *rest = cli_keep_text("%s", arguments->packs[i].maps), *word;
        while ((word = strsep(&rest, ",")))
            bake_maps_add_packed(arguments, word);
    }
}

/* What words of --quality and --preset stand for: values of other options that are not given. */
static const struct setting {
    const char *option, *word, *name, *key, *text;
} settings[] = {
    {"quality", "draft", "samples", NULL, "1"},
    {"quality", "draft", "rays", "ao", "4"},
    {"quality", "draft", "rays", "thickness", "2"},
    {"quality", "draft", "rays", "filter", "surface"},
    {"quality", "final", "samples", NULL, "4"},
    {"quality", "final", "rays", "ao", "4096"},
    {"quality", "final", "rays", "thickness", "2048"},
    {"preset", "unreal", "normal", "green", "down"},
    {"preset", "unreal", "pack", NULL, "orm=ao,roughness,metallic"},
    {"preset", "unity", "normal", "green", "up"},
    {"preset", "unity", "pack", NULL, "mask_map=metallic,ao,0,1-roughness"},
    {"preset", "blender", "normal", "green", "up"},
    {"preset", "gltf", "normal", "green", "up"},
    {"preset", "gltf", "pack", NULL, "orm=ao,roughness,metallic"},
    {"preset", "unreal", "type", NULL, "8+16"},
    {"preset", "unity", "type", NULL, "8+16"},
    {"preset", "gltf", "type", NULL, "8+16"},
};

/* Returns whether a row has the value of a setting, which is one of its words. */
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
        return row->own_syntax ? bake_maps_take(cli, arguments, row, setting->text)
                               : cli_parse_value(cli, setting->option, row, setting->text, bake);
    }
    return 0;
}

/* OpenEXR files have no samples of 8 bits, which presets ask for in PNG files. */
static int apply_settings(struct cli *cli, struct bake_arguments *arguments)
{
    const bool is_exr = cli_ends_with(arguments->bake.output_path, ".exr");
    for (size_t i = 0; i < sizeof settings / sizeof *settings; i++)
        if (is_chosen(&arguments->bake, &settings[i]) &&
            !(is_exr && strcmp(settings[i].name, "type") == 0))
            BSQ_PASS(apply_setting(cli, arguments, &settings[i]));
    return 0;
}

/* ---- all of them ---- */

int bake_maps_take(struct cli *cli, void *arg, const struct bsq_option *row, const char *text)
{
    struct bake_arguments *arguments = arg;
    if (strcmp(row->name, "maps") == 0)
        return parse_maps(cli, arguments, text);
    return strcmp(row->name, "pack") == 0 ? parse_pack(cli, arguments, text)
                                          : parse_texture(cli, arguments, text);
}

int bake_maps_finish(struct cli *cli, struct bake_arguments *arguments)
{
    BSQ_PASS(apply_settings(cli, arguments));
    finish_packs(arguments);
    return finish_transfers(cli, arguments);
}
