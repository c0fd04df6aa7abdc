/* preview.c - renders the views one by one, band by band on all threads, and writes the PNG. */
#include "libbake/preview/preview.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/colour_difference.h"
#include "base/parallel.h"
#include "base/text.h"
#include "formats/image/image_writer.h"
#include "libbake/preview/preview_view.h"

enum {
    PANELS = 3,
    SEPARATOR = 4,
    LINE = 24,        /* pixel rows of the line below each view */
    SIDE_ALONE = 768, /* of the panels of a single view */
    SIDE = 384        /* of the panels of each of several views: four take the time of one */
};
_Static_assert(SIDE_ALONE % PREVIEW_BAND == 0 && SIDE % PREVIEW_BAND == 0, "bands fill a panel");

enum { PANEL_PLAIN, PANEL_MAPPED, PANEL_SCAN };

struct rendering {
    struct bsq_ctx *ctx;
    const struct bake_preview *preview;
    uint32_t side, width; /* of a panel and of the picture */
    struct preview_view view;
    struct preview_band *bands; /* one a worker */
    float *pixels;              /* of a view: (side + LINE) x width x 3 */
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
    struct bake_hit *hits, *backs; /* what faces the camera, and what faces away */
    float *pixels;                 /* of the panel's first row */
    size_t stride;                 /* floats from row to row */
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

static struct bsq_vec3 hit_color(const struct strip *strip, uint64_t ray, uint32_t row)
{
    const struct bake_hit *hit = &strip->hits[ray], *back = &strip->backs[ray];
    /* Planes of voxels beside an edge must not show before its front. */
    const bool behind =
        back->triangle != BAKE_NO_HIT &&
        (hit->triangle == BAKE_NO_HIT || back->t < hit->t - 2 * strip->preview->surface->detail);
    if (behind)
        hit = back;
    if (hit->triangle == BAKE_NO_HIT)
        return bake_preview_background(row, strip->view->side);
    struct bsq_vec3 normal = bsq_load3(hit->normal);
    if (behind || strip->preview->options->two_sided)
        normal = bake_preview_turn_normal(strip->view, normal);
    /* Without a colour map the mesh is grey; so is the scan, to be compared with it. */
    struct bsq_vec3 albedo =
        strip->preview->tiles[0].color->texels ? bsq_load3(hit->color) : bake_preview_grey();
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
                    sum, hit_color(strip, ray_at(strip, column * PREVIEW_GRID + i, top + j), row));
        put_pixel(sum, out);
    }
    return 0;
}

static int render_strip(struct strip *strip)
{
    struct bsq_ctx *ctx = strip->preview->surface->ctx;
    struct bake_ray_batch rays = {.rays = strip->rays,
                                  .hits = strip->hits,
                                  .count = (uint64_t)strip->rows * strip->row_rays,
                                  .t_min = 0,
                                  .t_max = strip->view->scan_span,
                                  .facing_origin = true,
                                  .best = true}; /* the reference is as accurate as possible */
    BSQ_PASS(bsq_parallel_for(ctx, strip->view->samples / COLUMN, cast_column, strip));
    BSQ_PASS(bake_surface_trace(strip->preview->surface, &rays));
    rays.hits = strip->backs;
    rays.facing_origin = false;
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
    uint64_t most = bake_surface_capacity(preview->surface, sizeof *strip.backs) / row_rays;
    most = most < 1 ? 1 : most > side ? side : most;
    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "preview", most, row_rays * sizeof *strip.rays, &strip.rays));
    BSQ_TRY(bsq_alloc(ctx, "preview", most, row_rays * sizeof *strip.hits, &strip.hits));
    BSQ_TRY(bsq_alloc(ctx, "preview", most, row_rays * sizeof *strip.backs, &strip.backs));
    for (uint32_t row = 0; row < side; row += strip.rows) {
        strip.first_row = row;
        strip.rows = side - row < most ? side - row : (uint32_t)most;
        BSQ_TRY(render_strip(&strip));
        bsq_progress_add(ctx, strip.rows);
    }
done:
    BSQ_FREE(ctx, strip.backs, strip.hits, strip.rays);
    return status;
}

/* ---- a view ---- */

static int preview_allocate(struct rendering *r)
{
    struct bsq_ctx *ctx = r->ctx;
    const uint64_t samples = (uint64_t)PREVIEW_BAND * PREVIEW_GRID * r->side * PREVIEW_GRID;
    BSQ_PASS(bsq_calloc(ctx, "preview", (uint64_t)r->width * (r->side + LINE), 3 * sizeof(float),
                        &r->pixels));
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

/* ---- the difference below each view ---- */

/* Glyphs of 5 x 7 pixels: a byte for each row, with the leftmost pixel in bit 4. */
static const struct {
    char letter;
    uint8_t rows[7];
} glyphs[] = {
    {'0', {0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e}},
    {'1', {0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e}},
    {'2', {0x0e, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1f}},
    {'3', {0x1f, 0x02, 0x04, 0x02, 0x01, 0x11, 0x0e}},
    {'4', {0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02}},
    {'5', {0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e}},
    {'6', {0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e}},
    {'7', {0x1f, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08}},
    {'8', {0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e}},
    {'9', {0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c}},
    {'m', {0x00, 0x00, 0x1a, 0x15, 0x15, 0x11, 0x11}},
    {'e', {0x00, 0x00, 0x0e, 0x11, 0x1f, 0x10, 0x0e}},
    {'a', {0x00, 0x00, 0x0e, 0x01, 0x0f, 0x11, 0x0f}},
    {'n', {0x00, 0x00, 0x16, 0x19, 0x11, 0x11, 0x11}},
    {'d', {0x01, 0x01, 0x0d, 0x13, 0x11, 0x11, 0x0f}},
    {'E', {0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x1f}},
    {'.', {0x00, 0x00, 0x00, 0x00, 0x00, 0x0c, 0x0c}},
};
enum { GLYPHS = sizeof glyphs / sizeof *glyphs, GLYPH_STEP = 12 }; /* 2 x 2 pixels for each */

static void draw_letter(const struct rendering *r, char letter, uint32_t left)
{
    size_t g = 0;
    while (g < GLYPHS && glyphs[g].letter != letter)
        g++;
    for (uint32_t y = 0; g < GLYPHS && y < 14; y++)
        for (uint32_t x = 0; x < 10; x++) {
            float *pixel = r->pixels + ((size_t)(r->side + 6 + y) * r->width + left + x) * 3;
            if (glyphs[g].rows[y / 2] >> (4 - x / 2) & 1)
                pixel[0] = pixel[1] = pixel[2] = 0.6f;
        }
}

/* Returns whether a panel shows a surface at a pixel. */
static bool shows_surface(const float pixel[3], struct bsq_vec3 background)
{
    return fabsf(pixel[0] - background.x) + fabsf(pixel[1] - background.y) +
               fabsf(pixel[2] - background.z) >
           1e-6f;
}

/* Writes the mean difference of mesh and scan below the view, between their panels: CIEDE2000 of
 * the pixels, of which each second one of a row is taken, that show either. */
static void write_difference(const struct rendering *r)
{
    const size_t next = ((size_t)r->side + SEPARATOR) * 3;
    double sum = 0, lab[2][3];
    uint32_t count = 0;
    char text[40];
    memset(r->pixels + (size_t)r->side * r->width * 3, 0,
           (size_t)LINE * r->width * 3 * sizeof *r->pixels);
    for (uint32_t y = 0; y < r->side; y++)
        for (uint32_t x = y % 2; x < r->side; x += 2) {
            const float *mapped = r->pixels + ((size_t)y * r->width + x) * 3 + next,
                        *scan = mapped + next;
            const struct bsq_vec3 background = bake_preview_background(y, r->side);
            if (!shows_surface(mapped, background) && !shows_surface(scan, background))
                continue;
            bsq_lab(mapped, lab[0]);
            bsq_lab(scan, lab[1]);
            sum += bsq_ciede2000(lab[0], lab[1]);
            count++;
        }
    const locale_t host = bsq_plain_numbers();
    snprintf(text, sizeof text, "mean dE2000 %.2f", count > 0 ? sum / count : 0);
    uselocale(host);
    const uint32_t length = (uint32_t)strlen(text), middle = 2 * r->side + SEPARATOR;
    for (uint32_t i = 0; i < length; i++)
        draw_letter(r, text[i], middle + GLYPH_STEP * i - GLYPH_STEP * length / 2);
}

/* Renders and writes all views. The pixels between panels stay black. */
static int write_views(struct rendering *r, struct fmt_image_writer *writer, int up,
                       const struct bake_preview_views *views)
{
    int status = 0;
    for (uint32_t i = 0; status == 0 && i < r->preview->options->preview_views; ++i) {
        bake_preview_view_set(r->preview, views->from + i * views->step, views->above, up, r->side,
                              &r->view);
        status = render_view(r);
        if (status == 0) {
            write_difference(r);
            status = fmt_image_write_rows(writer, r->pixels, r->side + LINE);
        }
        if (status < 0 || i + 1 == r->preview->options->preview_views)
            break;
        memset(r->pixels, 0, (size_t)SEPARATOR * r->width * 3 * sizeof *r->pixels);
        status = fmt_image_write_rows(writer, r->pixels, SEPARATOR);
    }
    return status;
}

int bake_preview_write(struct bsq_ctx *ctx, const char *path, const struct bake_preview *preview,
                       struct bake_preview_views *views, struct bsq_output **out)
{
    const int up = bake_preview_up_axis(preview);
    struct rendering r = {.ctx = ctx,
                          .preview = preview,
                          .side = preview->options->preview_views == 1 ? SIDE_ALONE : SIDE};
    struct fmt_image_writer *writer = NULL;
    int status;
    r.width = PANELS * r.side + (PANELS - 1) * SEPARATOR;
    const struct fmt_image_options options = {
        .width = r.width,
        .height = preview->options->preview_views * (r.side + LINE + SEPARATOR) - SEPARATOR,
        .channel_count = 3,
        .type = FMT_UINT8,
        .color = true};
    BSQ_TRY(fmt_image_create(ctx, &fmt_png_format, path, &options, &writer));
    BSQ_TRY(preview_allocate(&r));
    bsq_progress_begin(ctx, "preview", "rows",
                       UINT64_C(2) * r.side * preview->options->preview_views);
    bake_preview_place_views(preview, up, views);
    status = write_views(&r, writer, up, views);
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
