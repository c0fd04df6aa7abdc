/* fuzz_packed.c - fuzz target for packed files: whatever gzip or Zstandard data hold, and however
 * they are damaged, a mesh is read or refused. */
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/mesh_check.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_files(&(struct fuzz_input){data, size, "fuzz.obj.gz"}, 1, fuzz_mesh);
}
