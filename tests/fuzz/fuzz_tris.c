/* fuzz_tris.c - fuzz target for chunk files: every chunk of whatever opens is read. */
#include "formats/tris.h"
#include "tests/fuzz/fuzz_file.h"

static void check_chunk(const struct fmt_tris_chunk *chunk)
{
    for (uint32_t t = 0; t < chunk->triangle_count; t++)
        for (int i = 0; i < 3; i++)
            require(chunk->triangles[t][i] < chunk->vertex_count, "a vertex out of range");
}

static int use(struct bsq_ctx *ctx, const char *path)
{
    struct fmt_tris_file *file;
    void *scratch = NULL;
    int status = fmt_tris_open(ctx, path, &file);
    if (status)
        return status;
    status = bsq_alloc(ctx, "chunk", fmt_tris_load_size_max(file), 1, &scratch);
    for (uint64_t i = 0; !status && i < fmt_tris_get_header(file)->chunk_count; i++) {
        struct fmt_tris_chunk chunk;
        status = fmt_tris_load(file, i, scratch, &chunk);
        if (!status)
            check_chunk(&chunk);
    }
    bsq_free(ctx, scratch);
    fmt_tris_close(file);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_file(data, size, "fuzz.tris", use);
}
