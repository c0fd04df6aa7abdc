/* tris_mend.h - corrects the checksums of a damaged chunk file. */
#ifndef FUZZ_TRIS_MEND_H
#define FUZZ_TRIS_MEND_H

#include <stddef.h>
#include <stdint.h>

/* Sets the file's size, and the checksum of each part that is inside the file. */
void tris_mend(uint8_t *data, size_t size);

#endif
