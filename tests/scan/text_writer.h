/* text_writer.h - buffered OBJ text with fast fixed-point numbers, for scans of many gigabytes. */
#ifndef SCAN_TEXT_WRITER_H
#define SCAN_TEXT_WRITER_H

#include <stdint.h>
#include <stdio.h>

struct text_writer {
    FILE *file;
    char *buffer;
    size_t used;
    uint64_t written;
};

/* All functions exit with a message if writing fails: these are tools for tests. */
void text_open(struct text_writer *writer, const char *path);
void text_close(struct text_writer *writer);

/* Appends up to 128 bytes. */
void text_bytes(struct text_writer *writer, const char *bytes, size_t size);
void text_string(struct text_writer *writer, const char *string);
/* Writes a blank and a number with six decimals. */
void text_real(struct text_writer *writer, double value);
/* Writes a number without a blank. */
void text_integer(struct text_writer *writer, uint64_t value);

#endif
