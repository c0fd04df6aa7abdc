/* glb.h - writes a mesh and its textures as a GLB file, glTF 2.0.
 *
 * Takes vertices, indices and PNG files; gives one file that viewers and engines open. Positions
 * are relative to the node's translation, so that large coordinates lose nothing. */
#ifndef FMT_ASSET_GLB_H
#define FMT_ASSET_GLB_H

#include "base/output.h"

/* As in the file, whose vertices are interleaved. v points downwards. */
struct fmt_glb_vertex {
    float position[3], normal[3], tangent[4], texcoord[2];
};

_Static_assert(sizeof(struct fmt_glb_vertex) == 48, "a vertex has no padding");

enum fmt_glb_texture {
    FMT_GLB_BASE_COLOR, /* sRGB; with alpha unless the material is opaque */
    FMT_GLB_NORMAL,     /* tangent space; green points up */
    FMT_GLB_ORM,        /* occlusion in red, roughness in green, metallic in blue */
    FMT_GLB_EMISSION,   /* sRGB */
    FMT_GLB_TEXTURES
};

/* How a viewer uses the alpha of the base colour, as glTF's alphaMode says. */
enum fmt_glb_alpha {
    FMT_GLB_OPAQUE, /* not at all */
    FMT_GLB_MASK,   /* texels with an alpha below 0.5 are not drawn */
    FMT_GLB_BLEND   /* texels hide what is behind the surface as far as alpha says: 1 hides all */
};

struct fmt_glb_material {
    const char *name;                                  /* UTF-8 */
    const struct bsq_file *textures[FMT_GLB_TEXTURES]; /* PNG files, or NULL */
    bool occlusion, roughness, metallic; /* which components of the ORM texture count */
    enum fmt_glb_alpha alpha;
    bool double_sided;     /* its back is drawn too */
    float emission_factor; /* of the texture, with its values from 0 to 1; above 0 */
};

/* Triangles with one material: number i has material i. */
struct fmt_glb_primitive {
    const struct fmt_glb_vertex *vertices; /* or NULL: */
    const float (*shaded)[6];              /* position and normal alone */
    const uint32_t *indices;
    uint32_t vertex_count, index_count; /* both above 0 */
    bool plain;                         /* without a material; such a primitive is the last one */
};

struct fmt_glb {
    const char *name; /* of the node */
    double translation[3];
    const struct fmt_glb_primitive *primitives;
    const struct fmt_glb_material *materials;
    uint32_t primitive_count;
};

/* Writes the file to a new output. Errors: BSQ_EDATA if it would have 4 GiB; BSQ_EIO, BSQ_ENOMEM,
 * BSQ_EINTR. */
int fmt_glb_write(struct bsq_ctx *ctx, const struct fmt_glb *glb, const char *path,
                  struct bsq_output *output);

#endif
