/* vdb_export.c - exports a grid as an OpenVDB file, whose content the program bisque-vdb writes.
 *
 * OpenVDB writes an archive from whole grids in memory. The memory follows from the node counts and
 * is reserved before anything is built. */
#include <stdio.h>
#include <xxhash.h>

#include "formats/grid/nvdb_layout_internal.h"
#include "formats/program/program.h"

static const char purpose[] = "OpenVDB files";

static uint64_t export_bytes(const struct fmt_nvdb_grid *grid)
{
    const uint64_t vectors = (uint64_t)grid->leaf_count * VDB_VECTOR_LEAF +
                             (uint64_t)grid->lower_count * VDB_VECTOR_LOWER +
                             (uint64_t)grid->upper_count * VDB_VECTOR_UPPER;
    const uint64_t bits = (uint64_t)grid->leaf_count * VDB_BIT_LEAF +
                          (uint64_t)grid->lower_count * VDB_BIT_LOWER +
                          (uint64_t)grid->upper_count * VDB_BIT_UPPER;
    return bits + (grid->colors ? 2 * vectors : vectors);
}

/* Replaces the random UUID that OpenVDB gives each file by one that follows from the grid, so that
 * equal grids give equal files. It is text, after the magic number, two versions and a flag. */
static int replace_uuid(struct bsq_output *output, const struct fmt_nvdb_grid *grid)
{
    const struct nvdb_trailer *trailer = nvdb_trailer_of(grid);
    XXH128_hash_t hash = XXH3_128bits(trailer, sizeof *trailer);
    char uuid[37];
    snprintf(uuid, sizeof uuid, "%08x-%04x-8%03x-%04x-%012llx", (uint32_t)(hash.high64 >> 32),
             (uint32_t)(hash.high64 >> 16 & 0xffff), (uint32_t)(hash.high64 & 0xfff),
             (uint32_t)(hash.low64 >> 48 & 0x3fff) | 0x8000,
             (unsigned long long)(hash.low64 & 0xffffffffffff));
    return bsq_output_write_at(output, uuid, 36, 8 + 4 + 4 + 4 + 1);
}

int fmt_vdb_check(struct bsq_ctx *ctx)
{
    char program[PATH_MAX];
    return fmt_program_find(ctx, "bisque-vdb", purpose, program);
}

/* Lets bisque-vdb write the file of an output. */
static int vdb_write_content(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                             const char *path, struct bsq_output *output, uint64_t bytes)
{
    char threads[12];
    const struct fmt_converter how = {.program = "bisque-vdb",
                                      .purpose = purpose,
                                      .library = "OpenVDB",
                                      .path = path,
                                      .option = threads,
                                      .memory = bytes,
                                      .exports = true};
    struct bsq_file file = BSQ_FILE_CLOSED;
    int status;
    snprintf(threads, sizeof threads, "%u", bsq_threads(ctx));
    BSQ_TRY(fmt_program_check(ctx, purpose));
    BSQ_TRY(bsq_output_read(output, &file));
    status = fmt_program_convert(ctx, &how, grid->map.fd, &file);
done:
    bsq_file_close(ctx, &file);
    return status;
}

int fmt_vdb_export(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid, const char *path,
                   struct bsq_output **out)
{
    struct bsq_output *output = NULL;
    const uint64_t bytes = export_bytes(grid);
    int status;
    *out = NULL;
    BSQ_TRY(bsq_output_open(ctx, path, &output));
    BSQ_TRY(bsq_reserve(ctx, "the grids of the OpenVDB export", bytes));
    status = vdb_write_content(ctx, grid, path, output, bytes);
    bsq_release(ctx, bytes);
    BSQ_TRY(status);
    BSQ_TRY(replace_uuid(output, grid));
    BSQ_TRY(bsq_map_check(ctx, &grid->map));
    *out = output;
    output = NULL;
done:
    bsq_output_discard(output);
    return status;
}
