/* scratch.h - a directory for a test program's files, for cmocka's group set-up and tear-down. */
#ifndef TEST_SCRATCH_H
#define TEST_SCRATCH_H

#include <stddef.h>

extern char scratch_directory[64];
int scratch_make(void **state);
/* With all that is in it. */
int scratch_remove(void **state);

/* Path of a file in the directory; the last eight stay valid. */
const char *scratch_path(const char *name);
/* Write a file there, and give its path. */
const char *scratch_bytes(const char *name, const void *bytes, size_t size);
const char *scratch_text(const char *name, const char *text);

#endif
