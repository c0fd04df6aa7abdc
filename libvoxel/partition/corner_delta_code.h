/* corner_delta_code.h - delta coding of triangles' corner indices.
 *
 * In nearly all scans a triangle shares an edge with the previous triangle. So one of its corners
 * is new, and the index of this corner is mostly close to the last new index. A control byte has
 * two bits for each corner: the number of the same corner in the previous triangle, or CORNER_NEW.
 * Its upper two bits give the width of the differences between new indices, 1, 2 or 4 bytes.
 * Ordinary scans take about two bytes a triangle. If one difference is much wider than the others,
 * a second byte gives each width. In scans whose faces have no order, all corners are new, and
 * mostly the differences take four, two and two bytes; CORNER_CODE_FAR alone says so, which makes
 * nine bytes a triangle. */
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
#define CORNER_ALL_NEW    0x3fu
/* Control bytes of three new corners whose differences take four, two and two bytes, and of others
 * with a width for each. Corners that all match have no widths, so the second one is free. */
#define CORNER_CODE_FAR  (CORNER_ALL_NEW | CORNER_WIDTH_EACH << 6)
#define CORNER_CODE_EACH (CORNER_WIDTH_EACH << 6)

/* Encodes differences, at least one of which takes four bytes or more. */
static inline uint8_t *corner_code_put_wide(const uint64_t *differences, unsigned count,
                                            unsigned control, uint8_t *to)
{
    unsigned widths = 0, bytes = 0, widest = 0;
    if (control == CORNER_ALL_NEW && differences[0] <= 0xffffffffu &&
        (differences[1] | differences[2]) <= 0xffff) {
        *to = CORNER_CODE_FAR;
        memcpy(to + 1, &differences[0], 4);
        memcpy(to + 5, &differences[1], 2);
        memcpy(to + 7, &differences[2], 2);
        return to + 9;
    }
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
        *to++ = (uint8_t)(control == CORNER_ALL_NEW ? CORNER_CODE_EACH
                                                    : control | CORNER_WIDTH_EACH << 6);
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

static inline uint64_t corner_code_signed(uint64_t difference)
{
    return difference >> 1 ^ (0 - (difference & 1));
}

/* Decodes a triangle after CORNER_CODE_FAR. */
static inline const uint8_t *corner_code_get_far(struct corner_code *code, const uint8_t *from,
                                                 uint64_t index[3])
{
    uint32_t first;
    uint16_t others[2];
    memcpy(&first, from, 4);
    memcpy(others, from + 4, 4);
    index[0] = code->corner[0] = code->last + corner_code_signed(first);
    index[1] = code->corner[1] = index[0] + corner_code_signed(others[0]);
    index[2] = code->corner[2] = code->last = index[1] + corner_code_signed(others[1]);
    return from + 8;
}

/* Decodes a triangle and returns the end of its code. */
static inline const uint8_t *corner_code_get(struct corner_code *code, const uint8_t *from,
                                             uint64_t index[3])
{
    static const uint64_t masks[4] = {0xff, 0xffff, 0xffffffffu, UINT64_MAX};
    unsigned control = *from++, widths = (control >> 6) * 0x15;
    if (control >> 6 == CORNER_WIDTH_EACH) {
        if (control == CORNER_CODE_FAR)
            return corner_code_get_far(code, from, index);
        widths = *from++;
        control = control == CORNER_CODE_EACH ? CORNER_ALL_NEW : control;
    }
    for (unsigned k = 0; k < 3; k++) {
        unsigned match = control >> 2 * k & 3;
        if (match == CORNER_NEW) {
            uint64_t value;
            memcpy(&value, from, 8);
            code->last += corner_code_signed(value & masks[widths & 3]);
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
