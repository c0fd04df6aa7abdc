/* compare.c - loads two maps, checks that they can be compared, and measures the error of each
 * texel. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/colour_difference.h"
#include "base/srgb.h"
#include "base/parallel.h"
#include "base/text.h"
#include "formats/image/image_writer.h"
#include "formats/texture/image_rows.h"
#include "libbake/compare/comparison.h"
#include "libbake/page/items.h"

const char *bake_compare_unit(enum bake_compare_kind kind)
{
    static const char *const units[] = {"", "degrees", "dE2000", "difference"};
    return units[kind];
}

/* ---- maps as floats ---- */

/* Takes the texts before the texels of a PNG file. */
static int read_texts(struct bsq_ctx *ctx, const void *png, struct fmt_exr_image *out)
{
    const char *name, *value;
    uint64_t capacity = 0;
    for (uint32_t i = 0; fmt_png_text(png, i, &name, &value); i++) {
        BSQ_PASS(BSQ_GROW(ctx, "a map's attributes", i + UINT64_C(1), &out->attributes, &capacity));
        struct fmt_exr_attribute *attribute = &out->attributes[out->attribute_count++];
        *attribute = (struct fmt_exr_attribute){0};
        BSQ_PASS(bsq_text_copy(ctx, name, &attribute->name));
        BSQ_PASS(bsq_text_copy(ctx, value, &attribute->value));
    }
    return 0;
}

static void to_floats(const struct fmt_rows_info *info, const uint8_t *row, float *out)
{
    const size_t count = (size_t)info->width * info->channels;
    for (size_t i = 0; i < count; i++) {
        uint16_t wide;
        if (info->sample_bytes == 1) {
            out[i] = (float)row[i] / 255.0f;
        } else if (info->sample_bytes == 2) {
            memcpy(&wide, row + 2 * i, sizeof wide);
            out[i] = (float)wide / 65535.0f;
        } else {
            memcpy(&out[i], row + 4 * i, sizeof out[i]);
        }
    }
}

/* Names the channels: grey or RGB, perhaps with alpha. */
static int name_channels(struct bsq_ctx *ctx, const struct fmt_rows_info *info,
                         struct fmt_exr_image *out)
{
    static const char *const grey[] = {"Y", "A"}, *const rgb[] = {"R", "G", "B", "A"};
    const char *const *names = info->channels >= 3 ? rgb : grey;
    BSQ_PASS(BSQ_CALLOC(ctx, "a map's channels", info->channels, &out->channels));
    for (; out->channel_count < info->channels; out->channel_count++)
        BSQ_PASS(bsq_text_copy(ctx, names[out->channel_count], &out->channels[out->channel_count]));
    return 0;
}

static int compare_read_rows(struct bsq_ctx *ctx, struct fmt_rows *rows, struct fmt_exr_image *out)
{
    const struct fmt_rows_info *info = &rows->info;
    const uint64_t samples = (uint64_t)info->width * info->channels;
    uint8_t *row = NULL;
    int status;
    if (info->channels > 4)
        return bsq_fail(ctx, BSQ_EDATA, "%s: %u channels; a map that is not OpenEXR has at most 4",
                        rows->input.path, info->channels);
    out->width = info->width;
    out->height = info->height;
    BSQ_TRY(name_channels(ctx, info, out));
    BSQ_TRY(bsq_alloc(ctx, "a map", samples * info->height, sizeof(float), &out->samples));
    BSQ_TRY(bsq_alloc(ctx, "a row of a map", samples, info->sample_bytes, &row));
    for (uint32_t y = 0; y < info->height; y++) {
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(rows->decoder->read(rows->state, row));
        to_floats(info, row, out->samples + y * samples);
    }
    if (rows->decoder == &fmt_png_rows)
        BSQ_TRY(read_texts(ctx, rows->state, out));
    status = bsq_file_check(ctx, &rows->input.file);
done:
    bsq_free(ctx, row);
    return status;
}

/* Reads a map: OpenEXR, PNG, or another format that textures may have. Integers become 0 to 1.
 * Bisque and other programs store the attributes of PNG files as texts. Free the image with
 * fmt_exr_image_free(). */
static int compare_read_map(struct bsq_ctx *ctx, const char *path, struct fmt_exr_image *out,
                            struct bake_samples *samples)
{
    static const char exr[4] = {0x76, 0x2f, 0x31, 0x01};
    struct bsq_file file = BSQ_FILE_CLOSED;
    struct fmt_rows rows = {0};
    char head[sizeof exr] = {0};
    uint64_t got = 0;
    int status;
    BSQ_TRY(bsq_file_open(ctx, path, &file));
    BSQ_TRY(bsq_file_read_some(ctx, &file, head, sizeof head, 0, &got));
    *samples = (struct bake_samples){.gamma = 1};
    if (memcmp(head, exr, sizeof exr) == 0) {
        status = fmt_exr_read(ctx, path, out);
        goto done;
    }
    BSQ_TRY(fmt_rows_open(ctx, path, 1, &rows));
    samples->integers = rows.info.sample_bytes < 4;
    samples->gamma = samples->integers ? rows.info.gamma : 1;
    status = compare_read_rows(ctx, &rows, out);
done:
    fmt_rows_close(&rows);
    bsq_file_close(ctx, &file);
    if (status < 0)
        fmt_exr_image_free(ctx, out);
    return status;
}

/* ---- inputs ---- */

static int check_same_size(struct bsq_ctx *ctx, const char *path, const struct fmt_exr_image *image,
                           const char *other_path, const struct fmt_exr_image *other)
{
    if (image->width == other->width && image->height == other->height)
        return 0;
    return bsq_fail(ctx, BSQ_EDATA, "%s has %u x %u texels, %s has %u x %u", path, image->width,
                    image->height, other_path, other->width, other->height);
}

static int compare_load_image(struct bsq_ctx *ctx, const struct bake_compare_options *o,
                              struct bake_comparison *c)
{
    struct bake_samples mask;
    BSQ_PASS(compare_read_map(ctx, o->a_path, &c->a, &c->a_samples));
    BSQ_PASS(compare_read_map(ctx, o->b_path, &c->b, &c->b_samples));
    BSQ_PASS(check_same_size(ctx, o->a_path, &c->a, o->b_path, &c->b));
    if (o->a_mask_path) {
        BSQ_PASS(compare_read_map(ctx, o->a_mask_path, &c->a_mask, &mask));
        BSQ_PASS(check_same_size(ctx, o->a_mask_path, &c->a_mask, o->a_path, &c->a));
    }
    if (o->b_mask_path) {
        BSQ_PASS(compare_read_map(ctx, o->b_mask_path, &c->b_mask, &mask));
        BSQ_PASS(check_same_size(ctx, o->b_mask_path, &c->b_mask, o->b_path, &c->b));
    }
    return 0;
}

/* ---- channels ---- */

static void add_pair(struct bake_comparison *c, uint32_t a, uint32_t b)
{
    c->pairs[c->pair_count][0] = a;
    c->pairs[c->pair_count++][1] = b;
}

/* Returns the number of channels besides alpha. */
static uint32_t count_colors(const struct fmt_exr_image *image)
{
    return image->channel_count - (fmt_exr_channel(image, "A") != UINT32_MAX);
}

/* Returns the channel with this name, or that of a grey map. */
static uint32_t compare_find_channel(const struct fmt_exr_image *image, const char *name)
{
    const uint32_t found = fmt_exr_channel(image, name);
    return found == UINT32_MAX && count_colors(image) == 1 ? fmt_exr_channel(image, "Y") : found;
}

static bool has_rgb(const struct fmt_exr_image *image)
{
    return fmt_exr_channel(image, "R") != UINT32_MAX && fmt_exr_channel(image, "G") != UINT32_MAX &&
           fmt_exr_channel(image, "B") != UINT32_MAX;
}

/* Pairs R, G and B. One of the maps may be grey; otherwise returns false. */
static bool pair_rgb(struct bake_comparison *c)
{
    static const char *const names[] = {"R", "G", "B"};
    bool all = has_rgb(&c->a) || has_rgb(&c->b);
    c->pair_count = 0;
    for (int k = 0; k < 3; k++) {
        add_pair(c, compare_find_channel(&c->a, names[k]), compare_find_channel(&c->b, names[k]));
        all &= c->pairs[k][0] != UINT32_MAX && c->pairs[k][1] != UINT32_MAX;
    }
    return all;
}

/* Pairs the channels of equal names. Alpha that only one map has does not count. Returns false if
 * there are others that only one map has. */
static bool pair_all(struct bake_comparison *c)
{
    uint32_t own = 0;
    c->pair_count = 0;
    for (uint32_t k = 0; k < c->b.channel_count; k++)
        own += fmt_exr_channel(&c->a, c->b.channels[k]) == UINT32_MAX &&
               strcmp(c->b.channels[k], "A") != 0;
    for (uint32_t k = 0; k < c->a.channel_count; k++) {
        const uint32_t other = fmt_exr_channel(&c->b, c->a.channels[k]);
        if (other != UINT32_MAX)
            add_pair(c, k, other);
        own += other == UINT32_MAX && strcmp(c->a.channels[k], "A") != 0;
    }
    return own == 0;
}

/* Checks whether nine in ten of the reference's values, decoded, have length 1. Colours hardly ever
 * do. Looks at about 65536 texels. */
static bool has_unit_vectors(const struct bake_comparison *c)
{
    uint64_t texels = (uint64_t)c->b.width * c->b.height, unit = 0, finite = 0;
    uint64_t step = texels / 65536 + 1;
    for (uint64_t i = 0; i < texels; i += step) {
        float a[3], rgb[3], square = 0;
        read_rgb(c, i, a, rgb);
        for (int k = 0; k < 3; k++)
            square += (2 * rgb[k] - 1) * (2 * rgb[k] - 1);
        unit += fabsf(square - 1) < 0.05f;
        finite += isfinite(square) != 0;
    }
    return unit * 10 > finite * 9;
}

/* Map a may be of Bisque, and the reference of another program. */
static enum bake_compare_kind kind_of_map(struct bake_comparison *c)
{
    const char *own = fmt_exr_image_attribute(&c->a, "bisque:map");
    const char *map = own ? own : fmt_exr_image_attribute(&c->b, "bisque:map");
    const bool rgb = has_rgb(&c->a) && has_rgb(&c->b) && pair_rgb(c);
    if (map && rgb && strcmp(map, "normal") == 0)
        return BAKE_COMPARE_NORMAL;
    if (map && rgb && strcmp(map, "color") == 0)
        return BAKE_COMPARE_COLOR;
    if (map || !rgb)
        return BAKE_COMPARE_DATA;
    return has_unit_vectors(c) ? BAKE_COMPARE_NORMAL : BAKE_COMPARE_COLOR;
}

/* Refuses maps whose attributes say that their values mean different things: the error would mean
 * nothing. Attributes that only one of the maps has are not checked. */
static int check_same_meaning(struct bsq_ctx *ctx, const struct bake_compare_options *o,
                              const struct bake_comparison *c)
{
    static const char *const names[] = {"bisque:map",   "bisque:normalSpace", "bisque:tangents",
                                        "bisque:green", "bisque:encoding",    "bisque:unit",
                                        "bisque:origin"};
    for (unsigned i = 0; !o->force && i < sizeof names / sizeof *names; i++) {
        const char *a = fmt_exr_image_attribute(&c->a, names[i]);
        const char *b = fmt_exr_image_attribute(&c->b, names[i]);
        if (a && b && strcmp(a, b) != 0)
            return bsq_fail(ctx, BSQ_EDATA,
                            "%s has %s \"%s\", %s has \"%s\": these maps cannot be compared",
                            o->a_path, names[i], a, o->b_path, b);
    }
    return 0;
}

static int choose_kind(struct bsq_ctx *ctx, const struct bake_compare_options *o,
                       struct bake_comparison *c)
{
    c->kind = o->kind == BAKE_COMPARE_AUTO ? kind_of_map(c) : o->kind;
    const uint32_t a = count_colors(&c->a), b = count_colors(&c->b);
    const bool grey = (a == 1 && b == 3) || (a == 3 && b == 1);
    if (c->kind == BAKE_COMPARE_DATA ? pair_all(c) || (grey && pair_rgb(c)) : pair_rgb(c))
        return 0;
    if (c->kind == BAKE_COMPARE_DATA)
        return bsq_fail(ctx, BSQ_EDATA, "%s and %s have different channels", o->a_path, o->b_path);
    return bsq_fail(ctx, BSQ_EDATA, "%s has no channels R, G and B",
                    has_rgb(&c->a) ? o->b_path : o->a_path);
}

/* ---- decoding ---- */

/* Turns integers of a map of colours into linear light. Their values come again and again, so each
 * cell keeps the last one that fell into it. */
static int compare_make_linear(struct bsq_ctx *ctx, const struct bake_samples *of,
                               struct fmt_exr_image *image)
{
    enum { CELLS_LOG2 = 12 };
    float(*cells)[2] = NULL; /* a value, and what it is in linear light; 0 is 0 */
    const uint64_t samples = (uint64_t)image->width * image->channel_count;
    const uint32_t alpha = fmt_exr_channel(image, "A");
    int status = 0;
    if (of->gamma == 1)
        return 0;
    BSQ_TRY(BSQ_CALLOC(ctx, "values of a map", 1 << CELLS_LOG2, &cells));
    for (uint64_t y = 0; y < image->height; y++) {
        float *row = image->samples + y * samples;
        BSQ_TRY(bsq_check(ctx));
        for (uint64_t i = 0; i < samples; i++) {
            uint32_t bits;
            memcpy(&bits, &row[i], sizeof bits);
            float *cell = cells[bits * UINT32_C(0x9e3779b1) >> (32 - CELLS_LOG2)];
            if (i % image->channel_count == alpha)
                continue;
            if (cell[0] != row[i]) {
                cell[0] = row[i];
                cell[1] = (float)(of->gamma == 0 ? bsq_srgb_to_linear((double)row[i])
                                                 : pow((double)row[i], of->gamma));
            }
            row[i] = cell[1];
        }
    }
done:
    bsq_free(ctx, cells);
    return status;
}

/* Reads up to three numbers of an attribute. Returns how many there are. */
static int compare_read_numbers(const struct fmt_exr_image *image, const char *name, double out[3])
{
    const char *text = fmt_exr_image_attribute(image, name);
    const locale_t host = bsq_plain_numbers();
    const int count = text ? sscanf(text, "%lf %lf %lf", &out[0], &out[1], &out[2]) : 0;
    uselocale(host);
    for (int k = count; k > 0 && k < 3; k++)
        out[k] = out[0];
    return count;
}

/* Turns the integers of a map into its values by bisque:scale and bisque:offset. */
static void decode_values(const struct bake_samples *of, struct fmt_exr_image *image)
{
    static const char *const names[] = {"R", "G", "B"};
    double scale[3], offset[3];
    if (!of->integers || compare_read_numbers(image, "bisque:scale", scale) < 1 ||
        compare_read_numbers(image, "bisque:offset", offset) < 1)
        return;
    for (uint32_t c = 0; c < image->channel_count; c++) {
        int k = 0;
        while (k < 2 && strcmp(image->channels[c], names[k]) != 0)
            k++;
        k = image->channel_count == 1 ? 0 : k;
        for (uint64_t i = c; i < (uint64_t)image->width * image->height * image->channel_count;
             i += image->channel_count)
            image->samples[i] = (float)((double)image->samples[i] * scale[k] + offset[k]);
    }
}

/* Gives both maps values that can be compared. Values of data are decoded if both files say how
 * they are encoded. */
static int compare_decode(struct bsq_ctx *ctx, struct bake_comparison *c)
{
    if (c->kind == BAKE_COMPARE_COLOR) {
        BSQ_PASS(compare_make_linear(ctx, &c->a_samples, &c->a));
        BSQ_PASS(compare_make_linear(ctx, &c->b_samples, &c->b));
    }
    if (c->kind == BAKE_COMPARE_DATA && fmt_exr_image_attribute(&c->a, "bisque:scale") &&
        fmt_exr_image_attribute(&c->b, "bisque:scale")) {
        decode_values(&c->a_samples, &c->a);
        decode_values(&c->b_samples, &c->b);
    }
    return 0;
}

/* ---- the error of a texel ---- */

/* Returns the angle in degrees between two encoded normals. The arc tangent is accurate for small
 * angles, unlike the arc cosine of the dot product. */
static float angle_between(const float a[3], const float b[3])
{
    double n[3], m[3], cross = 0, dot = 0;
    for (int k = 0; k < 3; k++) {
        n[k] = 2 * (double)a[k] - 1;
        m[k] = 2 * (double)b[k] - 1;
        dot += n[k] * m[k];
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        double x = n[j] * m[k] - n[k] * m[j];
        cross += x * x;
    }
    return (float)(atan2(sqrt(cross), dot) * 57.295779513082320877);
}

static float colour_difference(const float a[3], const float b[3])
{
    double lab_a[3], lab_b[3];
    bsq_lab(a, lab_a);
    bsq_lab(b, lab_b);
    return (float)bsq_ciede2000(lab_a, lab_b);
}

static float largest_difference(const struct bake_comparison *c, uint64_t texel)
{
    const float *a = c->a.samples + texel * c->a.channel_count;
    const float *b = c->b.samples + texel * c->b.channel_count;
    float largest = 0;
    for (uint32_t k = 0; k < c->pair_count; k++) {
        const float d = fabsf(a[c->pairs[k][0]] - b[c->pairs[k][1]]);
        largest = d > largest ? d : largest;
    }
    return largest;
}

static float error_at(const struct bake_comparison *c, uint64_t texel)
{
    float a[3], b[3];
    if (c->kind == BAKE_COMPARE_DATA)
        return largest_difference(c, texel);
    read_rgb(c, texel, a, b);
    if (a[0] == b[0] && a[1] == b[1] && a[2] == b[2])
        return 0;
    return c->kind == BAKE_COMPARE_NORMAL ? angle_between(a, b) : colour_difference(a, b);
}

static int compare_measure_row(void *arg, uint64_t y, unsigned worker)
{
    (void)worker;
    struct bake_comparison *c = arg;
    for (uint64_t texel = y * c->a.width; texel < (y + 1) * c->a.width; texel++) {
        if (!covers(&c->a_mask, texel) || !covers(&c->b_mask, texel))
            c->errors[texel] = BAKE_NOT_COVERED;
        else if (!is_finite(&c->a, &c->a_mask, texel) || !is_finite(&c->b, &c->b_mask, texel))
            c->errors[texel] = NAN;
        else
            c->errors[texel] = error_at(c, texel);
    }
    return 0;
}

/* ---- the heat map ---- */

/* Colours of texels without an error: blue-grey, and cyan. */
static const float not_compared[3] = {0.22f, 0.25f, 0.30f}, not_finite[3] = {0.0f, 0.9f, 0.9f};

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

static int write_heat_rows(struct bsq_ctx *ctx, const struct bake_comparison *comparison,
                           double top, struct fmt_image_writer *writer)
{
    const uint64_t width = comparison->a.width;
    const float *error = comparison->errors;
    float(*row)[3];
    int status;
    BSQ_TRY(BSQ_ALLOC(ctx, "heat map", width, &row));
    for (uint32_t y = 0; y < comparison->a.height; y++) {
        for (uint64_t x = 0; x < width; x++, error++)
            if (*error >= 0)
                heat((double)*error / top, row[x]);
            else
                memcpy(row[x], isnan(*error) ? not_finite : not_compared, sizeof row[x]);
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(fmt_image_write_rows(writer, row[0], 1));
    }
done:
    bsq_free(ctx, row);
    return status;
}

/* Writes the error of each texel as a PNG, in colours from 0 to `top`, and adds the output to a
 * group.
 *
 * Colours run from near black over purple and orange to light yellow with steadily growing
 * lightness. So the picture reads the same in grey and for colour-blind eyes. The attribute
 * "bisque:errors" names the error of the lightest colour: it is another one in each comparison. */
static int write_heat_map(struct bsq_ctx *ctx, const struct bake_comparison *comparison, double top,
                          const char *path, struct bsq_output **out)
{
    char scale[64];
    const struct fmt_image_attribute attribute = {"bisque:errors", scale};
    const struct fmt_image_options options = {.width = comparison->a.width,
                                              .height = comparison->a.height,
                                              .channel_count = 3,
                                              .type = FMT_UINT8,
                                              .attributes = &attribute,
                                              .attribute_count = 1};
    struct fmt_image_writer *writer = NULL;
    int status;
    const locale_t host = bsq_plain_numbers();
    snprintf(scale, sizeof scale, "0 to %.6g %s", top, bake_compare_unit(comparison->kind));
    uselocale(host);
    BSQ_TRY(fmt_image_create(ctx, &fmt_png_format, path, &options, &writer));
    BSQ_TRY(write_heat_rows(ctx, comparison, top, writer));
    status = fmt_image_hand_over(writer, out);
    writer = NULL;
done:
    fmt_image_discard(writer);
    return status;
}

/* ---- a page ---- */

/* Adds both maps, which are shown with the same range, and the error of each texel to a page. */
static int show(struct bsq_ctx *ctx, const struct bake_compare_options *options,
                const struct bake_comparison *c, double top)
{
    const uint64_t width = c->a.width;
    struct bake_page_picture maps[2] = {0};
    struct bsq_output *errors = NULL;
    float(*rows)[3] = NULL;
    int status;
    for (int i = 0; i < 2; i++)
        BSQ_TRY(bake_page_begin_picture(ctx, c->a.width, c->a.height, &maps[i]));
    BSQ_TRY(BSQ_ALLOC(ctx, "rows of maps", 2 * width, &rows));
    for (uint32_t y = 0; y < c->a.height; y++) {
        for (uint64_t x = 0; x < width; x++)
            read_rgb(c, y * width + x, rows[x], rows[width + x]);
        for (int i = 0; i < 2; i++)
            BSQ_TRY(bake_page_take_rows(ctx, &maps[i], 3, y, 1, rows[i * width]));
    }
    for (int k = 0; k < 3; k++) {
        maps[0].low[k] = maps[1].low[k] = fminf(maps[0].low[k], maps[1].low[k]);
        maps[0].high[k] = maps[1].high[k] = fmaxf(maps[0].high[k], maps[1].high[k]);
    }
    for (int i = 0; i < 2; i++) {
        maps[i].color = c->kind == BAKE_COMPARE_COLOR;
        BSQ_TRY(
            bake_page_add_picture(options->page, json_pack("{s:s}", "kind", "compared"), &maps[i]));
    }
    BSQ_TRY(write_heat_map(ctx, c, top, options->page->path, &errors));
    status = bake_page_add(options->page, json_pack("{s:s}", "kind", "error"), errors);
done:
    bake_thumbnail_free(ctx, &maps[0].texels);
    bake_thumbnail_free(ctx, &maps[1].texels);
    bsq_free(ctx, rows);
    bsq_output_discard(errors);
    return status;
}

/* ---- all ---- */

void bake_compare_defaults(struct bake_compare_options *options)
{
    *options = (struct bake_compare_options){.size = sizeof *options};
}

int bake_compare(struct bsq_ctx *ctx, const struct bake_compare_options *options,
                 struct bake_compare_report *report)
{
    struct bake_comparison c = {0};
    struct bsq_output *picture = NULL;
    int status = 0;
    BSQ_TRY(bsq_clear_report(ctx, "bake_compare_report", report, sizeof *report));
    BSQ_TRY(bsq_check_size(ctx, "bake_compare_options", options->size, sizeof *options));
    BSQ_TRY(compare_load_image(ctx, options, &c));
    BSQ_TRY(check_same_meaning(ctx, options, &c));
    BSQ_TRY(BSQ_ALLOC(ctx, "channels", c.a.channel_count + UINT64_C(3), &c.pairs));
    BSQ_TRY(choose_kind(ctx, options, &c));
    BSQ_TRY(compare_decode(ctx, &c));
    BSQ_TRY(BSQ_ALLOC(ctx, "errors", (uint64_t)c.a.width * c.a.height, &c.errors));
    BSQ_TRY(bsq_parallel_for(ctx, c.a.height, compare_measure_row, &c));
    BSQ_TRY(bake_comparison_summarise(ctx, options, &c, report));
    report->scale = options->scale > 0                         ? options->scale
                    : report->p99 > 0 && isfinite(report->p99) ? report->p99
                                                               : 1;
    if (options->heatmap_path)
        BSQ_TRY(write_heat_map(ctx, &c, report->scale, options->heatmap_path, &picture));
    if (options->page)
        BSQ_TRY(show(ctx, options, &c, report->scale));
    if (picture) {
        status = bsq_output_commit(picture);
        picture = NULL;
    }
done:
    bsq_output_discard(picture);
    BSQ_FREE(ctx, c.errors, c.pairs);
    fmt_exr_image_free(ctx, &c.a), fmt_exr_image_free(ctx, &c.b);
    fmt_exr_image_free(ctx, &c.a_mask), fmt_exr_image_free(ctx, &c.b_mask);
    return status;
}
