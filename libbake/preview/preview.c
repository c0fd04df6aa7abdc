/* preview.c - renders the preview picture band by band on all threads, and writes the PNG. */
#include "libbake/preview/preview.h"

#include <string.h>

#include "base/parallel.h"
#include "formats/image/image_writer.h"
#include "libbake/preview/preview_view.h"

enum {
    PANELS = 3,
    SEPARATOR = 4,
    WIDTH = PANELS * PREVIEW_SIDE + (PANELS - 1) * SEPARATOR,
    HEIGHT = PREVIEW_SIDE,
    BANDS = HEIGHT / PREVIEW_BAND,
    EXTENTS_A_TASK = 4096
};
_Static_assert(HEIGHT % PREVIEW_BAND == 0, "bands fill the picture");

enum { PANEL_PLAIN, PANEL_MAPPED, PANEL_SCAN };

struct bake_preview_file {
    struct bsq_ctx *ctx;
    struct fmt_image_writer *writer;
};

struct rendering {
    struct bsq_ctx *ctx;
    const struct bake_preview *preview;
    struct preview_view view;
    struct preview_extent *extents;
    struct preview_band *bands; /* one a worker */
    float *pixels;              /* HEIGHT x WIDTH x 3 */
};

int bake_preview_open(struct bsq_ctx *ctx, const char *path, struct bake_preview_file **out)
{
    *out = NULL;
    const struct fmt_image_options options = {
        .width = WIDTH, .height = HEIGHT, .channel_count = 3, .type = FMT_UINT8, .color = true};
    struct bake_preview_file *file;
    int status = bsq_calloc(ctx, "preview", 1, sizeof *file, &file);
    if (status < 0)
        return status;
    file->ctx = ctx;
    status = fmt_image_create(ctx, &fmt_png_format, path, &options, &file->writer);
    if (status < 0)
        bake_preview_discard(file);
    else
        *out = file;
    return status;
}

static int measure_extents(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    struct rendering *r = arg;
    uint64_t first = task * EXTENTS_A_TASK;
    uint64_t left = r->preview->mesh->triangle_count - first;
    bake_preview_mesh_extents(r->preview, &r->view, first,
                              left < EXTENTS_A_TASK ? left : EXTENTS_A_TASK, r->extents);
    return 0;
}

/* Returns the colour of a sample of one of the mesh's panels. x, y: in samples; band_y: y inside
 * the band. */
static struct bsq_vec3 sample(const struct rendering *r, const struct preview_band *band, int panel,
                              uint32_t x, uint32_t y, uint32_t band_y)
{
    uint32_t triangle = band->triangle[(size_t)band_y * PREVIEW_SAMPLES + x];
    if (triangle == UINT32_MAX)
        return bake_preview_background(y / PREVIEW_GRID);
    return bake_preview_mesh_sample(r->preview, &r->view, triangle, x + 0.5, y + 0.5,
                                    panel == PANEL_MAPPED);
}

static void render_panel_row(const struct rendering *r, const struct preview_band *band, int panel,
                             uint32_t row, float *out)
{
    for (uint32_t column = 0; column < PREVIEW_SIDE; ++column, out += 3) {
        struct bsq_vec3 sum = bsq_v3(0, 0, 0);
        for (uint32_t j = 0; j < PREVIEW_GRID; ++j)
            for (uint32_t i = 0; i < PREVIEW_GRID; ++i)
                sum = bsq_add3(sum, sample(r, band, panel, column * PREVIEW_GRID + i,
                                           row * PREVIEW_GRID + j,
                                           row % PREVIEW_BAND * PREVIEW_GRID + j));
        sum = bsq_scale3(sum, 1.0f / (PREVIEW_GRID * PREVIEW_GRID));
        out[0] = sum.x;
        out[1] = sum.y;
        out[2] = sum.z;
    }
}

static int render_band(void *arg, uint64_t index, unsigned worker)
{
    struct rendering *r = arg;
    struct preview_band *band = &r->bands[worker];
    uint32_t first_row = (uint32_t)index * PREVIEW_BAND;
    bake_preview_mesh_band(r->preview, &r->view, r->extents, first_row * PREVIEW_GRID, band);
    for (uint32_t row = first_row; row < first_row + PREVIEW_BAND; ++row)
        for (int panel = PANEL_PLAIN; panel < PANEL_SCAN; ++panel)
            render_panel_row(
                r, band, panel, row,
                r->pixels + ((size_t)row * WIDTH + (size_t)panel * (PREVIEW_SIDE + SEPARATOR)) * 3);
    bsq_progress_add(r->ctx, PREVIEW_BAND);
    return 0;
}

static int allocate(struct rendering *r)
{
    struct bsq_ctx *ctx = r->ctx;
    const uint64_t rows = PREVIEW_BAND * PREVIEW_GRID;
    int status =
        bsq_calloc(ctx, "preview", (uint64_t)WIDTH * HEIGHT, 3 * sizeof(float), &r->pixels);
    if (status == 0)
        status = bsq_alloc(ctx, "preview", r->preview->mesh->triangle_count, sizeof *r->extents,
                           &r->extents);
    if (status == 0)
        status = bsq_calloc(ctx, "preview", bsq_threads(ctx), sizeof *r->bands, &r->bands);
    for (unsigned w = 0; status == 0 && w < bsq_threads(ctx); ++w) {
        status =
            bsq_alloc(ctx, "preview", rows * PREVIEW_SAMPLES, sizeof(float), &r->bands[w].depth);
        if (status == 0)
            status = bsq_alloc(ctx, "preview", rows * PREVIEW_SAMPLES, sizeof(uint32_t),
                               &r->bands[w].triangle);
    }
    return status;
}

static void release(struct rendering *r)
{
    for (unsigned w = 0; r->bands && w < bsq_threads(r->ctx); ++w) {
        bsq_free(r->ctx, r->bands[w].depth);
        bsq_free(r->ctx, r->bands[w].triangle);
    }
    bsq_free(r->ctx, r->bands);
    bsq_free(r->ctx, r->extents);
    bsq_free(r->ctx, r->pixels);
}

int bake_preview_write(struct bake_preview_file *file, const struct bake_preview *preview)
{
    struct rendering r = {.ctx = file->ctx, .preview = preview};
    bake_preview_view_set(preview, &r.view);
    int status = allocate(&r);
    if (status == 0) {
        uint64_t tasks = (preview->mesh->triangle_count - 1) / EXTENTS_A_TASK + 1;
        status = bsq_parallel_for(file->ctx, tasks, measure_extents, &r);
    }
    if (status == 0) {
        bsq_progress_begin(file->ctx, "preview", "rows", 2 * HEIGHT);
        status = bsq_parallel_for(file->ctx, BANDS, render_band, &r);
        if (status == 0)
            status = bake_preview_scan_panel(
                preview, &r.view, r.pixels + (size_t)PANEL_SCAN * (PREVIEW_SIDE + SEPARATOR) * 3,
                (size_t)WIDTH * 3);
        bsq_progress_end(file->ctx);
    }
    if (status == 0)
        status = fmt_image_write_rows(file->writer, r.pixels, HEIGHT);
    if (status == 0)
        status = fmt_image_finish(file->writer);
    release(&r);
    return status;
}

int bake_preview_hand_over(struct bake_preview_file *file, struct bsq_output **out)
{
    int status = fmt_image_hand_over(file->writer, out);
    bsq_free(file->ctx, file);
    return status;
}

void bake_preview_discard(struct bake_preview_file *file)
{
    if (!file)
        return;
    fmt_image_discard(file->writer);
    bsq_free(file->ctx, file);
}
