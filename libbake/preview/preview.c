/* preview.c - renders the views one by one, band by band on all threads, and writes the PNG. */
#include "libbake/preview/preview.h"

#include <string.h>

#include "base/parallel.h"
#include "formats/image/image_writer.h"
#include "libbake/preview/preview_view.h"

enum {
    PANELS = 3,
    SEPARATOR = 4,
    SIDE_ALONE = 768, /* of the panels of a single view */
    SIDE = 384,       /* of the panels of each of several views: four take the time of one */
    PROBE_SIDE = 96,  /* of the pictures that tell which view shows most */
    PROBES = 8
};
_Static_assert(SIDE_ALONE % PREVIEW_BAND == 0 && SIDE % PREVIEW_BAND == 0 &&
                   PROBE_SIDE % PREVIEW_BAND == 0,
               "bands fill a panel");

enum { PANEL_PLAIN, PANEL_MAPPED, PANEL_SCAN };

struct rendering {
    struct bsq_ctx *ctx;
    const struct bake_preview *preview;
    uint32_t side, width; /* of a panel and of the picture */
    struct preview_view view;
    struct preview_band *bands; /* one a worker */
    float *pixels;              /* of a view: side x width x 3 */
};

/* Computes the colours of a sample in the mesh's two panels. x, y: in samples; band_y: y inside the
 * band. */
static void preview_sample(const struct rendering *r, const struct preview_band *band, uint32_t x,
                           uint32_t y, uint32_t band_y, struct bsq_vec3 colors[PANEL_SCAN])
{
    uint32_t triangle = band->triangle[(size_t)band_y * r->view.samples + x];
    if (triangle == UINT32_MAX)
        colors[PANEL_PLAIN] = colors[PANEL_MAPPED] =
            bake_preview_background(y / PREVIEW_GRID, r->side);
    else
        bake_preview_mesh_sample(r->preview, &r->view, triangle, x + 0.5, y + 0.5,
                                 &colors[PANEL_PLAIN], &colors[PANEL_MAPPED]);
}

static void put_pixel(struct bsq_vec3 sum, float *out)
{
    sum = bsq_scale3(sum, 1.0f / (PREVIEW_GRID * PREVIEW_GRID));
    out[0] = sum.x;
    out[1] = sum.y;
    out[2] = sum.z;
}

/* Renders a row of the mesh's two panels. out: of the first one. */
static void render_panel_row(const struct rendering *r, const struct preview_band *band,
                             uint32_t row, float *out)
{
    const size_t next = ((size_t)r->side + SEPARATOR) * 3; /* panel */
    for (uint32_t column = 0; column < r->side; ++column, out += 3) {
        struct bsq_vec3 sums[PANEL_SCAN] = {{0}}, colors[PANEL_SCAN];
        for (uint32_t j = 0; j < PREVIEW_GRID; ++j)
            for (uint32_t i = 0; i < PREVIEW_GRID; ++i) {
                preview_sample(r, band, column * PREVIEW_GRID + i, row * PREVIEW_GRID + j,
                               row % PREVIEW_BAND * PREVIEW_GRID + j, colors);
                for (int panel = PANEL_PLAIN; panel < PANEL_SCAN; ++panel)
                    sums[panel] = bsq_add3(sums[panel], colors[panel]);
            }
        for (int panel = PANEL_PLAIN; panel < PANEL_SCAN; ++panel)
            put_pixel(sums[panel], out + (size_t)panel * next);
    }
}

static int render_band(void *arg, uint64_t index, unsigned worker)
{
    struct rendering *r = arg;
    struct preview_band *band = &r->bands[worker];
    uint32_t first_row = (uint32_t)index * PREVIEW_BAND;
    bake_preview_mesh_band(r->preview, &r->view, first_row * PREVIEW_GRID, band);
    for (uint32_t row = first_row; row < first_row + PREVIEW_BAND; ++row)
        render_panel_row(r, band, row, r->pixels + (size_t)row * r->width * 3);
    bsq_progress_add(r->ctx, PREVIEW_BAND);
    return 0;
}

/* ---- the scan's panel ---- */

/* The panel is divided into strips whose rays and hits fit into memory. */
enum { COLUMN = 16 }; /* samples; divides those of a panel's side */

struct strip {
    const struct bake_preview *preview;
    const struct preview_view *view;
    uint32_t first_row, rows; /* pixels */
    uint32_t row_rays;        /* of a row of pixels */
    struct bake_ray *rays;
    struct bake_hit *hits;
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
    struct bake_ray *ray = &strip->rays[i];
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

static struct bsq_vec3 hit_color(const struct strip *strip, const struct bake_hit *hit,
                                 uint32_t row)
{
    if (hit->triangle == BAKE_NO_HIT)
        return bake_preview_background(row, strip->view->side);
    struct bsq_vec3 normal = bsq_v3(hit->normal[0], hit->normal[1], hit->normal[2]);
    const double *toward = strip->view->toward;
    const double facing = normal.x * toward[0] + normal.y * toward[1] + normal.z * toward[2];
    if (strip->preview->options->two_sided && facing < 0)
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
    BSQ_PASS(bsq_parallel_for(ctx, strip->view->samples / COLUMN, cast_column, strip));
    BSQ_PASS(bake_surface_trace(strip->preview->surface, &rays));
    return bsq_parallel_for(ctx, strip->rows, shade_row, strip);
}

/* Renders the scan's panel on all threads: view->side rows of RGB, `stride` floats apart. */
static int render_scan_panel(const struct bake_preview *preview, const struct preview_view *view,
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
    BSQ_FREE(ctx, strip.hits, strip.rays);
    return status;
}

/* ---- a view ---- */

static int preview_allocate(struct rendering *r)
{
    struct bsq_ctx *ctx = r->ctx;
    const uint64_t samples = (uint64_t)PREVIEW_BAND * PREVIEW_GRID * r->side * PREVIEW_GRID;
    BSQ_PASS(
        bsq_calloc(ctx, "preview", (uint64_t)r->width * r->side, 3 * sizeof(float), &r->pixels));
    BSQ_PASS(BSQ_CALLOC(ctx, "preview", bsq_threads(ctx), &r->bands));
    for (unsigned w = 0; w < bsq_threads(ctx); ++w) {
        BSQ_PASS(bsq_alloc(ctx, "preview", samples, sizeof(float), &r->bands[w].depth));
        BSQ_PASS(bsq_alloc(ctx, "preview", samples, sizeof(uint32_t), &r->bands[w].triangle));
    }
    return 0;
}

static void preview_release(struct rendering *r)
{
    for (unsigned w = 0; r->bands && w < bsq_threads(r->ctx); ++w) {
        BSQ_FREE(r->ctx, r->bands[w].depth, r->bands[w].triangle);
    }
    BSQ_FREE(r->ctx, r->bands, r->pixels);
}

/* Renders the panels of r->view. */
static int render_view(struct rendering *r)
{
    BSQ_PASS(bsq_parallel_for(r->ctx, r->side / PREVIEW_BAND, render_band, r));
    return render_scan_panel(r->preview, &r->view,
                             r->pixels + (size_t)PANEL_SCAN * (r->side + SEPARATOR) * 3,
                             (size_t)r->width * 3);
}

/* ---- the most telling view ---- */

/* A small picture of the mesh with its maps is made from each of PROBES directions. Light changes
 * from pixel to pixel most where there are faces, reliefs and inscriptions. Changes above
 * most_change are outlines, which say as little of a view as their length. */
static const float most_change = 0.06f;
static const double first_probe = 30; /* degrees: a three-quarter view from the front */
static const double front_bonus = 1.1;

static float light_at(const struct rendering *r, uint32_t x, uint32_t y)
{
    const size_t panel = (size_t)PANEL_MAPPED * (r->side + SEPARATOR);
    const float *pixel = r->pixels + ((size_t)y * r->width + panel + x) * 3;
    return sqrtf(0.2126f * pixel[0] + 0.7152f * pixel[1] + 0.0722f * pixel[2]);
}

/* Returns how much light changes in the picture that was rendered last. */
static double sum_changes(const struct rendering *r)
{
    double sum = 0;
    for (uint32_t y = 0; y + 1 < r->side; ++y)
        for (uint32_t x = 0; x + 1 < r->side; ++x) {
            const float here = light_at(r, x, y);
            sum += fminf(fabsf(light_at(r, x + 1, y) - here), most_change);
            sum += fminf(fabsf(light_at(r, x, y + 1) - here), most_change);
        }
    return sum;
}

/* Finds where the first view is, in degrees around the mesh. */
static int find_first_view(struct rendering *r, int up, double *out)
{
    const uint32_t side = r->side;
    double most = 0;
    int status = 0;
    *out = r->preview->options->preview_from < 0 ? first_probe : r->preview->options->preview_from;
    r->side = PROBE_SIDE;
    for (uint32_t i = 0; r->preview->options->preview_from < 0 && i < PROBES; ++i) {
        const double from = first_probe + i * 360.0 / PROBES;
        bake_preview_view_set(r->preview, from, up, r->side, &r->view);
        BSQ_TRY(bsq_parallel_for(r->ctx, r->side / PREVIEW_BAND, render_band, r));
        const double changes = sum_changes(r) * (i == 0 ? front_bonus : 1);
        if (changes > most) {
            most = changes;
            *out = from;
        }
    }
done:
    memset(r->pixels, 0, (size_t)r->side * r->width * 3 * sizeof *r->pixels);
    r->side = side;
    return status;
}

/* Renders and writes all views. The pixels between panels stay black. */
static int write_views(struct rendering *r, struct fmt_image_writer *writer, double *first)
{
    const int up = bake_preview_up_axis(r->preview);
    int status = find_first_view(r, up, first);
    for (uint32_t i = 0; status == 0 && i < r->preview->options->preview_views; ++i) {
        const double from = *first + i * 360.0 / r->preview->options->preview_views;
        bake_preview_view_set(r->preview, from, up, r->side, &r->view);
        status = render_view(r);
        if (status == 0)
            status = fmt_image_write_rows(writer, r->pixels, r->side);
        if (status < 0 || i + 1 == r->preview->options->preview_views)
            break;
        memset(r->pixels, 0, (size_t)SEPARATOR * r->width * 3 * sizeof *r->pixels);
        status = fmt_image_write_rows(writer, r->pixels, SEPARATOR);
    }
    return status;
}

int bake_preview_write(struct bsq_ctx *ctx, const char *path, const struct bake_preview *preview,
                       double *from, struct bsq_output **out)
{
    struct rendering r = {.ctx = ctx,
                          .preview = preview,
                          .side = preview->options->preview_views == 1 ? SIDE_ALONE : SIDE};
    struct fmt_image_writer *writer = NULL;
    int status;
    r.width = PANELS * r.side + (PANELS - 1) * SEPARATOR;
    const struct fmt_image_options options = {
        .width = r.width,
        .height = preview->options->preview_views * (r.side + SEPARATOR) - SEPARATOR,
        .channel_count = 3,
        .type = FMT_UINT8,
        .color = true};
    BSQ_TRY(fmt_image_create(ctx, &fmt_png_format, path, &options, &writer));
    BSQ_TRY(preview_allocate(&r));
    const uint64_t probe_rows = preview->options->preview_from < 0 ? PROBES * PROBE_SIDE : 0;
    bsq_progress_begin(ctx, "preview", "rows",
                       UINT64_C(2) * r.side * preview->options->preview_views + probe_rows);
    status = write_views(&r, writer, from);
    bsq_progress_end(ctx);
    if (status == 0) {
        status = fmt_image_hand_over(writer, out);
        writer = NULL;
    }
done:
    fmt_image_discard(writer);
    preview_release(&r);
    return status;
}
