/* glb.c - writes GLB files: a header, a chunk of JSON and a chunk with vertices, indices and
 * images.
 *
 * The JSON names the place of everything in the binary chunk, so it is made first. */
#include "formats/asset/glb.h"

#include <jansson.h>
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "base/version.h"

enum { FLOAT = 5126, UINT32 = 5125, ARRAY_BUFFER = 34962, ELEMENT_BUFFER = 34963 };
enum { LINEAR = 9729, LINEAR_MIPMAP_LINEAR = 9987, CLAMP_TO_EDGE = 33071 };
enum { COPY_BYTES = 1 << 20 };
#define STRENGTH "KHR_materials_emissive_strength"

#define GREY 0.6 /* the base colour without a texture, linear */

/* The arrays of the document while they grow. */
struct document {
    json_t *views, *accessors, *primitives, *materials, *textures, *images;
    uint64_t bytes; /* of the binary chunk so far */
    bool strong;    /* some material has KHR_materials_emissive_strength */
};

/* Adds a view of `bytes` bytes, which begins at a multiple of 4. Returns its number. */
static int glb_add_view(struct document *d, uint64_t bytes, int stride, int target)
{
    json_t *view = json_pack("{s:i, s:I, s:I}", "buffer", 0, "byteOffset", (json_int_t)d->bytes,
                             "byteLength", (json_int_t)bytes);
    if (stride > 0)
        json_object_set_new(view, "byteStride", json_integer(stride));
    if (target > 0)
        json_object_set_new(view, "target", json_integer(target));
    json_array_append_new(d->views, view);
    d->bytes = bsq_align_up(d->bytes + bytes, 4);
    return (int)json_array_size(d->views) - 1;
}

static int add_accessor(struct document *d, int view, size_t offset, int component, uint32_t count,
                        const char *type)
{
    json_array_append_new(d->accessors,
                          json_pack("{s:i, s:I, s:i, s:I, s:s}", "bufferView", view, "byteOffset",
                                    (json_int_t)offset, "componentType", component, "count",
                                    (json_int_t)count, "type", type));
    return (int)json_array_size(d->accessors) - 1;
}

/* Gives the accessor of positions the bounds that the format demands. */
static void glb_set_bounds(struct document *d, int accessor,
                           const struct fmt_glb_primitive *primitive)
{
    float least[3] = {INFINITY, INFINITY, INFINITY}, most[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t i = 0; i < primitive->vertex_count; i++) {
        const float *position =
            primitive->vertices ? primitive->vertices[i].position : primitive->shaded[i];
        for (int k = 0; k < 3; k++) {
            least[k] = fminf(least[k], position[k]);
            most[k] = fmaxf(most[k], position[k]);
        }
    }
    json_t *object = json_array_get(d->accessors, (size_t)accessor);
    json_object_set_new(
        object, "min",
        json_pack("[f, f, f]", (double)least[0], (double)least[1], (double)least[2]));
    json_object_set_new(object, "max",
                        json_pack("[f, f, f]", (double)most[0], (double)most[1], (double)most[2]));
}

static size_t glb_vertex_bytes(const struct fmt_glb_primitive *primitive)
{
    return primitive->vertices ? sizeof *primitive->vertices : sizeof *primitive->shaded;
}

static void glb_add_primitive(struct document *d, const struct fmt_glb_primitive *from,
                              int material)
{
    const uint32_t n = from->vertex_count;
    const size_t stride = glb_vertex_bytes(from);
    const int vertices = glb_add_view(d, n * (uint64_t)stride, (int)stride, ARRAY_BUFFER);
    const int indices =
        glb_add_view(d, (uint64_t)from->index_count * sizeof(uint32_t), 0, ELEMENT_BUFFER);
#define ATTRIBUTE(member, type)                                                                    \
    add_accessor(d, vertices, offsetof(struct fmt_glb_vertex, member), FLOAT, n, type)
    const int position = ATTRIBUTE(position, "VEC3"), normal = ATTRIBUTE(normal, "VEC3");
    json_t *attributes = json_pack("{s:i, s:i}", "POSITION", position, "NORMAL", normal);
    if (from->vertices) {
        json_object_set_new(attributes, "TANGENT", json_integer(ATTRIBUTE(tangent, "VEC4")));
        json_object_set_new(attributes, "TEXCOORD_0", json_integer(ATTRIBUTE(texcoord, "VEC2")));
    }
    const int index = add_accessor(d, indices, 0, UINT32, from->index_count, "SCALAR");
    json_t *primitive =
        json_pack("{s:o, s:i, s:i}", "attributes", attributes, "indices", index, "mode", 4);
    glb_set_bounds(d, position, from);
    if (!from->plain)
        json_object_set_new(primitive, "material", json_integer(material));
    json_array_append_new(d->primitives, primitive);
}

/* Adds an image and its texture. Returns a reference to it, or NULL without an image. */
static json_t *glb_add_texture(struct document *d, const struct bsq_file *image)
{
    if (!image)
        return NULL;
    json_array_append_new(d->images,
                          json_pack("{s:i, s:s}", "bufferView", glb_add_view(d, image->size, 0, 0),
                                    "mimeType", "image/png"));
    const int number = (int)json_array_size(d->textures);
    json_array_append_new(d->textures, json_pack("{s:i, s:i}", "source", number, "sampler", 0));
    return json_pack("{s:i}", "index", number);
}

/* Adds what a material emits. A factor has at most 1; the extension multiplies it. */
static void glb_add_emission(struct document *d, const struct fmt_glb_material *from,
                             json_t *material)
{
    const double factor = (double)from->emission_factor, one = fmin(factor, 1);
    json_t *emission = glb_add_texture(d, from->textures[FMT_GLB_EMISSION]);
    if (!emission)
        return;
    json_object_set_new(material, "emissiveTexture", emission);
    json_object_set_new(material, "emissiveFactor", json_pack("[f, f, f]", one, one, one));
    d->strong |= factor > 1;
    if (factor > 1)
        json_object_set_new(material, "extensions",
                            json_pack("{s:{s:f}}", STRENGTH, "emissiveStrength", factor));
}

static void glb_add_material(struct document *d, const struct fmt_glb_material *from)
{
    static const char *const modes[] = {[FMT_GLB_MASK] = "MASK", [FMT_GLB_BLEND] = "BLEND"};
    json_t *base = glb_add_texture(d, from->textures[FMT_GLB_BASE_COLOR]);
    json_t *normal = glb_add_texture(d, from->textures[FMT_GLB_NORMAL]);
    json_t *orm = glb_add_texture(d, from->textures[FMT_GLB_ORM]);
    json_t *pbr = json_pack("{s:f, s:f}", "roughnessFactor", 1.0, "metallicFactor",
                            from->metallic ? 1.0 : 0.0);
    json_t *material = json_pack("{s:o}", "pbrMetallicRoughness", pbr);
    if (json_object_set_new(material, "name", json_string(from->name)) < 0) /* no UTF-8 */
        json_object_set_new(material, "name", json_string("material"));
    if (base)
        json_object_set_new(pbr, "baseColorTexture", base);
    else
        json_object_set_new(pbr, "baseColorFactor",
                            json_pack("[f, f, f, f]", GREY, GREY, GREY, 1.0));
    if (orm && (from->roughness || from->metallic))
        json_object_set(pbr, "metallicRoughnessTexture", orm);
    if (orm && from->occlusion)
        json_object_set(material, "occlusionTexture", orm);
    if (normal)
        json_object_set_new(material, "normalTexture", normal);
    json_decref(orm);
    glb_add_emission(d, from, material);
    if (from->alpha != FMT_GLB_OPAQUE)
        json_object_set_new(material, "alphaMode", json_string(modes[from->alpha]));
    if (from->double_sided)
        json_object_set_new(material, "doubleSided", json_true());
    json_array_append_new(d->materials, material);
}

/* Adds an array that is not empty, as the format demands. */
static void put_array(json_t *root, const char *key, json_t *array)
{
    if (json_array_size(array) > 0)
        json_object_set(root, key, array);
    json_decref(array);
}

/* Returns the JSON text; NULL if there is no memory. */
static char *make_json(const struct fmt_glb *glb, uint64_t *binary_bytes)
{
    struct document d = {
        json_array(), json_array(), json_array(), json_array(), json_array(), json_array(), 0,
        false};
    const double *t = glb->translation;
    for (uint32_t i = 0; i < glb->primitive_count; i++)
        glb_add_primitive(&d, &glb->primitives[i], (int)i);
    for (uint32_t i = 0; i < glb->primitive_count; i++)
        if (!glb->primitives[i].plain)
            glb_add_material(&d, &glb->materials[i]);
    json_t *root = json_pack(
        "{s:{s:s, s:s}, s:i, s:[{s:[i]}], s:[{s:s*, s:i, s:[f, f, f]}], s:[{s:o}], s:[{s:I}]}",
        "asset", "version", "2.0", "generator", "Bisque " BSQ_VERSION, "scene", 0, "scenes",
        "nodes", 0, "nodes", "name", glb->name, "mesh", 0, "translation", t[0], t[1], t[2],
        "meshes", "primitives", d.primitives, "buffers", "byteLength", (json_int_t)d.bytes);
    if (d.strong)
        json_object_set_new(root, "extensionsUsed", json_pack("[s]", STRENGTH));
    put_array(root, "bufferViews", d.views);
    put_array(root, "accessors", d.accessors);
    put_array(root, "materials", d.materials);
    if (json_array_size(d.textures) > 0)
        json_object_set_new(root, "samplers",
                            json_pack("[{s:i, s:i, s:i, s:i}]", "magFilter", LINEAR, "minFilter",
                                      LINEAR_MIPMAP_LINEAR, "wrapS", CLAMP_TO_EDGE, "wrapT",
                                      CLAMP_TO_EDGE));
    put_array(root, "textures", d.textures);
    put_array(root, "images", d.images);
    char *text = root ? json_dumps(root, JSON_COMPACT | JSON_PRESERVE_ORDER) : NULL;
    json_decref(root);
    *binary_bytes = d.bytes;
    return text;
}

/* ---- bytes ---- */

static int write_u32(struct bsq_output *output, uint32_t a, uint32_t b)
{
    const uint32_t words[2] = {a, b};
    return bsq_output_write(output, words, sizeof words);
}

/* Writes bytes, and then `fill` up to a multiple of 4. */
static int write_padded(struct bsq_output *output, const void *bytes, uint64_t size, char fill)
{
    const char padding[3] = {fill, fill, fill};
    BSQ_PASS(bsq_output_write(output, bytes, size));
    return bsq_output_write(output, padding, bsq_align_up(size, 4) - size);
}

static int copy_image(struct bsq_ctx *ctx, const struct bsq_file *image, struct bsq_output *output)
{
    uint8_t *buffer = NULL;
    int status = 0;
    if (!image)
        return 0;
    BSQ_TRY(bsq_alloc(ctx, "an image of a GLB file", COPY_BYTES, 1, &buffer));
    for (uint64_t at = 0; at < image->size; at += COPY_BYTES) {
        const uint64_t left = image->size - at, size = left < COPY_BYTES ? left : COPY_BYTES;
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(bsq_file_read(ctx, image, buffer, size, at));
        BSQ_TRY(write_padded(output, buffer, size, 0));
    }
done:
    bsq_free(ctx, buffer);
    return status;
}

static int write_binary(struct bsq_ctx *ctx, const struct fmt_glb *glb, struct bsq_output *output)
{
    for (uint32_t i = 0; i < glb->primitive_count; i++) {
        const struct fmt_glb_primitive *primitive = &glb->primitives[i];
        const void *vertices =
            primitive->vertices ? (const void *)primitive->vertices : primitive->shaded;
        BSQ_PASS(bsq_output_write(output, vertices,
                                  (uint64_t)primitive->vertex_count * glb_vertex_bytes(primitive)));
        BSQ_PASS(bsq_output_write(output, primitive->indices,
                                  (uint64_t)primitive->index_count * sizeof *primitive->indices));
    }
    for (uint32_t i = 0; i < glb->primitive_count; i++)
        for (int k = 0; k < FMT_GLB_TEXTURES && !glb->primitives[i].plain; k++)
            BSQ_PASS(copy_image(ctx, glb->materials[i].textures[k], output));
    return 0;
}

int fmt_glb_write(struct bsq_ctx *ctx, const struct fmt_glb *glb, const char *path,
                  struct bsq_output *output)
{
    const uint32_t magic = 0x46546c67, json_chunk = 0x4e4f534a, binary_chunk = 0x004e4942;
    uint64_t binary = 0;
    char *text = make_json(glb, &binary);
    int status = 0;
    if (!text)
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", path);
    const uint64_t json = bsq_align_up(strlen(text), 4), all = 12 + 8 + json + 8 + binary;
    if (all > UINT32_MAX)
        BSQ_TRY(bsq_fail(ctx, BSQ_EDATA, "%s: a GLB file ends at 4 GiB: use smaller maps", path));
    BSQ_TRY(bsq_output_write(output, &magic, sizeof magic));
    BSQ_TRY(write_u32(output, 2, (uint32_t)all));
    BSQ_TRY(write_u32(output, (uint32_t)json, json_chunk));
    BSQ_TRY(write_padded(output, text, strlen(text), ' '));
    BSQ_TRY(write_u32(output, (uint32_t)binary, binary_chunk));
    status = write_binary(ctx, glb, output);
done:
    free(text);
    return status;
}
