/* fuzz_assimp.c - fuzz target for the program that reads files by Assimp: the scenes that Assimp
 * may hand over, not the files. */
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/scene_check.h"

static const uint8_t *input;
static size_t input_size;

static int copy(struct bsq_ctx *ctx)
{
    return fuzz_scene(ctx, input, input_size);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input = data;
    input_size = size;
    fuzz_in_context(copy);
    return 0;
}
