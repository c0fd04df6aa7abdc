/* fuzz_ply.c - fuzz target for PLY: each mesh that loads has finite positions and valid indices. */
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/mesh_check.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_files(&(struct fuzz_input){data, size, "fuzz.ply"}, 1, fuzz_mesh);
}
