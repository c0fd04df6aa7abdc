/* shade.h - the colours of a scan: where they come from, and the colour of a triangle. */
#ifndef VOX_VOXELIZE_CLIP_SHADE_H
#define VOX_VOXELIZE_CLIP_SHADE_H

#include "formats/texture/texture.h"
#include "libvoxel/voxelize/records/region.h"
#include "libvoxel/voxelize/cache/chunk_cache.h"

struct bsq_channel;

struct vox_shading_channel {
    uint32_t number; /* in the header */
    const struct bsq_channel *row;
};

/* Further channels of a scan, such as roughness, that the grid gets. */
struct vox_shading_channels {
    uint32_t count, words; /* channels, and values of all of them */
    struct vox_shading_channel *list;
    double *values; /* of each material, then of triangles without one: `words` values */
    bool *textured; /* of each material: some channel has a texture */
    struct fmt_textures *textures; /* images: those of the first channel by material, and so on;
                                      NULL: none */
};

/* The scan's normal map in tangent space (base/normal_map.h). */
struct vox_shading_normal_map {
    struct fmt_tris_source *sources; /* of each material, then of triangles without one */
    struct fmt_textures *textures;   /* the images of the sources; NULL: there is no map */
};

/* Sources of colour in order of precedence: the texture of the triangle's material, if the scan has
 * texture coordinates; vertex colours; the material's diffuse colour. */
struct vox_shading {
    bool has_color; /* the scan has any of these */
    const struct fmt_tris_header *header;
    struct fmt_textures *textures; /* NULL: no texture is used */
    double (*diffuse)[3];          /* of each material, in linear light */
    uint32_t *ids; /* of each material, then of triangles without one; NULL: not used */
    struct vox_color_tables tables;
    struct vox_shading_channels channels;
    struct vox_shading_normal_map normal_map;
};

/* Warns of tiles of textures that are missing, and of textures with texels that are not finite,
 * each once. Not from parallel work. Errors: BSQ_EDATA in a strict job. */
int vox_shading_tell_losses(const struct vox_shading *shading);

/* Opens the textures that the scan needs, with a cache of texture_bytes if there are any. */
int vox_shading_init(struct bsq_ctx *ctx, const struct fmt_tris_header *header,
                     uint64_t texture_bytes, struct vox_shading *out);
void vox_shading_free(struct bsq_ctx *ctx, struct vox_shading *shading);
/* vox_shading_has_color() returns whether the scan has any colour, vox_shading_needs_textures()
 * whether vox_shading_init() will open textures. */
bool vox_shading_has_color(const struct fmt_tris_header *header);
bool vox_shading_needs_textures(const struct fmt_tris_header *header);

/* Prepares the ids of a scan that has them. */
int vox_shading_use_ids(struct bsq_ctx *ctx, struct vox_shading *shading);
/* Returns the id of a fragment: of its triangle's region or, if ids are colours, of the corner
 * nearest to its centroid. area, moment: as in struct block_fragment. */
uint32_t vox_shade_id(const struct vox_shading *shading, const struct vox_chunk *chunk,
                      uint32_t triangle, double area, const double moment[2]);

/* Prepares the channels of a list (base/channels.h), all of which the scan must have, and opens
 * their textures with a cache of texture_bytes. Errors: BSQ_EDATA, and those of textures. */
int vox_shading_use_channels(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                             const char *list, uint64_t texture_bytes, struct vox_shading *shading);
/* Returns whether channels of a list have textures. */
bool vox_shading_channels_need_textures(const struct fmt_tris_header *header, const char *list);
void vox_shading_channels_free(struct bsq_ctx *ctx, struct vox_shading_channels *channels);

/* Returns whether vox_shading_use_normal_map() will open textures. path: as there. */
bool vox_shading_needs_normal_map(const struct fmt_tris_header *header, const char *path);
/* Opens the scan's normal map: the image `path` or, if that is NULL, those that the chunk file
 * keeps, if any. tris_path is for messages. Errors: BSQ_EDATA for an image without texture
 * coordinates, and those of textures. */
int vox_shading_use_normal_map(struct bsq_ctx *ctx, const char *tris_path, const char *path,
                               uint64_t texture_bytes, struct vox_shading *shading);
void vox_shading_normal_map_free(struct bsq_ctx *ctx, struct vox_shading_normal_map *map);

/* Returns a triangle's material; the number of materials if it has none. */
static inline uint32_t vox_shade_material(const struct vox_shading *shading,
                                          const struct vox_chunk *chunk, uint32_t triangle)
{
    const uint32_t none = shading->header->material_count;
    const uint32_t material = chunk->source.materials ? chunk->source.materials[triangle] : none;
    return material < none ? material : none;
}

/* Returns whether a triangle has a normal map. */
bool vox_shade_has_normal_map(const struct vox_shading *shading, const struct vox_chunk *chunk,
                              uint32_t triangle);
/* Samples a triangle's normal map over a fragment. uv, b, uv_extent: as for vox_shade_texture().
 * Errors: those of fmt_texture_sample(). */
int vox_shade_normal_map(const struct vox_shading *shading, const struct vox_chunk *chunk,
                         uint32_t triangle, const double (*uv)[2], const double b[2],
                         const double uv_extent[2], float texel[3]);

/* Returns whether channels of a triangle come from textures. */
bool vox_shade_has_textures(const struct vox_shading *shading, const struct vox_chunk *chunk,
                            uint32_t triangle);
/* Returns the values of a triangle's channels without their textures. */
const double *vox_shade_channels(const struct vox_shading *shading, const struct vox_chunk *chunk,
                                 uint32_t triangle);
/* Sets the values of a fragment's channels. uv, b, uv_extent: as for vox_shade_texture(). Errors:
 * those of fmt_texture_sample(). */
int vox_shade_channel_textures(const struct vox_shading *shading, const struct vox_chunk *chunk,
                               uint32_t triangle, const double (*uv)[2], const double b[2],
                               const double uv_extent[2], double *out);

/* Returns the image that colours a triangle of the chunk, UINT32_MAX if it has no texture. */
uint32_t vox_shade_image(const struct vox_shading *shading, const struct vox_chunk *chunk,
                         uint32_t triangle);

/* Sets the colours, in linear light, at the corners of a triangle without a texture. Returns false
 * if the triangle has no colour. */
bool vox_shade_corners(const struct vox_shading *shading, const struct vox_chunk *chunk,
                       uint32_t triangle, double rgb[3][3]);

/* Sets the colour, in linear light, of a fragment of a triangle with a texture. b: corner weights
 * of its centroid, as in struct vox_fragment. uv: texture coordinates of the corners. uv_extent:
 * size of the fragment in texture space. Errors: those of fmt_texture_sample(). */
int vox_shade_texture(const struct vox_shading *shading, uint32_t image, const double (*uv)[2],
                      const double b[2], const double uv_extent[2], double rgb[3]);

/* Samples an image alike, through the scale and offset of its texture coordinates. */
int vox_sample_fragment(struct fmt_textures *textures, uint32_t image, const struct bsq_uv *moved,
                        const double (*uv)[2], const double b[2], const double uv_extent[2],
                        float out[3]);

#endif
