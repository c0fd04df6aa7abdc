/* map_encode.c - see map_encode.h.
 *
 * Maps have no alpha channel. Some programs would multiply colours by it, and so blacken the
 * dilated texels around the charts. The mask is a map of its own. */
#include "libbake/maps/map_encode.h"

#include <stdio.h>
#include <string.h>

#include "base/text.h"
/* Returns the place in a texel of the transfer map that the mask is multiplied by; 0: none. */
static uint32_t place_in_mask(const struct bake_options *options, uint32_t maps)
{
    for (uint32_t i = 0; i < options->transfer_count; ++i)
        if (options->transfers[i].in_mask)
            return bake_map_offset(maps, BK_MAP_COUNT + i);
    return 0;
}

void bake_encoder_init(const struct bake_encoding_facts *facts, uint32_t maps, unsigned number,
                       struct bake_encoder *out)
{
    *out = (struct bake_encoder){.row = bake_row_of(facts->options, number),
                                 .offset = bake_map_offset(maps, number),
                                 .encoding = {.scale = {1.0, 1.0, 1.0}}};
    const struct bake_encoding *encoding = &out->encoding;
    if (!out->row->resolve)
        out->offset = place_in_mask(facts->options, maps);
    if (out->row->encode)
        out->row->encode(facts, &out->encoding);
    for (int c = 0; c < 3; ++c) {
        double shift =
            out->row->positions ? facts->traced->image_origin[c] - encoding->origin[c] : 0;
        bool some = encoding->scale[c] != 0.0;
        out->factor[c] = some ? 1.0 / encoding->scale[c] : 0.0;
        out->bias[c] = some ? (shift - encoding->offset[c]) / encoding->scale[c] : 0.5;
    }
}

static void encode_shares(const struct bake_encoder *encoder, const float *texels,
                          uint32_t channels, uint32_t width, float *out)
{
    for (uint32_t x = 0; x < width; ++x) {
        const float *texel = texels + (size_t)x * channels;
        out[x] = texel[0] > 0.0f ? texel[0] : 0.0f;
        if (encoder->offset > 0 && texel[0] > 0.0f)
            out[x] *= texel[encoder->offset];
    }
}

void bake_encode_row(const struct bake_encoder *encoder, const float *const *sources,
                     const float *texels, uint32_t channels, uint32_t width, float *out)
{
    const uint32_t count = encoder->row->channels;
    if (!encoder->row->resolve || encoder->row->of_all) {
        encode_shares(encoder, texels, channels, width, out);
        return;
    }
    for (uint32_t x = 0; x < width; ++x)
        for (uint32_t c = 0; c < count; ++c)
            *out++ = sources[x]
                         ? (float)(encoder->factor[c] * (double)sources[x][encoder->offset + c] +
                                   encoder->bias[c])
                         : encoder->encoding.background[c];
}

uint32_t bake_limit_to_half(float *samples, uint32_t count)
{
    static const float most = 65504.0f;
    uint32_t beyond = 0;
    for (uint32_t i = 0; i < count; ++i) {
        const float v = samples[i];
        beyond += v > most || v < -most;
        samples[i] = v > most ? most : v < -most ? -most : v; /* NaN stays */
    }
    return beyond;
}

/* ---- attributes ---- */

void bake_add_attribute(struct bake_attributes *attributes, const char *name, const char *value)
{
    attributes->list[attributes->count++] = (struct fmt_image_attribute){name, value};
}

static const char *rays_text(const struct bake_options *options)
{
    static const char *const names[] = {
        [BAKE_RAYS_SMOOTH] = "smooth", [BAKE_RAYS_MESH] = "mesh", [BAKE_RAYS_FACE] = "face"};
    return bake_has_cage(options) ? "cage" : names[options->rays];
}

void bake_describe_map(const struct bake_options *options, unsigned number,
                       const struct bake_traced *traced, struct bake_attributes *out)
{
    const unsigned packs = BK_MAP_COUNT + options->transfer_count;
    const bool packed = number >= packs;
    out->count = 0;
    snprintf(out->text[0], sizeof out->text[0], "%u x %u", options->samples, options->samples);
    const locale_t host = bsq_plain_numbers();
    snprintf(out->text[1], sizeof out->text[1], "%.9g", traced->front);
    snprintf(out->text[2], sizeof out->text[2], "%.9g", traced->back);
    uselocale(host);
    bake_add_attribute(out, "software", "Bisque " BSQ_VERSION);
    bake_add_attribute(out, "bisque:version", BSQ_VERSION);
    bake_add_attribute(out, "bisque:map",
                       number < BK_MAP_COUNT ? bake_map_names[number]
                       : packed              ? "pack"
                                             : "transfer");
    if (number >= BK_MAP_COUNT)
        bake_add_attribute(out, packed ? "bisque:pack" : "bisque:transfer",
                           packed ? options->packs[number - packs].maps
                                  : bake_name_of(options, number));
    if (bake_row_of(options, number)->describe)
        bake_row_of(options, number)->describe(options, traced, out);
    bake_add_attribute(out, "bisque:samples", out->text[0]);
    bake_add_attribute(out, "bisque:sampling", traced->sampling);
    bake_add_attribute(out, "bisque:rays", rays_text(options));
    bake_add_attribute(out, "bisque:front", out->text[1]);
    bake_add_attribute(out, "bisque:back", out->text[2]);
    if (traced->scans)
        bake_add_attribute(out, "bisque:scans", traced->scans);
}

/* Adds numbers, one a channel, as a text. */
static void add_numbers(struct bake_attributes *out, const char *name, const double *numbers,
                        uint32_t count, int digits)
{
    char *text = out->text[out->count];
    size_t length = 0;
    const locale_t host = bsq_plain_numbers();
    for (uint32_t c = 0; c < count; ++c)
        length += (size_t)snprintf(text + length, sizeof out->text[0] - length, "%s%.*g",
                                   c ? " " : "", digits, numbers[c]);
    uselocale(host);
    bake_add_attribute(out, name, text);
}

void bake_describe_encoding(const struct bake_encoder *encoder, struct bake_attributes *out)
{
    const struct bake_encoding *encoding = &encoder->encoding;
    const uint32_t channels = encoder->row->channels;
    out->count = 0;
    if (!encoder->row->unit)
        return;
    add_numbers(out, "bisque:range", &encoding->range, 1, 9);
    add_numbers(out, "bisque:scale", encoding->scale, channels, 9);
    add_numbers(out, "bisque:offset", encoding->offset, channels, 9);
    if (encoder->row->positions)
        add_numbers(out, "bisque:origin", encoding->origin, channels, 17);
    if (encoding->radius > 0.0)
        add_numbers(out, "bisque:curvatureRadius", &encoding->radius, 1, 9);
    bake_add_attribute(out, "bisque:unit", encoder->row->unit);
}
