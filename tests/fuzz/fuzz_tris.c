/* fuzz_tris.c - fuzz target for chunk files: loads each chunk of an accepted file. Most mutated
 * files get correct checksums, so that mutations reach the checks after them. */
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/tris_mend.h"

#include "formats/chunks/tris.h"

static void check_chunk(const struct fmt_tris_chunk *chunk)
{
    for (uint32_t t = 0; t < chunk->triangle_count; t++)
        for (int i = 0; i < 3; i++)
            require(chunk->triangles[t][i] < chunk->vertex_count, "a vertex out of range");
}

static int use(struct bsq_ctx *ctx, const char *const *paths, uint32_t count)
{
    const char *path = paths[0];
    (void)count;
    struct fmt_tris_file *file;
    void *scratch = NULL;
    int status = fmt_tris_open(ctx, path, &file);
    if (status)
        return status;
    for (uint64_t i = 0; !status && i < fmt_tris_get_header(file)->chunk_count; i++) {
        struct fmt_tris_chunk chunk;
        uint64_t bytes = fmt_tris_load_size(file, i);
        require(bytes <= fmt_tris_load_size_max(file), "a chunk larger than the largest");
        /* Of the exact size, so that the sanitizer sees an access one byte beyond it. */
        status = bsq_alloc(ctx, "chunk", bytes, 1, &scratch);
        if (!status)
            status = fmt_tris_load(file, i, scratch, &chunk);
        if (!status)
            check_chunk(&chunk);
        bool found = false;
        if (!status)
            status = fmt_tris_load_sample(file, i, scratch, &chunk, &found);
        if (!status && found)
            check_chunk(&chunk);
        bsq_free(ctx, scratch);
    }
    fmt_tris_close(file);
    return status;
}

size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned seed)
{
    size = LLVMFuzzerMutate(data, size, max_size);
    if (seed % 8)
        tris_mend(data, size);
    return size;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_system_file(data, size, "fuzz.tris", use);
}
