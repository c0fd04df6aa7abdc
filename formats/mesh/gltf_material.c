/* gltf_material.c - materials of glTF files: base colours, their textures and texture coordinates.
 *
 * Also checks which extensions a file needs. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/srgb.h"
#include "formats/mesh/gltf_internal.h"
#include "formats/mesh/mesh_text.h"

/* ---- extensions ---- */

/* Returns whether files that need an extension can be read: it is understood, or says nothing about
 * shape and base colour. A name that ends in "_" stands for all names that begin with it. */
static bool is_known(const char *name)
{
    static const char *const known[] = {
        "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization",
        "KHR_texture_transform",      "KHR_materials_",          "EXT_texture_webp",
        "KHR_lights_punctual",        "KHR_xmp_json_ld",         "KHR_animation_pointer",
        "KHR_audio_emitter",          "KHR_node_hoverability",   "KHR_node_selectability",
    };
    for (size_t i = 0; name && i < sizeof known / sizeof *known; i++) {
        const size_t length = strlen(known[i]);
        if (known[i][length - 1] == '_' ? strncmp(name, known[i], length) == 0
                                        : strcmp(name, known[i]) == 0)
            return true;
    }
    return false;
}

int fmt_gltf_check_extensions(struct gltf_document *document)
{
    const json_t *required = json_object_get(document->root, "extensionsRequired");
    char unknown[200] = "";
    for (size_t i = 0; i < json_array_size(required); i++) {
        const char *name = json_string_value(json_array_get(required, i));
        const size_t length = strlen(unknown);
        if (!is_known(name))
            snprintf(unknown + length, sizeof unknown - length, "%s%.60s", length > 0 ? ", " : "",
                     name ? name : "?");
    }
    if (unknown[0])
        return bsq_fail(document->ctx, BSQ_EDATA, "%s: needs extensions that are not read: %s",
                        document->file.path, unknown);
    return 0;
}

/* ---- images ---- */

/* Describes the data of a view: bytes of a file. Returns its path, NULL if it is packed. */
static const char *part_of_view(const struct gltf_document *document,
                                const struct gltf_source *source, uint32_t number,
                                struct bsq_part *out)
{
    const struct gltf_view *view = &source->views[number];
    const struct gltf_buffer *buffer = &source->buffers[view->buffer];
    *out = buffer->part;
    out->first += view->offset;
    out->size = view->size;
    if (buffer->path)
        return buffer->path;
    return fmt_input_is_plain(document->input) ? document->file.path : NULL;
}

/* Sets *out to the path or name of an image; NULL if it has no data that can be read. An image
 * inside of a packed file cannot be named: counts it. */
static int find_image(const struct gltf_place *place, struct gltf_source *source, char **out)
{
    struct gltf_document *d = place->document;
    const char *uri = fmt_gltf_string(place->object, "uri");
    struct bsq_part part = {.base64 = true};
    uint64_t size;
    uint32_t view;
    bool exists;
    int status = fmt_gltf_index(place, place->object, "bufferView", "bufferViews", &view);
    if (status)
        return status;
    if (view != GLTF_NONE && source->views[view].decoded != GLTF_NOT_DECODED)
        return fmt_gltf_fail(place, "an image in a compressed view");
    if (view != GLTF_NONE) {
        const char *path = part_of_view(d, source, view, &part);
        source->unread.packed_images += !path;
        return path ? bsq_part_name(d->ctx, path, &part, out) : 0;
    }
    if (uri && fmt_gltf_find_data(uri, &part.offset, &size) && !fmt_input_is_plain(d->input)) {
        source->unread.packed_images++;
        return 0;
    }
    if (uri && fmt_gltf_find_data(uri, &part.offset, &size)) {
        status = fmt_gltf_measure_data(place, part.offset, size, &part.size);
        return status ? status : bsq_part_name(d->ctx, d->file.path, &part, out);
    }
    const char *beside = fmt_input_beside(d->input);
    const int found = uri ? fmt_gltf_uri_path(d->ctx, beside, uri, false, out, &exists) : 0;
    source->unread.images += found == 0;
    return found < 0 ? found : 0;
}

int fmt_gltf_find_texture(struct gltf_document *document, struct gltf_source *source,
                          uint32_t texture, char **out)
{
    const struct gltf_place place = fmt_gltf_element(document, "textures", texture);
    uint32_t image;
    int status = fmt_gltf_index(&place, place.object, "source", "images", &image);
    if (!status && image == GLTF_NONE)
        status = fmt_gltf_index(&place, fmt_gltf_extension(place.object, "EXT_texture_webp"),
                                "source", "images", &image);
    if (!status && image == GLTF_NONE)
        source->unread.images++;
    if (status || image == GLTF_NONE)
        return status;
    const struct gltf_place image_place = fmt_gltf_element(document, "images", image);
    return find_image(&image_place, source, out);
}

/* ---- texture coordinates ---- */

/* Reads KHR_texture_transform: first the scale, then a rotation, then the offset. The rotation is
 * counter-clockwise where v points downwards. */
static int read_transform(const struct gltf_place *place, const json_t *transform, double out[2][3])
{
    double offset[2] = {0, 0}, scale[2] = {1, 1}, rotation = 0;
    const json_t *angle = json_object_get(transform, "rotation");
    int status = fmt_gltf_numbers(place, transform, "offset", 2, offset);
    if (status >= 0)
        status = fmt_gltf_numbers(place, transform, "scale", 2, scale);
    if (status < 0)
        return status;
    rotation = json_number_value(angle);
    const double c = cos(rotation), s = sin(rotation);
    const double matrix[2][3] = {{c * scale[0], s * scale[1], offset[0]},
                                 {-s * scale[0], c * scale[1], offset[1]}};
    memcpy(out, matrix, sizeof matrix);
    return 0;
}

int fmt_gltf_read_texcoord(const struct gltf_place *place, const json_t *info, uint32_t *set,
                           double matrix[2][3])
{
    static const double identity[2][3] = {{1, 0, 0}, {0, 1, 0}};
    const json_t *transform = fmt_gltf_extension(info, "KHR_texture_transform");
    uint64_t number = 0;
    memcpy(matrix, identity, sizeof identity);
    int status = fmt_gltf_number(place, info, "texCoord", 1000000, &number);
    if (!status)
        status = fmt_gltf_number(place, transform, "texCoord", 1000000, &number);
    *set = (uint32_t)number;
    return status || !transform ? status : read_transform(place, transform, matrix);
}

/* Returns the texture that chooses the texture coordinates of a material: the base colour's, or
 * another one. A low-poly mesh may have only normal maps, for instance. */
static const json_t *find_texture_info(const struct gltf_place *place, const json_t *base)
{
    static const char *const keys[] = {"normalTexture", "occlusionTexture", "emissiveTexture"};
    const json_t *pbr = json_object_get(place->object, "pbrMetallicRoughness");
    const json_t *info = base ? base : json_object_get(pbr, "metallicRoughnessTexture");
    for (size_t i = 0; !info && i < sizeof keys / sizeof *keys; i++)
        info = json_object_get(place->object, keys[i]);
    return info;
}

/* ---- materials ---- */

/* Reads a factor of red, green, blue and alpha. */
static int read_color(const struct gltf_place *place, const json_t *object, const char *key,
                      struct gltf_material *out, double *alpha)
{
    double rgba[4] = {1, 1, 1, 1};
    int status = fmt_gltf_numbers(place, object, key, 4, rgba);
    for (int k = 0; k < 4; k++) /* as the format demands */
        rgba[k] = fmin(fmax(rgba[k], 0.0), 1.0);
    memcpy(out->color, rgba, sizeof out->color);
    for (int k = 0; k < 3; k++)
        out->described.diffuse[k] = (float)bsq_linear_to_srgb(rgba[k]);
    *alpha = rgba[3];
    out->described.has_diffuse = status > 0;
    return status < 0 ? status : 0;
}

static int read_name(const struct gltf_place *place, char **out)
{
    const char *name = fmt_gltf_string(place->object, "name");
    char number[40];
    snprintf(number, sizeof number, "material %lu", (unsigned long)place->index);
    return bsq_text_copy(place->document->ctx, name ? name : number, out);
}

/* Reads how alpha hides a material. `alpha` is for faces without texture, and multiplies the
 * texture's alpha. */
static int read_opacity(const struct gltf_place *place, double alpha, struct fmt_material *out)
{
    const json_t *value = json_object_get(place->object, "alphaCutoff");
    const char *mode = fmt_gltf_string(place->object, "alphaMode");
    const double cutoff = json_is_number(value) ? json_number_value(value) : 0.5;
    struct fmt_material_channel *opacity;
    out->opaque = !mode || strcmp(mode, "OPAQUE") == 0;
    out->cutout = mode && strcmp(mode, "MASK") == 0;
    if (out->opaque)
        return 0;
    int status = fmt_material_enter_channel(place->document->ctx, out, bsq_channel_find("opacity"),
                                            &opacity);
    if (status)
        return status;
    opacity->value[0] = out->cutout ? (float)(alpha >= cutoff) : (float)alpha;
    opacity->has_value = true;
    /* 2 is above the alpha of all textures. */
    out->cutoff = alpha > 0.0 ? (float)fmin(fmax(cutoff / alpha, 0.0), 2.0)
                              : 2.0f * (1.0f - opacity->value[0]);
    return 0;
}

int fmt_gltf_read_material(const struct gltf_place *place, struct gltf_source *source,
                           void *element)
{
    struct gltf_material *out = element;
    struct gltf_document *d = place->document;
    const json_t *pbr = json_object_get(place->object, "pbrMetallicRoughness");
    const json_t *old = fmt_gltf_extension(place->object, "KHR_materials_pbrSpecularGlossiness");
    const json_t *from = pbr ? pbr : old;
    const json_t *base = json_object_get(from, pbr ? "baseColorTexture" : "diffuseTexture");
    struct fmt_material *m = &out->described;
    uint32_t texture = GLTF_NONE;
    struct bsq_part part;
    double alpha;
    int status;
    BSQ_TRY(read_name(place, &m->name));
    BSQ_TRY(read_color(place, from, pbr ? "baseColorFactor" : "diffuseFactor", out, &alpha));
    if (base)
        BSQ_TRY(fmt_gltf_index(place, base, "index", "textures", &texture));
    if (texture != GLTF_NONE)
        BSQ_TRY(fmt_gltf_find_texture(d, source, texture, &m->texture_path));
    if (m->texture_path && bsq_part_parse(m->texture_path, &part) == 0)
        BSQ_TRY(bsq_text_copy(d->ctx, d->file.path, &m->texture_place));
    BSQ_TRY(fmt_gltf_read_texcoord(place, find_texture_info(place, base), &out->texcoord,
                                   out->uv_matrix));
    BSQ_TRY(fmt_gltf_read_channels(place, source, out));
    source->unread.texture_factors +=
        m->texture_path && (out->color[0] != 1 || out->color[1] != 1 || out->color[2] != 1);
    status = read_opacity(place, alpha, m);
done:
    return status;
}
