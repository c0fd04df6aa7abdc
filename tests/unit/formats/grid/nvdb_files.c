#include <sys/stat.h>

#include "tests/unit/fixture.h"
#include "tests/unit/formats/grid/nvdb_files.h"

static char directory[] = "/tmp/bsq-test-nvdb-XXXXXX";
char nvdb_path[64], nvdb_other_path[64];

int nvdb_make_directory(void **state)
{
    (void)state;
    if (!mkdtemp(directory))
        return -1;
    snprintf(nvdb_path, sizeof(nvdb_path), "%s/a.nvdb", directory);
    snprintf(nvdb_other_path, sizeof(nvdb_other_path), "%s/b.nvdb", directory);
    return 0;
}

int nvdb_remove_directory(void **state)
{
    (void)state;
    unlink(nvdb_path);
    unlink(nvdb_other_path);
    return rmdir(directory);
}

uint8_t *nvdb_read_file(const char *name, uint64_t *size)
{
    FILE *file = fopen(name, "rb");
    assert_non_null(file);
    struct stat info;
    assert_int_equal(fstat(fileno(file), &info), 0);
    *size = (uint64_t)info.st_size;
    uint8_t *bytes = malloc(*size);
    assert_int_equal(fread(bytes, 1, *size, file), *size);
    fclose(file);
    return bytes;
}
