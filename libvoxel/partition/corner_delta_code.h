/* corner_delta_code.h - private to the sorter: triangles' corner indices as bytes.
 *
 * In nearly all scans a triangle shares an edge with the one before it, so of its corners one is
 * new, and that one mostly lies close to the last new one. A byte says for each corner which corner
 * of the triangle before it is, or that it is new, and how many bytes the differences of new ones
 * to the last new one take: about two bytes a triangle in all. Where faces have no order the first
 * corner is far from the last one, but the others mostly are near it; then a second byte tells each
 * difference's bytes, about nine a triangle in all. */
#ifndef VOX_READ_CORNER_DELTA_CODE_H
#define VOX_READ_CORNER_DELTA_CODE_H

#include <stdint.h>
#include <string.h>

/* Bytes that a triangle takes at most. */
#define CORNER_CODE_MAX 26u
/* Bytes past the end that encoding may write and decoding may read. */
#define CORNER_CODE_SLACK 8u
#define CORNER_NEW        3u

/* The triangle before and the last new index. Starts as {0}, for both directions. */
struct corner_code {
    uint64_t corner[3], last;
};

/* Which corner of the triangle before has this index, or CORNER_NEW. */
static inline unsigned corner_code_match(const uint64_t before[3], uint64_t index)
{
    unsigned match = CORNER_NEW;
    match = index == before[2] ? 2 : match;
    match = index == before[1] ? 1 : match;
    return index == before[0] ? 0 : match;
}

/* 1 << this many bytes hold the value. */
static inline unsigned corner_code_width(uint64_t value)
{
    return (value > 0xff) + (value > 0xffff) + (value > 0xffffffffu);
}

#define CORNER_WIDTH_EACH 3u /* a byte of widths follows, two bits for each new corner */

/* Differences of which one takes four bytes or more. */
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

/* Indices are any numbers; differences are taken modulo 2^64. Returns the end of what was written.
 */
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

/* Returns the end of what was read. */
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
