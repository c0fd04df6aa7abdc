#include "tests/unit/formats/mesh/ply_builder.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void append(struct ply_builder *b, const void *bytes, size_t size)
{
    if (b->size + size > b->capacity) {
        b->capacity = 2 * (b->size + size);
        b->bytes = realloc(b->bytes, b->capacity);
    }
    if (!b->bytes)
        abort();
    memcpy(b->bytes + b->size, bytes, size);
    b->size += size;
}

static void append_text(struct ply_builder *b, const char *text)
{
    append(b, text, strlen(text));
}

void ply_begin(struct ply_builder *b, enum ply_test_encoding encoding, const char *header)
{
    static const char *const names[] = {"ascii", "binary_little_endian", "binary_big_endian"};
    memset(b, 0, sizeof *b);
    b->encoding = encoding;
    append_text(b, "ply\nformat ");
    append_text(b, names[encoding]);
    append_text(b, " 1.0\n");
    append_text(b, header);
    append_text(b, "end_header\n");
    b->header_size = b->size;
}

/* Stores an integer's or a float's bytes in the file's order. */
static void append_bits(struct ply_builder *b, uint64_t bits, unsigned bytes)
{
    for (unsigned i = 0; i < bytes; i++) {
        unsigned place = b->encoding == PLY_TEST_BIG ? bytes - 1 - i : i;
        unsigned char byte = (unsigned char)(bits >> 8 * place);
        append(b, &byte, 1);
    }
}

static void append_number(struct ply_builder *b, char type, double value)
{
    char text[40];
    float single = (float)value;
    uint32_t single_bits;
    uint64_t double_bits;
    memcpy(&single_bits, &single, 4);
    memcpy(&double_bits, &value, 8);
    if (b->encoding == PLY_TEST_ASCII) {
        snprintf(text, sizeof text, "%.17g ", type == 'f' ? (double)single : value);
        append_text(b, text);
    } else if (type == 'f') {
        append_bits(b, single_bits, 4);
    } else if (type == 'd') {
        append_bits(b, double_bits, 8);
    } else {
        unsigned bytes = strchr("cC", type)   ? 1
                         : strchr("sS", type) ? 2
                         : strchr("iI", type) ? 4
                                              : 8;
        append_bits(b, (uint64_t)(int64_t)value, bytes);
    }
}

void ply_put(struct ply_builder *b, const char *types, ...)
{
    va_list values;
    va_start(values, types);
    for (; *types; types++)
        append_number(b, *types, va_arg(values, double));
    va_end(values);
}

void ply_end(struct ply_builder *b)
{
    if (b->encoding == PLY_TEST_ASCII)
        append_text(b, "\n");
}

void ply_free(struct ply_builder *b)
{
    free(b->bytes);
}
