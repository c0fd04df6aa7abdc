/* channels.h - what a scan has besides its shape: further channels such as roughness, their names
 * and what values mean; ids of its regions; colours; how materials move texture coordinates.
 *
 * A channel is a quantity of the scan's surface that a texture gives, besides its colour. */
#ifndef BSQ_CHANNELS_H
#define BSQ_CHANNELS_H

#include <math.h>

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Where materials of glTF files have a channel: members of an object. */
struct bsq_channel_gltf {
    const char *object;  /* a member of the material, an extension, or "" for the material itself;
                            NULL: materials do not have the channel */
    const char *texture; /* its texture */
    const char *factor;  /* its value, or a factor of the texture; NULL: none */
    uint32_t component;  /* of the texture, 0 to 2, for channels with one value */
    float usual;         /* value without both */
};

/* The channel of a scan's normal map in tangent space. It belongs to the scan's normals, so grids
 * do not keep it. */
#define BSQ_CHANNEL_NORMAL_MAP "normal_map"

/* What is known of a channel by its name. */
struct bsq_channel {
    const char *name; /* "" for names that the table does not have */
    uint32_t values;  /* 1 or 3 */
    bool color;       /* linear light, which files of integers hold sRGB-encoded; else data */
    /* Statements of MTL files: its texture and its value; NULL: none. */
    const char *mtl_map, *mtl_value;
    const char *mtl_inverse; /* a statement of 1 - value; NULL: none */
    uint32_t component;      /* of a texture, unless the file names another one */
    float usual;             /* the value of what has neither a texture nor a value */
    float neutral;           /* a factor of a texture scales the distance from it */
    struct bsq_channel_gltf gltf;
};

/* Components of a texture. 0 to 2 are red, green and blue. */
enum {
    BSQ_CHANNEL_ALPHA = 3,  /* of an image without alpha, the first component */
    BSQ_CHANNEL_CUTOUT = 4, /* 1 where alpha is at least the channel's value, else 0 */
    BSQ_CHANNEL_COMPONENTS
};

/* Returns whether a component needs the alpha of a texture. */
static inline bool bsq_channel_needs_alpha(uint32_t component)
{
    return component == BSQ_CHANNEL_ALPHA || component == BSQ_CHANNEL_CUTOUT;
}

/* Returns the row of a name, or that of all other names: three values, data. */
const struct bsq_channel *bsq_channel_find(const char *name);
/* Returns row `number` of the table; NULL after the last. */
const struct bsq_channel *bsq_channel_at(unsigned number);

/* Returns whether a channel can have this name: lower-case letters, digits and underscores, with a
 * letter first. */
bool bsq_is_channel_name(const char *name);
/* Returns whether bisque-bake has another meaning for a name, such as the map "normal", so that the
 * channel could not be baked as a map of its name. */
bool bsq_is_map_name(const char *name);

/* ---- lists: names separated by commas, as in "roughness,emission" ---- */

/* Most values of all channels of a list together. */
enum { BSQ_CHANNEL_VALUES_MAX = 65535 };

/* Returns the number of values of all channels of a list of `bytes` bytes; 0 if it is no list of
 * names, or has more than BSQ_CHANNEL_VALUES_MAX values. */
uint32_t bsq_channel_list_values(const char *list, uint64_t bytes);
/* Splits a list into its names. Free *names, which has the names too, with bsq_free(). Errors:
 * BSQ_ENOMEM. */
int bsq_channel_list_split(struct bsq_ctx *ctx, const char *list, uint64_t bytes, char ***names,
                           uint32_t *count);
/* Finds the first channel of this name in a list. Sets *first to the number of values before its
 * own. Returns its row, or NULL. */
const struct bsq_channel *bsq_channel_list_find(const char *list, uint64_t bytes, const char *name,
                                                uint32_t *first);

/* ---- ids of the regions of a scan ---- */

/* What ids tell apart. Files store these numbers. */
enum bsq_ids {
    BSQ_IDS_NONE,     /* there are no ids */
    BSQ_IDS_MATERIAL, /* materials, by name */
    BSQ_IDS_OBJECT,   /* objects and groups, by name */
    BSQ_IDS_COLOR     /* vertex colours */
};

/* Returns "material", "object" or "color". */
const char *bsq_ids_text(enum bsq_ids ids);

/* Returns the id of a name, a colour that depends on its bytes alone: red in bits 0-7, green in
 * 8-15, blue in 16-23, 255 in 24-31. It is never black. formats/FORMATS.md has the formula. */
uint32_t bsq_name_id(const char *name);

/* ---- texture coordinates: scale, then offset ---- */

/* Beyond an image it repeats, its border texels do, or it is mirrored at each border. */
enum bsq_wrap { BSQ_WRAP_REPEAT, BSQ_WRAP_CLAMP, BSQ_WRAP_MIRROR, BSQ_WRAPS };

/* All zero: coordinates stay as they are, and the image repeats. */
struct bsq_uv {
    bool moves;
    float scale[2], offset[2]; /* u, v; finite; used if `moves` is set */
    uint8_t wrap[2];           /* enum bsq_wrap, of u and v */
    bool srgb;                 /* integers of the image are sRGB, whatever gamma its file names */
};

static inline float bsq_uv_apply(const struct bsq_uv *uv, int axis, float value)
{
    return uv->moves ? uv->scale[axis] * value + uv->offset[axis] : value;
}

/* Returns the width of something that was `width` wide. */
static inline float bsq_uv_width(const struct bsq_uv *uv, int axis, float width)
{
    const float scale = uv->moves ? uv->scale[axis] : 1.0f;
    return scale < 0 ? -scale * width : scale * width;
}

/* ---- the transfer curve of sRGB (IEC 61966-2-1), for tables and reports; clamps to 0..1 ---- */

static inline double bsq_srgb_to_linear(double srgb)
{
    if (!(srgb > 0.0))
        return 0.0;
    if (srgb >= 1.0)
        return 1.0;
    return srgb <= 0.04045 ? srgb / 12.92 : pow((srgb + 0.055) / 1.055, 2.4);
}

static inline double bsq_linear_to_srgb(double linear)
{
    linear = fmin(fmax(linear, 0.0), 1.0);
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
}

#ifdef __cplusplus
}
#endif
#endif
