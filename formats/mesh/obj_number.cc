// obj_number.cc - correctly rounded decimal numbers of any shape, by the C++ library.
//
// std::from_chars() has no locale and does not allocate. It cannot tell numbers that are too large
// for a double from those that are too small, so these go to strtod() in the C locale.
#include "formats/mesh/obj_number.h"

#include <charconv>
#include <initializer_list>

#include <locale.h>
#include <stdlib.h>
#include <strings.h>

static bool is_digit(char c)
{
    return (unsigned char)(c - '0') <= 9;
}

// glibc returns its static C locale here, so this neither allocates nor fails.
static double by_c_library(const char *text)
{
    locale_t c_locale = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    if (!c_locale)
        return NAN;
    const double value = strtod_l(text, nullptr, c_locale);
    freelocale(c_locale);
    return value;
}

// Parses a decimal number, however large, as fmt_obj_number_general() does.
static const char *parse(const char *text, double *out)
{
    const char *digits = text + (*text == '-' || *text == '+'), *end = digits;
    if (!is_digit(*digits) && *digits != '.') // "nan" and "inf" are names
        return nullptr;
    while (!obj_is_delimiter(*end))
        end++;
    const auto result = std::from_chars(text + (*text == '+'), end, *out);
    if (result.ptr != end || result.ec == std::errc::invalid_argument)
        return nullptr;
    if (result.ec == std::errc::result_out_of_range)
        *out = by_c_library(text);
    return end;
}

const char *fmt_obj_number_general(const char *text, double *out)
{
    double value = 0;
    const char *end = parse(text, &value);
    if (!end || !std::isfinite(value))
        return nullptr;
    *out = value;
    return end;
}

const char *fmt_obj_not_finite(const char *text)
{
    const char *p = text + (*text == '-' || *text == '+'), *end = p, *digits = p;
    double value = 0;
    while (!obj_is_delimiter(*end))
        end++;
    while (is_digit(*digits))
        digits++;
    if (digits > p && digits[0] == '.' && digits[1] == '#')
        return end;
    for (const char *name : {"infinity", "inf", "nan"}) {
        const size_t length = strlen(name);
        if (strncasecmp(p, name, length) == 0 && (p[length] == '(' || p + length == end))
            return end;
    }
    return parse(text, &value) && !std::isfinite(value) ? end : nullptr;
}
