/* shading.h - what a scan is like at a point of one of its triangles: its colour, its normal map,
 * further channels such as roughness, and ids.
 *
 * Takes an open chunk file, and what is wanted of it. Each attribute has a source for each
 * material: a texture or a value. Gives attributes filtered over a box in texture space. Colours of
 * vertices are the caller's, which interpolates them as it does normals. */
#ifndef FMT_SHADING_SHADING_H
#define FMT_SHADING_SHADING_H

#include "formats/material/channels.h"
#include "formats/chunks/tris.h"

/* Numbers of attributes. Further channels follow. */
enum { FMT_SHADING_COLOR, FMT_SHADING_NORMAL_MAP, FMT_SHADING_CHANNELS };

struct fmt_attribute {
    const struct fmt_channel *row; /* how many values it has, and whether they are a colour */
    /* Of each material, then of triangles without one. NULL: the attribute is not used. Colours
     * have their textures here, and other values in `diffuse`. */
    struct fmt_tris_source *sources;
};

/* Begin with the first four members and zeros. */
struct fmt_shading {
    struct bsq_ctx *ctx;
    const char *path; /* of the scan, for messages */
    const struct fmt_tris_file *file;
    const struct fmt_tris_header *header;
    struct fmt_attribute *attributes;
    uint32_t attribute_count; /* 0, or at least FMT_SHADING_CHANNELS */
    uint64_t attribute_capacity;
    double (*diffuse)[3]; /* colours of materials in linear light; NULL: colours are not used */
    uint32_t *ids; /* of each material, then of triangles without one; NULL: they are not used */
    struct fmt_textures *textures; /* NULL: nothing comes from textures */
};

/* Make an attribute available, each at most once and before the textures are opened. A path is that
 * of an image for all triangles, and must live as long as the shading; if it is NULL, materials of
 * the chunk file have the sources. Colours and normal maps that the scan lacks are ignored. Errors:
 * BSQ_EDATA for a scan without the channel, or without the texture coordinates that an image needs;
 * BSQ_ENOMEM. */
int fmt_shading_add_color(struct fmt_shading *shading);
int fmt_shading_add_normal_map(struct fmt_shading *shading, const char *path);
int fmt_shading_add_channel(struct fmt_shading *shading, const char *name, const char *path);
/* Makes ids available. The scan must have some. Errors: BSQ_ENOMEM. */
int fmt_shading_add_ids(struct fmt_shading *shading);

/* Lists the names that ids by name stand for: ascending, each once. Free *names with bsq_free(),
 * also after a failure; the names are the header's. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int fmt_shading_id_names(struct bsq_ctx *ctx, const struct fmt_tris_header *header,
                         const char ***names, uint64_t *count);

/* Returns whether some attribute of some material comes from a texture. */
bool fmt_shading_needs_textures(const struct fmt_shading *shading);
/* Opens the textures of all attributes, if there are any, with a cache of this size. Until then,
 * attributes have values only. Not from parallel work. Errors: those of fmt_textures_open(). */
int fmt_shading_open_textures(struct fmt_shading *shading, uint64_t cache_bytes);
/* Warns of tiles of textures that are missing, and of textures with texels that are not finite,
 * each once. Not from parallel work. Errors: BSQ_EDATA in a strict job. */
int fmt_shading_tell_losses(const struct fmt_shading *shading);
void fmt_shading_close(struct fmt_shading *shading); /* zeros are allowed */

/* ---- triangles ---- */

/* Returns a triangle's material; the number of materials if it has none. */
static inline uint32_t fmt_shading_material(const struct fmt_shading *shading,
                                            const struct fmt_tris_chunk *chunk, uint32_t triangle)
{
    const uint32_t none = shading->header->material_count;
    const uint32_t material = chunk->materials ? chunk->materials[triangle] : none;
    return material < none ? material : none;
}

/* Returns the colour of a material without a texture; NULL if it has none. */
static inline const double *fmt_shading_diffuse(const struct fmt_shading *shading,
                                                uint32_t material)
{
    const struct fmt_tris_header *header = shading->header;
    return material < header->material_count && shading->diffuse &&
                   !header->materials[material].colorless
               ? shading->diffuse[material]
               : NULL;
}

/* Returns whether an attribute of a material comes from a texture. */
static inline bool fmt_shading_is_textured(const struct fmt_shading *shading, uint32_t attribute,
                                           uint32_t material)
{
    return shading->textures && shading->attributes[attribute].sources &&
           shading->attributes[attribute].sources[material].texture_path;
}

/* Returns whether colours of vertices multiply the texture of a material. */
static inline bool fmt_shading_is_tinted(const struct fmt_shading *shading, uint32_t material)
{
    const struct fmt_tris_header *header = shading->header;
    return material < header->material_count && header->materials[material].tinted;
}

/* Returns the id of a point of a triangle: that of its material's name or, if ids are colours, the
 * colour of the corner with the largest weight, the first of several; 0 without vertex colours. */
uint32_t fmt_shade_id(const struct fmt_shading *shading, const struct fmt_tris_chunk *chunk,
                      uint32_t triangle, const double weights[3]);

/* A box in texture space, before materials move it. */
struct fmt_shading_footprint {
    float at[2], width[2]; /* centre; full widths */
    uint32_t material;     /* as fmt_shading_material() returns it */
};

/* Sets three values of an attribute that is used; if it has one value, three times this one.
 * Thread-safe. Errors: those of fmt_texture_sample(). */
int fmt_shade_attribute(const struct fmt_shading *shading, uint32_t attribute,
                        const struct fmt_shading_footprint *footprint, float out[3]);

#endif
