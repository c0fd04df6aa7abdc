/* mesh_text.c - see mesh_text.h. */
#include "formats/mesh/mesh_text.h"

#include <string.h>

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
    struct mesh_quoted quoted;
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

bool fmt_mesh_plain_name(char *text)
{
    char *quote = text[0] == '"' ? strchr(text + 1, '"') : NULL;
    if (quote) {
        memmove(text, text + 1, (size_t)(quote - text));
        text[quote - text - 1] = '\0';
        return true;
    }
    char *end = text + 1;
    while (*text && *end && !(*end == '#' && fmt_mesh_is_blank(end[-1])))
        end++;
    if (!*text || !*end)
        return false;
    while (end > text && fmt_mesh_is_blank(end[-1]))
        end--;
    *end = '\0';
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

int fmt_mesh_hex_digit(char c)
{
    const char lower = (char)(c | 0x20);
    if (c >= '0' && c <= '9')
        return c - '0';
    return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : -1;
}
