/* material.h - lists of materials, as readers of meshes describe them.
 *
 * A material has a colour and further channels. Each has a value, a texture, or both. */
#ifndef FMT_MATERIAL_MATERIAL_H
#define FMT_MATERIAL_MATERIAL_H

#include "formats/material/channels.h"

/* The colour of a material, or a further channel, such as its roughness. */
struct fmt_material_channel {
    const struct fmt_channel *channel; /* a row with a name, or fmt_color_channel */
    bool has_value;
    /* Of the colour, display-referred (sRGB); of further channels that are colours, linear light.
     * Without has_value it is what the material has if another material has the channel. */
    float value[3];
    char *texture_path; /* as the file system finds it; or NULL */
    bool lost_texture;  /* the file names a texture that cannot be used; readers do not set it */
    /* What names it, for messages: "scan.mtl:3" or "scan.gltf"; NULL: nothing, or the texture is a
     * part of the scan's own file. */
    char *texture_place;
    struct fmt_uv uv;
    float factor[3];    /* of the texture, see struct fmt_channel; of colours, in linear light */
    uint32_t component; /* of the texture, see FMT_CHANNEL_ALPHA, for channels with one value */
    const char *loss;   /* what of the channel cannot be used, for a warning; or NULL */
};

/* The row of the colours of materials. Lists of channels do not have it. */
extern const struct fmt_channel fmt_color_channel;

struct fmt_material {
    char *name;
    struct fmt_material_channel color; /* diffuse: 0..1; 0.8 if the file gives none */
    bool tinted;                       /* colours of vertices multiply its texture */
    bool opaque;                       /* the alpha of its texture has no meaning */
    bool cutout; /* it hides what is below the cutoff, and shows the rest whole */
    float cutoff;
    bool double_sided; /* its faces are seen from behind too */
    struct fmt_material_channel *channels;
    uint32_t channel_count;
    char *object; /* that the faces belong to, see fmt_mesh_use_objects(); or NULL */
};

/* All zero at first. */
struct fmt_materials {
    struct fmt_material *list;
    uint32_t count;
    uint64_t capacity;
};

void fmt_materials_free(struct bsq_ctx *ctx, struct fmt_materials *materials);
/* Adds a material to the end of a list: grey, as materials without a colour are. Errors:
 * BSQ_ENOMEM, BSQ_EDATA if there are too many. */
int fmt_materials_add(struct bsq_ctx *ctx, struct fmt_materials *list, struct fmt_material **out);
/* Returns the material's entry for a channel of this name, or NULL. */
struct fmt_material_channel *fmt_material_find_channel(const struct fmt_material *material,
                                                       const char *name);
/* Returns in *out the material's entry for a channel, which is added if there is none. Errors:
 * BSQ_ENOMEM. */
int fmt_material_enter_channel(struct bsq_ctx *ctx, struct fmt_material *material,
                               const struct fmt_channel *channel,
                               struct fmt_material_channel **out);
/* Copies a material, but not its object. Free *out as fmt_materials_free() does. */
int fmt_material_copy(struct bsq_ctx *ctx, const struct fmt_material *from,
                      struct fmt_material *out);
void fmt_material_free(struct bsq_ctx *ctx, struct fmt_material *material);

#endif
