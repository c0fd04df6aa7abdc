/* nvdb_check_records.c - is every record of a grid one that a writer may write?
 *
 * Only who verifies a whole file asks: the baker is safe with any bits in a record, and reading the
 * channels would be most of the work of opening a grid. Voxels go in pieces of a whole number of
 * words of `second`, so that each piece knows the numbers of its second records from the ranks,
 * which fmt_nvdb_check_nodes() has checked. */
#include <inttypes.h>

#include "base/parallel.h"
#include "formats/grid/nvdb_layout_internal.h"

enum { WORDS_PER_PIECE = 1 << 14 };

struct check {
    struct bsq_ctx *ctx;
    const struct fmt_nvdb_grid *grid;
    bool forget;
};

static int bad_record(const struct check *c, uint64_t number, const char *what)
{
    return bsq_fail(c->ctx, BSQ_EDATA, "%s: damaged: record %" PRIu64 " has a wrong %s",
                    c->grid->map.path, number, what);
}

/* What is wrong with a record whose voxel has a second one (or not); NULL: nothing. */
static const char *fault_of(const struct fmt_nvdb_grid *grid, uint64_t number, bool second)
{
    uint32_t normal = grid->normals[number], plane = grid->planes[number];
    if ((normal & 0xffff) == 0x8000 || normal >> 16 == 0x8000)
        return "normal";
    uint32_t grain = plane >> FMT_NVDB_GRAIN_SHIFT;
    if (grain > FMT_NVDB_GRAIN_MAX || (grain > 0 && (plane & FMT_NVDB_PLANE_SHADED)) ||
        (plane & 0xffff) == 0x8000)
        return "plane";
    if (!(plane & FMT_NVDB_PLANE_SECOND) != !second)
        return "mark of a second record";
    uint32_t color = grid->colors ? grid->colors[number] : 0;
    return color != 0 && color >> 24 != 255 ? "colour" : NULL;
}

static int check_voxel(const struct check *c, uint64_t v)
{
    uint64_t second = fmt_nvdb_second(c->grid, v);
    const char *fault = fault_of(c->grid, v, second != 0);
    if (fault)
        return bad_record(c, v, fault);
    if (second && (fault = fault_of(c->grid, second, false)))
        return bad_record(c, second, fault);
    return 0;
}

static int check_piece(void *arg, uint64_t index, unsigned worker)
{
    const struct check *c = arg;
    const struct fmt_nvdb_grid *grid = c->grid;
    uint64_t begin = index * WORDS_PER_PIECE * 32, end = begin + WORDS_PER_PIECE * 32;
    int status = bsq_check(c->ctx);
    (void)worker;
    if (end > grid->voxel_count + 1)
        end = grid->voxel_count + 1;
    for (uint64_t v = begin > 0 ? begin : 1; v < end && !status; v++)
        status = check_voxel(c, v);
    if (c->forget) {
        fmt_nvdb_forget_pages(grid->normals + begin, (end - begin) * 4);
        fmt_nvdb_forget_pages(grid->planes + begin, (end - begin) * 4);
        if (grid->colors)
            fmt_nvdb_forget_pages(grid->colors + begin, (end - begin) * 4);
    }
    return status;
}

int fmt_nvdb_check_records(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid, bool forget)
{
    struct check c = {ctx, grid, forget};
    uint64_t words = grid->voxel_count / 32 + 1;
    if (grid->normals[0] || grid->planes[0] || (grid->colors && grid->colors[0]))
        return bad_record(&c, 0, "value, as it is the background");
    return bsq_parallel_for(ctx, (words + WORDS_PER_PIECE - 1) / WORDS_PER_PIECE, check_piece, &c);
}
