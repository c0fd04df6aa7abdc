/* shade.h - what a scan says of the points of a triangle: normal and colour. */
#ifndef VOX_SHADE_H
#define VOX_SHADE_H

#include "formats/texture.h"
#include "libvoxel/region.h"
#include "libvoxel/scan_chunks.h"

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

enum vox_color_source {
    VOX_COLOR_NONE,
    VOX_COLOR_DIFFUSE, /* corner 0 holds it */
    VOX_COLOR_VERTEX,
    VOX_COLOR_TEXTURE
};

/* A triangle's attributes at its corners. */
struct vox_corners {
    double flat[3]; /* unit normal of its plane, zero where it has no area */
    bool has_normals;
    bool curved; /* the triangle is so large that its plane differs from the surface they describe */
    double normal[3][3]; /* unit, or zero */
    enum vox_color_source color_source;
    double rgb[3][3]; /* linear light */
    double uv[3][2];
    uint32_t image;
};

/* Looks up the attributes of a triangle of the chunk, except for `flat`. */
void vox_shade_corners(const struct vox_shading *shading, const struct vox_chunk *chunk,
                       uint32_t triangle, struct vox_corners *out);

/* Interpolated normal of a triangle that has normals, at the weights b of struct vox_piece. */
void vox_shade_normal(const struct vox_corners *corners, const double b[2], double normal[3]);

/* Colour in linear light of a piece of a triangle that has a colour source; its centroid is at the
 * weights b. uv_extent: widths of the piece in texture space. Errors: those of
 * fmt_texture_sample(). */
int vox_shade_color(const struct vox_shading *shading, const struct vox_corners *corners,
                    const double b[2], const double uv_extent[2], double rgb[3]);

#endif
