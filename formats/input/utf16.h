/* utf16.h - private to formats/input: text in UTF-16 with a byte order mark, turned into UTF-8. */
#ifndef FMT_INPUT_UTF16_H
#define FMT_INPUT_UTF16_H

#include <stdbool.h>
#include <stdint.h>

/* Returns whether a file is such text, by its first UTF16_HEAD_BYTES bytes, or all if it has fewer:
 * a mark and then an ASCII character, as every mesh or material file in text begins. So no binary
 * file is taken for text. */
bool fmt_utf16_recognise(const uint8_t *head, uint64_t size);
#define UTF16_HEAD_BYTES 4

/* What a converter must know of the bytes before. All zero but for the order at first. */
struct utf16 {
    bool big_endian;
    bool marked;    /* the byte order mark has passed */
    uint16_t first; /* of a surrogate pair whose second half is to come; 0: none */
};

/* Converts whole characters, as many as there are and as `out` has space for, which is at least
 * UTF16_MAX_BYTES. Halves of surrogate pairs that are alone become U+FFFD. *used, *made: bytes of
 * `in` and `out`. last: no bytes follow those of `in`. */
void fmt_utf16_convert(struct utf16 *state, const uint8_t *in, uint64_t in_size, bool last,
                       uint8_t *out, uint64_t out_size, uint64_t *used, uint64_t *made);
#define UTF16_MAX_BYTES 8

#endif
