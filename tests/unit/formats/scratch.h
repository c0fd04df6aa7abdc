/* scratch.h - a temporary directory for the files of a test program, for cmocka. */
#ifndef TEST_SCRATCH_H
#define TEST_SCRATCH_H

#include <stddef.h>

extern char scratch_directory[64];
int scratch_make(void **state);
/* Removes the directory with all its files. */
int scratch_remove(void **state);

/* Returns the path of a file in the directory; the last eight paths stay valid. */
const char *scratch_path(const char *name);
/* Write a file there; return its path. */
const char *scratch_bytes(const char *name, const void *bytes, size_t size);
const char *scratch_text(const char *name, const char *text);

#endif
