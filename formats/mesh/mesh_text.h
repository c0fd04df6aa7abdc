/* mesh_text.h - private to formats/mesh: names, text for messages, and files that others name. */
#ifndef FMT_MESH_TEXT_H
#define FMT_MESH_TEXT_H

#include "base/context.h"

/* Returns the bytes of the byte order mark that text in UTF-8 may begin with: 3, or 0. */
size_t fmt_mesh_mark(const void *text, uint64_t size);

/* Takes a name out of quotes, in place, and drops what follows them. Returns whether there are any.
 */
bool fmt_mesh_unquote(char *text);

/* Returns whether a character of a line separates words. */
static inline bool fmt_mesh_is_blank(char c)
{
    return c == ' ' || c == '\t';
}

/* Returns whether a character is a blank, a line end or another control character, but not zero. */
static inline bool fmt_mesh_is_space(char c)
{
    return c != '\0' && (unsigned char)c <= ' ';
}

/* Returns the number of such characters at the start of a text. */
static inline uint64_t fmt_mesh_count_space(const void *text, uint64_t size)
{
    uint64_t count = 0;
    while (count < size && fmt_mesh_is_space(((const char *)text)[count]))
        count++;
    return count;
}

/* Returns the length of the line end at p ("\n", "\r\n" or a lone "\r"); 0 if there is none. */
static inline int fmt_mesh_line_end(const char *p)
{
    if (*p == '\n')
        return 1;
    return *p == '\r' ? 1 + (p[1] == '\n') : 0;
}

/* Which statements go on in the next line after a backslash at the end of a line. */
enum mesh_continued {
    MESH_NOT_CONTINUED,  /* comments: one that ends so, as a Windows path does, must not swallow the
                            line after it */
    MESH_CONTINUED,      /* numbers */
    MESH_CONTINUED_NAMES /* after a blank only: elsewhere it is the end of a name */
};
/* Returns the bytes from `text` to the end of its statement: a line end, or a zero. Adds the line
 * ends before that to *lines. */
uint64_t fmt_mesh_statement_size(const char *text, enum mesh_continued continued, uint64_t *lines);

/* Returns the value of a hexadecimal digit, or -1. */
int fmt_mesh_hex_digit(char c);

/* Makes a name fit for output, in place: without a comment, which begins with "#" after a blank and
 * before a blank or the end, and without quotes around all of it. Keeps "wall #3". */
void fmt_mesh_tidy_name(char *text);

/* Copies text of a file into `out` for a message: one line, printable, shortened. */
void fmt_mesh_quote(const char *text, const char *end, char *out, size_t size);
/* Returns the word at `text`, which a blank, a line end or a zero ends, for a message. */
struct mesh_quoted {
    char text[44];
};
struct mesh_quoted fmt_mesh_quote_word(const char *text);

/* Joins the directory of the file `beside` and a path; an absolute path stays as it is. Free *out
 * with bsq_free(). Errors: BSQ_ENOMEM. */
int fmt_path_beside(struct bsq_ctx *ctx, const char *beside, const char *path, char **out);

/* Finds the file `name` that the file `beside` refers to. Tries in this order: the name as written,
 * relative to the directory of `beside`; its backslashes as slashes, since many files come from
 * Windows; its last component alone, since absolute paths rarely survive a copy. Each of them is
 * tried as it is, then without quotes around it; and each with these capitals, then with folders
 * and a file that differ in capitals. A texture of tiles (formats/material/tile_files.h) exists if
 * a tile does, and its last component keeps its capitals. *out is the first file, otherwise the
 * name without quotes or comment; free it with bsq_free(). Errors: BSQ_ENOMEM, BSQ_EINTR; then *out
 * is NULL. */
int fmt_path_find(struct bsq_ctx *ctx, const char *beside, const char *name, char **out,
                  bool *exists);

#endif
