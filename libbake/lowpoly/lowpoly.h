/* lowpoly.h - the low-poly mesh that maps are baked for. Takes a mesh file with texture
 * coordinates; gives corners with normals, texture coordinates and tangent frames. */
#ifndef BAKE_LOWPOLY_LOWPOLY_H
#define BAKE_LOWPOLY_LOWPOLY_H

#include "formats/mesh/mesh_reader.h"
#include "libbake/bake.h"

struct bake_lowmesh {
    uint64_t triangle_count;
    /* Of each triangle's three corners. */
    double (*positions)[3][3]; /* world space */
    float (*normals)[3][3];    /* unit; from the file, else area-weighted smooth vertex normals */
    float (*texcoords)[3][2];  /* OBJ convention: v upwards; clamped to finite floats */
    float (*tangents)[3][4];   /* MikkTSpace; w is the sign of the bitangent */
    float (*directions)[3][3]; /* of rays, outwards: unit; with a cage, the way to its corner */
    double cage_distance;      /* of the farthest corner of the cage; 0: there is no cage */
    double bounds_min[3], bounds_max[3];
};

struct bake_lowmesh_options {
    const char *path;
    const char *cage_path; /* NULL: no cage */
    enum bake_rays rays;   /* without a cage */
};

/* Loads a mesh file, fills in missing normals and computes tangents and ray directions. Free *out
 * with bake_lowmesh_free(). Errors: those of fmt_mesh_load(); BSQ_EDATA with the line of the first
 * face that has no texture coordinates, or whose corners differ from the cage's, or for too many
 * triangles; BSQ_ENOMEM, BSQ_EINTR. */
int bake_lowmesh_load(struct bsq_ctx *ctx, const struct bake_lowmesh_options *options,
                      struct bake_lowmesh *out);
/* A zeroed mesh is allowed. */
void bake_lowmesh_free(struct bsq_ctx *ctx, struct bake_lowmesh *mesh);

#endif
