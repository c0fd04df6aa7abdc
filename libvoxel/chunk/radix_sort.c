/* radix_sort.c - see radix_sort.h.
 *
 * A least-significant-digit radix sort orders entries by their upper 20 bits, or by 30 bits if
 * there are many. Few entries then share these bits: seven levels below its own, a bucket of a
 * surface has about 4^7 occupied cells. Such entries are sorted by insertion, or by their next bits
 * if many. */
#include "libvoxel/chunk/radix_sort.h"

#include <stdbool.h>
#include <string.h>

#define DIGIT_BITS  10u
#define DIGITS_MAX  3u
#define DIGIT_MASK  ((1u << DIGIT_BITS) - 1)
#define SMALL_COUNT 24u
/* Up to this count two digits are enough. An even number of passes ends in `entries`. */
#define TWO_DIGITS_COUNT (1u << 15)

static void insertion_sort(struct entry *entries, uint64_t n)
{
    for (uint64_t i = 1; i < n; i++) {
        struct entry moving = entries[i];
        uint64_t at = i;
        for (; at > 0 && entries[at - 1].key > moving.key; at--)
            entries[at] = entries[at - 1];
        entries[at] = moving;
    }
}

static void count_digits(const struct entry *entries, uint64_t n, uint32_t shift, uint32_t digits,
                         uint32_t counts[DIGITS_MAX][1u << DIGIT_BITS])
{
    memset(counts, 0, digits * sizeof counts[0]);
    for (uint64_t i = 0; i < n; i++) {
        uint64_t key = entries[i].key >> shift;
        for (uint32_t d = 0; d < digits; d++)
            counts[d][key >> d * DIGIT_BITS & DIGIT_MASK]++;
    }
}

/* Turns counts of one digit into first positions. False: all entries have the same digit. */
static bool start_positions(uint32_t counts[1u << DIGIT_BITS], uint64_t n)
{
    uint32_t sum = 0;
    for (uint32_t i = 0; i <= DIGIT_MASK; i++) {
        uint32_t count = counts[i];
        if (count == n)
            return false;
        counts[i] = sum;
        sum += count;
    }
    return true;
}

static void radix_sort(struct entry *entries, struct entry *scratch, uint64_t n, uint32_t shift,
                       uint32_t digits)
{
    uint32_t counts[DIGITS_MAX][1u << DIGIT_BITS];
    struct entry *from = entries, *to = scratch;
    count_digits(entries, n, shift, digits, counts);
    for (uint32_t d = 0; d < digits; d++) {
        if (!start_positions(counts[d], n))
            continue;
        for (uint64_t i = 0; i < n; i++)
            to[counts[d][from[i].key >> (shift + d * DIGIT_BITS) & DIGIT_MASK]++] = from[i];
        struct entry *filled = to;
        to = from;
        from = filled;
    }
    if (from != entries)
        memcpy(entries, from, n * sizeof *entries);
}

void vox_radix_sort(struct entry *entries, struct entry *scratch, uint64_t n, uint32_t bits)
{
    if (n <= SMALL_COUNT) {
        insertion_sort(entries, n);
        return;
    }
    uint32_t digits = n <= TWO_DIGITS_COUNT ? 2 : DIGITS_MAX;
    uint32_t shift = bits > digits * DIGIT_BITS ? bits - digits * DIGIT_BITS : 0;
    radix_sort(entries, scratch, n, shift, digits);
    for (uint64_t begin = 0, end; shift > 0 && begin < n; begin = end) {
        uint64_t prefix = entries[begin].key >> shift;
        for (end = begin + 1; end < n && entries[end].key >> shift == prefix; end++)
            ;
        if (end - begin > 1)
            vox_radix_sort(entries + begin, scratch, end - begin, shift);
    }
}
