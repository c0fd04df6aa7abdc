/* index_delta_code.h - private to the sorter: index lists as differences in 1, 2, 4 or 8 bytes.
 *
 * A list is two bits of length for each index, four to a byte, followed by the differences to the
 * index before, zigzag coded so that small negative ones are short as well. With the lengths apart
 * from the data nothing in decoding waits for a branch (compare Dean, "Challenges in Building
 * Large-Scale Information Retrieval Systems", WSDM 2009, on group varint). "None" is coded as index
 * 0, others are one more. */
#ifndef VOX_READ_INDEX_DELTA_CODE_H
#define VOX_READ_INDEX_DELTA_CODE_H

#include <stdbool.h>
#include <stdint.h>

/* Bytes that a decoder may read, and an encoder write, past the end. */
#define INDEX_CODE_SLACK 8

/* Room that `count` indices need, slack included. */
uint64_t vox_index_code_bound(uint64_t count);

/* Returns the end of what was written. *end: one more than the largest index, 0 if there
 * is none; *none: FMT_MESH_NONE is among them. */
uint8_t *vox_index_code_encode(const uint64_t *indices, uint64_t count, uint8_t *to, uint64_t *end,
                               bool *none);
uint8_t *vox_index_code_encode_sizes(const uint32_t *sizes, uint64_t count, uint8_t *to);

/* Return the end of what was read. */
const uint8_t *vox_index_code_decode(const uint8_t *from, uint64_t count, uint64_t *indices);
const uint8_t *vox_index_code_decode_sizes(const uint8_t *from, uint64_t count, uint32_t *sizes);

#endif
