/* tile_files.c - see tile_files.h. */
#include "formats/material/tile_files.h"

#include <dirent.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "formats/material/file_extent.h"
#include "base/sort_array.h"
#include "base/text.h"

static const char udim[] = "<UDIM>", uvtile[] = "<UVTILE>";

/* Returns the length of the token that a text begins with; 0: none. */
static size_t token_at(const char *text, bool *is_udim)
{
    *is_udim = strncmp(text, udim, strlen(udim)) == 0;
    return *is_udim                                     ? strlen(udim)
           : strncmp(text, uvtile, strlen(uvtile)) == 0 ? strlen(uvtile)
                                                        : 0;
}

/* Returns the first component of a path that has a token, or NULL. */
static const char *find_component(const char *path)
{
    const char *component = path;
    bool is_udim;
    for (const char *at = path; *at; at++) {
        if (token_at(at, &is_udim) > 0)
            return component;
        component = *at == '/' ? at + 1 : component;
    }
    return NULL;
}

bool fmt_has_tiles(const char *path)
{
    struct fmt_extent extent;
    return find_component(path) != NULL && fmt_extent_parse(path, &extent) == 0;
}

size_t fmt_tile_folder(const char *path)
{
    const char *component = find_component(path);
    return component ? (size_t)(component - path) : strlen(path);
}

/* Parses a number of at most four digits without a sign. Returns its end, or NULL. */
static const char *tile_files_parse_number(const char *text, uint32_t *out)
{
    const char *at = text;
    *out = 0;
    while (*at >= '0' && *at <= '9' && at - text < 4)
        *out = 10 * *out + (uint32_t)(*at++ - '0');
    return at > text ? at : NULL;
}

/* Parses what stands for a token. Returns its end, or NULL if it is no tile. */
static const char *parse_tile(const char *text, bool is_udim, uint32_t *number)
{
    uint32_t u = 0, v = 0;
    const char *at;
    if (is_udim) {
        at = tile_files_parse_number(text, &v);
        *number = v - 1001u;
        return at == text + 4 && v > 1000 ? at : NULL;
    }
    at = *text == 'u' ? tile_files_parse_number(text + 1, &u) : NULL;
    at = at && strncmp(at, "_v", 2) == 0 ? tile_files_parse_number(at + 2, &v) : NULL;
    *number = (u - 1) + FMT_TILE_COLUMNS * (v - 1);
    return at && u >= 1 && u <= FMT_TILE_COLUMNS && v >= 1 && v <= FMT_TILE_ROWS ? at : NULL;
}

/* A tile while its file is looked for. */
struct tile {
    bool known;
    uint32_t number;
};

/* Returns whether a name matches a component of a path up to `end`. All tokens must stand for one
 * tile: the one in *tile, which is set if it is not known. */
static bool matches(const char *component, const char *end, const char *name, struct tile *tile)
{
    while (component < end) {
        uint32_t number;
        bool is_udim;
        const size_t token = token_at(component, &is_udim);
        if (token == 0 && *component++ != *name++)
            return false;
        if (token == 0)
            continue;
        name = parse_tile(name, is_udim, &number);
        if (!name || (tile->known && number != tile->number))
            return false;
        *tile = (struct tile){true, number};
        component += token;
    }
    return *name == '\0';
}

/* Adds a file, if there is a regular one of this path. */
static int tile_files_add(struct bsq_ctx *ctx, const char *path, uint32_t number,
                          struct fmt_tile_files *out)
{
    struct stat info;
    if (stat(path, &info) != 0 || !S_ISREG(info.st_mode))
        return 0;
    BSQ_PASS(BSQ_GROW(ctx, "tiles of a texture", out->count + 1, &out->list, &out->capacity));
    out->list[out->count].number = number;
    const int status = bsq_text_copy(ctx, path, &out->list[out->count].path);
    out->count += status == 0;
    return status;
}

/* Lists the files whose path begins with `folder`, which is "" or ends in a slash, and matches
 * `rest` after that. Calls itself for the entries of a folder that match the next component with a
 * token: at most as deep as folders are. */
static int find_files(struct bsq_ctx *ctx, const char *folder, const char *rest, struct tile tile,
                      struct fmt_tile_files *out)
{
    const char *component = find_component(rest);
    char *path = NULL;
    int status = bsq_check(ctx);
    if (status == 0)
        status = bsq_text_print(ctx, &path, "%s%.*s", folder, (int)fmt_tile_folder(rest), rest);
    if (status == 0 && !component)
        status = tile_files_add(ctx, path, tile.number, out);
    DIR *entries = status == 0 && component ? opendir(*path ? path : ".") : NULL;
    const char *end = component ? component + strcspn(component, "/") : NULL;
    for (struct dirent *entry; status == 0 && entries && (entry = readdir(entries)) != NULL;) {
        struct tile found = tile;
        char *next;
        if (!matches(component, end, entry->d_name, &found))
            continue;
        status = bsq_text_print(ctx, &next, "%s%s%s", path, entry->d_name, *end ? "/" : "");
        if (status == 0)
            status = find_files(ctx, next, *end ? end + 1 : end, found, out);
        bsq_free(ctx, next);
    }
    if (entries)
        closedir(entries);
    bsq_free(ctx, path);
    return status;
}

static int compare_files(const void *a, const void *b)
{
    const struct fmt_tile_file *x = a, *y = b;
    return x->number != y->number ? (x->number < y->number ? -1 : 1) : strcmp(x->path, y->path);
}

/* Sorts the files, and keeps one of each tile: u01_v1 and u1_v1 are the same. */
static void sort_files(struct bsq_ctx *ctx, struct fmt_tile_files *files)
{
    uint64_t kept = 0;
    bsq_sort(files->list, files->count, sizeof *files->list, compare_files);
    for (uint64_t i = 0; i < files->count; i++)
        if (kept > 0 && files->list[kept - 1].number == files->list[i].number)
            bsq_free(ctx, files->list[i].path);
        else
            files->list[kept++] = files->list[i];
    files->count = kept;
}

int fmt_tile_files_find(struct bsq_ctx *ctx, const char *path, struct fmt_tile_files *out)
{
    int status = fmt_has_tiles(path) ? find_files(ctx, "", path, (struct tile){0}, out) : 0;
    sort_files(ctx, out);
    if (status < 0)
        fmt_tile_files_free(ctx, out);
    return status;
}

void fmt_tile_files_free(struct bsq_ctx *ctx, struct fmt_tile_files *files)
{
    for (uint64_t i = 0; i < files->count; i++)
        bsq_free(ctx, files->list[i].path);
    bsq_free(ctx, files->list);
    *files = (struct fmt_tile_files){0};
}

int fmt_note_texture(struct bsq_ctx *ctx, const char *path, const char *format, ...)
{
    struct fmt_tile_files tiles = {0};
    char *role = NULL;
    va_list arguments;
    va_start(arguments, format);
    int length = vasprintf(&role, format, arguments);
    va_end(arguments);
    if (length < 0)
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", path);
    int status = fmt_has_tiles(path) ? fmt_tile_files_find(ctx, path, &tiles)
                                     : bsq_note_input(ctx, path, "%s", role);
    for (uint64_t i = 0; i < tiles.count && status == 0; i++)
        status = bsq_note_input(ctx, tiles.list[i].path, "%s", role);
    fmt_tile_files_free(ctx, &tiles);
    free(role);
    return status;
}
