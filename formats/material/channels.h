/* channels.h - what a scan has besides its shape: further channels such as roughness, their names
 * and what values mean; ids of its regions; how materials move texture coordinates.
 *
 * A channel is a quantity of the scan's surface that a texture gives, besides its colour. */
#ifndef FMT_MATERIAL_CHANNELS_H
#define FMT_MATERIAL_CHANNELS_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Where materials of glTF files have a channel: members of an object. */
struct fmt_channel_gltf {
    const char *object;  /* a member of the material, an extension, or "" for the material itself;
                            NULL: materials do not have the channel */
    const char *texture; /* its texture */
    const char *factor;  /* its value, or a factor of the texture; NULL: none */
    uint32_t component;  /* of the texture, 0 to 2, for channels with one value */
    float usual;         /* value without both */
};

/* The channel of a scan's normal map in tangent space. It belongs to the scan's normals, so grids
 * do not keep it. */
#define FMT_CHANNEL_NORMAL_MAP "normal_map"

/* What is known of a channel by its name. */
struct fmt_channel {
    const char *name; /* "" for names that the table does not have */
    uint32_t values;  /* 1 or 3 */
    bool color;       /* linear light, which files of integers hold sRGB-encoded; else data */
    /* Statements of MTL files: its texture and its value; NULL: none. */
    const char *mtl_map, *mtl_value;
    const char *mtl_inverse; /* a statement of 1 - value; NULL: none */
    uint32_t component;      /* of a texture, unless the file names another one */
    float usual;             /* the value of what has neither a texture nor a value */
    float neutral;           /* a factor of a texture scales the distance from it */
    struct fmt_channel_gltf gltf;
};

/* Components of a texture. 0 to 2 are red, green and blue. */
enum {
    FMT_CHANNEL_ALPHA = 3,  /* of an image without alpha, the first component */
    FMT_CHANNEL_CUTOUT = 4, /* 1 where alpha is at least the channel's value, else 0 */
    FMT_CHANNEL_COMPONENTS
};

/* Returns whether a component needs the alpha of a texture. */
static inline bool fmt_channel_needs_alpha(uint32_t component)
{
    return component == FMT_CHANNEL_ALPHA || component == FMT_CHANNEL_CUTOUT;
}

/* Returns the row of a name, or that of all other names: three values, data. */
const struct fmt_channel *fmt_channel_find(const char *name);
/* Returns row `number` of the table; NULL after the last. */
const struct fmt_channel *fmt_channel_at(unsigned number);

/* Returns whether a channel can have this name: lower-case letters, digits and underscores, with a
 * letter first. */
bool fmt_is_channel_name(const char *name);
/* Returns whether bisque-bake has another meaning for a name, such as the map "normal", so that the
 * channel could not be baked as a map of its name. */
bool fmt_is_map_name(const char *name);

/* ---- lists: names separated by commas, as in "roughness,emission" ---- */

/* Most values of all channels of a list together. */
enum { FMT_CHANNEL_VALUES_MAX = 65535 };

/* Returns the number of values of all channels of a list of `bytes` bytes; 0 if it is no list of
 * names, or has more than FMT_CHANNEL_VALUES_MAX values. */
uint32_t fmt_channel_list_values(const char *list, uint64_t bytes);
/* Splits a list into its names. Free *names, which has the names too, with bsq_free(). Errors:
 * BSQ_ENOMEM. */
int fmt_channel_list_split(struct bsq_ctx *ctx, const char *list, uint64_t bytes, char ***names,
                           uint32_t *count);
/* Finds the first channel of this name in a list. Sets *first to the number of values before its
 * own. Returns its row, or NULL. */
const struct fmt_channel *fmt_channel_list_find(const char *list, uint64_t bytes, const char *name,
                                                uint32_t *first);

/* ---- ids of the regions of a scan ---- */

/* What ids tell apart. Files store these numbers. */
enum fmt_ids {
    FMT_IDS_NONE,     /* there are no ids */
    FMT_IDS_MATERIAL, /* materials, by name */
    FMT_IDS_OBJECT,   /* objects and groups, by name */
    FMT_IDS_COLOR     /* vertex colours */
};

/* Returns "material", "object" or "color". */
const char *fmt_ids_text(enum fmt_ids ids);

/* Returns the id of a name, a colour that depends on its bytes alone: red in bits 0-7, green in
 * 8-15, blue in 16-23, 255 in 24-31. It is never black. formats/FORMATS.md has the formula. */
uint32_t fmt_name_id(const char *name);

/* ---- texture coordinates: scale, then offset ---- */

/* Beyond an image it repeats, its border texels do, or it is mirrored at each border. */
enum fmt_wrap { FMT_WRAP_REPEAT, FMT_WRAP_CLAMP, FMT_WRAP_MIRROR, FMT_WRAPS };

/* All zero: coordinates stay as they are, and the image repeats. */
struct fmt_uv {
    bool moves;
    float scale[2], offset[2]; /* u, v; finite; used if `moves` is set */
    uint8_t wrap[2];           /* enum fmt_wrap, of u and v */
    bool srgb;                 /* integers of the image are sRGB, whatever gamma its file names */
};

static inline float fmt_uv_apply(const struct fmt_uv *uv, int axis, float value)
{
    return uv->moves ? uv->scale[axis] * value + uv->offset[axis] : value;
}

/* Returns the width of something that was `width` wide. */
static inline float fmt_uv_width(const struct fmt_uv *uv, int axis, float width)
{
    const float scale = uv->moves ? uv->scale[axis] : 1.0f;
    return scale < 0 ? -scale * width : scale * width;
}

#ifdef __cplusplus
}
#endif
#endif
