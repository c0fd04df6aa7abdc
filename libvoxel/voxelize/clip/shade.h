/* shade.h - what a scan says of the colour of a triangle. */
#ifndef VOX_VOXELIZE_CLIP_SHADE_H
#define VOX_VOXELIZE_CLIP_SHADE_H

#include "formats/texture/texture.h"
#include "libvoxel/voxelize/records/region.h"
#include "libvoxel/voxelize/cache/chunk_cache.h"

/* Where colour comes from, in order of precedence: the texture of the triangle's material where
 * there are texture coordinates, else vertex colours, else the material's diffuse colour. */
struct vox_shading {
    bool has_color; /* any of these exist in the scan */
    const struct fmt_tris_header *header;
    struct fmt_textures *textures; /* NULL: none are used */
    double (*diffuse)[3];          /* of each material, linear light */
    struct vox_color_tables tables;
};

/* Opens the textures that the scan needs, with a cache of texture_bytes where there are any. */
int vox_shading_init(struct bsq_ctx *ctx, const struct fmt_tris_header *header,
                     uint64_t texture_bytes, struct vox_shading *out);
void vox_shading_free(struct bsq_ctx *ctx, struct vox_shading *shading);
/* Whether any source of colour exists, and whether vox_shading_init() will open textures. */
bool vox_shading_has_color(const struct fmt_tris_header *header);
bool vox_shading_needs_textures(const struct fmt_tris_header *header);

/* Image that colours a triangle of the chunk, UINT32_MAX where it has no texture. */
uint32_t vox_shade_image(const struct vox_shading *shading, const struct vox_chunk *chunk,
                         uint32_t triangle);

/* Colours in linear light at the corners of a triangle without a texture; false where it has none.
 */
bool vox_shade_corners(const struct vox_shading *shading, const struct vox_chunk *chunk,
                       uint32_t triangle, double rgb[3][3]);

/* Colour in linear light of a piece of a triangle with a texture. Its centroid is at the weights b
 * of struct vox_piece. uv: texture coordinates of the corners; uv_extent: widths of the piece in
 * texture space. Errors: those of fmt_texture_sample(). */
int vox_shade_texture(const struct vox_shading *shading, uint32_t image, const double (*uv)[2],
                      const double b[2], const double uv_extent[2], double rgb[3]);

#endif
