/* tile_files.c - see tile_files.h. */
#include "base/tile_files.h"

#include <dirent.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/file_part.h"
#include "base/job_files.h"
#include "base/sort_array.h"

static const char udim[] = "<UDIM>", uvtile[] = "<UVTILE>";

static const char *name_of(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

/* Returns the token in a path's last component, or NULL. */
static const char *find_token(const char *path, bool *is_udim)
{
    const char *name = name_of(path), *number = strstr(name, udim);
    struct bsq_part part;
    *is_udim = number != NULL;
    if (bsq_part_parse(path, &part) > 0)
        return NULL;
    return number ? number : strstr(name, uvtile);
}

bool bsq_has_tiles(const char *path)
{
    bool is_udim;
    return find_token(path, &is_udim) != NULL;
}

/* Parses a number of at most four digits without a sign. Returns its end, or NULL. */
static const char *parse_number(const char *text, uint32_t *out)
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
        at = parse_number(text, &v);
        *number = v - 1001u;
        return at == text + 4 && v > 1000 ? at : NULL;
    }
    at = *text == 'u' ? parse_number(text + 1, &u) : NULL;
    at = at && strncmp(at, "_v", 2) == 0 ? parse_number(at + 2, &v) : NULL;
    *number = (u - 1) + BSQ_TILE_COLUMNS * (v - 1);
    return at && u >= 1 && u <= BSQ_TILE_COLUMNS && v >= 1 && v <= BSQ_TILE_ROWS ? at : NULL;
}

static int add_file(struct bsq_ctx *ctx, const char *path, const char *name, uint32_t number,
                    struct bsq_tile_files *out)
{
    const size_t directory = (size_t)(name_of(path) - path), length = strlen(name);
    int status = bsq_grow(ctx, "tiles of a texture", out->count + 1, sizeof *out->list, &out->list,
                          &out->capacity);
    if (status < 0)
        return status;
    struct bsq_tile_file *file = &out->list[out->count];
    status = bsq_alloc(ctx, "tiles of a texture", directory + length + 1, 1, &file->path);
    if (status < 0)
        return status;
    memcpy(file->path, path, directory);
    memcpy(file->path + directory, name, length + 1);
    file->number = number;
    out->count++;
    return 0;
}

static int compare_files(const void *a, const void *b)
{
    const struct bsq_tile_file *x = a, *y = b;
    return x->number != y->number ? (x->number < y->number ? -1 : 1) : strcmp(x->path, y->path);
}

/* Sorts the files, and keeps one of each tile: u01_v1 and u1_v1 are the same. */
static void sort_files(struct bsq_ctx *ctx, struct bsq_tile_files *files)
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

int bsq_tile_files_find(struct bsq_ctx *ctx, const char *path, struct bsq_tile_files *out)
{
    bool is_udim;
    const char *name = name_of(path), *token = find_token(path, &is_udim);
    const size_t before = token ? (size_t)(token - name) : 0;
    char *directory = strndup(path, (size_t)(name - path));
    int status = directory ? bsq_check(ctx) : bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", path);
    DIR *folder = directory && status == 0 && token ? opendir(*directory ? directory : ".") : NULL;
    for (struct dirent *entry; status == 0 && folder && (entry = readdir(folder)) != NULL;) {
        uint32_t number;
        const char *found = entry->d_name, *end;
        if (strncmp(found, name, before) != 0 ||
            !(end = parse_tile(found + before, is_udim, &number)) ||
            strcmp(end, token + (is_udim ? strlen(udim) : strlen(uvtile))) != 0)
            continue;
        status = add_file(ctx, path, found, number, out);
    }
    if (folder)
        closedir(folder);
    free(directory);
    sort_files(ctx, out);
    if (status < 0)
        bsq_tile_files_free(ctx, out);
    return status;
}

void bsq_tile_files_free(struct bsq_ctx *ctx, struct bsq_tile_files *files)
{
    for (uint64_t i = 0; i < files->count; i++)
        bsq_free(ctx, files->list[i].path);
    bsq_free(ctx, files->list);
    *files = (struct bsq_tile_files){0};
}

int bsq_note_texture(struct bsq_ctx *ctx, const char *path, const char *format, ...)
{
    struct bsq_tile_files tiles = {0};
    char *role = NULL;
    va_list arguments;
    va_start(arguments, format);
    int length = vasprintf(&role, format, arguments);
    va_end(arguments);
    if (length < 0)
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", path);
    int status = bsq_has_tiles(path) ? bsq_tile_files_find(ctx, path, &tiles)
                                     : bsq_note_input(ctx, path, "%s", role);
    for (uint64_t i = 0; i < tiles.count && status == 0; i++)
        status = bsq_note_input(ctx, tiles.list[i].path, "%s", role);
    bsq_tile_files_free(ctx, &tiles);
    free(role);
    return status;
}
