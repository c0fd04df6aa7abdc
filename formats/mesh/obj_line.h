/* obj_line.h - parses the two forms of lines that make up nearly all of a scan, a line at a time.
 *
 * A parser that reads one number after the other waits for the end of each. Here a few comparisons
 * find all ends of "v 0.125 -1.5 22.25" or "f 1 22 333" at once. The end of the line is found on
 * its own, and it is all that the next line has to wait for. Any other form is left to
 * obj_number.h, and so is everything on machines without SSE4.1. */
#ifndef FMT_MESH_OBJ_LINE_H
#define FMT_MESH_OBJ_LINE_H

#include "formats/mesh/obj_number.h"

#ifdef __SSE4_1__

/* Returns a bit for each of 16 bytes that is not a digit; `digits` holds the text's bytes minus
 * '0'. */
static inline unsigned obj_other_bytes(__m128i digits)
{
    __m128i is_digit = _mm_cmpeq_epi8(_mm_min_epu8(digits, _mm_set1_epi8(9)), digits);
    return (unsigned)_mm_movemask_epi8(is_digit) ^ 0xffffu;
}

/* Clears the lowest bit and returns its position. */
static inline unsigned obj_next_bit(uint64_t *bits)
{
    unsigned at = (unsigned)__builtin_ctzll(*bits);
    *bits &= *bits - 1;
    return at;
}

/* ---- three numbers ---- */

/* Where the digits of a number are in the text. */
struct obj_span {
    unsigned start, point, end; /* of digits and point; start is after a minus */
};

static inline __m128i obj_span_groups(const char *text, struct obj_span s)
{
    __m128i bytes = _mm_loadu_si128((const __m128i *)(text + s.start));
    return obj_digit_groups(_mm_sub_epi8(bytes, _mm_set1_epi8('0')), (int)(s.point - s.start),
                            (int)(s.end - s.start));
}

/* Computes two numbers of at most 15 digits, each an integer divided by a power of ten. Both are
 * exact as doubles, so the quotient is correctly rounded. */
static inline __m128d obj_two_quotients(__m128i groups_a, __m128i groups_b, const double *power_a,
                                        const double *power_b)
{
    __m128i halves = obj_join_groups(groups_a, groups_b);
    __m128d high = _mm_cvtepi32_pd(_mm_shuffle_epi32(halves, _MM_SHUFFLE(3, 1, 2, 0)));
    __m128d low = _mm_cvtepi32_pd(_mm_shuffle_epi32(halves, _MM_SHUFFLE(2, 0, 3, 1)));
    __m128d integers = _mm_add_pd(_mm_mul_pd(high, _mm_set1_pd(1e8)), low);
    return _mm_div_pd(integers, _mm_loadh_pd(_mm_load_sd(power_a), power_b));
}

/* Parses "0.125 -1.5 22.25" and a line feed: three numbers of at most 15 digits, each with a point,
 * single blanks between them, in at most 48 bytes. Returns the position after the line feed.
 * Returns NULL for any other text; *out then has no meaning. */
static inline const char *obj_three_numbers(const char *text, double out[3])
{
    const __m128i zero = _mm_set1_epi8('0'), minus = _mm_set1_epi8('-'), feed = _mm_set1_epi8('\n');
    uint64_t others = (uint64_t)0xffff << 48, minuses = 0, feeds = (uint64_t)1 << 48;
    for (unsigned i = 0; i < 48; i += 16) {
        __m128i bytes = _mm_loadu_si128((const __m128i *)(text + i));
        others |= (uint64_t)obj_other_bytes(_mm_sub_epi8(bytes, zero)) << i;
        minuses |= (uint64_t)(unsigned)_mm_movemask_epi8(_mm_cmpeq_epi8(bytes, minus)) << i;
        feeds |= (uint64_t)(unsigned)_mm_movemask_epi8(_mm_cmpeq_epi8(bytes, feed)) << i;
    }
    const unsigned length = (unsigned)__builtin_ctzll(feeds);
    uint64_t marks = others & ~minuses, starts = 0;
    unsigned negative[3], from = 0, wrong = 0;
    struct obj_span s[3];
    for (int k = 0; k < 3; k++) {
        negative[k] = (unsigned)(minuses >> from) & 1;
        starts |= (uint64_t)1 << from;
        s[k].start = from + negative[k];
        s[k].point = obj_next_bit(&marks);
        s[k].end = obj_next_bit(&marks);
        from = s[k].end + 1;
        wrong |= (unsigned char)(text[s[k].point] ^ '.');
        wrong |= k < 2 ? (unsigned char)(text[s[k].end] ^ ' ') : s[k].end ^ length;
        /* From a digit and the point to 16 bytes. */
        wrong |= s[k].end - s[k].start - 2 > 14;
    }
    if (__builtin_expect(wrong || length == 48 || (minuses & ~starts) << (63 - length), 0))
        return NULL;
    static const double powers[2][16] = {
        {1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15},
        {-1e0, -1e1, -1e2, -1e3, -1e4, -1e5, -1e6, -1e7, -1e8, -1e9, -1e10, -1e11, -1e12, -1e13,
         -1e14, -1e15}};
    const double *power[3];
    __m128i groups[3];
    for (int k = 0; k < 3; k++) {
        power[k] = &powers[negative[k]][s[k].end - s[k].point - 1];
        groups[k] = obj_span_groups(text, s[k]);
    }
    _mm_storeu_pd(out, obj_two_quotients(groups[0], groups[1], power[0], power[1]));
    _mm_store_sd(out + 2, obj_two_quotients(groups[2], groups[2], power[2], power[2]));
    return text + length + 1;
}

/* ---- three indices ---- */

/* Shuffle sources that right-align n digits in eight bytes, from the lower or the upper half of a
 * vector. The other bytes become zero. */
#define OBJ_FROM(n, at, half) ((at) + (n) < 8 ? -128 : (at) + (n)-8 + (half))
#define OBJ_FROM_HALF(n, half)                                                                     \
    OBJ_FROM(n, 0, half), OBJ_FROM(n, 1, half), OBJ_FROM(n, 2, half), OBJ_FROM(n, 3, half),        \
        OBJ_FROM(n, 4, half), OBJ_FROM(n, 5, half), OBJ_FROM(n, 6, half), OBJ_FROM(n, 7, half)
#define OBJ_ALIGN(n)                                                                               \
    {                                                                                              \
        {OBJ_FROM_HALF(n, 0)},                                                                     \
        {                                                                                          \
            OBJ_FROM_HALF(n, 8)                                                                    \
        }                                                                                          \
    }

static const int8_t obj_align[9][2][8] = {OBJ_ALIGN(0), OBJ_ALIGN(1), OBJ_ALIGN(2),
                                          OBJ_ALIGN(3), OBJ_ALIGN(4), OBJ_ALIGN(5),
                                          OBJ_ALIGN(6), OBJ_ALIGN(7), OBJ_ALIGN(8)};

/* Returns two integers of at most 8 digits, at a and b, as two groups of four digits each. */
static inline __m128i obj_two_integers(const char *a, unsigned a_count, const char *b,
                                       unsigned b_count)
{
    __m128i text = _mm_unpacklo_epi64(_mm_loadl_epi64((const __m128i *)a),
                                      _mm_loadl_epi64((const __m128i *)b));
    __m128i source = _mm_unpacklo_epi64(_mm_loadl_epi64((const __m128i *)obj_align[a_count][0]),
                                        _mm_loadl_epi64((const __m128i *)obj_align[b_count][1]));
    __m128i digits = _mm_shuffle_epi8(_mm_sub_epi8(text, _mm_set1_epi8('0')), source);
    digits = _mm_maddubs_epi16(digits, _mm_set1_epi16(1 << 8 | 10));
    return _mm_madd_epi16(digits, _mm_set1_epi32(1 << 16 | 100));
}

/* The largest index of some triangles, in three of the lanes. */
typedef __m128i obj_most;

static inline uint64_t obj_bound_of(obj_most most)
{
    uint32_t lanes[4];
    _mm_storeu_si128((__m128i *)(void *)lanes, most);
    const uint32_t two = lanes[0] > lanes[1] ? lanes[0] : lanes[1];
    return (two > lanes[2] ? two : lanes[2]) + UINT64_C(1);
}

/* Parses "1 22 333" and a line feed: three integers of 1 to 8 digits, not 0, with single blanks
 * between them. Stores each minus one, and adds them to *most. Returns the position after the line
 * feed. Returns NULL for any other text; *out then has no meaning. */
static inline const char *obj_three_indices(const char *text, uint64_t out[3], obj_most *most)
{
    const __m128i zero = _mm_set1_epi8('0'), feed = _mm_set1_epi8('\n');
    const __m128i low = _mm_loadu_si128((const __m128i *)text);
    const __m128i high = _mm_loadu_si128((const __m128i *)(text + 16));
    const unsigned feeds = (unsigned)_mm_movemask_epi8(_mm_cmpeq_epi8(low, feed)) |
                           (unsigned)_mm_movemask_epi8(_mm_cmpeq_epi8(high, feed)) << 16;
    if (__builtin_expect(feeds == 0, 0))
        return NULL;
    const unsigned length = (unsigned)__builtin_ctz(feeds);
    uint64_t others = obj_other_bytes(_mm_sub_epi8(low, zero)) |
                      (uint64_t)obj_other_bytes(_mm_sub_epi8(high, zero)) << 16 | (uint64_t)7 << 32;
    const unsigned a = obj_next_bit(&others), b = obj_next_bit(&others);
    const unsigned c = obj_next_bit(&others);
    /* Each count minus one must be below 8; a count of zero wraps. */
    if (__builtin_expect(((a - 1) | (b - a - 2) | (c - b - 2)) >= 8 || c != length ||
                             ((text[a] ^ ' ') | (text[b] ^ ' ')),
                         0))
        return NULL;
    __m128i first = obj_two_integers(text, a, text + a + 1, b - a - 1);
    __m128i last = obj_two_integers(text + b + 1, c - b - 1, text, 0);
    __m128i values = _mm_sub_epi32(obj_join_groups(first, last), _mm_set1_epi32(1));
    if (__builtin_expect(_mm_movemask_ps(_mm_castsi128_ps(values)) & 7, 0))
        return NULL;
    *most = _mm_max_epi32(*most, values);
    _mm_storeu_si128((__m128i *)out, _mm_cvtepu32_epi64(values));
    _mm_storel_epi64((__m128i *)(out + 2), _mm_cvtepu32_epi64(_mm_srli_si128(values, 8)));
    return text + length + 1;
}

#else

static inline const char *obj_three_numbers(const char *text, double out[3])
{
    (void)text, (void)out;
    return NULL;
}

typedef uint64_t obj_most;

static inline uint64_t obj_bound_of(obj_most most)
{
    return most;
}

static inline const char *obj_three_indices(const char *text, uint64_t out[3], obj_most *most)
{
    (void)text, (void)out, (void)most;
    return NULL;
}

#endif
#endif
