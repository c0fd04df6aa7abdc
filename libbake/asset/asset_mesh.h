/* asset_mesh.h - vertices and indices of an asset; private to this folder. */
#ifndef BAKE_ASSET_ASSET_MESH_H
#define BAKE_ASSET_ASSET_MESH_H

#include "formats/asset/glb.h"
#include "libbake/lowpoly/lowpoly.h"
#include "libbake/udim/udim.h"

struct bake_asset_mesh {
    double centre[3]; /* to which positions are relative */
    struct fmt_glb_primitive *list;
    uint32_t *tiles; /* of each primitive: its number in the udim; not of a plain primitive */
    uint32_t count;
    struct fmt_glb_vertex *vertices; /* of all primitives */
    uint32_t *indices;
    uint64_t vertex_count, index_count;
};

/* Makes a primitive of each UDIM tile, and a plain one of triangles outside of all tiles. Corners
 * with equal values share a vertex. Free *out also after a failure. Errors: BSQ_EDATA, BSQ_ENOMEM,
 * BSQ_EINTR. */
int bake_asset_mesh_create(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                           const struct bake_udim *udim, struct bake_asset_mesh *out);
void bake_asset_mesh_free(struct bsq_ctx *ctx, struct bake_asset_mesh *mesh);

#endif
