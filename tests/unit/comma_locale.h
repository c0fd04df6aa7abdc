/* comma_locale.h - a locale with a decimal comma, for tests of numbers in texts. */
#ifndef TEST_COMMA_LOCALE_H
#define TEST_COMMA_LOCALE_H

#include <locale.h>
#include <stdlib.h>
#include <unistd.h>

#include "tests/unit/fixture.h"

/* Makes a German locale in the current directory (Debian's packages libc-bin and locales have what
 * that needs) and sets it for the whole program. setlocale(LC_ALL, "C") ends it. */
static inline void test_set_comma_locale(void)
{
    char here[4096];
    assert_non_null(getcwd(here, sizeof here));
    assert_int_equal(system("test -d de_DE.UTF-8 || localedef -i de_DE -f UTF-8 ./de_DE.UTF-8"), 0);
    assert_int_equal(setenv("LOCPATH", here, 1), 0);
    assert_non_null(setlocale(LC_ALL, "de_DE.UTF-8"));
    assert_string_equal(localeconv()->decimal_point, ",");
}

#endif
