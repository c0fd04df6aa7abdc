/* fuzz_nvdb.c - fuzz target for grids: lookups and rays in an accepted grid stay in bounds. */
#include "libbake/device/device.h"
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/grid_use.h"

static int use(struct bsq_ctx *ctx)
{
    struct fmt_nvdb_grid grid;
    int status = fmt_nvdb_open(ctx, "fuzz.nvdb", &grid);
    if (status)
        return status;
    grid_use_look_up(&grid);
    status = bake_check_grid(ctx, &grid);
    if (status == 0) {
        grid_use_trace(&grid);
        status = grid_use_trace_patch(ctx, &grid);
        if (status == 0)
            status = grid_use_look_around(ctx, &grid);
    }
    if (status == 0 && fuzzed_grid.verify)
        status = fmt_nvdb_verify(ctx, &grid);
    fmt_nvdb_close(ctx, &grid);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    grid_patch_apply(data, size, &fuzzed_grid);
    fuzz_in_context(use);
    grid_patch_revert(&fuzzed_grid);
    return 0;
}
