/* fuzz_stl.c - fuzz target for STL: each mesh that loads has finite positions and valid indices. */
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/mesh_check.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_file(data, size, "fuzz.stl", fuzz_mesh);
}
