/* options.c - see options.h. */
#include "base/options.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/text.h"

int bsq_option_word(const char *words, const char *word)
{
    int index = 0;
    for (const char *at = words; at && *at; at += *at != '\0') {
        const size_t length = strcspn(at, " /");
        if (length == strlen(word) && memcmp(at, word, length) == 0)
            return index;
        at += length;
        index += *at == ' ';
    }
    return -1;
}

/* Copies a word of a row to `buffer`. */
static const char *copy_word(const char *words, unsigned index, char *buffer)
{
    for (; index > 0 && strchr(words, ' '); index--)
        words = strchr(words, ' ') + 1;
    snprintf(buffer, BSQ_OPTION_TEXT_BYTES, "%.*s", (int)strcspn(words, " /"), words);
    return buffer;
}

const char *bsq_option_text(const struct bsq_option *row, const void *options,
                            char buffer[BSQ_OPTION_TEXT_BYTES])
{
    const void *at = bsq_option_at(row, options);
    double number;
    if (row->kind >= BSQ_OPTION_LIST || row->own_syntax)
        return NULL;
    switch (row->kind) {
    case BSQ_OPTION_FLAG:
        return copy_word(row->words ? row->words : "no yes", *(const bool *)at, buffer);
    case BSQ_OPTION_CHOICE:
        return copy_word(row->words, *(const unsigned *)at, buffer);
    case BSQ_OPTION_COUNT:
        number = row->words && *(const uint32_t *)at == UINT32_MAX ? -1.0 : *(const uint32_t *)at;
        break;
    case BSQ_OPTION_BYTES:
        number = (double)*(const uint64_t *)at;
        break;
    case BSQ_OPTION_NUMBER:
        number = *(const double *)at;
        break;
    default:
        return *(const char *const *)at;
    }
    if (row->words && number < 0)
        return copy_word(row->words, 0, buffer);
    const locale_t host = bsq_plain_numbers();
    snprintf(buffer, BSQ_OPTION_TEXT_BYTES, "%.10g", number);
    uselocale(host);
    return isfinite(number) ? buffer : NULL;
}

void bsq_options_defaults(const struct bsq_option *rows, size_t count, void *options)
{
    for (const struct bsq_option *row = rows; row < rows + count; row++) {
        void *at = bsq_option_at(row, options);
        memset(at, 0, row->bytes);
        if (row->kind == BSQ_OPTION_COUNT || row->kind == BSQ_OPTION_CHOICE)
            *(uint32_t *)at = (uint32_t)row->usual;
        else if (row->kind == BSQ_OPTION_NUMBER)
            *(double *)at = row->usual;
        else if (row->kind == BSQ_OPTION_TEXT)
            *(const char **)at = row->text;
        else if (row->kind == BSQ_OPTION_LIST)
            *(uint32_t *)((char *)options + row->count_offset) = 0;
    }
}

static bool is_number(const struct bsq_option *row, double value)
{
    if (row->words && value < 0)
        return isfinite(value);
    return row->positive ? value > row->least && value <= row->most
                         : value >= row->least && value <= row->most;
}

static uint32_t count_words(const struct bsq_option *row)
{
    uint32_t count = 1;
    for (const char *at = row->words; *at; at++)
        count += *at == ' ';
    return count;
}

int bsq_options_check(struct bsq_ctx *ctx, const struct bsq_option *rows, size_t count,
                      const void *options)
{
    for (const struct bsq_option *row = rows; row < rows + count; row++) {
        const void *at = bsq_option_at(row, options);
        const char *name = row->member;
        const uint32_t value = row->bytes == sizeof value ? *(const uint32_t *)at : 0;
        if (row->kind == BSQ_OPTION_COUNT && !(row->words && value == UINT32_MAX) &&
            value != row->usual && (value < row->least || value > row->most))
            return bsq_fail(ctx, BSQ_EUSAGE, "%s: %u is not a whole number from %.0f to %.0f", name,
                            value, row->least, row->most);
        if (row->kind == BSQ_OPTION_CHOICE && value >= count_words(row))
            return bsq_fail(ctx, BSQ_EUSAGE, "%s: there is no choice %u", name, value);
        if (row->kind == BSQ_OPTION_NUMBER && !is_number(row, *(const double *)at))
            return bsq_fail(ctx, BSQ_EUSAGE, "%s: %g is not a number %s %g, up to %g", name,
                            *(const double *)at, row->positive ? "above" : "from", row->least,
                            row->most);
        if (row->kind == BSQ_OPTION_TEXT && !*(const char *const *)at)
            return bsq_fail(ctx, BSQ_EUSAGE, "%s is missing", name);
    }
    return 0;
}
