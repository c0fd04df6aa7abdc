/* fuzz_stl.c - fuzz target for STL: each mesh that loads has finite positions and valid indices. */
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/mesh_check.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_files(&(struct fuzz_input){data, size, "fuzz.stl"}, 1, fuzz_mesh);
}
