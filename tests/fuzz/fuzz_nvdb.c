/* fuzz_nvdb.c - fuzz target for grids: whatever opens can be walked and looked up, in bounds. */
#include "formats/nvdb.h"
#include "tests/fuzz/fuzz_file.h"

/* Voxels on the diagonal of the bounds and around them, with all that they refer to. */
static void look_up(const struct fmt_nvdb_grid *grid)
{
    for (int step = -2; step <= 66; step++) {
        int32_t at[3];
        for (int k = 0; k < 3; k++) {
            int64_t extent = (int64_t)grid->index_max[k] - grid->index_min[k];
            at[k] = (int32_t)(grid->index_min[k] + extent * step / 64);
        }
        uint64_t value = fmt_nvdb_find(grid, at);
        require(value <= grid->voxel_count, "a value index out of range");
        if (!value)
            continue;
        fmt_nvdb_get(grid, value);
        uint64_t second = fmt_nvdb_second(grid, value);
        require(second < grid->record_count, "a second record out of range");
        if (second)
            fmt_nvdb_get(grid, second);
    }
}

static int use(struct bsq_ctx *ctx, const char *path)
{
    struct fmt_nvdb_grid grid;
    int status = fmt_nvdb_open(ctx, path, &grid);
    if (status)
        return status;
    look_up(&grid);
    status = fmt_nvdb_verify(ctx, &grid);
    fmt_nvdb_close(ctx, &grid);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_file(data, size, "fuzz.nvdb", use);
}
