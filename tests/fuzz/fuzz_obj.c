/* fuzz_obj.c - fuzz target for OBJ: each mesh that loads has finite positions and valid indices. */
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/mesh_check.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_files(&(struct fuzz_input){data, size, "fuzz.obj"}, 1, fuzz_mesh);
}
