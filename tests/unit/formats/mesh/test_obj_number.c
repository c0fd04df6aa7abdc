/* test_obj_number.c - numbers are rounded exactly as strtod() rounds them in the C locale. */
#include <locale.h>

#include "formats/mesh/obj_line.h"
#include "tests/unit/comma_locale.h"
#include "tests/unit/test.h"

static uint64_t random_state; /* of test_random() */

static uint64_t random_bits(void)
{
    return test_random(&random_state);
}

static unsigned below(unsigned limit)
{
    return (unsigned)((random_bits() >> 32) * limit >> 32);
}

/* Returns the value that strtod() gives in the C locale. */
static double reference(const char *text)
{
    static locale_t c_locale;
    if (!c_locale)
        c_locale = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    return strtod_l(text, NULL, c_locale);
}

/* Compares both parsers with strtod() on `text` followed by `delimiter`. */
static void check(const char *text, char delimiter)
{
    char buffer[2048 + OBJ_TEXT_PADDING] = {0};
    size_t length = strlen(text);
    memcpy(buffer, text, length);
    buffer[length] = delimiter;
    double expected = reference(text);
    for (int general = 0; general < 2; general++) {
        double value = 77;
        const char *end =
            general ? fmt_obj_number_general(buffer, &value) : obj_number(buffer, &value);
        if (!isfinite(expected)) {
            assert_null(end);
            continue;
        }
        if (end != buffer + length || memcmp(&value, &expected, sizeof value))
            fail_msg("\"%s\" gives %a, strtod gives %a (general %d)", text, value, expected,
                     general);
    }
}

static const char delimiters[] = " \n\t\r\\";

static char any_delimiter(void)
{
    return delimiters[below(sizeof delimiters)]; /* the terminating 0 is one of them */
}

static int append_digits(char *out, unsigned count)
{
    for (unsigned i = 0; i < count; i++)
        out[i] = (char)('0' + below(10));
    return (int)count;
}

/* Writes [sign] digits [. digits] [e exponent]; the arguments limit the numbers of digits. */
static void random_shape(char *out, unsigned whole, unsigned fraction, int exponent)
{
    unsigned w = below(whole + 1), f = below(fraction + 1);
    if (w + f == 0)
        w = 1;
    switch (below(6)) {
    case 0:
        *out++ = '+';
        break;
    case 1:
    case 2:
        *out++ = '-';
        break;
    }
    for (unsigned zeros = below(8) ? 0 : below(30); zeros; zeros--)
        *out++ = '0';
    out += append_digits(out, w);
    if (f || below(4) == 0)
        *out++ = '.';
    for (unsigned zeros = f == 0 || below(8) ? 0 : below(30); zeros; zeros--)
        *out++ = '0';
    out += append_digits(out, f);
    if (exponent && below(2))
        out += sprintf(out, "%c%s%d", below(2) ? 'e' : 'E', below(3) ? "" : "+",
                       (int)below((unsigned)exponent));
    else if (exponent)
        out += sprintf(out, "e-%d", (int)below((unsigned)exponent));
    *out = '\0';
}

TEST(test_random_shapes)
{
    static const struct {
        unsigned count, whole, fraction;
        int exponent;
    } shapes[] = {
        {800000, 4, 6, 0},   {300000, 7, 8, 0},    {300000, 1, 17, 0},  {300000, 3, 20, 0},
        {200000, 19, 0, 0},  {200000, 10, 10, 30}, {100000, 25, 25, 0}, {100000, 10, 10, 330},
        {20000, 60, 60, 40}, {20000, 2, 800, 0},   {300000, 2, 2, 23},  {50000, 400, 3, 400},
    };
    char text[2048];
    random_state = test_seed();
    for (size_t s = 0; s < sizeof shapes / sizeof *shapes; s++)
        for (unsigned i = 0; i < shapes[s].count; i++) {
            random_shape(text, shapes[s].whole, shapes[s].fraction, shapes[s].exponent);
            check(text, any_delimiter());
        }
}

/* Doubles in the formats that programs print. */
TEST(test_printed_doubles)
{
    static const char *const formats[] = {"%.17g", "%.9g", "%.15e", "%f", "%.6f", "%.12f", "%a"};
    char text[400];
    random_state = test_seed();
    for (int i = 0; i < 300000; i++) {
        uint64_t bits = random_bits();
        double value;
        if (below(2)) /* an exponent that is usual for coordinates */
            bits = (bits & ~(UINT64_C(0x7ff) << 52)) | (uint64_t)(1023 - 40 + below(70)) << 52;
        memcpy(&value, &bits, sizeof value);
        if (!isfinite(value))
            continue;
        snprintf(text, sizeof text, formats[below(6)], value);
        check(text, any_delimiter());
    }
}

/* Midpoints of neighbouring doubles round to even. One unit more or less in the last decimal place
 * rounds to the nearer double. */
TEST(test_midpoints)
{
    char text[400];
    random_state = test_seed();
    for (int i = 0; i < 100000; i++) {
        uint64_t mantissa = (random_bits() >> 11) | UINT64_C(1) << 52;
        int exponent = (int)below(60) - 54;
        /* (2 m + 1) * 2^(e-1) has at most 54 bits: exact as a long double, and so is its text. */
        long double midpoint = ldexpl((long double)(2 * mantissa + 1), exponent - 1);
        int length =
            snprintf(text, sizeof text, "%.*Lf", exponent < 1 ? 1 - exponent : 1, midpoint);
        check(text, ' ');
        char *last = text + length - 1;
        if (*last != '9') {
            ++*last;
            check(text, ' ');
            --*last;
        }
        if (*last != '0') {
            --*last;
            check(text, ' ');
        }
    }
}

TEST(test_other_locale)
{
    test_set_comma_locale();
    check("1.5", ' ');
    check("3.14159265358979323846264338327950288", ' ');
    check("2.2250738585072011e-308", ' ');
    check("9007199254740993.00000000000000000000000000000000000000001", ' ');
    setlocale(LC_ALL, "C");
}

/* Moves to the next word of a list with single blanks. Returns false at its end. */
static bool next_of(const char **list, char word[64])
{
    int used = 0;
    const bool found = sscanf(*list, " %63s%n", word, &used) == 1;
    *list += used;
    return found;
}

TEST(test_shapes_in_the_wild)
{
    const char *list =
        "0 -0 -0.0 1 1. .5 -.5E+2 +1.0 1e5 1.e-3 1E+05 00012.500 "
        "123456789012345678901234567890 0.000000000000000000000000000001 1e-400 4.9e-324 "
        "2.4703282292062327e-324 2.4703282292062328e-324 1.7976931348623157e308 "
        "0e999999999999999999999 1e-999999999999999999999 500000.123 12345678.1234567 "
        "123456789.123456 0.1234567890123456 9007199254740993 9007199254740992.5";
    char word[64];
    while (next_of(&list, word))
        for (size_t d = 0; d < sizeof delimiters; d++)
            check(word, delimiters[d]);
}

static void check_rejected(const char *text)
{
    char buffer[128] = {0};
    double value;
    snprintf(buffer, 96, "%s\n", text);
    if (obj_number(buffer, &value) || fmt_obj_number_general(buffer, &value))
        fail_msg("\"%s\" was accepted", text);
}

TEST(test_rejected)
{
    const char *list =
        "- + . -. e5 .e5 1e 1e+ 1e- 1.5e --1 +-1 1..2 1.2.3 1,5 nan NaN -nan inf -inf "
        "infinity 1e400 -1e309 0x10 1.#QNAN 1.#INF00 1# 1.5f 1.5/2 12a 1.234567x "
        "1.7976931348623159e308 1e99999999999999999999999 1d5";
    char word[64];
    while (next_of(&list, word))
        check_rejected(word);
    check_rejected("");
    check_rejected(" 1");
}

TEST(test_integers)
{
    char buffer[96];
    uint64_t value;
    random_state = test_seed();
    for (int i = 0; i < 1000000; i++) {
        memset(buffer, below(2) ? '/' : ' ', sizeof buffer);
        int length = append_digits(buffer, 1 + below(18));
        buffer[length] = "/ \n\r:a\x80\xff"[below(8)];
        buffer[length + 1] = (char)random_bits();
        assert_ptr_equal(obj_integer(buffer, &value), buffer + length);
        char copy[32] = {0};
        memcpy(copy, buffer, (size_t)length);
        assert_true(value == strtoull(copy, NULL, 10));
    }
    memset(buffer, 0, sizeof buffer);
    assert_null(obj_integer(buffer, &value));
    assert_null(obj_integer("/1 234567890123456789012345678901", &value));
    assert_null(obj_integer("1234567890123456789 23456789012345", &value));
    assert_null(obj_integer("123456789012345678901234567890123456", &value));
}

/* Checks that parsing ended after `length` bytes. Without SSE4.1 the fast parsers return NULL. */
static void check_end(const char *end, const char *line, int length)
{
#ifdef __SSE4_1__
    assert_ptr_equal(end, line + length);
#else
    (void)line, (void)length;
    assert_null(end);
#endif
}

/* obj_three_indices() accepts "a b c" and a line feed, and returns NULL for any other text. */
TEST(test_three_indices)
{
    random_state = test_seed();
    for (int i = 0; i < 1000000; i++) {
        char buffer[160] = {0};
        uint64_t expected[3], values[3];
        bool plain = true;
        int length = 0;
        for (int k = 0; k < 3; k++) {
            unsigned digits = below(20) ? 1 + below(8) : below(12);
            int start = length;
            plain &= digits >= 1 && digits <= 8;
            length += append_digits(buffer + length, digits);
            expected[k] = strtoull(buffer + start, NULL, 10);
            plain &= expected[k] != 0;
            expected[k]--;
            char after = k == 2 ? '\n' : ' ';
            if (below(30) == 0)
                after = " \n\t/\r-:"[below(7)];
            plain &= after == (k == 2 ? '\n' : ' ');
            buffer[length++] = after;
        }
        for (int k = 0; k < 32; k++)
            buffer[length + k] = "01 f\n"[below(5)];
        obj_most most = {0};
        const char *end = obj_three_indices(buffer, values, &most);
        if (!plain) {
            assert_null(end);
            continue;
        }
        check_end(end, buffer, length);
        if (!end)
            continue;
        assert_memory_equal(values, expected, sizeof values);
        uint64_t bound = 0;
        for (int k = 0; k < 3; k++)
            bound = values[k] >= bound ? values[k] + 1 : bound;
        assert_int_equal(obj_bound_of(most), bound);
    }
    uint64_t values[3];
    obj_most most = {0};
    static const char line[96] = "f 12345678 1 98765432\n";
    check_end(obj_three_indices(line + 2, values, &most), line, (int)strlen(line));
    assert_null(obj_three_indices("1 0 3\n                          ", values, &most));
}

/* Writes a number as "%.6f" prints it, or one with other numbers of digits, or other text. Clears
 * *plain unless it has a point and 1 to 15 digits. Returns its length. */
static int any_coordinate(char *out, bool *plain)
{
    unsigned whole = below(6) ? below(4) : below(16), fraction = below(6) ? 6 : below(17);
    char *p = out;
    if (below(2))
        *p++ = '-';
    p += append_digits(p, whole);
    bool point = below(40) > 0;
    if (point)
        *p++ = '.';
    p += append_digits(p, fraction);
    *plain &= point && whole + fraction >= 1 && whole + fraction <= 15;
    if (below(60) == 0) {
        *p++ = "+-eE,"[below(5)];
        *plain = false;
    }
    *p = '\0';
    return (int)(p - out);
}

/* obj_three_numbers() accepts "x y z" and a line feed, rounds as strtod() does, and returns NULL
 * for any other text. */
TEST(test_three_numbers)
{
    random_state = test_seed();
    int accepted = 0;
    for (int i = 0; i < 1000000; i++) {
        char buffer[256] = {0};
        double expected[3], values[3];
        bool plain = true;
        int length = 0;
        for (int k = 0; k < 3; k++) {
            char text[64];
            int size = any_coordinate(text, &plain);
            memcpy(buffer + length, text, (size_t)size);
            expected[k] = reference(text);
            length += size;
            char after = k == 2 ? '\n' : ' ';
            if (below(40) == 0)
                after = " \n\t/\r-"[below(6)];
            plain &= after == (k == 2 ? '\n' : ' ');
            buffer[length++] = after;
        }
        for (int k = 0; k < 64; k++)
            buffer[length + k] = "01 v.-\n"[below(7)];
        const char *end = obj_three_numbers(buffer, values);
        if (!plain || length > 48) {
            if (end)
                fail_msg("\"%s\" is accepted", buffer);
            continue;
        }
        check_end(end, buffer, length);
        if (end && memcmp(values, expected, sizeof values) != 0)
            fail_msg("\"%s\" gives %a %a %a", buffer, values[0], values[1], values[2]);
        accepted += end != NULL;
    }
    assert_true(accepted == 0 || accepted > 300000);
}

RUN_TESTS(NULL, NULL)
