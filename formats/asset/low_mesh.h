/* low_mesh.h - writes a low-poly mesh with normals as an OBJ, PLY or GLB file. */
#ifndef FMT_ASSET_LOW_MESH_H
#define FMT_ASSET_LOW_MESH_H

#include "base/output.h"
#include "formats/chunks/tris.h"

struct fmt_low_mesh {
    const float (*positions)[3];
    const uint32_t (*triangles)[3];
    uint32_t vertex_count, triangle_count;
};

/* Returns whether meshes can be written under this name: it ends in .obj, .ply or .glb. */
bool fmt_low_mesh_path_is_known(const char *path);

/* Writes a mesh to *out, which the caller commits. The origin is the header's. The normal of a
 * corner is the sum of its vertex's triangles whose normals are within `hard_angle` degrees of its
 * own one's, each weighted by its angle there (Thuermer and Wuethrich, "Computing Vertex Normals
 * from Polygonal Facets", 1998). Errors: BSQ_ECANTCREAT, BSQ_EIO, BSQ_ENOMEM, BSQ_EINTR. */
int fmt_low_mesh_write(struct bsq_ctx *ctx, const char *path, const struct fmt_low_mesh *mesh,
                       const struct fmt_tris_header *header, double hard_angle,
                       struct bsq_output **out);

#endif
