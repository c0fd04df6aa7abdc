/* paths.c - names of map files: an output path whose tokens are replaced. */
#include "libbake/udim/udim.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Returns a copy of `path` with each `token` replaced by `value`; NULL if there is no memory. The
 * caller frees it. A NULL path is allowed and gives NULL. */
static char *udim_path_replace(const char *path, const char *token, const char *value)
{
    if (!path)
        return NULL;
    size_t value_bytes = strlen(value), token_bytes = strlen(token), length = strlen(path);
    const char *at;
    for (at = strstr(path, token); at; at = strstr(at + token_bytes, token))
        length += value_bytes;
    char *out = malloc(length + 1), *to = out;
    while (out && (at = strstr(path, token))) {
        to = mempcpy(to, path, (size_t)(at - path));
        to = mempcpy(to, value, value_bytes);
        path = at + token_bytes;
    }
    if (out)
        strcpy(to, path);
    return out;
}

char *bake_map_path(const char *path, const char *name)
{
    return udim_path_replace(path, BAKE_MAP_TOKEN, name);
}

/* Returns a name as a part of a file's name: '/', control characters and the brackets of tokens
 * become '_', and so does a point at the start, so that no name leads to another folder. The caller
 * frees it. */
static char *file_name_of(const char *name)
{
    char *out = strdup(*name ? name : "_");
    for (char *c = out; c && *c; c++)
        if (*c == '/' || *c == '<' || *c == '>' || *c == '\x7f' || (*c > 0 && *c < ' ') ||
            (*c == '.' && c == out))
            *c = '_';
    return out;
}

/* Replaces a token by a name; NULL: keeps the token. */
static char *replace_name(const char *path, const char *token, const char *name)
{
    char *value = name ? file_name_of(name) : strdup(token);
    char *out = value ? udim_path_replace(path, token, value) : NULL;
    free(value);
    return out;
}

char *bake_object_path(const char *path, const char *object, const char *material)
{
    char *named = replace_name(path, BAKE_OBJECT_TOKEN, object);
    char *out = replace_name(named, BAKE_MATERIAL_TOKEN, material);
    free(named);
    return out;
}

char *bake_tile_path(const char *path, uint32_t tile)
{
    const uint32_t place = tile - BAKE_FIRST_TILE;
    char number[16], uv[32];
    snprintf(number, sizeof number, "%u", tile);
    snprintf(uv, sizeof uv, "u%u_v%u", place % 10 + 1, place / 10 + 1);
    char *numbered = udim_path_replace(path, BAKE_UDIM_TOKEN, number);
    char *out = udim_path_replace(numbered, BAKE_UVTILE_TOKEN, uv);
    free(numbered);
    return out;
}
