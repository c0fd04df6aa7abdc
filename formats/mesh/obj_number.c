/* obj_number.c - correctly rounded decimal numbers of any shape.
 *
 * There are three exact methods, each for fewer numbers than the one before. (1) An integer up to
 * 2^53 and a power of ten up to 22: one double operation. (2) Up to 19 digits and a power of ten up
 * to 27, as programs write doubles with 17 digits: 5^27 fits 64 bits, so quotient and product are
 * exact in 128-bit integers. (3) More digits: both neighbours in the 19th digit are tried; if they
 * round alike, so does the number between them. The rest, far exponents and near ties, go to the C
 * library in the C locale. */
#include "formats/mesh/obj_number.h"

#include <float.h>
#include <locale.h>
#include <math.h>
#include <stdlib.h>
#include <strings.h>

const double fmt_obj_power_of_ten[23] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                         1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                         1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

enum { max_digits = 19, max_exact_power = 22, max_integer_power = 27 };

/* The first 19 significant digits as an integer. The number is (mantissa + f) * 10^exponent with 0
 * <= f < 1; f > 0 only if `truncated`. */
struct decimal {
    uint64_t mantissa;
    int64_t exponent;
    int digits;
    bool truncated;
};

static bool is_digit(char c)
{
    return (unsigned char)(c - '0') <= 9;
}

/* Appends a run of digits; `after_point` is 1 for digits of the fraction. */
static const char *scan_digits(const char *p, struct decimal *number, int after_point)
{
    for (; is_digit(*p); p++) {
        if (number->digits < max_digits) {
            number->mantissa = number->mantissa * 10 + (uint64_t)(*p - '0');
            number->digits += number->mantissa != 0;
            number->exponent -= after_point;
        } else {
            number->truncated |= *p != '0';
            number->exponent += 1 - after_point;
        }
    }
    return p;
}

/* Adds "e+12" to the exponent. Returns NULL if no digits follow the letter. */
static const char *scan_exponent(const char *p, struct decimal *number)
{
    const int64_t far = 1000000000000000; /* beyond any length of text */
    p++;
    bool negative = *p == '-';
    if (*p == '-' || *p == '+')
        p++;
    if (!is_digit(*p))
        return NULL;
    int64_t exponent = 0;
    for (; is_digit(*p); p++)
        if (exponent < far)
            exponent = exponent * 10 + (*p - '0');
    number->exponent += negative ? -exponent : exponent;
    return p;
}

static uint64_t power_of_five(int64_t n)
{
    uint64_t value = 1;
    for (uint64_t factor = 5; n; n >>= 1, factor *= factor)
        if (n & 1)
            value *= factor;
    return value;
}

/* Returns the double nearest to mantissa * 10^exponent, for mantissa > 0 and |exponent| <= 27.
 * Takes the top 64 bits of the exact result and sets the lowest bit if any bit below them is set;
 * that rounds as the whole result would. */
static double scale_exactly(uint64_t mantissa, int64_t exponent)
{
    uint64_t top;
    int shift;
    if (exponent < 0) {
        uint64_t divisor = power_of_five(-exponent);
        int up = __builtin_clzll(mantissa), divisor_up = __builtin_clzll(divisor);
        unsigned __int128 dividend = (unsigned __int128)(mantissa << up) << 63;
        divisor <<= divisor_up;
        top = (uint64_t)(dividend / divisor);
        top |= (uint64_t)dividend != top * divisor; /* a remainder has 64 bits at most */
        shift = divisor_up - up - 63;
    } else {
        unsigned __int128 product = (unsigned __int128)mantissa * power_of_five(exponent);
        uint64_t high = (uint64_t)(product >> 64);
        shift = high ? 64 - __builtin_clzll(high) : 0;
        top = (uint64_t)(product >> shift);
        top |= shift != 0 && (uint64_t)product << (64 - shift) != 0;
    }
    return ldexp((double)top, shift + (int)exponent);
}

/* glibc returns its static C locale here, so this neither allocates nor fails. */
static double by_c_library(const char *text)
{
    locale_t c_locale = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    if (!c_locale)
        return NAN;
    double value = strtod_l(text, NULL, c_locale);
    freelocale(c_locale);
    return value;
}

/* Parses a number with the C library. `text` is the number without its sign. */
static double decimal_value(const struct decimal *number, const char *text)
{
    int64_t exponent = number->exponent;
    uint64_t mantissa = number->mantissa;
    if (mantissa == 0)
        return 0.0;
    if (!number->truncated && mantissa <= (uint64_t)1 << DBL_MANT_DIG) {
        if (exponent >= 0 && exponent <= max_exact_power)
            return (double)mantissa * fmt_obj_power_of_ten[exponent];
        if (exponent < 0 && exponent >= -max_exact_power)
            return (double)mantissa / fmt_obj_power_of_ten[-exponent];
    }
    if (exponent >= -max_integer_power && exponent <= max_integer_power) {
        double value = scale_exactly(mantissa, exponent);
        if (!number->truncated || value == scale_exactly(mantissa + 1, exponent))
            return value;
    }
    return by_c_library(text);
}

const char *fmt_obj_number_general(const char *text, double *out)
{
    const char *p = text;
    bool negative = *p == '-';
    if (*p == '-' || *p == '+')
        p++;
    const char *unsigned_text = p;
    struct decimal number = {0};
    p = scan_digits(p, &number, 0);
    bool any = p != unsigned_text;
    if (*p == '.') {
        const char *fraction = ++p;
        p = scan_digits(p, &number, 1);
        any |= p != fraction;
    }
    if (!any)
        return NULL;
    if ((*p == 'e' || *p == 'E') && !(p = scan_exponent(p, &number)))
        return NULL;
    if (!obj_is_delimiter(*p))
        return NULL;
    double value = decimal_value(&number, unsigned_text);
    if (!isfinite(value))
        return NULL;
    *out = negative ? -value : value;
    return p;
}

/* Returns the position after decimal digits. */
static const char *skip_digits(const char *p)
{
    while (is_digit(*p))
        p++;
    return p;
}

/* Returns whether `p`, after its sign, is a decimal number, however large. */
static bool is_decimal(const char *p)
{
    struct decimal number = {0};
    const char *whole = p;
    p = skip_digits(p);
    if (p == whole && !(p[0] == '.' && is_digit(p[1])))
        return false;
    if (*p == '.')
        p = skip_digits(p + 1);
    if (*p == 'e' || *p == 'E')
        p = scan_exponent(p, &number);
    return p && obj_is_delimiter(*p);
}

const char *fmt_obj_not_finite(const char *text)
{
    static const char *const names[] = {"infinity", "inf", "nan"};
    const char *p = text + (*text == '-' || *text == '+'), *end = p;
    const char *digits = skip_digits(p);
    double value;
    while (!obj_is_delimiter(*end))
        end++;
    if (digits > p && digits[0] == '.' && digits[1] == '#')
        return end;
    for (int i = 0; i < 3; i++) {
        const size_t length = strlen(names[i]);
        if (strncasecmp(p, names[i], length) == 0 && (p[length] == '(' || p + length == end))
            return end;
    }
    return is_decimal(p) && !fmt_obj_number_general(p, &value) ? end : NULL;
}
