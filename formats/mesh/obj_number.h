/* obj_number.h - decimal numbers and indices from text, without locale.
 *
 * A number is rounded to the nearest double, ties to even, as strtod() does in the C locale. The
 * inline part handles the form of nearly all numbers, "-12.345678": its digits and point lie in 16
 * bytes, and one shuffle turns them into an integer of at most 15 digits. That integer and the
 * power of ten are exact doubles, so one division rounds correctly (Clinger, "How to Read Floating
 * Point Numbers Accurately", PLDI 1990). Whole numbers of at most 15 digits are exact too. All
 * other forms go to fmt_obj_number_general().
 *
 * Callers guarantee OBJ_TEXT_PADDING readable bytes after the text, and a line end before them. */
#ifndef FMT_MESH_OBJ_NUMBER_H
#define FMT_MESH_OBJ_NUMBER_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>
#ifdef __SSE4_1__
#include <smmintrin.h>
#endif

#define OBJ_TEXT_PADDING 64

#ifdef __cplusplus
extern "C" {
#endif

/* Returns true for what may follow a number: blank, control character, continuation. A comment may
 * not: "1.#QNAN" is how some C libraries print a NaN. */
static inline bool obj_is_delimiter(char c)
{
    return (unsigned char)c <= ' ' || c == '\\';
}

/* Parses any decimal number at `text` into *out and returns the position after it. Returns NULL if
 * there is no number, if it is not finite, or if no delimiter follows it. */
const char *fmt_obj_number_general(const char *text, double *out);

/* Returns the position after a word at `text` that stands for a number that is not finite: "nan",
 * "-inf", "1.#QNAN", "-nan(ind)" in any case, and numbers beyond the largest double, such as
 * "1e999". Returns NULL for any other text. */
const char *fmt_obj_not_finite(const char *text);

#ifdef __cplusplus
}
#endif

#ifdef __SSE4_1__
/* Returns four groups of four decimal digits, the highest first: the digits of text[0..end) without
 * the point at `point`; end <= 16. `digits` holds the text's bytes minus '0'. */
static inline __m128i obj_digit_groups(__m128i digits, int point, int end)
{
    const __m128i iota = _mm_setr_epi8(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    /* Right-aligns: lanes before the first digit get a negative source, which shuffles to zero. */
    __m128i source = _mm_sub_epi8(iota, _mm_set1_epi8((char)(17 - end)));
    source = _mm_sub_epi8(source, _mm_cmpgt_epi8(source, _mm_set1_epi8((char)(point - 1))));
    __m128i d = _mm_shuffle_epi8(digits, source);
    d = _mm_maddubs_epi16(d, _mm_set1_epi16(1 << 8 | 10));
    return _mm_madd_epi16(d, _mm_set1_epi32(1 << 16 | 100));
}

/* Joins the groups of two numbers to the upper and lower eight digits of each, one number after the
 * other. */
static inline __m128i obj_join_groups(__m128i a, __m128i b)
{
    return _mm_madd_epi16(_mm_packus_epi32(a, b), _mm_set1_epi32(1 << 16 | 10000));
}

/* Returns the integer that all digits form. */
static inline uint64_t obj_digits_without_point(__m128i digits, int point, int end)
{
    __m128i groups = obj_digit_groups(digits, point, end);
    uint64_t halves = (uint64_t)_mm_cvtsi128_si64(obj_join_groups(groups, groups));
    return (halves & 0xffffffffu) * 100000000u + (halves >> 32);
}
#endif

/* Returns the value of `count` (1 to 8) decimal digits at `text`, where 8 bytes are readable.
 * Works on all bytes at a time (Lamport, "Multiple Byte Processing with Full-Word Instructions",
 * CACM 1975): first pairs of digits, then pairs of pairs, then pairs of those. Needs a
 * little-endian machine. */
static inline uint64_t obj_digits_value(const char *text, unsigned count)
{
    uint64_t digits;
    memcpy(&digits, text, sizeof digits);
    digits = (digits ^ 0x3030303030303030u) << (64 - 8 * count);
    digits = digits * 10 + (digits >> 8);
    return ((digits & 0x000000ff000000ffu) * 0x000f424000000064u +
            ((digits >> 16) & 0x000000ff000000ffu) * 0x0000271000000001u) >>
           32;
}

/* Returns the number of leading decimal digits (0 to 8) in 8 bytes of text. */
static inline unsigned obj_count_digits(const char *text)
{
    uint64_t digits;
    memcpy(&digits, text, sizeof digits);
    digits ^= 0x3030303030303030u;
    /* The high bit of each byte outside 0..9. A carry can only spoil later bytes. */
    uint64_t others = ((digits + 0x7676767676767676u) | digits) & 0x8080808080808080u;
    return others ? (unsigned)__builtin_ctzll(others) >> 3 : 8;
}

/* Parses an unsigned integer of at most 18 digits. Returns NULL if there is none or it is longer.
 */
static inline const char *obj_integer(const char *text, uint64_t *out)
{
    static const uint32_t scale[9] = {1,      10,      100,      1000,     10000,
                                      100000, 1000000, 10000000, 100000000};
    unsigned count = obj_count_digits(text);
    if (count == 0)
        return NULL;
    uint64_t value = obj_digits_value(text, count);
    for (unsigned more = count; more == 8 && count <= 18; count += more) {
        more = obj_count_digits(text + count);
        if (more == 0)
            break;
        value = value * scale[more] + obj_digits_value(text + count, more);
    }
    *out = value;
    return count <= 18 ? text + count : NULL;
}

/* Does what fmt_obj_number_general() does; fast for the common forms. */
static inline const char *obj_number(const char *text, double *out)
{
#ifdef __SSE4_1__
    static const double powers[16] = {1e0, 1e1, 1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                      1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15};
    const bool negative = *text == '-';
    uint64_t integer;
    const char *p = text + negative;
    __m128i digits = _mm_sub_epi8(_mm_loadu_si128((const __m128i *)p), _mm_set1_epi8('0'));
    __m128i is_digit = _mm_cmpeq_epi8(_mm_min_epu8(digits, _mm_set1_epi8(9)), digits);
    unsigned others = (unsigned)_mm_movemask_epi8(is_digit) ^ 0xffffu;
    unsigned after_point = others & (others - 1);
    if (__builtin_expect(after_point != 0, 1)) {
        int point = __builtin_ctz(others), end = __builtin_ctz(after_point);
        if (__builtin_expect(p[point] == '.' && end > 1 && (unsigned char)p[end] <= ' ', 1)) {
            double value = (double)(int64_t)obj_digits_without_point(digits, point, end) /
                           powers[end - point - 1];
            *out = copysign(value, negative ? -1.0 : 1.0);
            return p + end;
        }
    }
    const char *after = obj_integer(p, &integer);
    if (after && after - p <= 15 && (unsigned char)*after <= ' ') {
        *out = copysign((double)(int64_t)integer, negative ? -1.0 : 1.0);
        return after;
    }
#endif
    return fmt_obj_number_general(text, out);
}

/* Parses a number as obj_number() does; words for numbers that are not finite give NaN. Returns the
 * position after it, or NULL. */
static inline const char *obj_real(const char *text, double *out)
{
    const char *after = obj_number(text, out);
    if (__builtin_expect(after != NULL, 1))
        return after;
    *out = NAN;
    return fmt_obj_not_finite(text);
}

#endif
