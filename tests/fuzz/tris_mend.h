/* tris_mend.h - right sums for a damaged chunk file. */
#ifndef FUZZ_TRIS_MEND_H
#define FUZZ_TRIS_MEND_H

#include <stddef.h>
#include <stdint.h>

/* Sets the file's size and all checksums as far as their parts lie in the file. */
void tris_mend(uint8_t *data, size_t size);

#endif
