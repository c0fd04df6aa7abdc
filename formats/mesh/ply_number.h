/* ply_number.h - private to the PLY reader: binary numbers of any type and byte order. */
#ifndef FMT_MESH_PLY_NUMBER_H
#define FMT_MESH_PLY_NUMBER_H

#include <string.h>

#include "formats/mesh/ply_header.h"

/* Returns the 1, 2, 4 or 8 bytes at `from`. swap: in reverse order. */
static inline uint64_t ply_bits(const uint8_t *from, uint32_t bytes, bool swap)
{
    uint16_t two;
    uint32_t four;
    uint64_t eight;
    switch (bytes) {
    case 1:
        return *from;
    case 2:
        memcpy(&two, from, sizeof two);
        return swap ? __builtin_bswap16(two) : two;
    case 4:
        memcpy(&four, from, sizeof four);
        return swap ? __builtin_bswap32(four) : four;
    default:
        memcpy(&eight, from, sizeof eight);
        return swap ? __builtin_bswap64(eight) : eight;
    }
}

/* Returns an integer. Those of PLY_UINT64 above INT64_MAX become INT64_MAX, which is out of range
 * for whatever a file counts. */
static inline int64_t ply_integer(const uint8_t *from, enum ply_type type, bool swap)
{
    switch (type) {
    case PLY_INT8:
        return (int8_t)*from;
    case PLY_UINT8:
        return *from;
    case PLY_INT16:
        return (int16_t)ply_bits(from, 2, swap);
    case PLY_UINT16:
        return (uint16_t)ply_bits(from, 2, swap);
    case PLY_INT32:
        return (int32_t)ply_bits(from, 4, swap);
    case PLY_UINT32:
        return (uint32_t)ply_bits(from, 4, swap);
    case PLY_INT64:
        return (int64_t)ply_bits(from, 8, swap);
    default: {
        uint64_t bits = ply_bits(from, 8, swap);
        return bits > INT64_MAX ? INT64_MAX : (int64_t)bits;
    }
    }
}

/* Returns a number of any type. */
static inline double ply_real(const uint8_t *from, enum ply_type type, bool swap)
{
    float single;
    double number;
    if (type == PLY_FLOAT32) {
        uint32_t bits = (uint32_t)ply_bits(from, 4, swap);
        memcpy(&single, &bits, sizeof single);
        return single;
    }
    if (type == PLY_FLOAT64) {
        uint64_t bits = ply_bits(from, 8, swap);
        memcpy(&number, &bits, sizeof number);
        return number;
    }
    return (double)ply_integer(from, type, swap);
}

#endif
