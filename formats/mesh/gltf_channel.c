/* gltf_channel.c - further channels of glTF materials, such as roughness, emission and occlusion.
 *
 * A vertex has one pair of texture coordinates, which the base colour uses. Textures of channels
 * are looked up there too, moved if necessary. If that is not possible, the texture is not used,
 * and a warning says so if the channel is kept.
 */
#include <math.h>

#include "base/file_part.h"
#include "base/srgb.h"
#include "formats/mesh/gltf_internal.h"
#include "formats/mesh/mesh_text.h"

/* Returns the object of a material that has the members of a channel; NULL: none. */
static const json_t *object_of(const struct gltf_place *place, const struct bsq_channel_gltf *row)
{
    const json_t *member = json_object_get(place->object, row->object);
    if (row->object[0] == '\0')
        return place->object;
    return member ? member : fmt_gltf_extension(place->object, row->object);
}

/* ---- texture coordinates ---- */

/* Finds out how coordinates that `base` made become those that `own` makes, of the same set. v of
 * matrices points downwards, v of *out upwards. Returns false if scale and offset cannot do it. */
static bool relate(const double base[2][3], const double own[2][3], struct bsq_uv *out)
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
    *out = (struct bsq_uv){.moves = true,
                           .scale = {(float)scale[0][0], (float)scale[1][1]},
                           .offset = {(float)offset[0], (float)(1 - scale[1][1] - offset[1])}};
    return isfinite(out->scale[0] + out->scale[1] + out->offset[0] + out->offset[1]);
}

/* Sets where the texture is looked up. Drops a texture with other coordinates. */
static int read_uv(const struct gltf_place *place, const struct gltf_material *material,
                   const json_t *info, struct fmt_material_channel *out)
{
    struct bsq_ctx *ctx = place->document->ctx;
    double matrix[2][3];
    uint32_t set;
    int status = fmt_gltf_read_texcoord(place, info, &set, matrix);
    if (status || (set == material->texcoord && relate((const double(*)[3])material->uv_matrix,
                                                       (const double(*)[3])matrix, &out->uv)))
        return status;
    bsq_free(ctx, out->texture_path);
    out->texture_path = NULL;
    out->uv = (struct bsq_uv){.moves = false};
    out->loss = "its texture has other texture coordinates than the base colour and is not used";
    return 0;
}

/* ---- values and textures ---- */

/* Larger factors would exceed the range of float. */
static const double most_factor = 1e30;

/* Reads the value, or the factor of a texture, into `linear`. */
static int read_factor(const struct gltf_place *place, const json_t *object,
                       struct fmt_material_channel *out, double linear[3])
{
    const struct bsq_channel_gltf *row = &out->channel->gltf;
    const json_t *value = row->factor ? json_object_get(object, row->factor) : NULL;
    int status = 0;
    for (int k = 0; k < 3; k++)
        linear[k] = (double)row->usual;
    if (value && out->channel->values == 3)
        status = fmt_gltf_numbers(place, object, row->factor, 3, linear);
    else if (value && json_is_number(value))
        linear[0] = linear[1] = linear[2] = json_number_value(value);
    for (int k = 0; k < 3; k++)
        linear[k] = fmin(linear[k], most_factor);
    /* A material is as rough and metallic as it says, or entirely. */
    out->has_value =
        value || (row->usual > 0 && row->factor &&
                  !fmt_gltf_extension(place->object, "KHR_materials_pbrSpecularGlossiness"));
    for (int k = 0; k < 3; k++)
        out->value[k] =
            (float)(out->channel->color ? bsq_linear_to_srgb(linear[k]) : fmax(linear[k], 0));
    return status < 0 ? status : 0;
}

/* Returns what else the file says of the values of a texture, which is not used. */
static const char *find_loss(const struct gltf_place *place, const json_t *info,
                             const struct fmt_material_channel *channel, const double factor[3])
{
    const json_t *strength = json_object_get(info, "strength");
    const json_t *emission = json_object_get(
        fmt_gltf_extension(place->object, "KHR_materials_emissive_strength"), "emissiveStrength");
    const json_t *scale = json_object_get(info, "scale");
    bool scaled = (json_is_number(strength) && json_number_value(strength) != 1) ||
                  (json_is_number(scale) && json_number_value(scale) != 1);
    for (int k = 0; k < 3 && channel->channel->gltf.factor; k++)
        scaled |= info && factor[k] != 1;
    if (channel->channel->color && json_is_number(emission) && json_number_value(emission) != 1)
        return "its strength is not used";
    return scaled ? "its texture has a factor, which is not used" : NULL;
}

static int read_texture(const struct gltf_place *place, struct gltf_source *source,
                        const struct gltf_material *material, const json_t *info,
                        struct fmt_material_channel *out)
{
    const struct gltf_unread before = source->unread;
    struct bsq_part part;
    uint32_t texture = GLTF_NONE;
    int status;
    BSQ_TRY(fmt_gltf_index(place, info, "index", "textures", &texture));
    if (texture != GLTF_NONE)
        BSQ_TRY(fmt_gltf_find_texture(place->document, source, texture, &out->texture_path));
    source->unread = before; /* these counts are of colours */
    if (!out->texture_path)
        out->loss = "its texture has a format or an address that is not read";
    if (out->texture_path)
        BSQ_TRY(read_uv(place, material, info, out));
    if (out->texture_path && bsq_part_parse(out->texture_path, &part) == 0)
        BSQ_TRY(
            bsq_text_copy(place->document->ctx, place->document->file.path, &out->texture_place));
done:
    return status;
}

static int read_channel(const struct gltf_place *place, struct gltf_source *source,
                        const struct gltf_material *material, struct fmt_material_channel *out)
{
    const struct bsq_channel_gltf *row = &out->channel->gltf;
    const json_t *object = object_of(place, row), *info = json_object_get(object, row->texture);
    double factor[3];
    int status = read_factor(place, object, out, factor);
    out->component = row->component;
    if (status || (row->factor && factor[0] == 0 && factor[1] == 0 && factor[2] == 0))
        return status; /* nothing is left of a texture */
    out->loss = find_loss(place, info, out, factor);
    return info ? read_texture(place, source, material, info, out) : 0;
}

int fmt_gltf_read_channels(const struct gltf_place *place, struct gltf_source *source,
                           struct gltf_material *material)
{
    struct fmt_material *list = &material->described;
    const struct bsq_channel *row;
    uint32_t count = 0;
    for (unsigned i = 0; (row = bsq_channel_at(i)); i++)
        count += row->gltf.object != NULL;
    int status = bsq_calloc(place->document->ctx, "glTF materials", count, sizeof *list->channels,
                            &list->channels);
    for (unsigned i = 0; (row = bsq_channel_at(i)) && !status; i++) {
        if (!row->gltf.object)
            continue;
        struct fmt_material_channel *channel = &list->channels[list->channel_count++];
        channel->channel = row;
        status = read_channel(place, source, material, channel);
    }
    return status;
}
