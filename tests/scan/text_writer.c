/* text_writer.c - formats numbers into a buffer of 1 MiB. */
#include "tests/scan/text_writer.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { BUFFER_BYTES = 1 << 20, LONGEST_ITEM = 128 };

static void die(const char *what)
{
    fprintf(stderr, "scan: %s: %s\n", what, strerror(errno));
    exit(74);
}

void text_open(struct text_writer *writer, const char *path)
{
    writer->file = fopen(path, "wb");
    writer->buffer = malloc(BUFFER_BYTES);
    writer->used = 0;
    writer->written = 0;
    if (!writer->file || !writer->buffer)
        die(path);
    setvbuf(writer->file, NULL, _IONBF, 0);
}

static void flush(struct text_writer *writer)
{
    if (fwrite(writer->buffer, 1, writer->used, writer->file) != writer->used)
        die("writing");
    writer->written += writer->used;
    writer->used = 0;
}

void text_close(struct text_writer *writer)
{
    flush(writer);
    if (fclose(writer->file))
        die("closing");
    free(writer->buffer);
}

/* Returns where the next item goes; it may be up to LONGEST_ITEM long. */
static char *next_item(struct text_writer *writer)
{
    if (writer->used > BUFFER_BYTES - LONGEST_ITEM)
        flush(writer);
    return writer->buffer + writer->used;
}

void text_bytes(struct text_writer *writer, const char *bytes, size_t size)
{
    memcpy(next_item(writer), bytes, size);
    writer->used += size;
}

void text_string(struct text_writer *writer, const char *string)
{
    for (; *string; string++) {
        *next_item(writer) = *string;
        writer->used++;
    }
}

static char *put_digits(char *end, uint64_t value)
{
    do
        *--end = (char)('0' + value % 10);
    while (value /= 10);
    return end;
}

void text_integer(struct text_writer *writer, uint64_t value)
{
    char digits[24], *end = digits + sizeof digits, *start = put_digits(end, value);
    memcpy(next_item(writer), start, (size_t)(end - start));
    writer->used += (size_t)(end - start);
}

void text_real(struct text_writer *writer, double value)
{
    char digits[32], *end = digits + sizeof digits, *p = end;
    uint64_t millionths = (uint64_t)llround(fabs(value) * 1e6);
    for (int i = 0; i < 6; i++, millionths /= 10)
        *--p = (char)('0' + millionths % 10);
    *--p = '.';
    p = put_digits(p, millionths);
    if (value < 0)
        *--p = '-';
    *--p = ' ';
    memcpy(next_item(writer), p, (size_t)(end - p));
    writer->used += (size_t)(end - p);
}
