/* preview_scan.c - renders the scan by rays from the camera. The panel is divided into strips whose
 * rays and hits fit into memory. */
#include "libbake/preview/preview_view.h"

#include "base/parallel.h"

enum { COLUMN = 16 }; /* samples; divides those of a panel's side */

struct strip {
    const struct bake_preview *preview;
    const struct preview_view *view;
    uint32_t first_row, rows; /* pixels */
    uint32_t row_rays;        /* of a row of pixels */
    struct bake_exact_ray *rays;
    struct bake_exact_hit *hits;
    float *pixels; /* of the panel's first row */
    size_t stride; /* floats from row to row */
};

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
    for (uint32_t row = 0; row < side; row += strip.rows) {
        strip.first_row = row;
        strip.rows = side - row < most ? side - row : (uint32_t)most;
        BSQ_TRY(render_strip(&strip));
        bsq_progress_add(ctx, strip.rows);
    }
done:
    bsq_free(ctx, strip.hits);
    bsq_free(ctx, strip.rays);
    return status;
}
