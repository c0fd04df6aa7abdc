/* corner_delta_code.h - delta coding of triangles' corner indices.
 *
 * In nearly all scans a triangle shares an edge with the previous triangle. So one of its corners
 * is new, and the index of this corner is mostly close to the last new index. A control byte has
 * two bits for each corner: the number of the same corner in the previous triangle, or CORNER_NEW.
 * Its upper two bits give the width of the differences between new indices, 1, 2 or 4 bytes.
 * Ordinary scans take about two bytes a triangle. If one difference is much wider than the others,
 * a second byte gives each width; scans whose faces have no order take about nine bytes a triangle.
 */
#ifndef VOX_PARTITION_CORNER_DELTA_CODE_H
#define VOX_PARTITION_CORNER_DELTA_CODE_H

#include <stdint.h>
#include <string.h>

/* Maximum bytes of a triangle. */
#define CORNER_CODE_MAX 26u
/* Bytes past the end that the encoder may write and the decoder may read. */
#define CORNER_CODE_SLACK 8u
#define CORNER_NEW        3u

/* State of a coder: the previous triangle and the last new index. Starts as {0}. */
struct corner_code {
    uint64_t corner[3], last;
};

/* Returns the corner of the previous triangle that has this index, or CORNER_NEW. */
static inline unsigned corner_code_match(const uint64_t before[3], uint64_t index)
{
    unsigned match = CORNER_NEW;
    match = index == before[2] ? 2 : match;
    match = index == before[1] ? 1 : match;
    return index == before[0] ? 0 : match;
}

/* Returns w so that 1 << w bytes hold the value. */
static inline unsigned corner_code_width(uint64_t value)
{
    return (value > 0xff) + (value > 0xffff) + (value > 0xffffffffu);
}

#define CORNER_WIDTH_EACH 3u /* a byte with two bits of width for each new corner follows */

/* Encodes differences, at least one of which takes four bytes or more. */
static inline uint8_t *corner_code_put_wide(const uint64_t *differences, unsigned count,
                                            unsigned control, uint8_t *to)
{
    unsigned widths = 0, bytes = 0, widest = 0;
    for (unsigned i = 0; i < count; i++) {
        unsigned width = corner_code_width(differences[i]);
        widths |= width << 2 * i;
        bytes += 1u << width;
        widest = width > widest ? width : widest;
    }
    if (widest < 3 && 4 * count <= bytes + 1) {
        *to++ = (uint8_t)(control | 2u << 6);
        widths = 0x2a;
    } else {
        *to++ = (uint8_t)(control | CORNER_WIDTH_EACH << 6);
        *to++ = (uint8_t)widths;
    }
    for (unsigned i = 0; i < count; i++, to += 1u << (widths & 3), widths >>= 2)
        memcpy(to, &differences[i], 8);
    return to;
}

/* Encodes a triangle and returns the end of its code. Indices may be any numbers; differences are
 * modulo 2^64. */
static inline uint8_t *corner_code_put(struct corner_code *code, const uint64_t index[3],
                                       uint8_t *to)
{
    uint64_t differences[4], all = 0;
    unsigned count = 0, control = 0;
    for (unsigned k = 0; k < 3; k++) {
        unsigned match = corner_code_match(code->corner, index[k]);
        uint64_t difference = index[k] - code->last;
        differences[count] = difference << 1 ^ (0 - (difference >> 63));
        all |= match == CORNER_NEW ? differences[count] : 0;
        code->last = match == CORNER_NEW ? index[k] : code->last;
        count += match == CORNER_NEW;
        control |= match << 2 * k;
    }
    memcpy(code->corner, index, sizeof code->corner);
    if (all > 0xffff)
        return corner_code_put_wide(differences, count, control, to);
    unsigned width = all > 0xff;
    *to++ = (uint8_t)(control | width << 6);
    for (unsigned i = 0; i < count; i++, to += 1u << width)
        memcpy(to, &differences[i], 8);
    return to;
}

/* Decodes a triangle and returns the end of its code. */
static inline const uint8_t *corner_code_get(struct corner_code *code, const uint8_t *from,
                                             uint64_t index[3])
{
    static const uint64_t masks[4] = {0xff, 0xffff, 0xffffffffu, UINT64_MAX};
    const unsigned control = *from++;
    unsigned widths = (control >> 6) * 0x15;
    if (control >> 6 == CORNER_WIDTH_EACH)
        widths = *from++;
    for (unsigned k = 0; k < 3; k++) {
        unsigned match = control >> 2 * k & 3;
        if (match == CORNER_NEW) {
            uint64_t value;
            memcpy(&value, from, 8);
            value &= masks[widths & 3];
            code->last += value >> 1 ^ (0 - (value & 1));
            index[k] = code->last;
            from += 1u << (widths & 3);
            widths >>= 2;
        } else {
            index[k] = code->corner[match];
        }
    }
    memcpy(code->corner, index, sizeof code->corner);
    return from;
}

#endif
