/* mesh_text.c - see mesh_text.h. */
#include "formats/mesh/mesh_text.h"

#include <string.h>

int fmt_string_copy(struct bsq_ctx *ctx, const char *text, char **out)
{
    size_t size = strlen(text) + 1;
    int status = bsq_alloc(ctx, "names", size, 1, out);
    if (!status)
        memcpy(*out, text, size);
    return status;
}

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
