/* fuzz_gltf.c - fuzz target for GLB files, and for .gltf files whose buffers are data URIs. */
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/mesh_check.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_files(&(struct fuzz_input){data, size, "fuzz.gltf"}, 1, fuzz_mesh);
}
