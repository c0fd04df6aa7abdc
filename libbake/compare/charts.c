/* charts.c - heat map and histogram of a comparison, as PNG.
 *
 * The scale is written into the picture, with a small font of this file, because its top is the
 * 99th percentile of each comparison by default. Without the number, pictures of an error of 0.1
 * and of 10 degrees would look alike once they are apart from the program's output.
 *
 * Colours run from near black over purple and orange to light yellow with steadily growing
 * lightness. So the picture reads the same in grey and for colour-blind eyes. Texels that were not
 * compared are blue-grey, those with values that are not finite are cyan. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "formats/image/image_writer.h"
#include "libbake/compare/comparison.h"

static const float paper[3] = {0.11f, 0.12f, 0.14f}, ink[3] = {0.92f, 0.92f, 0.90f};
static const float not_compared[3] = {0.22f, 0.25f, 0.30f}, not_finite[3] = {0.0f, 0.9f, 0.9f};

/* ---- a font ---- */

enum { GLYPH_WIDTH = 5, GLYPH_HEIGHT = 7 }; /* dots */

/* The characters of numbers, units and names of figures. Rows from the top; the leftmost dot is bit
 * 4. */
static const struct {
    char character;
    uint8_t rows[GLYPH_HEIGHT];
} glyphs[] = {
    {'0', {0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e}},
    {'1', {0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e}},
    {'2', {0x0e, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1f}},
    {'3', {0x0e, 0x11, 0x01, 0x06, 0x01, 0x11, 0x0e}},
    {'4', {0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02}},
    {'5', {0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e}},
    {'6', {0x0e, 0x10, 0x10, 0x1e, 0x11, 0x11, 0x0e}},
    {'7', {0x1f, 0x01, 0x02, 0x02, 0x04, 0x04, 0x04}},
    {'8', {0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e}},
    {'9', {0x0e, 0x11, 0x11, 0x0f, 0x01, 0x01, 0x0e}},
    {'.', {0x00, 0x00, 0x00, 0x00, 0x00, 0x0c, 0x0c}},
    {'-', {0x00, 0x00, 0x00, 0x0e, 0x00, 0x00, 0x00}},
    {'+', {0x00, 0x04, 0x04, 0x1f, 0x04, 0x04, 0x00}},
    {'a', {0x00, 0x00, 0x0e, 0x01, 0x0f, 0x11, 0x0f}},
    {'c', {0x00, 0x00, 0x0e, 0x10, 0x10, 0x10, 0x0e}},
    {'d', {0x01, 0x01, 0x0f, 0x11, 0x11, 0x11, 0x0f}},
    {'e', {0x00, 0x00, 0x0e, 0x11, 0x1f, 0x10, 0x0e}},
    {'f', {0x06, 0x08, 0x1c, 0x08, 0x08, 0x08, 0x08}},
    {'g', {0x00, 0x0f, 0x11, 0x11, 0x0f, 0x01, 0x0e}},
    {'i', {0x04, 0x00, 0x0c, 0x04, 0x04, 0x04, 0x0e}},
    {'m', {0x00, 0x00, 0x1a, 0x15, 0x15, 0x15, 0x15}},
    {'n', {0x00, 0x00, 0x1e, 0x11, 0x11, 0x11, 0x11}},
    {'p', {0x00, 0x1e, 0x11, 0x11, 0x1e, 0x10, 0x10}},
    {'r', {0x00, 0x00, 0x16, 0x18, 0x10, 0x10, 0x10}},
    {'s', {0x00, 0x00, 0x0f, 0x10, 0x0e, 0x01, 0x1e}},
    {'E', {0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x1f}},
};

static const uint8_t *find_glyph(char character)
{
    static const uint8_t blank[GLYPH_HEIGHT];
    for (unsigned i = 0; i < sizeof glyphs / sizeof *glyphs; i++)
        if (glyphs[i].character == character)
            return glyphs[i].rows;
    return blank;
}

/* ---- a small canvas ---- */

struct canvas {
    uint32_t width, height; /* pixels */
    float (*pixels)[3];     /* height x width, display-referred 0..1 */
};

static int canvas_create(struct bsq_ctx *ctx, uint64_t width, uint64_t height, struct canvas *out)
{
    *out = (struct canvas){(uint32_t)width, (uint32_t)height, NULL};
    int status = bsq_alloc(ctx, "chart", width * height, sizeof *out->pixels, &out->pixels);
    for (uint64_t i = 0; !status && i < width * height; i++)
        memcpy(out->pixels[i], paper, sizeof paper);
    return status;
}

/* Adds the picture to a group of outputs. */
static int canvas_write(struct bsq_ctx *ctx, const struct canvas *canvas, const char *path,
                        struct bsq_output_group *group)
{
    const struct fmt_image_options options = {
        .width = canvas->width, .height = canvas->height, .channel_count = 3, .type = FMT_UINT8};
    struct fmt_image_writer *writer;
    int status = fmt_image_create(ctx, &fmt_png_format, path, &options, &writer);
    if (status)
        return status;
    struct bsq_output *output;
    status = fmt_image_write_rows(writer, canvas->pixels[0], canvas->height);
    if (status) {
        fmt_image_discard(writer);
        return status;
    }
    status = fmt_image_hand_over(writer, &output);
    return status ? status : bsq_output_group_add(group, output);
}

/* Fills a rectangle; parts outside of the canvas are ignored. */
static void fill(struct canvas *canvas, int64_t x0, int64_t y0, int64_t width, int64_t height,
                 const float color[3])
{
    for (int64_t y = y0; y < y0 + height; y++)
        for (int64_t x = x0; x < x0 + width; x++)
            if (x >= 0 && y >= 0 && x < canvas->width && y < canvas->height)
                memcpy(canvas->pixels[y * canvas->width + x], color, 3 * sizeof *color);
}

/* Draws text with its top left corner at (x, y). A dot of the font is `scale` pixels wide and high.
 */
static void write_text(struct canvas *canvas, int64_t x, int64_t y, unsigned scale,
                       const char *text)
{
    for (; *text; text++, x += (GLYPH_WIDTH + 1) * scale) {
        const uint8_t *rows = find_glyph(*text);
        for (unsigned row = 0; row < GLYPH_HEIGHT; row++)
            for (unsigned column = 0; column < GLYPH_WIDTH; column++)
                if (rows[row] >> (GLYPH_WIDTH - 1 - column) & 1)
                    fill(canvas, x + column * scale, y + row * scale, scale, scale, ink);
    }
}

static int64_t text_width(const char *text, unsigned scale)
{
    return (int64_t)(strlen(text) * (GLYPH_WIDTH + 1) * scale);
}

/* ---- colours ---- */

/* Returns the colour of an error; `value` is its share of the top of the scale, clamped to 0..1. */
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

/* ---- the scale ---- */

enum { SCALE_MARGIN = 24, SCALE_HEIGHT = 28, TICKS = 5 }; /* margin and height in dots */

/* Draws the axis from 0 to `top`: a bar of colours if it is `colored`, ticks, and labels at both
 * ends. A dot is `dot` pixels wide and high. */
static void draw_scale(struct canvas *canvas, int64_t y, unsigned dot, double top, const char *unit,
                       bool colored)
{
    char label[48];
    int64_t margin = SCALE_MARGIN * dot, width = (int64_t)canvas->width - 2 * margin, bar = 8 * dot;
    for (int64_t x = 0; colored && x < width; x++) {
        float color[3];
        heat((double)x / (double)width, color);
        fill(canvas, margin + x, y, 1, bar, color);
    }
    for (int i = 0; i < TICKS; i++)
        fill(canvas, margin + width * i / (TICKS - 1), y + bar, dot, 3 * dot, ink);
    write_text(canvas, margin - GLYPH_WIDTH * dot / 2, y + bar + 5 * dot, dot, "0");
    snprintf(label, sizeof label, "%.3g+ %s", top, unit);
    write_text(canvas, (int64_t)canvas->width - text_width(label, dot) - dot, y + bar + 5 * dot,
               dot, label);
}

/* ---- the heat map ---- */

enum { LEAST_WIDTH = 256 }; /* pixels, for the labels */

/* Returns the size in pixels of the font's dots for a map of `width` texels. */
static unsigned dot_size(uint32_t width)
{
    return width < 512 ? 1 : width / 512;
}

int bake_heatmap_write(struct bsq_ctx *ctx, const struct bake_comparison *comparison, double top,
                       const char *path, struct bsq_output_group *group)
{
    uint32_t width = comparison->a.width, height = comparison->a.height;
    struct canvas canvas;
    unsigned dot = dot_size(width);
    int status = canvas_create(ctx, width < LEAST_WIDTH ? LEAST_WIDTH : width,
                               (uint64_t)height + SCALE_HEIGHT * dot, &canvas);
    if (status)
        return status;
    for (uint64_t y = 0; y < height && (status = bsq_check(ctx)) == 0; y++)
        for (uint64_t x = 0; x < width; x++) {
            float error = comparison->errors[y * width + x],
                  *pixel = canvas.pixels[y * canvas.width + x];
            if (isnan(error))
                memcpy(pixel, not_finite, sizeof not_finite);
            else if (error < 0)
                memcpy(pixel, not_compared, sizeof not_compared);
            else
                heat((double)error / top, pixel);
        }
    draw_scale(&canvas, (int64_t)height + 4 * dot, dot, top, bake_compare_unit(comparison->kind),
               true);
    if (status == 0)
        status = canvas_write(ctx, &canvas, path, group);
    bsq_free(ctx, canvas.pixels);
    return status;
}

/* ---- the histogram ---- */

/* Sizes in pixels. */
enum { BINS = 200, BIN_WIDTH = 4, CHART_HEIGHT = 320, CHART_TOP = 36, CHART_MARGIN = 48 };

/* Counts the compared errors in BINS equal steps up to `top`; the last bin takes all above. */
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

/* Draws a line at a value, with its name. Values beyond `top` are left out. */
static void draw_mark(struct canvas *canvas, double value, double top, int64_t y, const char *name)
{
    if (value > top)
        return;
    int64_t x = CHART_MARGIN + (int64_t)(value / top * BINS * BIN_WIDTH);
    fill(canvas, x, CHART_TOP, 1, CHART_HEIGHT, ink);
    write_text(canvas, x + 4, y, 2, name);
}

int bake_histogram_write(struct bsq_ctx *ctx, const struct bake_comparison *comparison,
                         const struct bake_compare_report *report, double top, const char *path,
                         struct bsq_output_group *group)
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
    status = canvas_write(ctx, &canvas, path, group);
    bsq_free(ctx, canvas.pixels);
    return status;
}
