/* replay.c - runs a fuzz target on files, without the fuzzer. */
#include "tests/fuzz/fuzz_file.h"

#include <stdio.h>
#include <stdlib.h>

static void replay(const char *path)
{
    FILE *file = fopen(path, "rb");
    require(file && !fseek(file, 0, SEEK_END), path);
    long size = ftell(file);
    uint8_t *data = malloc((size_t)size + 1);
    rewind(file);
    require(data && fread(data, 1, (size_t)size, file) == (size_t)size, path);
    fclose(file);
    LLVMFuzzerTestOneInput(data, (size_t)size);
    free(data);
}

int main(int count, char **paths)
{
    for (int i = 1; i < count; i++)
        replay(paths[i]);
    printf("ok 1 - %d files replayed\n", count - 1);
    return count < 2;
}
