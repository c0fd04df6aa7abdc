/* xxh3.c - prints the XXH3-64 of standard input as 16 hexadecimal digits, for tests that correct a
 * checksum by hand. */
#include <inttypes.h>
#include <stdio.h>
#include <xxhash.h>

int main(void)
{
    static char input[1 << 20];
    size_t size = fread(input, 1, sizeof input, stdin);
    if (ferror(stdin) || size == sizeof input)
        return 1;
    printf("%016" PRIx64 "\n", (uint64_t)XXH3_64bits(input, size));
    return 0;
}
