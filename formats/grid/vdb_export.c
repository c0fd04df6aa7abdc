/* vdb_export.c - exports a grid as an OpenVDB file, whose content the module bisque-openvdb.so
 * writes.
 *
 * OpenVDB writes an archive from whole grids in memory. The memory follows from the node counts and
 * is reserved before anything is built. */
#include <stdio.h>
#include <xxhash.h>

#include "formats/grid/nvdb_layout_internal.h"
#include "formats/grid/vdb_module.h"

/* Replaces the random UUID that OpenVDB gives each file by one that follows from the grid, so that
 * equal grids give equal files. It is text, after the magic number, two versions and a flag. */
static int replace_uuid(struct bsq_output *output, const struct fmt_nvdb_grid *grid)
{
    struct nvdb_layout layout;
    fmt_nvdb_layout_of(grid, &layout);
    const struct nvdb_trailer *trailer = fmt_nvdb_trailer_of(grid, &layout);
    XXH128_hash_t hash = XXH3_128bits(trailer, sizeof *trailer);
    char uuid[37];
    snprintf(uuid, sizeof uuid, "%08x-%04x-8%03x-%04x-%012llx", (uint32_t)(hash.high64 >> 32),
             (uint32_t)(hash.high64 >> 16 & 0xffff), (uint32_t)(hash.high64 & 0xfff),
             (uint32_t)(hash.low64 >> 48 & 0x3fff) | 0x8000,
             (unsigned long long)(hash.low64 & 0xffffffffffff));
    return bsq_output_write_at(output, uuid, 36, 8 + 4 + 4 + 4 + 1);
}

static int open_module(struct bsq_ctx *ctx, const struct fmt_module **module)
{
    return fmt_module_open(ctx, "openvdb", "OpenVDB files", module);
}

int fmt_vdb_check(struct bsq_ctx *ctx)
{
    const struct fmt_module *module;
    return open_module(ctx, &module);
}

int fmt_vdb_export(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid, const char *path,
                   struct bsq_output **out)
{
    const struct fmt_module *module;
    struct bsq_output *output = NULL;
    int status;
    *out = NULL;
    BSQ_TRY(open_module(ctx, &module));
    BSQ_TRY(bsq_output_open(ctx, path, &output));
    const struct fmt_vdb_module *vdb = (const struct fmt_vdb_module *)module;
    const uint64_t bytes = vdb->memory(grid);
    BSQ_TRY(bsq_reserve(ctx, "the grids of the OpenVDB export", bytes));
    status = vdb->write(&fmt_host_functions, ctx, grid, output, path);
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
