/* preview_front.c - finds where camera rays can first meet the scan. Most of a ray's steps would go
 * through empty space before the scan, or beside it. */
#include "libbake/preview/preview_view.h"

enum { BLOCK = 8, BLOCKS = 16 }; /* voxels, blocks along a side; see bake_surface_each_block() */

/* Voxels between the start of a ray and the first block, against rounding. */
static const double clearance = 2.0;

struct front_of_view {
    const struct preview_view *view;
    struct preview_front *front;
};

/* The projection of a group of blocks: positions in cells, depths in world units from where rays
 * begin. */
struct projection {
    double at[3], step[3][3]; /* of the first block's centre; from block to block on each axis */
    double reach[3];          /* of a block from its centre */
};

static uint32_t clamp_cell(double v, uint32_t cells)
{
    return v > 0 ? (v < cells ? (uint32_t)v : cells - 1) : 0;
}

static void add_block(struct preview_front *front, const struct projection *p, const double at[3])
{
    const double limit = front->cells;
    if (at[0] + p->reach[0] < 0 || at[1] + p->reach[1] < 0 || at[0] - p->reach[0] > limit ||
        at[1] - p->reach[1] > limit)
        return;
    const uint32_t x0 = clamp_cell(at[0] - p->reach[0], front->cells);
    const uint32_t x1 = clamp_cell(at[0] + p->reach[0], front->cells);
    const uint32_t y0 = clamp_cell(at[1] - p->reach[1], front->cells);
    const uint32_t y1 = clamp_cell(at[1] + p->reach[1], front->cells);
    const float start = (float)fmax(at[2] - p->reach[2], 0);
    for (uint32_t y = y0; y <= y1; ++y)
        for (uint32_t x = x0; x <= x1; ++x) {
            float *nearest = &front->starts[(size_t)y * front->cells + x];
            *nearest = start < *nearest ? start : *nearest;
        }
}

static void project_group(const struct preview_view *view, const double origin[3], double unit,
                          struct projection *out)
{
    const double cells_a_unit = view->scale / PREVIEW_CELL, half = BLOCK * unit / 2;
    double p[3];
    for (int k = 0; k < 3; ++k)
        p[k] = origin[k] + half - view->centre[k];
    out->at[0] = 0.5 * view->samples / PREVIEW_CELL + cells_a_unit * bsq_dotd(p, view->right);
    out->at[1] = 0.5 * view->samples / PREVIEW_CELL - cells_a_unit * bsq_dotd(p, view->up);
    out->at[2] = view->scan_depth - bsq_dotd(p, view->toward);
    for (int k = 0; k < 3; ++k) {
        out->step[k][0] = 2 * half * cells_a_unit * view->right[k];
        out->step[k][1] = -2 * half * cells_a_unit * view->up[k];
        out->step[k][2] = -2 * half * view->toward[k];
    }
    for (int i = 0; i < 3; ++i) {
        out->reach[i] = (fabs(out->step[0][i]) + fabs(out->step[1][i]) + fabs(out->step[2][i])) / 2;
        out->reach[i] += clearance * unit * (i < 2 ? cells_a_unit : 1);
    }
}

static void add_group(void *arg, const double origin[3], double unit,
                      const uint64_t mask[BAKE_MASK_WORDS])
{
    const struct front_of_view *to = arg;
    struct projection p;
    project_group(to->view, origin, unit, &p);
    for (uint32_t word = 0; word < BAKE_MASK_WORDS; ++word)
        for (uint64_t bits = mask[word]; bits; bits &= bits - 1) {
            const uint32_t n = word * 64 + (uint32_t)__builtin_ctzll(bits);
            const uint32_t block[3] = {n / (BLOCKS * BLOCKS), n / BLOCKS % BLOCKS, n % BLOCKS};
            double at[3];
            for (int i = 0; i < 3; ++i)
                at[i] = p.at[i] + block[0] * p.step[0][i] + block[1] * p.step[1][i] +
                        block[2] * p.step[2][i];
            add_block(to->front, &p, at);
        }
}

int bake_preview_front_create(struct bsq_ctx *ctx, const struct bake_surface *surface,
                              const struct preview_view *view, struct preview_front *out)
{
    struct front_of_view to = {view, out};
    out->cells = (view->samples + PREVIEW_CELL - 1) / PREVIEW_CELL;
    out->starts = NULL;
    if (bake_surface_has_triangles(surface))
        return 0;
    const uint64_t count = (uint64_t)out->cells * out->cells;
    int status = bsq_alloc(ctx, "preview", count, sizeof *out->starts, &out->starts);
    for (uint64_t i = 0; status == 0 && i < count; ++i)
        out->starts[i] = INFINITY;
    if (status == 0)
        bake_surface_each_block(surface, add_group, &to);
    return status;
}
