/* compare_chart.c - heat map and histogram of a comparison, as PNG.
 *
 * Colours run from near black over purple and orange to light yellow with steadily growing
 * lightness, so that the picture reads the same in grey and for colour-blind eyes. Texels without
 * an error are blue-grey. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "formats/image/png_image.h"
#include "libbake/compare/comparison.h"
#include "libbake/compare/glyphs.h"

/* ---- a small canvas ---- */

struct canvas {
    uint32_t width, height;
    float (*pixels)[3]; /* display-referred 0..1 */
};

static int canvas_create(struct bsq_ctx *ctx, uint64_t width, uint64_t height, struct canvas *out)
{
    static const float paper[3] = {0.11f, 0.12f, 0.14f};
    *out = (struct canvas){(uint32_t)width, (uint32_t)height, NULL};
    int status = bsq_alloc(ctx, "chart", width * height, sizeof *out->pixels, &out->pixels);
    for (uint64_t i = 0; !status && i < width * height; i++)
        memcpy(out->pixels[i], paper, sizeof paper);
    return status;
}

static int canvas_write(struct bsq_ctx *ctx, const struct canvas *canvas, const char *path)
{
    struct fmt_png_options options = {canvas->width, canvas->height, 3, 8, false};
    struct fmt_png_writer *writer;
    int status = fmt_png_create(ctx, path, &options, &writer);
    if (status)
        return status;
    status = fmt_png_write_rows(writer, canvas->pixels[0], canvas->height);
    if (!status)
        return fmt_png_commit(writer);
    fmt_png_discard(writer);
    return status;
}

static void fill(struct canvas *canvas, int64_t x0, int64_t y0, int64_t width, int64_t height,
                 const float color[3])
{
    for (int64_t y = y0; y < y0 + height; y++)
        for (int64_t x = x0; x < x0 + width; x++)
            if (x >= 0 && y >= 0 && x < canvas->width && y < canvas->height)
                memcpy(canvas->pixels[y * canvas->width + x], color, 3 * sizeof *color);
}

static const float ink[3] = {0.92f, 0.92f, 0.90f};

/* Text with its top left corner at (x, y), `scale` pixels to a dot. */
static void write_text(struct canvas *canvas, int64_t x, int64_t y, unsigned scale,
                       const char *text)
{
    for (; *text; text++, x += (BAKE_GLYPH_WIDTH + 1) * scale) {
        const uint8_t *rows = bake_glyph(*text);
        for (unsigned row = 0; row < BAKE_GLYPH_HEIGHT; row++)
            for (unsigned column = 0; column < BAKE_GLYPH_WIDTH; column++)
                if (rows[row] >> (BAKE_GLYPH_WIDTH - 1 - column) & 1)
                    fill(canvas, x + column * scale, y + row * scale, scale, scale, ink);
    }
}

static int64_t text_width(const char *text, unsigned scale)
{
    return (int64_t)(strlen(text) * (BAKE_GLYPH_WIDTH + 1) * scale);
}

/* ---- colours ---- */

static void heat(double value, float color[3])
{
    static const float stops[][3] = {{0.02f, 0.02f, 0.07f}, {0.24f, 0.06f, 0.42f},
                                     {0.60f, 0.15f, 0.45f}, {0.90f, 0.36f, 0.24f},
                                     {0.98f, 0.69f, 0.22f}, {0.99f, 0.98f, 0.75f}};
    const int last = sizeof stops / sizeof *stops - 1;
    double x = fmin(fmax(value, 0), 1) * last;
    int i = x < last ? (int)x : last - 1;
    for (int k = 0; k < 3; k++)
        color[k] = stops[i][k] + (float)(x - i) * (stops[i + 1][k] - stops[i][k]);
}

/* ---- the scale: a bar with five ticks ---- */

static bool overlap(const struct bake_scale_label *a, const struct bake_scale_label *b, int64_t gap)
{
    return a->left < b->left + b->width + gap && b->left < a->left + a->width + gap;
}

void bake_scale_layout(int64_t width, unsigned scale, double top, const char *unit,
                       struct bake_scale_label labels[BAKE_SCALE_TICKS])
{
    static const int by_weight[BAKE_SCALE_TICKS] = {4, 0, 2, 1, 3};
    int64_t margin = BAKE_SCALE_MARGIN * scale, bar = width - 2 * margin,
            gap = BAKE_GLYPH_WIDTH * scale;
    for (int i = 0; i < BAKE_SCALE_TICKS; i++) {
        int tick = by_weight[i];
        bool last = tick == BAKE_SCALE_TICKS - 1;
        struct bake_scale_label *label = &labels[tick];
        snprintf(label->text, sizeof label->text, "%.3g%s%s", top * tick / (BAKE_SCALE_TICKS - 1),
                 last ? "+ " : "", last ? unit : "");
        label->tick = margin + bar * tick / (BAKE_SCALE_TICKS - 1);
        label->width = text_width(label->text, scale) - scale;
        label->left = last ? width - label->width - 2 * scale : label->tick - label->width / 2;
        label->shown = true;
        for (int j = 0; j < i; j++)
            if (labels[by_weight[j]].shown && overlap(label, &labels[by_weight[j]], gap))
                label->shown = false;
    }
}

static void draw_scale(struct canvas *canvas, int64_t y, unsigned scale, double top,
                       const char *unit, bool colored)
{
    struct bake_scale_label labels[BAKE_SCALE_TICKS];
    int64_t margin = BAKE_SCALE_MARGIN * scale, width = (int64_t)canvas->width - 2 * margin,
            bar = 8 * scale;
    for (int64_t x = 0; colored && x < width; x++) {
        float color[3];
        heat((double)x / (double)width, color);
        fill(canvas, margin + x, y, 1, bar, color);
    }
    bake_scale_layout(canvas->width, scale, top, unit, labels);
    for (int i = 0; i < BAKE_SCALE_TICKS; i++) {
        fill(canvas, labels[i].tick, y + bar, scale, 3 * scale, ink);
        if (labels[i].shown)
            write_text(canvas, labels[i].left, y + bar + 5 * scale, scale, labels[i].text);
    }
}

static unsigned scale_for(uint32_t width)
{
    return width < 512 ? 1 : width / 512;
}

enum { SCALE_HEIGHT = 28, LEAST_WIDTH = 256 };

int bake_heatmap_write(struct bsq_ctx *ctx, const struct bake_comparison *comparison, double top,
                       const char *path)
{
    static const float empty[3] = {0.22f, 0.25f, 0.30f};
    uint32_t width = comparison->a.width, height = comparison->a.height;
    struct canvas canvas;
    unsigned scale = scale_for(width);
    int status = canvas_create(ctx, width < LEAST_WIDTH ? LEAST_WIDTH : width,
                               (uint64_t)height + SCALE_HEIGHT * scale, &canvas);
    if (status)
        return status;
    for (uint64_t y = 0; y < height && (status = bsq_check(ctx)) == 0; y++)
        for (uint64_t x = 0; x < width; x++) {
            float error = comparison->errors[y * width + x],
                  *pixel = canvas.pixels[y * canvas.width + x];
            if (error < 0)
                memcpy(pixel, empty, sizeof empty);
            else
                heat((double)error / top, pixel);
        }
    draw_scale(&canvas, (int64_t)height + 4 * scale, scale, top,
               bake_compare_unit(comparison->kind), true);
    if (status == 0)
        status = canvas_write(ctx, &canvas, path);
    bsq_free(ctx, canvas.pixels);
    return status;
}

/* ---- the histogram ---- */

enum { BINS = 200, BIN_WIDTH = 4, CHART_HEIGHT = 320, CHART_TOP = 36, CHART_MARGIN = 48 };

static void count_bins(const struct bake_comparison *comparison, double top, uint64_t bins[BINS])
{
    uint64_t texels = (uint64_t)comparison->a.width * comparison->a.height;
    memset(bins, 0, BINS * sizeof *bins);
    for (uint64_t i = 0; i < texels; i++) {
        double x = (double)comparison->errors[i] / top * BINS;
        if (x >= 0)
            bins[x < BINS ? (int)x : BINS - 1]++;
    }
}

static void draw_mark(struct canvas *canvas, double value, double top, int64_t y, const char *name)
{
    if (value > top)
        return;
    int64_t x = CHART_MARGIN + (int64_t)(value / top * BINS * BIN_WIDTH);
    fill(canvas, x, CHART_TOP, 1, CHART_HEIGHT, ink);
    write_text(canvas, x + 4, y, 2, name);
}

int bake_histogram_write(struct bsq_ctx *ctx, const struct bake_comparison *comparison,
                         const struct bake_compare_report *report, double top, const char *path)
{
    uint64_t bins[BINS], most = 1;
    struct canvas canvas;
    int status = canvas_create(ctx, BINS * BIN_WIDTH + 2 * CHART_MARGIN,
                               CHART_TOP + CHART_HEIGHT + 2 * SCALE_HEIGHT, &canvas);
    if (status)
        return status;
    count_bins(comparison, top, bins);
    for (int i = 0; i < BINS; i++)
        most = bins[i] > most ? bins[i] : most;
    for (int i = 0; i < BINS; i++) {
        float color[3];
        int64_t bar = (int64_t)((double)bins[i] / (double)most * CHART_HEIGHT + 0.5);
        heat(0.25 + 0.75 * i / BINS, color);
        fill(&canvas, CHART_MARGIN + i * BIN_WIDTH, CHART_TOP + CHART_HEIGHT - bar, BIN_WIDTH, bar,
             color);
    }
    fill(&canvas, CHART_MARGIN, CHART_TOP + CHART_HEIGHT, BINS * BIN_WIDTH, 1, ink);
    draw_mark(&canvas, report->mean, top, 2, "mean");
    draw_mark(&canvas, report->p95, top, 18, "p95");
    draw_mark(&canvas, report->p99, top, 2, "p99");
    draw_scale(&canvas, CHART_TOP + CHART_HEIGHT - 14, 2, top, bake_compare_unit(report->kind),
               false);
    status = canvas_write(ctx, &canvas, path);
    bsq_free(ctx, canvas.pixels);
    return status;
}
