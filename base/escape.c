/* escape.c - see escape.h. */
#include "base/escape.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* Decodes the UTF-8 character at `text` (RFC 3629, section 4). Returns its bytes; 0 if it is not
 * valid. */
static int decode(const unsigned char *text, uint32_t *character)
{
    static const uint32_t least[5] = {0, 0, 0x80, 0x800, 0x10000};
    const int bytes = text[0] < 0x80             ? 1
                      : (text[0] & 0xe0) == 0xc0 ? 2
                      : (text[0] & 0xf0) == 0xe0 ? 3
                      : (text[0] & 0xf8) == 0xf0 ? 4
                                                 : 0;
    if (bytes == 0)
        return 0;
    *character = bytes == 1 ? text[0] : text[0] & (0x7fu >> bytes);
    for (int i = 1; i < bytes; i++) {
        if ((text[i] & 0xc0) != 0x80)
            return 0;
        *character = *character << 6 | (text[i] & 0x3fu);
    }
    const bool valid = *character >= least[bytes] && *character <= 0x10ffff &&
                       !(*character >= 0xd800 && *character <= 0xdfff);
    return valid ? bytes : 0;
}

/* Returns whether a terminal may act on a character instead of showing it. */
static bool is_control(uint32_t c)
{
    return c < 0x20 || (c >= 0x7f && c < 0xa0) || /* C0, delete, C1 */
           c == 0x61c || c == 0x200e || c == 0x200f || (c >= 0x2028 && c <= 0x202e) ||
           (c >= 0x2066 && c <= 0x2069) || c == 0xfeff;
}

char *bsq_escape(const char *text, int keep_newlines)
{
    static const char digits[] = "0123456789abcdef";
    char *escaped = malloc(4 * strlen(text) + 1), *to = escaped;
    const unsigned char *from = (const unsigned char *)text;
    while (escaped && *from) {
        uint32_t character;
        int bytes = decode(from, &character);
        bool shown = bytes > 0 && !is_control(character);
        if (shown || (*from == '\n' && keep_newlines)) {
            memcpy(to, from, (size_t)bytes);
            to += bytes;
            from += bytes;
            continue;
        }
        for (int i = 0; i < (bytes ? bytes : 1); i++, from++) {
            *to++ = '\\';
            *to++ = 'x';
            *to++ = digits[*from >> 4];
            *to++ = digits[*from & 15];
        }
    }
    if (escaped)
        *to = '\0';
    return escaped;
}
