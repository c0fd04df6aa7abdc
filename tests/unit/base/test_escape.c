/* test_escape.c - text that reaches terminals and logs. */
#include "base/text.h"
#include "tests/unit/test.h"

static void expect(const char *text, const char *expected)
{
    char *escaped = bsq_escape(text, 0);
    assert_string_equal(escaped, expected);
    free(escaped);
}

TEST(test_text_stays)
{
    expect("", "");
    expect("a b\\c.obj:12: \"x\"", "a b\\c.obj:12: \"x\"");
    expect("Stra\xc3\x9f"
           "e \xe2\x82\xac \xf0\x9f\x97\xbf",
           "Stra\xc3\x9f"
           "e \xe2\x82\xac \xf0\x9f\x97\xbf");
}

TEST(test_control_characters)
{
    expect("\033[2J\a\r\n\t\x7f", "\\x1b[2J\\x07\\x0d\\x0a\\x09\\x7f");
    expect("\xc2\x9b"
           "31m",
           "\\xc2\\x9b31m"); /* C1's control sequence introducer */
    expect("a\xe2\x80\xaez\xe2\x81\xa6", "a\\xe2\\x80\\xaez\\xe2\\x81\\xa6"); /* direction */
    expect("\xe2\x80\xa8", "\\xe2\\x80\\xa8");                                /* line separator */
    char *kept = bsq_escape("a\nb\033\n", 1);
    assert_string_equal(kept, "a\nb\\x1b\n");
    free(kept);
}

TEST(test_invalid_utf8)
{
    expect("\xff", "\\xff");
    expect("\x80z", "\\x80z");
    expect("\xc3", "\\xc3");
    expect("\xc3(", "\\xc3(");
    expect("\xe2\x82", "\\xe2\\x82");
    expect("\xc0\xaf", "\\xc0\\xaf");                   /* longer than needed */
    expect("\xed\xa0\x80", "\\xed\\xa0\\x80");          /* half of a surrogate pair */
    expect("\xf4\x90\x80\x80", "\\xf4\\x90\\x80\\x80"); /* above U+10FFFF */
    expect("\xf8\x88\x80\x80\x80", "\\xf8\\x88\\x80\\x80\\x80");
}

/* Whatever the bytes, the result has neither control bytes nor bytes that are not UTF-8. */
TEST(test_random_bytes)
{
    uint64_t random = test_seed();
    for (int i = 0; i < 20000; i++) {
        char text[24];
        for (size_t k = 0; k < sizeof text - 1; k++) {
            uint64_t bits = test_random(&random);
            text[k] = (char)(bits % 4 ? 0x80 + bits / 4 % 0x80 : 1 + bits / 4 % 0x7f);
        }
        text[sizeof text - 1] = '\0';
        char *escaped = bsq_escape(text, 0), *again = bsq_escape(escaped, 0);
        assert_string_equal(escaped, again);
        for (const char *p = escaped; *p; p++)
            assert_true((unsigned char)*p >= 0x20 && *p != 0x7f);
        free(escaped);
        free(again);
    }
}

RUN_TESTS(NULL, NULL)
