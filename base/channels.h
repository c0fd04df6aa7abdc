/* channels.h - further channels of a scan, such as roughness: their names, and what values mean.
 *
 * A channel is a quantity of the scan's surface that a texture gives, besides its colour. */
#ifndef BSQ_CHANNELS_H
#define BSQ_CHANNELS_H

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

/* For a channel with one value, copies one component of a texture's sample to all three entries.
 * Samples of alpha have it three times already. value: that of the channel, for BSQ_CHANNEL_CUTOUT.
 */
void bsq_channel_pick(const struct bsq_channel *channel, uint32_t component, float value,
                      float sample[3]);
/* Applies the factor of a texture to its sample: neutral + factor * (sample - neutral). The third
 * value of a normal map stays as it is. */
void bsq_channel_scale(const struct bsq_channel *channel, const float factor[3], float sample[3]);

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

#ifdef __cplusplus
}
#endif
#endif
