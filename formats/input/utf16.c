/* utf16.c - see utf16.h. */
#include "formats/input/utf16.h"

enum { MARK = 0xfeff, REPLACEMENT = 0xfffd };

static uint16_t unit_at(const uint8_t *p, bool big_endian)
{
    return big_endian ? (uint16_t)(p[0] << 8 | p[1]) : (uint16_t)(p[1] << 8 | p[0]);
}

bool fmt_utf16_recognise(const uint8_t *head, uint64_t size)
{
    if (size < 2 || (unit_at(head, true) != MARK && unit_at(head, false) != MARK))
        return false;
    if (size < UTF16_HEAD_BYTES)
        return true;
    const uint16_t unit = unit_at(head + 2, unit_at(head, true) == MARK);
    return unit > 0 && unit < 0x80;
}

/* Writes a character as UTF-8; returns its length. */
static uint64_t put(uint32_t c, uint8_t *out)
{
    if (c < 0x80) {
        out[0] = (uint8_t)c;
        return 1;
    }
    if (c < 0x800) {
        out[0] = (uint8_t)(0xc0 | c >> 6);
        out[1] = (uint8_t)(0x80 | (c & 63));
        return 2;
    }
    if (c < 0x10000) {
        out[0] = (uint8_t)(0xe0 | c >> 12);
        out[1] = (uint8_t)(0x80 | (c >> 6 & 63));
        out[2] = (uint8_t)(0x80 | (c & 63));
        return 3;
    }
    out[0] = (uint8_t)(0xf0 | c >> 18);
    out[1] = (uint8_t)(0x80 | (c >> 12 & 63));
    out[2] = (uint8_t)(0x80 | (c >> 6 & 63));
    out[3] = (uint8_t)(0x80 | (c & 63));
    return 4;
}

static bool is_first(uint16_t unit)
{
    return unit >= 0xd800 && unit < 0xdc00;
}

static bool is_second(uint16_t unit)
{
    return unit >= 0xdc00 && unit < 0xe000;
}

/* Converts one unit; returns the bytes that it gives, at most UTF16_MAX_BYTES. */
static uint64_t convert_unit(struct utf16 *state, uint16_t unit, uint8_t *out)
{
    const uint16_t first = state->first;
    uint64_t made = 0;
    state->first = 0;
    if (first && is_second(unit))
        return put(0x10000 + ((uint32_t)(first - 0xd800) << 10) + (uint32_t)(unit - 0xdc00), out);
    if (first)
        made = put(REPLACEMENT, out);
    if (is_first(unit))
        state->first = unit;
    else
        made += put(is_second(unit) ? REPLACEMENT : unit, out + made);
    return made;
}

void fmt_utf16_convert(struct utf16 *state, const uint8_t *in, uint64_t in_size, bool last,
                       uint8_t *out, uint64_t out_size, uint64_t *used, uint64_t *made)
{
    uint64_t i = 0, n = 0;
    for (; i + 2 <= in_size && n + UTF16_MAX_BYTES <= out_size; i += 2) {
        const uint16_t unit = unit_at(in + i, state->big_endian);
        if (state->marked)
            n += convert_unit(state, unit, out + n);
        state->marked = true;
    }
    if (last && i + 2 > in_size && state->first && n + UTF16_MAX_BYTES <= out_size) {
        n += put(REPLACEMENT, out + n);
        state->first = 0;
    }
    *used = i;
    *made = n;
}
