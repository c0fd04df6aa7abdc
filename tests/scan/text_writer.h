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

/* Both exit with a message when the disk does not take it: these are tools for tests. */
void text_open(struct text_writer *writer, const char *path);
void text_close(struct text_writer *writer);

void text_string(struct text_writer *writer, const char *string);
/* A blank and the number with six decimals. */
void text_real(struct text_writer *writer, double value);
/* The number alone. */
void text_integer(struct text_writer *writer, uint64_t value);

#endif
