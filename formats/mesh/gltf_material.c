/* gltf_material.c - materials of glTF files: colours, channels, textures and texture coordinates.
 */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "base/srgb.h"
#include "formats/material/file_extent.h"
#include "formats/material/channels.h"
#include "formats/mesh/gltf_internal.h"

/* ---- images ---- */

enum { GLTF_CLAMP = 33071, GLTF_MIRROR = 33648 };

/* Describes the data of a view: bytes of a file. Returns its path, NULL if it is packed. */
static const char *range_of_view(const struct gltf_document *document,
                                 const struct gltf_source *source, uint32_t number,
                                 struct fmt_extent *out)
{
    const struct gltf_view *view = &source->views[number];
    const struct gltf_buffer *buffer = &source->buffers[view->buffer];
    *out = buffer->extent;
    out->first += view->offset;
    out->size = view->size;
    if (buffer->path)
        return buffer->path;
    return fmt_input_is_plain(document->input) ? document->file.path : NULL;
}

/* Sets *out to the path or name of an image; NULL if it has no data that can be read. An image
 * inside of a packed file cannot be named: counts it. */
static int find_image(const struct gltf_item *item, struct gltf_source *source, char **out)
{
    struct gltf_document *d = item->document;
    const char *uri = fmt_gltf_string(item->object, "uri");
    struct fmt_extent extent = {.base64 = true};
    uint64_t size;
    uint32_t view;
    bool exists;
    BSQ_PASS(fmt_gltf_index(item, item->object, "bufferView", "bufferViews", &view));
    if (view != GLTF_NONE && source->views[view].buffer == GLTF_NONE)
        return fmt_gltf_fail(item, "an image in a compressed view");
    if (view != GLTF_NONE) {
        const char *path = range_of_view(d, source, view, &extent);
        source->unread.packed_images += !path;
        return path ? fmt_extent_name(d->ctx, path, &extent, out) : 0;
    }
    if (uri && fmt_gltf_find_data(uri, &extent.offset, &size)) {
        const bool plain = fmt_input_is_plain(d->input);
        source->unread.packed_images += !plain;
        if (!plain)
            return 0;
        BSQ_PASS(fmt_gltf_measure_data(item, extent.offset, size, &extent.size));
        return fmt_extent_name(d->ctx, d->file.path, &extent, out);
    }
    const char *beside = fmt_input_beside(d->input);
    const int found = uri ? fmt_gltf_uri_path(d->ctx, beside, uri, false, out, &exists) : 0;
    source->unread.images += found == 0;
    return found < 0 ? found : 0;
}

/* Finds out how a texture wraps beyond its image. Repeats if its sampler is missing or odd. */
static void read_wrap(const struct gltf_item *texture, uint8_t wrap[2])
{
    static const char *const keys[] = {"wrapS", "wrapT"};
    uint64_t number, mode;
    if (!fmt_gltf_whole(json_object_get(texture->object, "sampler"), INT32_MAX, &number))
        return;
    const json_t *sampler = fmt_gltf_element(texture->document, "samplers", number).object;
    for (int k = 0; k < 2; k++)
        if (fmt_gltf_whole(json_object_get(sampler, keys[k]), INT32_MAX, &mode))
            wrap[k] = mode == GLTF_CLAMP    ? FMT_WRAP_CLAMP
                      : mode == GLTF_MIRROR ? FMT_WRAP_MIRROR
                                            : FMT_WRAP_REPEAT;
}

/* Sets *out to the path or name of the image of a texture, which the caller frees; NULL if there is
 * none that can be read, which is counted. */
static int find_texture(struct gltf_document *document, struct gltf_source *source,
                        uint32_t texture, uint8_t wrap[2], char **out)
{
    const struct gltf_item item = fmt_gltf_element(document, "textures", texture);
    uint32_t image;
    read_wrap(&item, wrap);
    BSQ_PASS(fmt_gltf_index(&item, item.object, "source", "images", &image));
    if (image == GLTF_NONE)
        BSQ_PASS(fmt_gltf_index(&item, fmt_gltf_extension(item.object, "EXT_texture_webp"),
                                "source", "images", &image));
    source->unread.images += image == GLTF_NONE;
    if (image == GLTF_NONE)
        return 0;
    const struct gltf_item image_item = fmt_gltf_element(document, "images", image);
    return find_image(&image_item, source, out);
}

/* ---- texture coordinates ---- */

/* Reads which texture coordinates a texture uses: the number of their set, and the matrix of
 * KHR_texture_transform, which is first the scale, then a rotation, counter-clockwise where v
 * points downwards, then the offset. `info` refers to the texture; NULL: set 0. */
static int read_texcoord(const struct gltf_item *item, const json_t *info, uint32_t *set,
                         double matrix[2][3])
{
    const json_t *transform = fmt_gltf_extension(info, "KHR_texture_transform");
    double offset[2] = {0, 0}, scale[2] = {1, 1};
    uint64_t number = 0;
    BSQ_PASS(fmt_gltf_number(item, info, "texCoord", 1000000, &number));
    BSQ_PASS(fmt_gltf_number(item, transform, "texCoord", 1000000, &number));
    BSQ_PASS(fmt_gltf_numbers(item, transform, "offset", 2, offset));
    BSQ_PASS(fmt_gltf_numbers(item, transform, "scale", 2, scale));
    const double rotation = json_number_value(json_object_get(transform, "rotation"));
    const double c = cos(rotation), s = sin(rotation);
    const double own[2][3] = {{c * scale[0], s * scale[1], offset[0]},
                              {-s * scale[0], c * scale[1], offset[1]}};
    memcpy(matrix, own, sizeof own);
    *set = (uint32_t)number;
    return 0;
}

/* Returns the texture that chooses the texture coordinates of a material: the base colour's, or
 * another one. A low-poly mesh may have only normal maps, for instance. */
static const json_t *find_texture_info(const struct gltf_item *item, const json_t *base)
{
    static const char *const keys[] = {"normalTexture", "occlusionTexture", "emissiveTexture"};
    const json_t *pbr = json_object_get(item->object, "pbrMetallicRoughness");
    const json_t *info = base ? base : json_object_get(pbr, "metallicRoughnessTexture");
    for (size_t i = 0; !info && i < sizeof keys / sizeof *keys; i++)
        info = json_object_get(item->object, keys[i]);
    return info;
}

/* ---- further channels, such as roughness, emission and occlusion ----
 *
 * A vertex has one pair of texture coordinates, which the base colour uses. Textures of channels
 * are looked up there too, moved if necessary. If that is not possible, the texture is not used,
 * and a warning says so if the channel is kept. */

/* Returns the object of a material that has the members of a channel; NULL: none. */
static const json_t *object_of(const struct gltf_item *item, const struct fmt_channel_gltf *row)
{
    const json_t *member = json_object_get(item->object, row->object);
    if (row->object[0] == '\0')
        return item->object;
    return member ? member : fmt_gltf_extension(item->object, row->object);
}

/* Finds out how coordinates that `base` made become those that `own` makes, of the same set. v of
 * matrices points downwards, v of *out upwards. Returns false if scale and offset cannot do it. */
static bool relate(const double base[2][3], const double own[2][3], struct fmt_uv *out)
{
    const double determinant = base[0][0] * base[1][1] - base[0][1] * base[1][0];
    double scale[2][2], offset[2];
    bool same = true;
    for (int i = 0; i < 6; i++)
        same &= base[i / 3][i % 3] == own[i / 3][i % 3];
    if (same)
        return true;
    if (fabs(determinant) < 1e-12)
        return false;
    for (int i = 0; i < 2; i++) { /* own * inverse of base */
        scale[i][0] = (own[i][0] * base[1][1] - own[i][1] * base[1][0]) / determinant;
        scale[i][1] = (own[i][1] * base[0][0] - own[i][0] * base[0][1]) / determinant;
        offset[i] = own[i][2] - scale[i][0] * base[0][2] - scale[i][1] * base[1][2];
    }
    const double least = 1e-6 * (fabs(scale[0][0]) + fabs(scale[1][1]));
    if (!(fabs(scale[0][1]) <= least && fabs(scale[1][0]) <= least))
        return false;
    out->moves = true;
    for (int i = 0; i < 2; i++)
        out->scale[i] = (float)scale[i][i];
    out->offset[0] = (float)offset[0];
    out->offset[1] = (float)(1 - scale[1][1] - offset[1]);
    return isfinite(out->scale[0] + out->scale[1] + out->offset[0] + out->offset[1]);
}

/* Sets where the texture is looked up. Drops a texture with other coordinates. */
static int read_uv(const struct gltf_item *item, const struct gltf_material *material,
                   const json_t *info, struct fmt_material_channel *out)
{
    struct bsq_ctx *ctx = item->document->ctx;
    double matrix[2][3];
    uint32_t set;
    int status = read_texcoord(item, info, &set, matrix);
    if (status || (set == material->texcoord && relate((const double(*)[3])material->uv_matrix,
                                                       (const double(*)[3])matrix, &out->uv)))
        return status;
    BSQ_FREE(ctx, out->texture_path, out->texture_place);
    out->texture_path = out->texture_place = NULL;
    out->uv = (struct fmt_uv){.moves = false};
    out->loss = "its texture has other texture coordinates than the base colour and is not used";
    return 0;
}

/* Larger factors would exceed the range of float. */
static const double most_factor = 1e30;

/* Reads a member that is a number, at most `most_factor`; `usual` if there is none. */
static double read_real(const json_t *object, const char *key, double usual)
{
    const json_t *value = key ? json_object_get(object, key) : NULL;
    return json_is_number(value) ? fmin(json_number_value(value), most_factor) : usual;
}

/* Reads the value, which is also the factor of a texture. `info` refers to that; NULL: none. */
static int read_factor(const struct gltf_item *item, const json_t *object, const json_t *info,
                       struct fmt_material_channel *out)
{
    const struct fmt_channel_gltf *row = &out->channel->gltf;
    const bool given = row->factor && json_object_get(object, row->factor);
    const double usual = (double)row->usual, one = read_real(object, row->factor, usual);
    const double light =
        out->channel->color
            ? read_real(fmt_gltf_extension(item->object, "KHR_materials_emissive_strength"),
                        "emissiveStrength", 1)
            : 1;
    double linear[3] = {one, one, one};
    int status = given && out->channel->values == 3
                     ? fmt_gltf_numbers(item, object, row->factor, 3, linear)
                     : 0;
    /* A material is as rough and metallic as it says, or entirely, unless it is glossy instead, or
     * shows its colour without light. */
    const bool glossy = !json_object_get(item->object, "pbrMetallicRoughness") &&
                        fmt_gltf_extension(item->object, "KHR_materials_pbrSpecularGlossiness");
    const bool unlit = fmt_gltf_extension(item->object, "KHR_materials_unlit") != NULL;
    out->has_value = given || (row->usual > 0 && row->factor && !glossy && !unlit);
    if (glossy && row->usual > 0 && row->factor)
        out->loss = "it has specular and glossiness instead, which are not read";
    for (int k = 0; k < 3; k++) {
        linear[k] = fmax(fmin(linear[k] * light, most_factor), 0);
        out->value[k] = (float)linear[k];
        out->factor[k] =
            (float)(row->factor ? linear[k]
                                : read_real(info, "scale", read_real(info, "strength", 1)));
    }
    return status;
}

/* Reads the texture of a channel, or of the colour. `info` refers to it; NULL: none. Integers of
 * colours are sRGB, as the format wants it. */
static int read_texture(const struct gltf_item *item, struct gltf_source *source,
                        const json_t *info, struct fmt_material_channel *out)
{
    struct gltf_document *d = item->document;
    struct fmt_extent extent;
    uint32_t texture = GLTF_NONE;
    BSQ_PASS(fmt_gltf_index(item, info, "index", "textures", &texture));
    if (texture != GLTF_NONE)
        BSQ_PASS(find_texture(d, source, texture, out->uv.wrap, &out->texture_path));
    out->uv.srgb = out->texture_path && out->channel->color;
    if (out->texture_path && fmt_extent_parse(out->texture_path, &extent) == 0)
        return bsq_text_copy(d->ctx, d->file.path, &out->texture_place);
    return 0;
}

static int read_channel_texture(const struct gltf_item *item, struct gltf_source *source,
                                const struct gltf_material *material, const json_t *info,
                                struct fmt_material_channel *out)
{
    const struct gltf_unread before = source->unread;
    int status = read_texture(item, source, info, out);
    source->unread = before; /* these counts are of colours */
    if (!status && !out->texture_path)
        out->loss = "its texture has a format or an address that is not read";
    return status || !out->texture_path ? status : read_uv(item, material, info, out);
}

static int read_channel(const struct gltf_item *item, struct gltf_source *source,
                        const struct gltf_material *material, struct fmt_material_channel *out)
{
    const struct fmt_channel_gltf *row = &out->channel->gltf;
    const json_t *object = object_of(item, row), *info = json_object_get(object, row->texture);
    int status = read_factor(item, object, info, out);
    out->component = row->component;
    if (status || (row->factor && !(out->factor[0] + out->factor[1] + out->factor[2] > 0)))
        return status; /* nothing is left of a texture */
    return info ? read_channel_texture(item, source, material, info, out) : 0;
}

/* Reads the further channels of a material whose texture coordinates are known. */
static int read_channels(const struct gltf_item *item, struct gltf_source *source,
                         struct gltf_material *material)
{
    struct fmt_material *list = &material->described;
    const struct fmt_channel *row;
    uint32_t count = 0;
    for (unsigned i = 0; (row = fmt_channel_at(i)); i++)
        count += row->gltf.object != NULL;
    BSQ_PASS(BSQ_CALLOC(item->document->ctx, "glTF materials", count, &list->channels));
    for (unsigned i = 0; (row = fmt_channel_at(i)); i++) {
        if (!row->gltf.object)
            continue;
        struct fmt_material_channel *channel = &list->channels[list->channel_count++];
        channel->channel = row;
        BSQ_PASS(read_channel(item, source, material, channel));
    }
    return 0;
}

/* ---- materials ---- */

/* Reads a factor of red, green, blue and alpha. */
static int read_color(const struct gltf_item *item, const json_t *object, const char *key,
                      struct gltf_material *out, double *alpha)
{
    double rgba[4] = {1, 1, 1, 1};
    int status = fmt_gltf_numbers(item, object, key, 4, rgba);
    for (int k = 0; k < 4; k++) /* as the format demands */
        rgba[k] = fmin(fmax(rgba[k], 0.0), 1.0);
    memcpy(out->color, rgba, sizeof out->color);
    for (int k = 0; k < 3; k++)
        out->described.color.value[k] = (float)bsq_linear_to_srgb(rgba[k]);
    *alpha = rgba[3];
    out->described.color.has_value = json_object_get(object, key) != NULL;
    return status;
}

static int read_name(const struct gltf_item *item, char **out)
{
    const char *name = fmt_gltf_string(item->object, "name");
    return name ? bsq_text_copy(item->document->ctx, name, out)
                : bsq_text_print(item->document->ctx, out, "material %" PRIu64, item->index);
}

/* Reads how alpha hides a material. `alpha` is for faces without texture, and multiplies the
 * texture's alpha. */
static int read_opacity(const struct gltf_item *item, double alpha, struct fmt_material *out)
{
    const json_t *value = json_object_get(item->object, "alphaCutoff");
    const char *mode = fmt_gltf_string(item->object, "alphaMode");
    const double cutoff = json_is_number(value) ? json_number_value(value) : 0.5;
    struct fmt_material_channel *opacity;
    out->opaque = !mode || strcmp(mode, "OPAQUE") == 0;
    out->cutout = mode && strcmp(mode, "MASK") == 0;
    if (out->opaque)
        return 0;
    BSQ_PASS(fmt_material_enter_channel(item->document->ctx, out, fmt_channel_find("opacity"),
                                        &opacity));
    opacity->value[0] = out->cutout ? (float)(alpha >= cutoff) : (float)alpha;
    opacity->has_value = true;
    opacity->factor[0] = opacity->factor[1] = opacity->factor[2] = (float)alpha;
    /* 2 is above the alpha of all textures. */
    out->cutoff = alpha > 0.0 ? (float)fmin(fmax(cutoff / alpha, 0.0), 2.0)
                              : 2.0f * (1.0f - opacity->value[0]);
    return 0;
}

int fmt_gltf_read_material(const struct gltf_item *item, struct gltf_source *source, void *element)
{
    struct gltf_material *out = element;
    const json_t *pbr = json_object_get(item->object, "pbrMetallicRoughness");
    const json_t *old = fmt_gltf_extension(item->object, "KHR_materials_pbrSpecularGlossiness");
    const json_t *from = pbr ? pbr : old;
    const json_t *base = json_object_get(from, pbr ? "baseColorTexture" : "diffuseTexture");
    struct fmt_material *m = &out->described;
    double alpha;
    m->color.channel = &fmt_color_channel;
    m->double_sided = json_is_true(json_object_get(item->object, "doubleSided"));
    BSQ_PASS(read_name(item, &m->name));
    BSQ_PASS(read_color(item, from, pbr ? "baseColorFactor" : "diffuseFactor", out, &alpha));
    BSQ_PASS(read_texture(item, source, base, &m->color));
    BSQ_PASS(read_texcoord(item, find_texture_info(item, base), &out->texcoord, out->uv_matrix));
    BSQ_PASS(read_channels(item, source, out));
    return read_opacity(item, alpha, m);
}
