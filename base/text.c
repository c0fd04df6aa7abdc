/* text.c - see text.h. */
#include "base/text.h"

#include <assert.h>
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- numbers ---- */

/* The C library has the locale "C" as a constant, so this neither allocates nor fails. */
locale_t bsq_plain_numbers(void)
{
    return uselocale(newlocale(LC_ALL_MASK, "C", (locale_t)0));
}

/* ---- escaping ---- */

/* Decodes the UTF-8 character at `text` (RFC 3629, section 4). Returns its bytes; 0 if it is not
 * valid. */
static int text_decode(const unsigned char *text, uint32_t *character)
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

char *bsq_escape(const char *text, bool keep_newlines)
{
    static const char digits[] = "0123456789abcdef";
    char *escaped = malloc(4 * strlen(text) + 1), *to = escaped;
    const unsigned char *from = (const unsigned char *)text;
    while (escaped && *from) {
        uint32_t character;
        int bytes = text_decode(from, &character);
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

/* ---- JSON ---- */

/* The factors follow from Jansson's structures json_object_t, hashtable_pair, json_array_t and
 * json_string_t. Tables double when they are full, and so does the buffer for the string that is
 * being read. */
uint64_t bsq_json_bound(const char *text, uint64_t size)
{
    uint64_t objects = 0, arrays = 0, members = 0, commas = 0, length = 0, longest = 0;
    bool in_string = false, escaped = false;
    for (uint64_t i = 0; i < size; i++) {
        const char c = text[i];
        if (in_string) {
            in_string = escaped || c != '"';
            escaped = !escaped && c == '\\';
            length++;
            longest = length > longest ? length : longest;
            continue;
        }
        objects += c == '{';
        arrays += c == '[';
        members += c == ':';
        commas += c == ',';
        in_string = c == '"';
        length = 0;
    }
    return 65536 + 256 * objects + 224 * arrays + 224 * members + 112 * commas + size + 4 * longest;
}

/* ---- copies and hashes ---- */

uint64_t bsq_text_hash(uint64_t hash, const char *text, size_t length)
{
    for (; length > 0; length--)
        hash = (hash ^ (unsigned char)*text++) * UINT64_C(0x100000001b3);
    return hash;
}

int bsq_text_copy(struct bsq_ctx *ctx, const char *text, char **out)
{
    *out = NULL;
    if (!text)
        return 0;
    const size_t size = strlen(text) + 1;
    int status = bsq_alloc(ctx, "names", size, 1, out);
    if (status == 0)
        memcpy(*out, text, size);
    return status;
}

int bsq_text_print(struct bsq_ctx *ctx, char **out, const char *format, ...)
{
    va_list arguments, again;
    va_start(arguments, format);
    va_copy(again, arguments);
    const size_t size = (size_t)vsnprintf(NULL, 0, format, arguments) + 1;
    *out = NULL;
    const int status = bsq_alloc(ctx, "names", size, 1, out);
    if (status == 0)
        vsnprintf(*out, size, format, again);
    va_end(again);
    va_end(arguments);
    return status;
}

enum { FIRST_CAPACITY = 32 };

static int text_fail_memory(struct bsq_ctx *ctx)
{
    return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "names");
}

/* ---- the memory ---- */

int bsq_tally_add(struct bsq_ctx *ctx, struct bsq_tally *tally, uint64_t bytes)
{
    tally->bytes += bytes;
    if (tally->bytes <= BSQ_FREE_BYTES)
        return 0;
    int status = bsq_reserve(ctx, "names", bytes);
    if (status == 0)
        tally->reserved += bytes;
    return status;
}

void bsq_tally_release(struct bsq_ctx *ctx, struct bsq_tally *tally)
{
    bsq_release(ctx, tally->reserved);
    *tally = (struct bsq_tally){0};
}

int bsq_tally_grow(struct bsq_ctx *ctx, struct bsq_tally *tally, uint64_t count, uint64_t size,
                   void *inout, uint64_t *capacity)
{
    void *list;
    uint64_t wanted = *capacity > 0 ? *capacity : FIRST_CAPACITY;
    if (count <= *capacity)
        return 0;
    while (wanted < count)
        wanted *= 2;
    BSQ_PASS(bsq_tally_add(ctx, tally, (wanted - *capacity) * size));
    memcpy(&list, inout, sizeof list);
    list = reallocarray(list, wanted, size);
    if (!list)
        return text_fail_memory(ctx);
    memcpy(inout, &list, sizeof list);
    *capacity = wanted;
    return 0;
}

/* ---- texts ---- */

/* Returns the cell of a text, or an empty one. Some cell must be empty. */
static uint64_t *text_find_cell(const struct bsq_texts *texts, const char *text)
{
    for (uint64_t i = bsq_text_hash(BSQ_HASH_START, text, strlen(text));; i++) {
        uint64_t *cell = &texts->cells[i & (2 * texts->capacity - 1)];
        if (*cell == 0 || strcmp(texts->list[*cell - 1], text) == 0)
            return cell;
    }
}

/* Makes space for one more text, and keeps half of the cells empty. */
static int grow(struct bsq_ctx *ctx, struct bsq_tally *tally, struct bsq_texts *texts)
{
    uint64_t capacity = texts->capacity;
    if (texts->count < capacity)
        return 0;
    int status =
        bsq_tally_grow(ctx, tally, texts->count + 1, sizeof *texts->list, &texts->list, &capacity);
    if (status == 0)
        status = bsq_tally_add(ctx, tally, 2 * (capacity - texts->capacity) * sizeof *texts->cells);
    assert(status < 0 || capacity > 0);
    uint64_t *cells = status == 0 ? calloc(2 * capacity, sizeof *cells) : NULL;
    if (!cells)
        return status < 0 ? status : text_fail_memory(ctx);
    free(texts->cells);
    texts->cells = cells;
    texts->capacity = capacity;
    for (uint64_t i = 0; i < texts->count; i++)
        *text_find_cell(texts, texts->list[i]) = i + 1;
    return 0;
}

uint64_t bsq_texts_find(const struct bsq_texts *texts, const char *text)
{
    const uint64_t cell = texts->count > 0 ? *text_find_cell(texts, text) : 0;
    return cell > 0 ? cell - 1 : texts->count;
}

int bsq_texts_add(struct bsq_ctx *ctx, struct bsq_tally *tally, struct bsq_texts *texts,
                  const char *text, uint64_t *number)
{
    *number = bsq_texts_find(texts, text);
    if (*number < texts->count)
        return 0;
    int status = grow(ctx, tally, texts);
    if (status == 0)
        status = bsq_tally_add(ctx, tally, strlen(text) + 1);
    char *copy = status == 0 ? strdup(text) : NULL;
    if (!copy)
        return status < 0 ? status : text_fail_memory(ctx);
    texts->list[texts->count++] = copy;
    *text_find_cell(texts, text) = texts->count;
    return 0;
}

void bsq_texts_free(struct bsq_texts *texts)
{
    for (uint64_t i = 0; i < texts->count; i++)
        free(texts->list[i]);
    free(texts->list);
    free(texts->cells);
    *texts = (struct bsq_texts){0};
}
