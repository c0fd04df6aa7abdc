/* mesh_text.c - see mesh_text.h. */
#include "formats/mesh/mesh_text.h"

#include <dirent.h>
#include <limits.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

#include "base/file.h"
#include "base/text.h"
#include "formats/material/tile_files.h"

void fmt_mesh_quote(const char *text, const char *end, char *out, size_t size)
{
    size_t length = 0;
    for (; text < end && *text != '\n' && *text != '\r'; text++) {
        if (length + 4 >= size) {
            memcpy(out + length, "...", 3);
            length += 3;
            break;
        }
        out[length++] = *text == '\t' ? ' ' : *text ? *text : '?';
    }
    out[length] = '\0';
}

struct mesh_quoted fmt_mesh_quote_word(const char *text)
{
    struct mesh_quoted quoted = {""};
    const char *end = text;
    while (*end && !fmt_mesh_is_blank(*end) && *end != '\n' && *end != '\r')
        end++;
    fmt_mesh_quote(text, end, quoted.text, sizeof quoted.text);
    return quoted;
}

size_t fmt_mesh_mark(const void *text, uint64_t size)
{
    return size >= 3 && memcmp(text, "\xef\xbb\xbf", 3) == 0 ? 3 : 0;
}

bool fmt_mesh_unquote(char *text)
{
    char *quote = text[0] == '"' ? strchr(text + 1, '"') : NULL;
    if (!quote)
        return false;
    *quote = '\0';
    memmove(text, text + 1, (size_t)(quote - text));
    return true;
}

void fmt_mesh_tidy_name(char *text)
{
    size_t length = 0;
    for (; text[length]; length++)
        if (text[length] == '#' && length > 0 && fmt_mesh_is_blank(text[length - 1]) &&
            (text[length + 1] == '\0' || fmt_mesh_is_blank(text[length + 1])))
            break;
    while (length > 0 && fmt_mesh_is_blank(text[length - 1]))
        length--;
    const bool quoted = length >= 2 && text[0] == '"' && text[length - 1] == '"';
    if (quoted)
        memmove(text, text + 1, length -= 2);
    text[length] = '\0';
}

uint64_t fmt_mesh_statement_size(const char *text, enum mesh_continued continued, uint64_t *lines)
{
    const char *p = text;
    for (int size; *p != '\0' && !fmt_mesh_line_end(p); p++) {
        if (*p != '\\' || continued == MESH_NOT_CONTINUED ||
            (continued == MESH_CONTINUED_NAMES && (p == text || (unsigned char)p[-1] > ' ')))
            continue;
        size = fmt_mesh_line_end(p + 1);
        p += size;
        *lines += size > 0;
    }
    return (uint64_t)(p - text);
}

int fmt_mesh_hex_digit(char c)
{
    const char lower = (char)(c | 0x20);
    if (c >= '0' && c <= '9')
        return c - '0';
    return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : -1;
}

/* ---- the files that mesh and material files name ---- */

/* Ways to read a name, in the order of the trials. */
enum form { AS_WRITTEN, WITH_SLASHES, LAST_COMPONENT, FORM_COUNT };

/* Returns the length of the directory of a file, with its slash. */
static size_t directory_length(const char *path)
{
    return (size_t)(bsq_file_name(path) - path);
}

int fmt_path_beside(struct bsq_ctx *ctx, const char *beside, const char *path, char **out)
{
    const size_t directory = path[0] == '/' ? 0 : directory_length(beside);
    return bsq_text_print(ctx, out, "%.*s%s", (int)directory, beside, path);
}

/* Checks that a path is a regular file, or that a texture of tiles has a tile. */
static int check_file(struct bsq_ctx *ctx, const char *path, bool *is_file)
{
    struct fmt_tile_files tiles = {0};
    struct stat info;
    int status = 0;
    if (fmt_has_tiles(path)) {
        status = fmt_tile_files_find(ctx, path, &tiles);
        *is_file = tiles.count > 0;
        fmt_tile_files_free(ctx, &tiles);
    } else {
        *is_file = stat(path, &info) == 0 && S_ISREG(info.st_mode);
    }
    return status;
}

/* ---- capitals ---- */

/* Replaces the last component of `path`, which begins at `name`, by an entry of its directory that
 * differs in its capitals. Takes the first one in the order of bytes. Returns whether there is one.
 */
static bool find_entry(char *path, char *name)
{
    char best[NAME_MAX + 1] = "";
    const char first = *name;
    *name = '\0';
    DIR *directory = opendir(name == path ? "." : path);
    *name = first;
    for (struct dirent *entry; directory && (entry = readdir(directory)) != NULL;)
        if (strcasecmp(entry->d_name, name) == 0 && (!*best || strcmp(entry->d_name, best) < 0))
            strcpy(best, entry->d_name);
    if (directory)
        closedir(directory);
    memcpy(name, best, strlen(best));
    return *best != '\0';
}

/* Gives the components of `path` from byte `from` on the capitals of folders and files that exist;
 * those that exist as they are stay so, and the token of a texture of tiles. *found: all exist. */
static int match_capitals(struct bsq_ctx *ctx, char *path, size_t from, bool *found)
{
    struct stat info;
    *found = true;
    for (char *name = path + from, *next; *name && *found; name = next) {
        char *end = strchrnul(name, '/');
        next = end + (*end == '/');
        const char end_byte = *end, next_byte = *next;
        *next = '\0'; /* a path that ends in a slash is a folder */
        *found = end == name || stat(path, &info) == 0 || (!end_byte && fmt_has_tiles(path));
        *next = next_byte;
        if (*found)
            continue;
        *end = '\0';
        *found = find_entry(path, name);
        *end = end_byte;
        BSQ_PASS(bsq_check(ctx));
    }
    return 0;
}

/* ---- trials ---- */

/* Looks for a file that a text names in this form, unless that of an earlier form is the same. Sets
 * *out to its path; NULL: there is none. */
static int try_name(struct bsq_ctx *ctx, const char *beside, const char *text, enum form form,
                    char **out)
{
    const char *name = text;
    bool found = false;
    if (form == LAST_COMPONENT) {
        name = bsq_file_name(text);
        const char *backslash = strrchr(name, '\\');
        name = backslash ? backslash + 1 : name;
    }
    const bool tried =
        (form == WITH_SLASHES && !strchr(name, '\\')) || (form == LAST_COMPONENT && name == text);
    if (!*name || tried)
        return 0;
    const size_t directory = name[0] == '/' ? 0 : directory_length(beside);
    BSQ_PASS(bsq_check(ctx)); /* directories may be long */
    BSQ_PASS(fmt_path_beside(ctx, beside, name, out));
    for (char *c = *out + directory; *c && form == WITH_SLASHES; c++)
        *c = *c == '\\' ? '/' : *c;
    int status = match_capitals(ctx, *out, directory, &found);
    if (!status && found)
        status = check_file(ctx, *out, &found);
    if (status || !found) {
        bsq_free(ctx, *out);
        *out = NULL;
    }
    return status;
}

int fmt_path_find(struct bsq_ctx *ctx, const char *beside, const char *name, char **out,
                  bool *exists)
{
    char *bare = NULL;
    int status;
    *out = NULL;
    BSQ_TRY(bsq_text_copy(ctx, name, &bare));
    const bool quoted = fmt_mesh_unquote(bare);
    for (enum form form = AS_WRITTEN; form < FORM_COUNT && !*out; form++) {
        BSQ_TRY(try_name(ctx, beside, name, form, out));
        if (quoted && !*out)
            BSQ_TRY(try_name(ctx, beside, bare, form, out));
    }
    *exists = *out != NULL;
    if (*exists)
        goto done;
    if (!quoted)
        fmt_mesh_tidy_name(bare);
    status = fmt_path_beside(ctx, beside, bare, out);
done:
    bsq_free(ctx, bare);
    return status;
}
