/* corner_code.h - private to the sorter: triangles' corner indices as bytes.
 *
 * In nearly all scans a triangle shares an edge with the one before it, so of its corners one is
 * new, and that one mostly lies close to the last new one. A byte says for each corner which corner
 * of the triangle before it is, or that it is new, and how many bytes the differences of new ones
 * to the last new one take: about two bytes a triangle in all. */
#ifndef VOX_CORNER_CODE_H
#define VOX_CORNER_CODE_H

#include <stdint.h>
#include <string.h>

/* Bytes that a triangle takes at most. */
#define CORNER_CODE_MAX 25u
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
    unsigned width = (all > 0xff) + (all > 0xffff) + (all > 0xffffffffu);
    *to++ = (uint8_t)(control | width << 6);
    for (unsigned i = 0; i < count; i++, to += 1u << width)
        memcpy(to, &differences[i], 8);
    memcpy(code->corner, index, sizeof code->corner);
    return to;
}

/* Returns the end of what was read. */
static inline const uint8_t *corner_code_get(struct corner_code *code, const uint8_t *from,
                                             uint64_t index[3])
{
    static const uint64_t masks[4] = {0xff, 0xffff, 0xffffffffu, UINT64_MAX};
    const unsigned control = *from++, width = control >> 6;
    for (unsigned k = 0; k < 3; k++) {
        unsigned match = control >> 2 * k & 3;
        if (match == CORNER_NEW) {
            uint64_t value;
            memcpy(&value, from, 8);
            value &= masks[width];
            code->last += value >> 1 ^ (0 - (value & 1));
            index[k] = code->last;
            from += 1u << width;
        } else {
            index[k] = code->corner[match];
        }
    }
    memcpy(code->corner, index, sizeof code->corner);
    return from;
}

#endif
