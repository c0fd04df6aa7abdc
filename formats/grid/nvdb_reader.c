/* nvdb_reader.c - recognises and opens grid files. */
#include <string.h>

#include "formats/grid/nvdb_layout_internal.h"

bool fmt_nvdb_recognise(const char first[8])
{
    return memcmp(first, "NanoVDB", 7) == 0 || memcmp(first + 1, "BDVonaN", 7) == 0;
}

bool fmt_vdb_recognise(const char first[8])
{
    return memcmp(first, " BDV", 4) == 0;
}

/* Checks a grid that was mapped, and fills in the rest. Closes it on failure. */
static int check_mapped(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid)
{
    int status = fmt_nvdb_check_header(ctx, grid);
    if (status == 0)
        status = fmt_nvdb_check_nodes(ctx, grid);
    status = bsq_map_explain(ctx, &grid->map, status);
    if (status)
        fmt_nvdb_close(ctx, grid);
    return status;
}

int fmt_nvdb_open(struct bsq_ctx *ctx, const char *path, struct fmt_nvdb_grid *out)
{
    memset(out, 0, sizeof(*out));
    int status = bsq_map_open(ctx, path, &out->map);
    return status ? status : check_mapped(ctx, out);
}

int fmt_nvdb_open_file(struct bsq_ctx *ctx, struct bsq_file *file, struct fmt_nvdb_grid *out)
{
    memset(out, 0, sizeof(*out));
    int status = bsq_map_file(ctx, file, &out->map);
    return status ? status : check_mapped(ctx, out);
}

void fmt_nvdb_close(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid)
{
    bsq_map_close(ctx, &grid->map);
    memset(grid, 0, sizeof(*grid));
}

int fmt_nvdb_record_version(const struct fmt_nvdb_grid *grid)
{
    return nvdb_record_version(grid->info.ids != BSQ_IDS_NONE, grid->channel_words > 0);
}

uint64_t fmt_nvdb_second(const struct fmt_nvdb_grid *grid, uint64_t v)
{
    assert(v <= grid->voxel_count);
    const uint32_t *word = grid->seconds[v / 32];
    uint32_t bit = UINT32_C(1) << (v % 32);
    uint64_t second = 1 + grid->voxel_count + word[1] + nvdb_popcount(word[0] & (bit - 1));
    return word[0] & bit && second < grid->record_count ? second : 0;
}
