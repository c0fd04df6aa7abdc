/* preview_scan.c - renders the scan by rays from the camera. The panel is divided into strips whose
 * rays and hits fit into memory. Rays start where they can first meet the scan: most of their steps
 * would go through empty space before the scan, or beside it. */
#include "libbake/preview/preview_view.h"

#include "base/parallel.h"

/* ---- the front of the scan ---- */

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

/* ---- rays ---- */

enum { COLUMN = 16 }; /* samples; divides those of a panel's side */

struct strip {
    const struct bake_preview *preview;
    const struct preview_view *view;
    uint32_t first_row, rows; /* pixels */
    uint32_t row_rays;        /* of a row of pixels */
    struct bake_exact_ray *rays;
    struct bake_exact_hit *hits;
    struct preview_front front;
    float *starts; /* one a ray, if front.starts is not NULL */
    float *pixels; /* of the panel's first row */
    size_t stride; /* floats from row to row */
};

/* Sets where a ray of a cell starts. A ray that cannot meet the scan gets no direction. */
static void start_ray(const struct strip *strip, uint64_t row, uint32_t column,
                      struct bake_exact_ray *ray)
{
    const float start = strip->front.starts[row * strip->front.cells + column];
    const bool meets = start <= strip->view->scan_span;
    strip->starts[ray - strip->rays] = meets ? start : 0;
    for (int k = 0; k < 3 && !meets; ++k)
        ray->direction[k] = 0;
}

/* Returns the number of a sample's ray. Rays follow each other down columns of COLUMN samples, as
 * rays near each other on both axes find what they need in the cache. y: from the strip's first
 * sample on. */
static uint64_t ray_at(const struct strip *strip, uint32_t x, uint32_t y)
{
    const uint64_t row = (uint64_t)(x / COLUMN) * strip->rows * PREVIEW_GRID + y;
    return row * COLUMN + x % COLUMN;
}

static void cast_ray(const struct strip *strip, uint32_t x, uint32_t y)
{
    const struct preview_view *view = strip->view;
    const struct bake_surface *surface = strip->preview->surface;
    const uint64_t i = ray_at(strip, x, y);
    const uint64_t row = (uint64_t)strip->first_row * PREVIEW_GRID + y;
    const double right = (x + 0.5 - 0.5 * view->samples) / view->scale;
    const double up = (0.5 * view->samples - ((double)row + 0.5)) / view->scale;
    struct bake_exact_ray *ray = &strip->rays[i];
    for (int k = 0; k < 3; ++k) {
        double p = view->centre[k] + right * view->right[k] + up * view->up[k] +
                   view->scan_depth * view->toward[k];
        ray->origin[k] = (float)((p - surface->translation[k]) / surface->unit);
        ray->direction[k] = -(float)view->toward[k];
    }
    if (strip->front.starts)
        start_ray(strip, row / PREVIEW_CELL, x / PREVIEW_CELL, ray);
}

static int cast_column(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct strip *strip = arg;
    for (uint32_t y = 0; y < strip->rows * PREVIEW_GRID; ++y)
        for (uint32_t x = 0; x < COLUMN; ++x)
            cast_ray(strip, (uint32_t)index * COLUMN + x, y);
    return 0;
}

static struct bsq_vec3 hit_color(const struct strip *strip, const struct bake_exact_hit *hit,
                                 uint32_t row)
{
    if (hit->triangle == BAKE_EXACT_NONE)
        return bake_preview_background(row, strip->view->side);
    struct bsq_vec3 normal = bsq_v3(hit->normal[0], hit->normal[1], hit->normal[2]);
    const double *toward = strip->view->toward;
    const double facing = normal.x * toward[0] + normal.y * toward[1] + normal.z * toward[2];
    if (strip->preview->two_sided && facing < 0)
        normal = bsq_scale3(normal, -1.0f);
    /* Without a colour map the mesh is grey; so is the scan, to be compared with it. */
    struct bsq_vec3 albedo = strip->preview->tiles[0].color->texels
                                 ? bsq_v3(hit->color[0], hit->color[1], hit->color[2])
                                 : bake_preview_grey();
    return bake_preview_shade(strip->view, normal, albedo);
}

static int shade_row(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct strip *strip = arg;
    const uint32_t row = strip->first_row + (uint32_t)index;
    const uint32_t top = (uint32_t)index * PREVIEW_GRID;
    float *out = strip->pixels + row * strip->stride;
    for (uint32_t column = 0; column < strip->view->side; ++column, out += 3) {
        struct bsq_vec3 sum = bsq_v3(0, 0, 0);
        for (uint32_t j = 0; j < PREVIEW_GRID; ++j)
            for (uint32_t i = 0; i < PREVIEW_GRID; ++i)
                sum = bsq_add3(
                    sum, hit_color(strip,
                                   &strip->hits[ray_at(strip, column * PREVIEW_GRID + i, top + j)],
                                   row));
        sum = bsq_scale3(sum, 1.0f / (PREVIEW_GRID * PREVIEW_GRID));
        out[0] = sum.x;
        out[1] = sum.y;
        out[2] = sum.z;
    }
    return 0;
}

static int render_strip(struct strip *strip)
{
    struct bsq_ctx *ctx = strip->preview->surface->ctx;
    const struct bake_surface_rays rays = {
        .batch = {.rays = strip->rays,
                  .hits = strip->hits,
                  .count = (uint64_t)strip->rows * strip->row_rays,
                  .t_min = 0,
                  .t_max = strip->view->scan_span,
                  .facing_origin = true},
        .starts = strip->starts,
        .best = true}; /* the reference is as accurate as possible */
    int status = 0;
    BSQ_TRY(bsq_parallel_for(ctx, strip->view->samples / COLUMN, cast_column, strip));
    BSQ_TRY(bake_surface_trace(strip->preview->surface, &rays));
    BSQ_TRY(bsq_parallel_for(ctx, strip->rows, shade_row, strip));
done:
    return status;
}

int bake_preview_scan_panel(const struct bake_preview *preview, const struct preview_view *view,
                            float *pixels, size_t stride)
{
    struct bsq_ctx *ctx = preview->surface->ctx;
    const uint32_t side = view->side, row_rays = view->samples * PREVIEW_GRID;
    struct strip strip = {
        .preview = preview, .view = view, .row_rays = row_rays, .pixels = pixels, .stride = stride};
    uint64_t most = bake_surface_capacity(preview->surface, 0) / row_rays;
    most = most < 1 ? 1 : most > side ? side : most;
    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "preview", most, row_rays * sizeof *strip.rays, &strip.rays));
    BSQ_TRY(bsq_alloc(ctx, "preview", most, row_rays * sizeof *strip.hits, &strip.hits));
    BSQ_TRY(bake_preview_front_create(ctx, preview->surface, view, &strip.front));
    if (strip.front.starts)
        BSQ_TRY(bsq_alloc(ctx, "preview", most, row_rays * sizeof *strip.starts, &strip.starts));
    for (uint32_t row = 0; row < side; row += strip.rows) {
        strip.first_row = row;
        strip.rows = side - row < most ? side - row : (uint32_t)most;
        BSQ_TRY(render_strip(&strip));
        bsq_progress_add(ctx, strip.rows);
    }
done:
    bsq_free(ctx, strip.starts);
    bsq_free(ctx, strip.front.starts);
    bsq_free(ctx, strip.hits);
    bsq_free(ctx, strip.rays);
    return status;
}
