/* lowpoly.h - the low mesh: corners with normals, texture coordinates and tangent frames. */
#ifndef BAKE_LOWPOLY_LOWPOLY_H
#define BAKE_LOWPOLY_LOWPOLY_H

#include "formats/mesh/obj.h"

struct bake_lowmesh {
    uint64_t triangle_count;
    double (*positions)[3][3]; /* per triangle, three corners, world space */
    float (*normals)[3][3];    /* unit; from the file, else area-weighted smooth vertex normals */
    float (*texcoords)[3][2];  /* OBJ convention: v upwards */
    float (*tangents)[3][4];   /* MikkTSpace; w is the bitangent's sign */
    double bounds_min[3], bounds_max[3];
};

/* Loads an OBJ, fills in missing normals and computes tangents. A file whose faces have no texture
 * coordinates is BSQ_EDATA with the line of the first such face. Free with bake_lowmesh_free(). */
int bake_lowmesh_load(struct bsq_ctx *ctx, const char *path, struct bake_lowmesh *out);
void bake_lowmesh_free(struct bsq_ctx *ctx, struct bake_lowmesh *mesh);

#endif
